// Rays against scenes of few primitives: those that a work-item takes against one primitive after the other. That is a loop over
// rays, which becomes vector instructions, in place of a walk through a hierarchy, which doesn't.
#pragma once
#include "analytic.h"
#include "paths.h"

#define RAYS 16  // taken together, so few that the corners as they see them stay in the cache

// Rays, member by member.
typedef struct {
    float origin_x[RAYS], origin_y[RAYS], origin_z[RAYS];
    float direction_x[RAYS], direction_y[RAYS], direction_z[RAYS];
    uint axis[RAYS];                                      // along which |direction| is largest
    float shear_x[RAYS], shear_y[RAYS], shear_z[RAYS];    // Woop's, of the axes after that one, and of that one
    uint starts_on[RAYS], ends_on[RAYS];                  // primitives that the ray does not meet
    float t_max[RAYS];                                    // of the nearest hit so far; below 0 there is no ray
    float u[RAYS], v[RAYS];
    uint primitive[RAYS];
} Rays;

// The scene's triangles. Corners that several share are looked at once.
typedef struct {
    __global const float* corners;
    __global const uint* triangles;  // three corners each
    uint corner_count, triangle_count;
    __global const Analytic* analytics;
    uint analytic_count;
} Primitives;

#define EACH_RAY(ray) AS_VECTOR for (uint ray = 0; ray < RAYS; ++ray)

// The component of a vector along an axis, or the first or second axis after it.
INLINE float along_axis(Vec3 v, uint axis)
{
    return axis == 0u ? v.x : axis == 1u ? v.y : v.z;
}

INLINE float after_axis(Vec3 v, uint axis)
{
    return axis == 0u ? v.y : axis == 1u ? v.z : v.x;
}

INLINE float before_axis(Vec3 v, uint axis)
{
    return axis == 0u ? v.z : axis == 1u ? v.x : v.y;
}

INLINE void set_ray(Rays* rays, uint ray, Vec3 origin, Vec3 direction, uint starts_on, uint ends_on, float t_max)
{
    const Vec3 size = abs3(direction);
    const uint axis = size.x > size.y ? (size.x > size.z ? 0u : 2u) : (size.y > size.z ? 1u : 2u);
    const float scale = 1.0f / along_axis(direction, axis);
    rays->axis[ray] = axis;
    rays->shear_x[ray] = after_axis(direction, axis) * scale;
    rays->shear_y[ray] = before_axis(direction, axis) * scale;
    rays->shear_z[ray] = scale;
    rays->origin_x[ray] = origin.x;
    rays->origin_y[ray] = origin.y;
    rays->origin_z[ray] = origin.z;
    rays->direction_x[ray] = direction.x;
    rays->direction_y[ray] = direction.y;
    rays->direction_z[ray] = direction.z;
    rays->starts_on[ray] = starts_on;
    rays->ends_on[ray] = ends_on;
    rays->t_max[ray] = t_max;
    rays->u[ray] = rays->v[ray] = 0.0f;
    rays->primitive[ray] = NONE;
}

#if FEATURE_TRIANGLES
// A corner as a ray sees it: from its origin, sheared so that it looks along z.
typedef struct {
    float x[RAYS], y[RAYS], z[RAYS];
} SeenCorner;

INLINE void see_corner(const Rays* rays, uint ray, Vec3 corner, SeenCorner* seen)
{
    const uint axis = rays->axis[ray];
    const Vec3 arm = sub3(corner, vec3(rays->origin_x[ray], rays->origin_y[ray], rays->origin_z[ray]));
    const float z = along_axis(arm, axis);
    seen->x[ray] = after_axis(arm, axis) - rays->shear_x[ray] * z;
    seen->y[ray] = before_axis(arm, axis) - rays->shear_y[ray] * z;
    seen->z[ray] = z;
}

// A ray against a triangle, as `triangles_met` of bvh.h has it, to the bit. There the first two axes change places for negative
// directions; that changes the sign of all edge functions and of nothing else.
INLINE void meet_triangle(Rays* rays, uint ray, const SeenCorner* a, const SeenCorner* b, const SeenCorner* c, uint triangle)
{
    const float edge_a = c->x[ray] * b->y[ray] - c->y[ray] * b->x[ray];
    const float edge_b = a->x[ray] * c->y[ray] - a->y[ray] * c->x[ray];
    const float edge_c = b->x[ray] * a->y[ray] - b->y[ray] * a->x[ray];
    const float lowest = LESSER(LESSER(edge_a, edge_b), edge_c), highest = GREATER(GREATER(edge_a, edge_b), edge_c);
    const float determinant = edge_a + edge_b + edge_c, inverse = 1.0f / determinant;
    const float t = (edge_a * a->z[ray] + edge_b * b->z[ray] + edge_c * c->z[ray]) * rays->shear_z[ray] * inverse;
    const bool met = ((lowest >= 0.0f) | (highest <= 0.0f)) & (determinant != 0.0f) & (t > 0.0f) & (t < rays->t_max[ray]) &
                     (triangle != rays->starts_on[ray]) & (triangle != rays->ends_on[ray]);
    // written whether met or not: what was written for some lanes alone is slow to be read again
    rays->t_max[ray] = met ? t : rays->t_max[ray];
    rays->u[ray] = met ? edge_b * inverse : rays->u[ray];
    rays->v[ray] = met ? edge_c * inverse : rays->v[ray];
    rays->primitive[ray] = met ? triangle : rays->primitive[ray];
}
#endif

#if FEATURE_ANALYTICS
INLINE void meet_analytic(Rays* rays, uint ray, __global const Analytic* analytics, uint index)
{
    const Vec3 origin = vec3(rays->origin_x[ray], rays->origin_y[ray], rays->origin_z[ray]);
    const Vec3 direction = vec3(rays->direction_x[ray], rays->direction_y[ray], rays->direction_z[ray]);
    const float t_max = rays->t_max[ray];
    const float t = analytic_distance(analytics, index, origin, direction, rays->starts_on[ray], rays->ends_on[ray], t_max);
    rays->t_max[ray] = t < t_max ? t : t_max;
    rays->primitive[ray] = t < t_max ? ANALYTIC_BIT | index : rays->primitive[ray];
}
#endif

// All rays against all primitives: the nearest that each meets.
INLINE void meet_all(Rays* rays, const Primitives* all)
{
#if FEATURE_TRIANGLES
    SeenCorner seen[MOST_CORNERS];
    for (uint k = 0; k < all->corner_count; ++k) {
        const Vec3 corner = LOAD3(k, all->corners);
        EACH_RAY(ray) see_corner(rays, ray, corner, seen + k);
    }
    for (uint k = 0; k < all->triangle_count; ++k) {
        __global const uint* corners = all->triangles + 3u * k;
        const SeenCorner *a = seen + corners[0], *b = seen + corners[1], *c = seen + corners[2];
        EACH_RAY(ray) meet_triangle(rays, ray, a, b, c, k);
    }
#endif
#if FEATURE_ANALYTICS
    for (uint k = 0; k < all->analytic_count; ++k) {
        EACH_RAY(ray) meet_analytic(rays, ray, all->analytics, k);
    }
#endif
}
