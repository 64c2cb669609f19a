// Stage: the shadow rays that shade has left; what arrives unblocked is added to the path's sample.
// Reads shadow_origin (w: bits of the primitive it ends on), shadow_direction (w: length in units of the direction, 0 for none),
// shadow_radiance, hit (the primitive it starts on); adds to samples.
#include "traverse.h"

INLINE bool blocked(Walk* walk, ulong* stack, __global const float8* nodes, __global const float8* blocks, uint first_analytic,
                    __global const Analytic* analytics, float t_max)
{
    for (uint leaf; (leaf = next_leaf(walk, stack, nodes, blocks, t_max, false)) != NO_LEAF;) {
#if FEATURE_TRIANGLES
        float8 t, u, v;
        if (leaf < first_analytic && triangles_met(blocks + leaf, &walk->ray, walk->skip, t_max, &t, &u, &v))
            return true;
#endif
#if FEATURE_ANALYTICS
        if (leaf >= first_analytic &&
            analytic_distance(analytics, leaf - first_analytic, walk->ray.origin, walk->ray.direction, walk->skip, t_max) < t_max)
            return true;
#endif
    }
    return false;
}

__kernel void shadow(uint paths, uint rays_per_item, __global const float8* nodes, __global const float8* blocks, uint first_analytic,
                     __global const Analytic* analytics, __global const float4* shadow_origin,
                     __global const float4* shadow_direction,
                     __global const float4* shadow_radiance, __global const float4* hit, __global const uint4* path,
                     __global float* samples
#if FEATURE_INSTANCES
                     , __global const Instance* instances, uint first_instance, __global const uint* instance
#endif
                     )
{
    const uint first = get_global_id(0) * rays_per_item, end = LESSER(first + rays_per_item, paths);
    for (uint i = first; i < end; ++i) {
        const float4 direction = shadow_direction[i];
        const float t_max = direction.w;
        if (t_max == 0.0f) continue;
        // not with its fourth lane, which is a denormal number to arithmetic on four
        const float3 origin = LOAD3(0, (__global const float*)(shadow_origin + i));
        const uint target = ((__global const uint*)(shadow_origin + i))[3];
        Walk walk;
#if FEATURE_INSTANCES
        walk.instances = instances;
        walk.first_instance = first_instance;
        walk.start = instance[i];
#endif
        ulong stack[STACK_SIZE];
        begin_walk(&walk, stack, origin, direction.xyz, (uint2)(as_uint(hit[i].w), target));
        if (blocked(&walk, stack, nodes, blocks, first_analytic, analytics, t_max)) continue;
        const uint sample = path[i].x;
        store3(LOAD3(sample, samples) + shadow_radiance[i].xyz, sample, samples);
    }
}
