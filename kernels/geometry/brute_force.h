// Rays against scenes of few primitives: those that a work-item takes against one primitive after the other. That is a loop over
// rays, which becomes vector instructions, in place of a walk through a hierarchy, which doesn't.
#pragma once
#include "geometry/analytic.h"
#include "path/path_state.h"

#define PACKET_SIZE 16  // taken together, so few that the corners as they see them stay in the cache

// Rays, member by member.
typedef struct {
    float origin_x[PACKET_SIZE], origin_y[PACKET_SIZE], origin_z[PACKET_SIZE];
    float direction_x[PACKET_SIZE], direction_y[PACKET_SIZE], direction_z[PACKET_SIZE];
    uint axis[PACKET_SIZE];                                      // along which |direction| is largest
    float shear_x[PACKET_SIZE], shear_y[PACKET_SIZE], shear_z[PACKET_SIZE];    // Woop's, of the axes after that one, and of that one
    uint skip_start[PACKET_SIZE], skip_end[PACKET_SIZE];                  // primitives that the ray does not meet
    float t_max[PACKET_SIZE];                                    // of the nearest hit so far; below 0 there is no ray
    float u[PACKET_SIZE], v[PACKET_SIZE];
    uint primitive[PACKET_SIZE];
} RayPacket;

// The scene's triangles. Corners that several share are looked at once.
typedef struct {
    __global const float* corners;
    __global const uint* triangles;  // three corners each
    uint corner_count, triangle_count;
    __global const Analytic* analytics;
    uint analytic_count;
} Primitives;

#define FOR_RAYS(ray) VECTORIZE for (uint ray = 0; ray < PACKET_SIZE; ++ray)

// The component of a vector along an axis, or the first or second axis after it.
INLINE float component(Vec3 v, uint axis)
{
    return axis == 0u ? v.x : axis == 1u ? v.y : v.z;
}

INLINE float component_after(Vec3 v, uint axis)
{
    return axis == 0u ? v.y : axis == 1u ? v.z : v.x;
}

INLINE float component_before(Vec3 v, uint axis)
{
    return axis == 0u ? v.z : axis == 1u ? v.x : v.y;
}

INLINE void set_ray(RayPacket* packet, uint ray, Vec3 origin, Vec3 direction, uint skip_start, uint skip_end, float t_max)
{
    const Vec3 size = abs3(direction);
    const uint axis = size.x > size.y ? (size.x > size.z ? 0u : 2u) : (size.y > size.z ? 1u : 2u);
    const float scale = 1.0f / component(direction, axis);
    packet->axis[ray] = axis;
    packet->shear_x[ray] = component_after(direction, axis) * scale;
    packet->shear_y[ray] = component_before(direction, axis) * scale;
    packet->shear_z[ray] = scale;
    packet->origin_x[ray] = origin.x;
    packet->origin_y[ray] = origin.y;
    packet->origin_z[ray] = origin.z;
    packet->direction_x[ray] = direction.x;
    packet->direction_y[ray] = direction.y;
    packet->direction_z[ray] = direction.z;
    packet->skip_start[ray] = skip_start;
    packet->skip_end[ray] = skip_end;
    packet->t_max[ray] = t_max;
    packet->u[ray] = packet->v[ray] = 0.0f;
    packet->primitive[ray] = NONE;
}

#if FEATURE_TRIANGLES
// A corner as a ray sees it: from its origin, sheared so that it looks along z.
typedef struct {
    float x[PACKET_SIZE], y[PACKET_SIZE], z[PACKET_SIZE];
} ShearedVertex;

INLINE void shear_vertex(const RayPacket* packet, uint ray, Vec3 corner, ShearedVertex* sheared)
{
    const uint axis = packet->axis[ray];
    const Vec3 arm = sub3(corner, vec3(packet->origin_x[ray], packet->origin_y[ray], packet->origin_z[ray]));
    const float z = component(arm, axis);
    sheared->x[ray] = component_after(arm, axis) - packet->shear_x[ray] * z;
    sheared->y[ray] = component_before(arm, axis) - packet->shear_y[ray] * z;
    sheared->z[ray] = z;
}

// A ray against a triangle, as `intersect_triangle_block` of geometry/bvh.h has it, to the bit. There the first two axes change places for negative
// directions; that changes the sign of all edge functions and of nothing else.
INLINE void intersect_triangle(RayPacket* packet, uint ray, const ShearedVertex* a, const ShearedVertex* b, const ShearedVertex* c, uint triangle)
{
    const float edge_a = c->x[ray] * b->y[ray] - c->y[ray] * b->x[ray];
    const float edge_b = a->x[ray] * c->y[ray] - a->y[ray] * c->x[ray];
    const float edge_c = b->x[ray] * a->y[ray] - b->y[ray] * a->x[ray];
    const float lowest = MIN(MIN(edge_a, edge_b), edge_c), highest = MAX(MAX(edge_a, edge_b), edge_c);
    const float determinant = edge_a + edge_b + edge_c, inverse = 1.0f / determinant;
    const float t = (edge_a * a->z[ray] + edge_b * b->z[ray] + edge_c * c->z[ray]) * packet->shear_z[ray] * inverse;
    const bool hit = ((lowest >= 0.0f) | (highest <= 0.0f)) & (determinant != 0.0f) & (t > 0.0f) & (t < packet->t_max[ray]) &
                     (triangle != packet->skip_start[ray]) & (triangle != packet->skip_end[ray]);
    // written whether met or not: what was written for some lanes alone is slow to be read again
    packet->t_max[ray] = hit ? t : packet->t_max[ray];
    packet->u[ray] = hit ? edge_b * inverse : packet->u[ray];
    packet->v[ray] = hit ? edge_c * inverse : packet->v[ray];
    packet->primitive[ray] = hit ? triangle : packet->primitive[ray];
}
#endif

#if FEATURE_ANALYTICS
INLINE void intersect_analytic(RayPacket* packet, uint ray, __global const Analytic* analytics, uint index)
{
    const Vec3 origin = vec3(packet->origin_x[ray], packet->origin_y[ray], packet->origin_z[ray]);
    const Vec3 direction = vec3(packet->direction_x[ray], packet->direction_y[ray], packet->direction_z[ray]);
    const float t_max = packet->t_max[ray];
    const float t = analytic_distance(analytics, index, origin, direction, packet->skip_start[ray], packet->skip_end[ray], t_max);
    packet->t_max[ray] = t < t_max ? t : t_max;
    packet->primitive[ray] = t < t_max ? ANALYTIC_BIT | index : packet->primitive[ray];
}
#endif

// All rays against all primitives: the nearest that each meets.
INLINE void intersect_all(RayPacket* packet, const Primitives* all)
{
#if FEATURE_TRIANGLES
    ShearedVertex sheared[MAX_CORNERS];
    for (uint k = 0; k < all->corner_count; ++k) {
        const Vec3 corner = LOAD3(k, all->corners);
        FOR_RAYS(ray) shear_vertex(packet, ray, corner, sheared + k);
    }
    for (uint k = 0; k < all->triangle_count; ++k) {
        __global const uint* corners = all->triangles + 3u * k;
        const ShearedVertex *a = sheared + corners[0], *b = sheared + corners[1], *c = sheared + corners[2];
        FOR_RAYS(ray) intersect_triangle(packet, ray, a, b, c, k);
    }
#endif
#if FEATURE_ANALYTICS
    for (uint k = 0; k < all->analytic_count; ++k) {
        FOR_RAYS(ray) intersect_analytic(packet, ray, all->analytics, k);
    }
#endif
}
