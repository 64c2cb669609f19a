// Stage: shadow, of scenes of few primitives. What it reads and writes is told in shadow.cl.
#include "few.h"

__kernel void shadow(uint paths, uint pool, __global const float* corners, uint corner_count,
                     __global const uint* corner_numbers, uint triangle_count,
                     __global const Analytic* analytics, uint analytic_count,
                     __global const float* shadow_origin, __global const float* shadow_direction,
                     __global const float* shadow_radiance, __global const float* hit,
                     __global const uint* path, __global float* samples)
{
    const Primitives all = {corners, corner_numbers, corner_count, triangle_count, analytics, analytic_count};
    // not every path has a shadow ray: those that have one are listed
    uint from[LANES + RAYS], count = 0u;
    for (size_t i = get_global_id(0) * LANES, end = LESSER(i + LANES, (size_t)paths); i < end; ++i) {
        from[count] = (uint)i;
        count += PLANE(3, shadow_direction, pool)[i] > 0.0f ? 1u : 0u;
    }
    for (uint k = count; k < count + RAYS; ++k) from[k] = from[0];
    for (uint first = 0; first < count; first += RAYS) {
        Rays rays;
        EACH_RAY(ray) {
            const size_t i = from[first + ray];
            const Vec4 origin = load_planes4(shadow_origin, i, pool), direction = load_planes4(shadow_direction, i, pool);
            set_ray(&rays, ray, xyz(origin), xyz(direction), as_uint(PLANE(3, hit, pool)[i]), as_uint(origin.w),
                    first + ray < count ? direction.w : -1.0f);
        }
        meet_all(&rays, &all);
        EACH_RAY(ray) {
            const size_t i = from[first + ray];
            if (first + ray >= count || rays.primitive[ray] != NONE) continue;
            const uint sample = PLANE(PATH_SAMPLE, path, pool)[i];
            ADD3(load_planes3(shadow_radiance, i, pool), sample, samples);
        }
    }
}
