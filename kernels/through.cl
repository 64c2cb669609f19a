// Stage: in place of `shadow`, where light goes through surfaces and media on its way. What arrives is added to the path's sample.
// Reads shadow_origin (w: bits of the primitive it ends on), shadow_direction (w: length in units of the direction, 0 for none),
// shadow_radiance (w: the medium it starts in), hit (the primitive it starts on); adds to samples.
//
// What surfaces let through is a product: it is taken over all of them in whatever order they are met, and one that lets nothing
// through ends the search. The medium behind a boundary holds to the next one, so these are put in order first. Summing
// distance * (sigma before - sigma behind) would need no order, but would cancel where a thin layer of a dense medium is far away,
// and go wrong where a scene does not name the media of both sides, which paths, that walk from one to the next, need not know.
#include "medium.h"
#include "through.h"
#include "traverse.h"

typedef struct {
    Vec3 share;  // of the light that gets through the surfaces met so far
#if FEATURE_MEDIA
    float passed;  // boundaries up to there are done with,
    uint medium;   // and this one is behind them
    bool again;    // the search is another one, for more boundaries: the surfaces' share is known
    Boundaries boundaries;
#endif
} Passage;

#if FEATURE_MEDIA
// Goes on to `distance`, in units of `length`, within one medium; and from boundary to boundary.
INLINE void fly_through(Passage* p, __global const Medium* media, float distance, float length)
{
    if (p->medium != MEDIUM_NONE) p->share = mul3(p->share, transmittance(media + p->medium, (distance - p->passed) * length));
    p->passed = distance;
}

INLINE void walk_media(Passage* p, __global const Medium* media, float length)
{
    for (uint k = 0u; k < p->boundaries.count; ++k) {
        fly_through(p, media, p->boundaries.distance[k], length);
        p->medium = p->boundaries.behind[k];
    }
}
#endif

// Takes what was met into the passage. Returns whether light still goes on.
INLINE bool pass(const Geometry* g, __global const Bsdf* bsdfs, const Surface* s, Vec3 direction, float t, Passage* p)
{
#if FEATURE_MEDIA
    if (s->media != NONE && t > p->passed) enter_boundary(&p->boundaries, t, medium_behind(s, direction, MEDIUM_NONE));
    if (p->again) return true;
#endif
    Shading at;
    at.bsdfs = bsdfs;
    at.bsdf = s->bsdf;
    at.normal = s->normal;
    at.wi = neg3(unit(direction));
    at.cos_i = dot3(at.normal, at.wi);
#if FEATURE_TEXTURES
    at.textures = &g->textures;
    at.point = texture_point(s);
#endif
    p->share = mul3(p->share, straight_share(&at));
    return largest(p->share) > 0.0f;
}

__kernel void through(uint paths, uint pool, __global const float8* nodes, __global const float8* blocks, uint first_analytic,
                      __global const float* triangles, __global const uint* faces,
                      __global const float* corner_normals,
#if FEATURE_UVS
                      __global const float* uvs,
#endif
#if FEATURE_TEXTURES
                      __global const Texture* textures, __global const uchar* texel_bytes,
                      __global const float* texel_floats, __global const float* srgb, __global const float* attributes,
#endif
                      __global const Analytic* analytics, __global const Shape* shapes, __global const Bsdf* bsdfs,
                      __global const float* shadow_origin, __global const float* shadow_direction,
                      __global const float* shadow_radiance, __global const float* hit, __global const uint* path,
                      __global float* samples
#if FEATURE_MEDIA
                      , __global const Medium* media, float4 scene_sphere
#endif
#if FEATURE_INSTANCES
                      , __global const Instance* instances, uint first_instance, __global const uint* instance
#endif
                      )
{
    const uint i = get_global_id(0);
    if (i >= paths) return;
    const Vec3 direction = load_planes3(shadow_direction, i, pool), origin = load_planes3(shadow_origin, i, pool);
    const float t_max = PLANE(3, shadow_direction, pool)[i];
    if (t_max == 0.0f) return;
    Geometry geometry;
    geometry.triangles = triangles;
    geometry.faces = faces;
    geometry.corner_normals = corner_normals;
    geometry.analytics = analytics;
    geometry.shapes = shapes;
#if FEATURE_UVS
    geometry.uvs = uvs;
#endif
#if FEATURE_TEXTURES
    const Textures all_textures = {textures, texel_bytes, texel_floats, srgb, attributes, faces};
    geometry.textures = all_textures;
#endif
    Passage passage;
    passage.share = all3(1.0f);
#if FEATURE_MEDIA
    passage.passed = 0.0f;
    passage.again = false;
    passage.boundaries.count = 0u;
    passage.medium = as_uint(PLANE(3, shadow_radiance, pool)[i]);
    const float length = SQRT(dot3(direction, direction));
#endif

    Walk walk;
#if FEATURE_INSTANCES
    walk.instances = instances;
    walk.first_instance = first_instance;
    walk.start = instance[i];
#endif
    ulong stack[STACK_SIZE];
    const uint2 skip = (uint2)(as_uint(PLANE(3, hit, pool)[i]), as_uint(PLANE(3, shadow_origin, pool)[i]));
    begin_walk(&walk, stack, origin, direction, skip);
    for (;;) {
        const uint leaf = next_leaf(&walk, stack, nodes, blocks, t_max, false);
        if (leaf == NO_LEAF) {
#if FEATURE_MEDIA
            const bool more = passage.boundaries.count == MOST_BOUNDARIES;
            walk_media(&passage, media, length);
            if (more) {
                passage.again = true;
                passage.boundaries.count = 0u;
                begin_walk(&walk, stack, origin, direction, skip);
                continue;
            }
            float end_of_flight = t_max;
            if (t_max == INFINITY) {  // within a medium without end, lights of infinite distance are where Mitsuba 3 has them
                const Vec3 arm = sub3(origin, vec3(scene_sphere.x, scene_sphere.y, scene_sphere.z));
                end_of_flight = GREATER(2.0f * GREATER(scene_sphere.w, SQRT(dot3(arm, arm))), passage.passed);
            }
            fly_through(&passage, media, end_of_flight, length);
#endif
            break;
        }
#if FEATURE_TRIANGLES
        if (leaf < first_analytic) {
            __global const float8* block = blocks + leaf;
            Lanes t, u, v;
            for (uint met = triangles_met(block, &walk.ray, walk.skip, t_max, &t.all, &u.all, &v.all); met; met &= met - 1u) {
                const uint lane = lowest_bit(met), primitive = ((__global const uint*)(block + 9))[lane];
                const uint flags = as_uint(triangles[TRIANGLE_FLOATS * primitive + 11u]);
                if (!(flags & SHAPE_SEE_THROUGH)) return;
#if FEATURE_INSTANCES
                const Surface s = instanced_surface_at(&geometry, instances, walk.inside, primitive, origin, direction,
                                                       t.lane[lane], u.lane[lane], v.lane[lane]);
#else
                const Surface s = triangle_surface(&geometry, primitive, u.lane[lane], v.lane[lane]);
#endif
                if (!pass(&geometry, bsdfs, &s, direction, t.lane[lane], &passage)) return;
            }
        }
#endif
#if FEATURE_ANALYTICS
        if (leaf >= first_analytic) {
            const uint index = leaf - first_analytic;
            const Vec3 towards = unpacked(walk.ray.direction);
            Vec3 from = unpacked(walk.ray.origin);
            float t = 0.0f;
            for (uint crossing = 0u; crossing < 2u; ++crossing) {  // into a sphere or a cylinder, and out of it
                const float on = analytic_distance(analytics, index, from, towards, walk.skip.x, walk.skip.y, t_max - t);
                t += on;
                if (!(t < t_max)) break;
                if (!(shapes[analytics[index].shape].flags & SHAPE_SEE_THROUGH)) return;
                Surface s = analytic_surface(&geometry, index, from, towards, on);
                from = leave(&s, towards);
#if FEATURE_INSTANCES
                s = instanced_surface_at(&geometry, instances, walk.inside, ANALYTIC_BIT | index, origin, direction, t,
                                         0.0f, 0.0f);
#endif
                if (!pass(&geometry, bsdfs, &s, direction, t, &passage)) return;
            }
        }
#endif
    }
    const uint sample = PLANE(PATH_SAMPLE, path, pool)[i];
    ADD3(mul3(passage.share, load_planes3(shadow_radiance, i, pool)), sample, samples);
}
