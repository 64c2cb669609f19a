// Stage: replaces shadow.cl in scenes of few primitives. It reads and writes the same buffers.
#include "geometry/brute_force.h"

__kernel void shadow(
#include "generated/shadow_brute_force_parameters.h"
)
{
    const Primitives primitives = {corners, corner_indices, corner_count, triangle_count, analytics, analytic_count};
    // compact the paths that have a shadow ray; the last packet is filled up with copies of the first
    uint slots[LANES + PACKET_SIZE], count = 0u;
    for (size_t i = get_global_id(0) * LANES, end = MIN(i + LANES, (size_t)path_count); i < end; ++i) {
        slots[count] = (uint)i;
        count += PLANE(3, shadow_direction, plane_stride)[i] > 0.0f ? 1u : 0u;
    }
    for (uint k = count; k < count + PACKET_SIZE; ++k) slots[k] = slots[0];
    for (uint first = 0; first < count; first += PACKET_SIZE) {
        RayPacket packet;
        FOR_RAYS(ray) {
            const size_t i = slots[first + ray];
            const Vec4 origin = load_planes4(shadow_origin, i, plane_stride);
            const Vec4 direction = load_planes4(shadow_direction, i, plane_stride);
            set_ray(&packet, ray, xyz(origin), xyz(direction), as_uint(PLANE(3, hit, plane_stride)[i]),
                    as_uint(origin.w), first + ray < count ? direction.w : -1.0f);
        }
        intersect_all(&packet, &primitives);
        FOR_RAYS(ray) {
            const size_t i = slots[first + ray];
            if (first + ray >= count || packet.primitive[ray] != NONE) continue;
            const uint sample = PLANE(PATH_SAMPLE, path_ids, plane_stride)[i];
            ADD3(load_planes3(shadow_radiance, i, plane_stride), sample, samples);
        }
    }
}
