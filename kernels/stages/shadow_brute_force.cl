// Stage: shadow, of scenes of few primitives. What it reads and writes is told in stages/shadow.cl.
#include "geometry/brute_force.h"

__kernel void shadow(
#include "generated/shadow_brute_force_parameters.h"
)
{
    const Primitives all = {corners, corner_indices, corner_count, triangle_count, analytics, analytic_count};
    // not every path has a shadow ray: those that have one are listed
    uint from[LANES + PACKET_SIZE], count = 0u;
    for (size_t i = get_global_id(0) * LANES, end = MIN(i + LANES, (size_t)path_count); i < end; ++i) {
        from[count] = (uint)i;
        count += PLANE(3, shadow_direction, plane_stride)[i] > 0.0f ? 1u : 0u;
    }
    for (uint k = count; k < count + PACKET_SIZE; ++k) from[k] = from[0];
    for (uint first = 0; first < count; first += PACKET_SIZE) {
        RayPacket packet;
        FOR_RAYS(ray) {
            const size_t i = from[first + ray];
            const Vec4 origin = load_planes4(shadow_origin, i, plane_stride), direction = load_planes4(shadow_direction, i, plane_stride);
            set_ray(&packet, ray, xyz(origin), xyz(direction), as_uint(PLANE(3, hit, plane_stride)[i]), as_uint(origin.w),
                    first + ray < count ? direction.w : -1.0f);
        }
        intersect_all(&packet, &all);
        FOR_RAYS(ray) {
            const size_t i = from[first + ray];
            if (first + ray >= count || packet.primitive[ray] != NONE) continue;
            const uint sample = PLANE(PATH_SAMPLE, path, plane_stride)[i];
            ADD3(load_planes3(shadow_radiance, i, plane_stride), sample, samples);
        }
    }
}
