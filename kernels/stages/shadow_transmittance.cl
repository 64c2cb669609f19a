// Stage: in place of `shadow`, where light goes through surfaces and media on its way. What arrives is added to the path's sample.
// Reads shadow_origin (w: bits of the primitive it ends on), shadow_direction (w: length in units of the direction, 0 for none),
// shadow_radiance (w: the medium it starts in), hit (the primitive it starts on); adds to samples.
//
// What surfaces let through is a product: it is taken over all of them in whatever order they are met, and one that lets nothing
// through ends the search. The medium behind a boundary holds to the next one, so these are put in order first. Summing
// distance * (sigma before - sigma behind) would need no order, but would cancel where a thin layer of a dense medium is far away,
// and go wrong where a scene does not name the media of both sides, which paths, that walk from one to the next, need not know.
#include "media/medium.h"
#include "bsdf/pass_through.h"
#include "geometry/traverse.h"

typedef struct {
    Vec3 attenuation;  // of the light that gets through the surfaces met so far
#if FEATURE_MEDIA
    float distance_done;  // boundaries up to there are done with,
    uint medium;   // and this one is behind them
    bool again;    // the search is another one, for more boundaries: the surfaces' share is known
    MediumInterfaces interfaces;
#endif
} ShadowState;

#if FEATURE_MEDIA
// Goes on to `distance`, in units of `length`, within one medium; and from boundary to boundary.
INLINE void attenuate_medium(ShadowState* shadow, __global const Medium* media, float distance, float length)
{
    if (shadow->medium != MEDIUM_NONE) shadow->attenuation = mul3(shadow->attenuation, medium_transmittance(media + shadow->medium, (distance - shadow->distance_done) * length));
    shadow->distance_done = distance;
}

INLINE void attenuate_interfaces(ShadowState* shadow, __global const Medium* media, float length)
{
    for (uint k = 0u; k < shadow->interfaces.count; ++k) {
        attenuate_medium(shadow, media, shadow->interfaces.distance[k], length);
        shadow->medium = shadow->interfaces.medium[k];
    }
}
#endif

// Takes what was met into the passage. Returns whether light still goes on.
INLINE bool attenuate(const SceneView* scene, __global const Bsdf* bsdfs, const Surface* s, Vec3 direction, float t, ShadowState* shadow)
{
#if FEATURE_MEDIA
    if (s->media != NONE && t > shadow->distance_done) insert_medium_interface(&shadow->interfaces, t, medium_towards(s, direction, MEDIUM_NONE));
    if (shadow->again) return true;
#endif
    BsdfContext ctx;
    ctx.bsdfs = bsdfs;
    ctx.bsdf = s->bsdf;
    ctx.normal = s->normal;
    ctx.wi = neg3(normalize3(direction));
    ctx.cos_i = dot3(ctx.normal, ctx.wi);
#if FEATURE_TEXTURES
    ctx.textures = &scene->textures;
    ctx.point = texture_point(s);
#endif
    shadow->attenuation = mul3(shadow->attenuation, pass_through_transmittance(&ctx));
    return max_component3(shadow->attenuation) > 0.0f;
}

__kernel void shadow_transmittance(
#include "generated/shadow_transmittance_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= path_count) return;
    const Vec3 direction = load_planes3(shadow_direction, i, plane_stride), origin = load_planes3(shadow_origin, i, plane_stride);
    const float t_max = PLANE(3, shadow_direction, plane_stride)[i];
    if (t_max == 0.0f) return;
    SceneView scene;
#include "generated/shadow_transmittance_scene_view.h"
    ShadowState shadow;
    shadow.attenuation = splat3(1.0f);
#if FEATURE_MEDIA
    shadow.distance_done = 0.0f;
    shadow.again = false;
    shadow.interfaces.count = 0u;
    shadow.medium = as_uint(PLANE(3, shadow_radiance, plane_stride)[i]);
    const float length = SQRT(dot3(direction, direction));
#endif

    Traversal traversal;
#if FEATURE_INSTANCES
    traversal.instances = instances;
    traversal.first_instance = first_instance;
    traversal.start_instance = instance[i];
#endif
    ulong stack[STACK_SIZE];
    const uint2 skip = (uint2)(as_uint(PLANE(3, hit, plane_stride)[i]), as_uint(PLANE(3, shadow_origin, plane_stride)[i]));
    begin_traversal(&traversal, stack, origin, direction, skip);
    for (;;) {
        const uint leaf = next_leaf(&traversal, stack, nodes, blocks, t_max, false);
        if (leaf == NO_LEAF) {
#if FEATURE_MEDIA
            const bool more = shadow.interfaces.count == MAX_MEDIUM_INTERFACES;
            attenuate_interfaces(&shadow, media, length);
            if (more) {
                shadow.again = true;
                shadow.interfaces.count = 0u;
                begin_traversal(&traversal, stack, origin, direction, skip);
                continue;
            }
            float end_of_flight = t_max;
            if (t_max == INFINITY) {  // within a medium without end, lights of infinite distance are where Mitsuba 3 has them
                const Vec3 arm = sub3(origin, vec3(scene_sphere.x, scene_sphere.y, scene_sphere.z));
                end_of_flight = MAX(2.0f * MAX(scene_sphere.w, SQRT(dot3(arm, arm))), shadow.distance_done);
            }
            attenuate_medium(&shadow, media, end_of_flight, length);
#endif
            break;
        }
#if FEATURE_TRIANGLES
        if (leaf < first_analytic) {
            __global const float8* block = blocks + leaf;
            Float8Lanes t, u, v;
            for (uint hits = intersect_triangle_block(block, &traversal.ray, traversal.skip, t_max, &t.vector, &u.vector, &v.vector); hits; hits &= hits - 1u) {
                const uint lane = lowest_set_bit(hits), primitive = ((__global const uint*)(block + 9))[lane];
                const uint flags = as_uint(triangles[TRIANGLE_FLOATS * primitive + 11u]);
                if (!(flags & SHAPE_PASS_THROUGH)) return;
#if FEATURE_INSTANCES
                const Surface s = instanced_surface_of_hit(&scene, traversal.instance, primitive, origin, direction,
                                                       t.lane[lane], u.lane[lane], v.lane[lane]);
#else
                const Surface s = triangle_surface(&scene, primitive, u.lane[lane], v.lane[lane]);
#endif
                if (!attenuate(&scene, bsdfs, &s, direction, t.lane[lane], &shadow)) return;
            }
        }
#endif
#if FEATURE_ANALYTICS
        if (leaf >= first_analytic) {
            const uint index = leaf - first_analytic;
            const Vec3 towards = from_float4(traversal.ray.direction);
            Vec3 from = from_float4(traversal.ray.origin);
            float t = 0.0f;
            for (uint crossing = 0u; crossing < 2u; ++crossing) {  // into a sphere or a cylinder, and out of it
                const float on = analytic_distance(analytics, index, from, towards, traversal.skip.x, traversal.skip.y, t_max - t);
                t += on;
                if (!(t < t_max)) break;
                if (!(shapes[analytics[index].shape].flags & SHAPE_PASS_THROUGH)) return;
                Surface s = analytic_surface(&scene, index, from, towards, on);
                from = spawn_origin(&s, towards);
#if FEATURE_INSTANCES
                s = instanced_surface_of_hit(&scene, traversal.instance, ANALYTIC_BIT | index, origin, direction, t,
                                         0.0f, 0.0f);
#endif
                if (!attenuate(&scene, bsdfs, &s, direction, t, &shadow)) return;
            }
        }
#endif
    }
    const uint sample = PLANE(PATH_SAMPLE, path, plane_stride)[i];
    ADD3(mul3(shadow.attenuation, load_planes3(shadow_radiance, i, plane_stride)), sample, samples);
}
