// Ray intersection of spheres, disks and cylinders. Used by both intersectors (BVH and brute force).
#pragma once
#include "util/math.h"

#define ANALYTIC_BIT 0x80000000u  // set in a primitive number whose other bits are an index into `analytics`

// Set in the number of the triangle that a shadow ray ends on if it ends on the next triangle too, because both are one
// light.
#define TWO_TRIANGLES_BIT 0x40000000u

#if FEATURE_SPHERES
// The discriminant from the distance of the centre to the line, the smaller root from the product of the roots.
// Haines et al., "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, 2019.
INLINE float sphere_distance(Vec3 origin, Vec3 direction, Vec3 center, float radius, float t_max)
{
    const Vec3 f = sub3(origin, center);
    const float a = dot3(direction, direction), b = -dot3(f, direction);
    const Vec3 closest = add3(f, scale3(direction, b / a));
    const float discriminant = radius * radius - dot3(closest, closest);
    if (discriminant < 0.0f) return INFINITY;
    const float length_f = SQRT(dot3(f, f));
    const float c = (length_f - radius) * (length_f + radius);
    const float q = b + copy_sign(SQRT(a * discriminant), b);
    const float t0 = c / q, t1 = q / a;
    const float near = MIN(t0, t1), far = MAX(t0, t1);
    const float t = near > 0.0f ? near : far;
    return t > 0.0f && t < t_max ? t : INFINITY;
}
#endif

#if FEATURE_DISKS
INLINE float disk_distance(Vec3 origin, Vec3 direction, float t_max)
{
    const float t = -origin.z / direction.z;
    const float x = origin.x + t * direction.x, y = origin.y + t * direction.y;
    return t > 0.0f && t < t_max && x * x + y * y <= 1.0f ? t : INFINITY;
}
#endif

#if FEATURE_CYLINDERS
INLINE float cylinder_distance(Vec3 origin, Vec3 direction, float t_max)
{
    const Vec2 o = vec2(origin.x, origin.y), d = vec2(direction.x, direction.y);
    const float a = dot2(d, d), b = -dot2(o, d);
    if (a == 0.0f) return INFINITY;
    const Vec2 closest = add2(o, scale2(d, b / a));
    const float discriminant = 1.0f - dot2(closest, closest);
    if (discriminant < 0.0f) return INFINITY;
    const float distance = SQRT(dot2(o, o));
    const float c = (distance - 1.0f) * (distance + 1.0f);
    const float q = b + copy_sign(SQRT(a * discriminant), b);
    const float roots[2] = {MIN(c / q, q / a), MAX(c / q, q / a)};
#pragma unroll
    for (int i = 0; i < 2; ++i) {
        const float t = roots[i], z = origin.z + t * direction.z;
        if (t > 0.0f && t < t_max && z >= 0.0f && z <= 1.0f) return t;
    }
    return INFINITY;
}
#endif

#if FEATURE_ANALYTICS
// Distance along the ray to an analytic primitive; INFINITY if there is no hit in (0, t_max).
// `start_primitive`, `end_primitive`: what the ray starts and ends on. A ray that starts or ends on a disk cannot hit
// it. A shadow ray that ends on a sphere or cylinder is not tested against it: `sample_light` sets end_primitive only
// if the shape does not occlude its own point, and far away rounding would say it does. A ray that starts on one may
// hit its far side; there the offset of the ray origin avoids false hits.
INLINE float analytic_distance(__global const Analytic* analytics, uint index, Vec3 origin, Vec3 direction,
                               uint start_primitive, uint end_primitive, float t_max)
{
    __global const Analytic* shape = analytics + index;
    if (end_primitive == (ANALYTIC_BIT | index)) return INFINITY;
#if FEATURE_SPHERES
    if (shape->kind & ANALYTIC_SPHERE)
        return sphere_distance(origin, direction, LOAD3(0, shape->center), shape->radius, t_max);
#endif
#if FEATURE_DISKS || FEATURE_CYLINDERS
    float to_object[12];
    load_matrix(shape->to_object, to_object);
    // affine: distances along the ray stay the same in object space
    const Vec3 o = transform_point(to_object, origin), d = transform_direction(to_object, direction);
#endif
#if FEATURE_DISKS
    if (shape->kind & ANALYTIC_DISK)
        return start_primitive == (ANALYTIC_BIT | index) ? INFINITY : disk_distance(o, d, t_max);
#endif
#if FEATURE_CYLINDERS
    if (shape->kind & ANALYTIC_CYLINDER) return cylinder_distance(o, d, t_max);
#endif
    return INFINITY;
}
#endif
