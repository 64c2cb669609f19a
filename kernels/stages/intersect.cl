// Stage: the closest surface along the ray of every path.
// Reads ray_origin, ray_direction, path (the primitive that the ray starts on); writes hit = (t, u, v, primitive bits).
// With instances: reads in which one the ray starts, writes in which one it ends; NONE is the world.
// To measure: writes how many nodes and blocks of triangles each ray was tested against.
#include "geometry/traverse.h"

__kernel void intersect(
#include "generated/intersect_parameters.h"
)
{
    const uint first = get_global_id(0) * rays_per_item, end = MIN(first + rays_per_item, path_count);
    for (uint i = first; i < end; ++i) {
        const Vec4 origin = load_planes4(ray_origin, i, plane_stride);
        Traversal traversal;
#if FEATURE_INSTANCES
        traversal.instances = instances;
        traversal.first_instance = first_instance;
        traversal.start_instance = instance[i];
        uint hit_instance = NONE;
#endif
        ulong stack[STACK_SIZE];
        begin_traversal(&traversal, stack, xyz(origin), load_planes3(ray_direction, i, plane_stride),
                   (uint2)(PLANE(PATH_START_PRIMITIVE, path, plane_stride)[i], NONE));

        float t_max = origin.w, hit_u = 0.0f, hit_v = 0.0f;
        uint primitive = NONE;
#if FEATURE_COUNT_TESTS
        uint blocks_tested = 0u;
#endif
        for (uint leaf; (leaf = next_leaf(&traversal, stack, nodes, blocks, t_max, true)) != NO_LEAF;) {
#if FEATURE_TRIANGLES
            if (leaf < first_analytic) {
#if FEATURE_COUNT_TESTS
                ++blocks_tested;
#endif
                __global const float8* block = blocks + leaf;
                float8 t8, u8, v8;
                uint hits = intersect_triangle_block(block, &traversal.ray, traversal.skip, t_max, &t8, &u8, &v8);
                if (!hits) continue;
                Float8Lanes t, u, v;
                t.vector = t8;
                u.vector = u8;
                v.vector = v8;
                for (; hits; hits &= hits - 1u) {
                    const uint lane = lowest_set_bit(hits);
                    if (t.lane[lane] < t_max) {
                        t_max = t.lane[lane];
                        hit_u = u.lane[lane];
                        hit_v = v.lane[lane];
                        primitive = ((__global const uint*)(block + 9))[lane];
#if FEATURE_INSTANCES
                        hit_instance = traversal.instance;
#endif
                    }
                }
            }
#endif
#if FEATURE_ANALYTICS
            if (leaf >= first_analytic) {
                const uint index = leaf - first_analytic;
                const float t = intersect_analytic_leaf(&traversal, analytics, index, t_max);
                if (t < t_max) {
                    t_max = t;
                    primitive = ANALYTIC_BIT | index;
#if FEATURE_INSTANCES
                    hit_instance = traversal.instance;
#endif
                }
            }
#endif
        }
        store_planes4(vec4(t_max, hit_u, hit_v, as_float(primitive)), hit, i, plane_stride);
#if FEATURE_INSTANCES
        instance[i] = hit_instance;
#endif
#if FEATURE_COUNT_TESTS
        tests[i] = (uint2)(traversal.nodes_tested, blocks_tested);
#endif
    }
}
