// Stage: intersect, of scenes of few primitives. What it reads and writes is told in intersect.cl.
#include "few.h"

__kernel void intersect(uint paths, uint pool, __global const float* corners, uint corner_count,
                        __global const uint* corner_numbers, uint triangle_count,
                        __global const Analytic* analytics, uint analytic_count,
                        __global const float* ray_origin, __global const float* ray_direction,
                        __global const uint* path, __global float* hit)
{
    const Primitives all = {corners, corner_numbers, corner_count, triangle_count, analytics, analytic_count};
    for (size_t first = get_global_id(0) * LANES, end = first + LANES; first < end; first += RAYS) {
        if (first >= paths) return;
        Rays rays;
        EACH_RAY(ray) {
            const size_t i = first + ray;
            Vec4 origin = vec4(0.0f, 0.0f, 0.0f, -1.0f);
            Vec3 direction = all3(1.0f);
            uint start = NONE;
            if (i < paths) {
                origin = load_planes4(ray_origin, i, pool);
                direction = load_planes3(ray_direction, i, pool);
                start = PLANE(PATH_START, path, pool)[i];
            }
            set_ray(&rays, ray, xyz(origin), direction, start, NONE, origin.w);
        }
        meet_all(&rays, &all);
        EACH_RAY(ray) {
            const size_t i = first + ray;
            const Vec4 met = vec4(rays.t_max[ray], rays.u[ray], rays.v[ray], as_float(rays.primitive[ray]));
            if (i < paths) store_planes4(met, hit, i, pool);
        }
    }
}
