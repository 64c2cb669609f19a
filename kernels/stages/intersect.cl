// Stage: finds the closest hit of the ray of every path by BVH traversal.
// Reads ray_origin, ray_direction, path_ids (the primitive that the ray starts on); writes hit = (t, u, v, primitive
// bits). With instances: `instance` holds the instance that the ray starts in and receives that of the hit; NONE is the
// world. With COUNT_TESTS: writes how many nodes and triangle blocks each ray was tested against.
#include "geometry/traverse.h"

typedef struct {
    float t, u, v;
    uint primitive;  // NONE without a hit; then t is the length of the ray
#if FEATURE_INSTANCES
    uint instance;
#endif
} ClosestHit;

#if FEATURE_TRIANGLES
INLINE void update_from_triangles(ClosestHit* closest, const Traversal* traversal, __global const float8* block,
                                  uint part)
{
    FloatLanes all_t, all_u, all_v;
    uint hits = intersect_triangles(block, part, &traversal->ray, traversal->skip, closest->t, &all_t, &all_u, &all_v);
    if (!hits) return;
    LaneNumbers t, u, v;
    t.vector = all_t;
    u.vector = all_u;
    v.vector = all_v;
    for (; hits; hits &= hits - 1u) {
        const uint triangle = lowest_set_bit(hits);
        if (t.lane[triangle] < closest->t) {
            closest->t = t.lane[triangle];
            closest->u = u.lane[triangle];
            closest->v = v.lane[triangle];
            closest->primitive = ((__global const uint*)(block + 9))[part * BVH_LANES + triangle];
#if FEATURE_INSTANCES
            closest->instance = traversal->instance;
#endif
        }
    }
}
#endif

#if FEATURE_ANALYTICS
INLINE void update_from_analytic(ClosestHit* closest, const Traversal* traversal, __global const Analytic* analytics,
                                 uint index)
{
    const float t = intersect_analytic_leaf(traversal, analytics, index, closest->t);
    if (t < closest->t) {
        closest->t = t;
        closest->primitive = ANALYTIC_BIT | index;
#if FEATURE_INSTANCES
        closest->instance = traversal->instance;
#endif
    }
}
#endif

__kernel void intersect(
#include "generated/intersect_parameters.h"
)
{
    const uint first = get_global_id(0) * rays_per_item, end = MIN(first + rays_per_item, path_count);
    for (uint i = first; i < end; ++i) {
        const Vec4 origin = load_planes4(ray_origin, i, plane_stride);
        Traversal traversal;
        ClosestHit closest;
        closest.t = origin.w;
        closest.u = closest.v = 0.0f;
        closest.primitive = NONE;
#if FEATURE_INSTANCES
        traversal.instances = instances;
        traversal.first_instance = first_instance;
        traversal.start_instance = instance[i];
        closest.instance = NONE;
#endif
        ulong stack[STACK_SIZE];
        begin_traversal(&traversal, stack, xyz(origin), load_planes3(ray_direction, i, plane_stride),
                        (uint2)(PLANE(PATH_START_PRIMITIVE, path_ids, plane_stride)[i], NONE));

#if FEATURE_COUNT_TESTS
        uint triangle_blocks_tested = 0u;
#endif
        for (uint leaf; (leaf = next_leaf(&traversal, stack, nodes, triangle_blocks, closest.t, true)) != NO_LEAF;) {
#if FEATURE_COUNT_TESTS
            triangle_blocks_tested += leaf < first_analytic ? 1u : 0u;
#endif
#if FEATURE_TRIANGLES
            if (leaf < first_analytic) {
                NO_UNROLL
                for (uint part = 0u; part < USED_PARTS(triangle_blocks + leaf); ++part)
                    update_from_triangles(&closest, &traversal, triangle_blocks + leaf, part);
            }
#endif
#if FEATURE_ANALYTICS
            if (leaf >= first_analytic) update_from_analytic(&closest, &traversal, analytics, leaf - first_analytic);
#endif
        }
        store_planes4(vec4(closest.t, closest.u, closest.v, as_float(closest.primitive)), hit, i, plane_stride);
#if FEATURE_INSTANCES
        instance[i] = closest.instance;
#endif
#if FEATURE_COUNT_TESTS
        tests[i] = (uint2)(traversal.nodes_tested, triangle_blocks_tested);
#endif
    }
}
