// Stage: the closest surface along the ray of every path.
// Reads ray_origin, ray_direction, path (the primitive that the ray starts on); writes hit = (t, u, v, primitive bits).
// With instances: reads in which one the ray starts, writes in which one it ends; NONE is the world.
// To measure: writes how many nodes and blocks of triangles each ray was tested against.
#include "traverse.h"

__kernel void intersect(uint paths, uint pool, uint rays_per_item, __global const float8* nodes, __global const float8* blocks,
                        uint first_analytic, __global const Analytic* analytics, __global const float* ray_origin,
                        __global const float* ray_direction, __global const uint* path, __global float* hit
#if FEATURE_INSTANCES
                        , __global const Instance* instances, uint first_instance, __global uint* instance
#endif
#if FEATURE_COUNT_TESTS
                        , __global uint2* tests
#endif
                        )
{
    const uint first = get_global_id(0) * rays_per_item, end = LESSER(first + rays_per_item, paths);
    for (uint i = first; i < end; ++i) {
        const Vec4 origin = load_planes4(ray_origin, i, pool);
        Walk walk;
#if FEATURE_INSTANCES
        walk.instances = instances;
        walk.first_instance = first_instance;
        walk.start = instance[i];
        uint hit_instance = NONE;
#endif
        ulong stack[STACK_SIZE];
        begin_walk(&walk, stack, xyz(origin), load_planes3(ray_direction, i, pool),
                   (uint2)(PLANE(PATH_START, path, pool)[i], NONE));

        float t_max = origin.w, hit_u = 0.0f, hit_v = 0.0f;
        uint primitive = NONE;
#if FEATURE_COUNT_TESTS
        uint blocks_tested = 0u;
#endif
        for (uint leaf; (leaf = next_leaf(&walk, stack, nodes, blocks, t_max, true)) != NO_LEAF;) {
#if FEATURE_TRIANGLES
            if (leaf < first_analytic) {
#if FEATURE_COUNT_TESTS
                ++blocks_tested;
#endif
                __global const float8* block = blocks + leaf;
                float8 t8, u8, v8;
                uint met = triangles_met(block, &walk.ray, walk.skip, t_max, &t8, &u8, &v8);
                if (!met) continue;
                Lanes t, u, v;
                t.all = t8;
                u.all = u8;
                v.all = v8;
                for (; met; met &= met - 1u) {
                    const uint lane = lowest_bit(met);
                    if (t.lane[lane] < t_max) {
                        t_max = t.lane[lane];
                        hit_u = u.lane[lane];
                        hit_v = v.lane[lane];
                        primitive = ((__global const uint*)(block + 9))[lane];
#if FEATURE_INSTANCES
                        hit_instance = walk.inside;
#endif
                    }
                }
            }
#endif
#if FEATURE_ANALYTICS
            if (leaf >= first_analytic) {
                const uint index = leaf - first_analytic;
                const float t = leaf_distance(&walk, analytics, index, t_max);
                if (t < t_max) {
                    t_max = t;
                    primitive = ANALYTIC_BIT | index;
#if FEATURE_INSTANCES
                    hit_instance = walk.inside;
#endif
                }
            }
#endif
        }
        store_planes4(vec4(t_max, hit_u, hit_v, as_float(primitive)), hit, i, pool);
#if FEATURE_INSTANCES
        instance[i] = hit_instance;
#endif
#if FEATURE_COUNT_TESTS
        tests[i] = (uint2)(walk.nodes, blocks_tested);
#endif
    }
}
