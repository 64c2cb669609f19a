// Stage: replaces intersect.cl in scenes of few primitives. It reads and writes the same buffers.
#include "geometry/brute_force.h"

__kernel void intersect(
#include "generated/intersect_brute_force_parameters.h"
)
{
    const Primitives primitives = {corners, corner_indices, corner_count, triangle_count, analytics, analytic_count};
    for (size_t first = get_global_id(0) * LANES, end = first + LANES; first < end; first += PACKET_SIZE) {
        if (first >= path_count) return;
        RayPacket packet;
        FOR_RAYS(ray) {
            const size_t i = first + ray;
            Vec4 origin = vec4(0.0f, 0.0f, 0.0f, -1.0f);
            Vec3 direction = splat3(1.0f);
            uint start_primitive = NONE;
            if (i < path_count) {
                origin = load_planes4(ray_origin, i, plane_stride);
                direction = load_planes3(ray_direction, i, plane_stride);
                start_primitive = PLANE(PATH_START_PRIMITIVE, path_ids, plane_stride)[i];
            }
            set_ray(&packet, ray, xyz(origin), direction, start_primitive, NONE, origin.w);
        }
        intersect_all(&packet, &primitives);
        FOR_RAYS(ray) {
            const size_t i = first + ray;
            const Vec4 nearest = vec4(packet.t_max[ray], packet.u[ray], packet.v[ray], as_float(packet.primitive[ray]));
            if (i < path_count) store_planes4(nearest, hit, i, plane_stride);
        }
    }
}
