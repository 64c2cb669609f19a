// Stage: traces the shadow rays that `shade` wrote. Unoccluded light is added to the path's sample.
// Reads shadow_origin (w: bits of the primitive that the ray ends on), shadow_direction (w: length in units of the
// direction, 0 for no ray), shadow_radiance, hit (the primitive that it starts on); adds to samples.
#include "geometry/traverse.h"

INLINE bool is_occluded(Traversal* traversal, ulong* stack, __global const float8* nodes,
                        __global const float8* triangle_blocks, uint first_analytic, __global const Analytic* analytics,
                        float t_max)
{
    for (uint leaf; (leaf = next_leaf(traversal, stack, nodes, triangle_blocks, t_max, false)) != NO_LEAF;) {
#if FEATURE_TRIANGLES
        if (leaf < first_analytic) {
            NO_UNROLL
            for (uint part = 0u; part < USED_PARTS(triangle_blocks + leaf); ++part) {
                FloatLanes t, u, v;
                if (intersect_triangles(triangle_blocks + leaf, part, &traversal->ray, traversal->skip, t_max, &t, &u,
                                        &v))
                    return true;
            }
        }
#endif
#if FEATURE_ANALYTICS
        if (leaf >= first_analytic &&
            intersect_analytic_leaf(traversal, analytics, leaf - first_analytic, t_max) < t_max)
            return true;
#endif
    }
    return false;
}

__kernel void shadow(
#include "generated/shadow_parameters.h"
)
{
    const uint first = get_global_id(0) * rays_per_item, end = MIN(first + rays_per_item, path_count);
    for (uint i = first; i < end; ++i) {
        const Vec4 direction = load_planes4(shadow_direction, i, plane_stride);
        const float t_max = direction.w;
        if (t_max == 0.0f) continue;
        const Vec4 origin = load_planes4(shadow_origin, i, plane_stride);
        Traversal traversal;
#if FEATURE_INSTANCES
        traversal.instances = instances;
        traversal.first_instance = first_instance;
        traversal.start_instance = instance[i];
#endif
        ulong stack[STACK_SIZE];
        begin_traversal(&traversal, stack, xyz(origin), xyz(direction),
                        (uint2)(as_uint(PLANE(3, hit, plane_stride)[i]), as_uint(origin.w)));
        if (is_occluded(&traversal, stack, nodes, triangle_blocks, first_analytic, analytics, t_max)) continue;
        const uint sample = PLANE(PATH_SAMPLE, path_ids, plane_stride)[i];
        ADD3(load_planes3(shadow_radiance, i, plane_stride), sample, samples);
    }
}
