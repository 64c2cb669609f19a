// Stage: the shadow rays that shade has left; what arrives unblocked is added to the path's sample.
// Reads shadow_origin (w: bits of the primitive it ends on), shadow_direction (w: length in units of the direction, 0 for none),
// shadow_radiance, hit (the primitive it starts on); adds to samples.
#include "bvh.h"
#include "paths.h"

__kernel void shadow(uint paths, uint pool, __global const float8* nodes, __global const float8* blocks, uint block_count,
                     __global const Analytic* analytics, __global const float* shadow_origin,
                     __global const float* shadow_direction,
                     __global const float* shadow_radiance, __global const float* hit, __global const uint* path,
                     __global float* samples
#if FEATURE_INSTANCES
                     , __global const Instance* instances, uint first_instance, __global const uint* instance
#endif
                     )
{
    const uint i = get_global_id(0);
    if (i >= paths) return;
    const Vec3 direction = load_planes3(shadow_direction, i, pool);
    const float t_max = PLANE(3, shadow_direction, pool)[i];
    if (t_max == 0.0f) return;
    const Vec3 origin = load_planes3(shadow_origin, i, pool);
    const uint start_primitive = as_uint(PLANE(3, hit, pool)[i]);
    uint2 skip = (uint2)(start_primitive, as_uint(PLANE(3, shadow_origin, pool)[i]));
    Ray ray = make_ray(origin, direction);
#if FEATURE_INSTANCES
    const uint start = instance[i];
    uint inside = NONE, bottom = 0;  // the part of the stack that is of the world
#endif

    int stack[STACK_SIZE];
    uint height = 0;
    int reference = 0;
    for (;;) {
        if (reference >= 0) {
            __global const float8* node = nodes + NODE_STRIDE * reference;
            __global const int* children = (__global const int*)(node + 6);
            float8 entry;
            for (uint met = children_met(node, &ray, t_max, &entry); met; met &= met - 1u)
                stack[height++] = children[lowest_bit(met)];
        } else {
            const uint leaf = (uint)(~reference);
#if FEATURE_INSTANCES
            if (leaf >= first_instance) {
                inside = leaf - first_instance;
                bottom = height;
                skip.x = skip_inside(start_primitive, start, inside);
                ray = make_object_ray(instances + inside, origin, direction);
                reference = (int)instances[inside].root;
                continue;
            }
#endif
#if FEATURE_TRIANGLES
            float8 t, u, v;
            if (leaf < block_count && triangles_met(blocks + BLOCK_STRIDE * leaf, &ray, skip, t_max, &t, &u, &v)) return;
#endif
#if FEATURE_ANALYTICS
            if (leaf >= block_count &&
                analytic_distance(analytics, leaf - block_count, ray.origin, ray.direction, skip.x, skip.y, t_max) < t_max)
                return;
#endif
        }
#if FEATURE_INSTANCES
        if (inside != NONE && height == bottom) {
            inside = NONE;
            ray = make_ray(origin, direction);
        }
#endif
        if (height == 0) break;
        reference = stack[--height];
    }
    const uint sample = path[i];
    ADD3(load_planes3(shadow_radiance, i, pool), sample, samples);
}
