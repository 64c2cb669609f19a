// Stage: replaces `shadow` where light passes through surfaces and media. Attenuated light is added to the path's
// sample. Reads shadow_origin (w: bits of the primitive that the ray ends on), shadow_direction (w: length in units of
// the direction, 0 for no ray), shadow_radiance (w: the medium that it starts in), hit (the primitive that it starts
// on); adds to samples.
//
// The transmittance of surfaces is a product, taken in any order; an opaque surface ends the traversal. The medium
// behind an interface extends to the next one, so interfaces are sorted first. Summing distance * (sigma before - sigma
// behind) would need no order, but it cancels where a thin layer of a dense medium is far away, and it is wrong where a
// scene names the media of one side only. Paths, which go from one interface to the next, do not need those.
#include "media/heterogeneous.h"
#include "media/medium.h"
#include "bsdf/pass_through.h"
#include "geometry/traverse.h"

typedef struct {
    Vec3 attenuation;  // transmittance of the surfaces and media so far
#if FEATURE_MEDIA
    float distance_done;  // interfaces up to there have been applied
    uint medium;          // the medium behind them
    bool media_only;      // a repeated traversal, for further interfaces: surfaces have been applied
    MediumInterfaces interfaces;
#endif
#if FEATURE_HETEROGENEOUS
    RandomStream stream;
#endif
} ShadowState;

#if FEATURE_MEDIA
// Applies the medium up to `distance`, in units of the direction, whose length is `length`.
INLINE void attenuate_medium(ShadowState* shadow, const SceneView* scene, Vec3 origin, Vec3 direction, float distance,
                             float length)
{
    const float begin = shadow->distance_done;
    shadow->distance_done = distance;
    if (shadow->medium == MEDIUM_NONE) return;
#if FEATURE_HETEROGENEOUS
    if (scene->heterogeneous.media[shadow->medium].sigma_t != NONE) {
        const Vec3 unit = scale3(direction, 1.0f / length);
        const Vec4 transmittance =
            heterogeneous_transmittance(&scene->heterogeneous, scene->media, shadow->medium, origin, unit,
                                        begin * length, distance * length, &shadow->stream);
        shadow->attenuation = mul3(shadow->attenuation, xyz(transmittance));
        return;
    }
#endif
    shadow->attenuation =
        mul3(shadow->attenuation, medium_transmittance(scene->media + shadow->medium, (distance - begin) * length));
}

// Applies the interfaces of a finished traversal. Returns whether there may be more of them, which needs another
// traversal; else also applies the medium up to the end of the ray.
INLINE bool attenuate_interfaces(ShadowState* shadow, const SceneView* scene, Vec3 origin, Vec3 direction, float length,
                                 float t_max, float4 scene_sphere)
{
    const bool may_be_more = shadow->interfaces.count == MAX_MEDIUM_INTERFACES;
    for (uint k = 0u; k < shadow->interfaces.count; ++k) {
        attenuate_medium(shadow, scene, origin, direction, shadow->interfaces.distance[k], length);
        shadow->medium = shadow->interfaces.medium[k];
    }
    if (may_be_more) {
        shadow->media_only = true;
        shadow->interfaces.count = 0u;
        return true;
    }
    float end = t_max;
    if (t_max == INFINITY) {  // in an unbounded medium, lights at infinity are at the distance that Mitsuba 3 uses
        const Vec3 to_origin = sub3(origin, vec3(scene_sphere.x, scene_sphere.y, scene_sphere.z));
        end = MAX(2.0f * MAX(scene_sphere.w, SQRT(dot3(to_origin, to_origin))), shadow->distance_done);
    }
    attenuate_medium(shadow, scene, origin, direction, end, length);
    return false;
}
#endif

// Applies a surface hit at distance t. Returns whether any light is left.
INLINE bool attenuate_surface(ShadowState* shadow, const SceneView* scene, const Surface* s, Vec3 direction, float t)
{
#if FEATURE_MEDIA
    if (s->media != NONE && t > shadow->distance_done)
        insert_medium_interface(&shadow->interfaces, t, medium_towards(s, direction, MEDIUM_NONE));
    if (shadow->media_only) return true;
#endif
    BsdfContext ctx;
    ctx.bsdfs = scene->bsdfs;
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

#if FEATURE_TRIANGLES
// Applies the hits in part `part` of a triangle block. Returns whether any light is left.
INLINE bool attenuate_triangles(ShadowState* shadow, const SceneView* scene, const Traversal* traversal,
                                __global const float8* block, uint part, Vec3 origin, Vec3 direction, float t_max)
{
    LaneNumbers t, u, v;
    uint hits =
        intersect_triangles(block, part, &traversal->ray, traversal->skip, t_max, &t.vector, &u.vector, &v.vector);
    for (; hits; hits &= hits - 1u) {
        const uint triangle = lowest_set_bit(hits);
        const uint primitive = ((__global const uint*)(block + 9))[part * BVH_LANES + triangle];
        if (!(Triangle_at(scene->triangles, primitive).flags & SHAPE_PASS_THROUGH)) return false;
#if FEATURE_INSTANCES
        const Surface s = instanced_surface_of_hit(scene, traversal->instance, primitive, origin, direction,
                                                   t.lane[triangle], u.lane[triangle], v.lane[triangle]);
#else
        const Surface s = triangle_surface(scene, primitive, u.lane[triangle], v.lane[triangle]);
#endif
        if (!attenuate_surface(shadow, scene, &s, direction, t.lane[triangle])) return false;
    }
    return true;
}
#endif

#if FEATURE_ANALYTICS
// Applies up to two hits of an analytic shape: where the ray enters a sphere or cylinder and where it leaves. Returns
// whether any light is left.
INLINE bool attenuate_analytic(ShadowState* shadow, const SceneView* scene, const Traversal* traversal, uint index,
                               Vec3 origin, Vec3 direction, float t_max)
{
    const Vec3 object_direction = from_float4(traversal->ray.direction);
    Vec3 object_origin = from_float4(traversal->ray.origin);
    float t = 0.0f;
    for (uint k = 0u; k < 2u; ++k) {
        const float step = analytic_distance(scene->analytics, index, object_origin, object_direction,
                                             traversal->skip.x, traversal->skip.y, t_max - t);
        t += step;
        if (!(t < t_max)) break;
        if (!(scene->shapes[scene->analytics[index].shape].flags & SHAPE_PASS_THROUGH)) return false;
        Surface s = analytic_surface(scene, index, object_origin, object_direction, step);
        object_origin = spawn_origin(&s, object_direction);
#if FEATURE_INSTANCES
        s = instanced_surface_of_hit(scene, traversal->instance, ANALYTIC_BIT | index, origin, direction, t, 0.0f,
                                     0.0f);
#endif
        if (!attenuate_surface(shadow, scene, &s, direction, t)) return false;
    }
    return true;
}
#endif

__kernel void shadow_transmittance(
#include "generated/shadow_transmittance_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= path_count) return;
    const Vec3 direction = load_planes3(shadow_direction, i, plane_stride);
    const Vec3 origin = load_planes3(shadow_origin, i, plane_stride);
    const float t_max = PLANE(3, shadow_direction, plane_stride)[i];
    if (t_max == 0.0f) return;
    SceneView scene;
#include "generated/shadow_transmittance_scene_view.h"
    ShadowState shadow;
    shadow.attenuation = splat3(1.0f);
#if FEATURE_MEDIA
    shadow.distance_done = 0.0f;
    shadow.media_only = false;
    shadow.interfaces.count = 0u;
    shadow.medium = as_uint(PLANE(3, shadow_radiance, plane_stride)[i]);
    const float length = SQRT(dot3(direction, direction));
#endif
#if FEATURE_HETEROGENEOUS
    shadow.stream = random_stream((uint2)(shadow_stream[i], PLANE(1, shadow_stream, plane_stride)[i]), 0u, 0u, 0u);
#endif

    Traversal traversal;
#if FEATURE_INSTANCES
    traversal.instances = instances;
    traversal.first_instance = first_instance;
    traversal.start_instance = instance[i];
#endif
    ulong stack[STACK_SIZE];
    const uint2 skip =
        (uint2)(as_uint(PLANE(3, hit, plane_stride)[i]), as_uint(PLANE(3, shadow_origin, plane_stride)[i]));
    begin_traversal(&traversal, stack, origin, direction, skip);
    for (;;) {
        const uint leaf = next_leaf(&traversal, stack, nodes, triangle_blocks, t_max, false);
        if (leaf == NO_LEAF) {
#if FEATURE_MEDIA
            if (attenuate_interfaces(&shadow, &scene, origin, direction, length, t_max, scene_sphere)) {
                begin_traversal(&traversal, stack, origin, direction, skip);
                continue;
            }
#endif
            break;
        }
#if FEATURE_TRIANGLES
        if (leaf < first_analytic) {
            NO_UNROLL
            for (uint part = 0u; part < USED_PARTS(triangle_blocks + leaf); ++part)
                if (!attenuate_triangles(&shadow, &scene, &traversal, triangle_blocks + leaf, part, origin, direction,
                                         t_max))
                    return;
        }
#endif
#if FEATURE_ANALYTICS
        if (leaf >= first_analytic &&
            !attenuate_analytic(&shadow, &scene, &traversal, leaf - first_analytic, origin, direction, t_max))
            return;
#endif
    }
    const uint sample = PLANE(PATH_SAMPLE, path_ids, plane_stride)[i];
    ADD3(mul3(shadow.attenuation, load_planes3(shadow_radiance, i, plane_stride)), sample, samples);
}
