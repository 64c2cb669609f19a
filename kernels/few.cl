// Stages intersect and shadow of scenes of few primitives; what they read and write is told in intersect.cl and shadow.cl.
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
            const Vec4 origin = load_planes4(ray_origin, i, pool);
            const Vec3 direction = load_planes3(ray_direction, i, pool);
            set_ray(&rays, ray, xyz(origin), direction, PLANE(PATH_START, path, pool)[i], NONE, i < paths ? origin.w : -1.0f);
        }
        meet_all(&rays, &all);
        EACH_RAY(ray) {
            const size_t i = first + ray;
            const Vec4 met = vec4(rays.t_max[ray], rays.u[ray], rays.v[ray], as_float(rays.primitive[ray]));
            if (i < paths) store_planes4(met, hit, i, pool);
        }
    }
}

#if FEATURE_NEXT_EVENT
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
    for (uint k = count; k < count + RAYS; ++k) from[k] = 0u;
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
#endif
