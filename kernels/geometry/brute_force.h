// Brute-force intersection for scenes of few primitives, used by the stages `*_brute_force.cl`: a packet of rays is
// tested against one primitive after the other. LLVM vectorises this loop over rays; it does not vectorise a BVH
// traversal.
#pragma once
#include "geometry/analytic.h"
#include "path/path_state.h"

#define PACKET_SIZE 16  // rays; small enough that the sheared vertices stay in the cache

// Rays and their nearest hits as a struct of arrays.
typedef struct {
    float origin_x[PACKET_SIZE], origin_y[PACKET_SIZE], origin_z[PACKET_SIZE];
    float direction_x[PACKET_SIZE], direction_y[PACKET_SIZE], direction_z[PACKET_SIZE];
    uint axis[PACKET_SIZE];  // along which |direction| is largest
    // Woop's shear constants: x and y belong to the next two axes, z to `axis`
    float shear_x[PACKET_SIZE], shear_y[PACKET_SIZE], shear_z[PACKET_SIZE];
    uint start_primitive[PACKET_SIZE], end_primitive[PACKET_SIZE];  // what the ray starts and ends on: not tested
#if FEATURE_PARALLELOGRAM_LIGHTS
    uint end_triangles[2][PACKET_SIZE];  // the triangles in end_primitive
#endif
    float t_max[PACKET_SIZE];              // of the nearest hit so far; negative for an unused ray
    float u[PACKET_SIZE], v[PACKET_SIZE];  // barycentric coordinates of the second and third corner
    uint primitive[PACKET_SIZE];
} RayPacket;

// The scene's primitives. Corners are shared between triangles, so each is sheared once per ray.
typedef struct {
    __global const float* corners;
    __global const uint* triangles;  // three corner indices each
    uint corner_count, triangle_count;
    __global const Analytic* analytics;
    uint analytic_count;
} Primitives;

#define FOR_RAYS(ray) \
    VECTORIZE         \
    for (uint ray = 0; ray < PACKET_SIZE; ++ray)

// The component of a vector along an axis, the next axis (cyclic), or the previous one.
INLINE float component(Vec3 v, uint axis)
{
    return axis == 0u ? v.x : axis == 1u ? v.y : v.z;
}

INLINE float next_component(Vec3 v, uint axis)
{
    return axis == 0u ? v.y : axis == 1u ? v.z : v.x;
}

INLINE float previous_component(Vec3 v, uint axis)
{
    return axis == 0u ? v.z : axis == 1u ? v.x : v.y;
}

INLINE void set_ray(RayPacket* packet, uint ray, Vec3 origin, Vec3 direction, uint start_primitive, uint end_primitive,
                    float t_max)
{
    const Vec3 magnitude = abs3(direction);
    const uint axis =
        magnitude.x > magnitude.y ? (magnitude.x > magnitude.z ? 0u : 2u) : (magnitude.y > magnitude.z ? 1u : 2u);
    const float scale = 1.0f / component(direction, axis);
    packet->axis[ray] = axis;
    packet->shear_x[ray] = next_component(direction, axis) * scale;
    packet->shear_y[ray] = previous_component(direction, axis) * scale;
    packet->shear_z[ray] = scale;
    packet->origin_x[ray] = origin.x;
    packet->origin_y[ray] = origin.y;
    packet->origin_z[ray] = origin.z;
    packet->direction_x[ray] = direction.x;
    packet->direction_y[ray] = direction.y;
    packet->direction_z[ray] = direction.z;
    packet->start_primitive[ray] = start_primitive;
    packet->end_primitive[ray] = end_primitive;
#if FEATURE_PARALLELOGRAM_LIGHTS
    packet->end_triangles[0][ray] = end_primitive & ~TWO_TRIANGLES_BIT;
    packet->end_triangles[1][ray] =
        (end_primitive & ~TWO_TRIANGLES_BIT) + (end_primitive & TWO_TRIANGLES_BIT ? 1u : 0u);
#endif
    packet->t_max[ray] = t_max;
    packet->u[ray] = packet->v[ray] = 0.0f;
    packet->primitive[ray] = NONE;
}

#if FEATURE_TRIANGLES
// A corner in the ray space of Woop: translated by the ray origin and sheared so that the ray points along z.
typedef struct {
    float x[PACKET_SIZE], y[PACKET_SIZE], z[PACKET_SIZE];
} ShearedVertex;

INLINE void shear_vertex(const RayPacket* packet, uint ray, Vec3 corner, ShearedVertex* sheared)
{
    const uint axis = packet->axis[ray];
    const Vec3 to_corner = sub3(corner, vec3(packet->origin_x[ray], packet->origin_y[ray], packet->origin_z[ray]));
    const float z = component(to_corner, axis);
    sheared->x[ray] = next_component(to_corner, axis) - packet->shear_x[ray] * z;
    sheared->y[ray] = previous_component(to_corner, axis) - packet->shear_y[ray] * z;
    sheared->z[ray] = z;
}

// Bit-identical to `intersect_triangles` in geometry/bvh.h. That one swaps the first two axes for negative
// directions, which changes only the sign of all edge functions.
INLINE void intersect_triangle(RayPacket* packet, uint ray, const ShearedVertex* a, const ShearedVertex* b,
                               const ShearedVertex* c, uint triangle)
{
    const float edge_a = c->x[ray] * b->y[ray] - c->y[ray] * b->x[ray];
    const float edge_b = a->x[ray] * c->y[ray] - a->y[ray] * c->x[ray];
    const float edge_c = b->x[ray] * a->y[ray] - b->y[ray] * a->x[ray];
    const float min_edge = MIN(MIN(edge_a, edge_b), edge_c), max_edge = MAX(MAX(edge_a, edge_b), edge_c);
    const float determinant = edge_a + edge_b + edge_c, inverse = 1.0f / determinant;
    const float t = (edge_a * a->z[ray] + edge_b * b->z[ray] + edge_c * c->z[ray]) * packet->shear_z[ray] * inverse;
    const bool hit = ((min_edge >= 0.0f) | (max_edge <= 0.0f)) & (determinant != 0.0f) & (t > 0.0f) &
                     (t < packet->t_max[ray]) & (triangle != packet->start_primitive[ray]) &
#if FEATURE_PARALLELOGRAM_LIGHTS
                     (triangle != packet->end_triangles[0][ray]) & (triangle != packet->end_triangles[1][ray]);
#else
                     (triangle != packet->end_primitive[ray]);
#endif
    // written for every ray: reading back after a partial (masked) store is slow
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
    const float t = analytic_distance(analytics, index, origin, direction, packet->start_primitive[ray],
                                      packet->end_primitive[ray], t_max);
    packet->t_max[ray] = t < t_max ? t : t_max;
    packet->primitive[ray] = t < t_max ? ANALYTIC_BIT | index : packet->primitive[ray];
}
#endif

// Finds the nearest hit of every ray.
INLINE void intersect_all(RayPacket* packet, const Primitives* primitives)
{
#if FEATURE_TRIANGLES
    ShearedVertex sheared[MAX_CORNERS];
    for (uint k = 0; k < primitives->corner_count; ++k) {
        const Vec3 corner = LOAD3(k, primitives->corners);
        FOR_RAYS(ray) shear_vertex(packet, ray, corner, sheared + k);
    }
    for (uint k = 0; k < primitives->triangle_count; ++k) {
        __global const uint* corners = primitives->triangles + 3u * k;
        const ShearedVertex *a = sheared + corners[0], *b = sheared + corners[1], *c = sheared + corners[2];
        FOR_RAYS(ray) intersect_triangle(packet, ray, a, b, c, k);
    }
#endif
#if FEATURE_ANALYTICS
    for (uint k = 0; k < primitives->analytic_count; ++k) {
        FOR_RAYS(ray) intersect_analytic(packet, ray, primitives->analytics, k);
    }
#endif
}
