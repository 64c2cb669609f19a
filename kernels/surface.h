// From a hit to the surface there: position with its error bound, normals, shape.
#pragma once
#include "instance.h"
#include "vectors.h"

#define GAMMA(n) ((n) * 0x1p-24f / (1.0f - (n) * 0x1p-24f))  // Higham's bound on n rounded operations

typedef struct {
    float3 position, error;   // |true position - position| <= error, per axis
    float3 geometric_normal;  // unit; zero for a triangle without area
    float3 normal;            // unit shading normal
    uint bsdf, light;         // indices; light is NONE if the surface does not shine
} Surface;

// All that describes the surfaces of a scene; members that it does not need are NULL.
typedef struct {
    __global const float4* triangles;  // records of TRIANGLE_ROWS: host/isonoise/scene/structs.py
    __global const uint* faces;
    __global const float* vertex_normals;
    __global const Analytic* analytics;
    __global const Shape* shapes;
} Geometry;

#define TRIANGLE_ROWS 4

#if FEATURE_TRIANGLES
INLINE Surface triangle_surface(const Geometry* g, uint triangle, float u, float v)
{
    __global const float4* record = g->triangles + TRIANGLE_ROWS * triangle;
    const float4 corner = record[0], edge1 = record[1], edge2 = record[2];
    const float3 along1 = u * edge1.xyz, along2 = v * edge2.xyz;
    Surface s;
    s.position = corner.xyz + (along1 + along2);
    // the edges are differences of corners: their rounding is bounded by GAMMA(1) of themselves
    s.error = GAMMA(5) * (abs3(corner.xyz) + abs3(along1) + abs3(along2));
    s.geometric_normal = s.normal = record[3].xyz;
    s.bsdf = as_uint(corner.w) ^ LANE_BIAS;
    s.light = as_uint(edge1.w) ^ LANE_BIAS;
#if FEATURE_VERTEX_NORMALS
    if ((as_uint(edge2.w) ^ LANE_BIAS) & SHAPE_VERTEX_NORMALS) {
        const uint3 index = LOAD3U(triangle, g->faces);
        const float3 interpolated = unit((1.0f - u - v) * LOAD3(index.x, g->vertex_normals) +
                                         u * LOAD3(index.y, g->vertex_normals) + v * LOAD3(index.z, g->vertex_normals));
        s.normal = dot3(interpolated, interpolated) > 0.0f ? interpolated : s.geometric_normal;
    }
#endif
    return s;
}
#endif

#if FEATURE_ANALYTICS
// What a surface point of an analytic shape has from its shape, once position and outward normal are known.
INLINE void complete_analytic(const Geometry* g, uint index, Surface* s)
{
    __global const Shape* shape = g->shapes + g->analytics[index].shape;
    if (shape->flags & SHAPE_FLIP_NORMALS) s->normal = -s->normal;
    s->geometric_normal = s->normal;
    s->bsdf = shape->bsdf;
    s->light = shape->first_light == NONE ? NONE : shape->first_light + (index - shape->first_primitive);
}
#endif

#if FEATURE_SPHERES
INLINE void sphere_surface(__global const Analytic* sphere, float3 outward, Surface* s)
{
    const float3 center = LOAD3(0, sphere->center), arm = sphere->radius * outward;
    s->position = center + arm;
    s->error = GAMMA(6) * (abs3(center) + abs3(arm));
    s->normal = outward;
}
#endif

#if FEATURE_DISKS || FEATURE_CYLINDERS || FEATURE_INSTANCES
// How far a point may be off that was taken from object space to world space and that the intersection stage takes back.
INLINE float3 round_trip_error(const float* to_world, const float* to_object, float3 on_object, float3 in_world)
{
    float m[12], inverse[12];
    for (int i = 0; i < 12; ++i) m[i] = abs1(to_world[i]);
    for (int i = 0; i < 12; ++i) inverse[i] = abs1(to_object[i]);
    return GAMMA(6) * transform_point(m, abs3(on_object)) +
           GAMMA(5) * transform_direction(m, transform_point(inverse, abs3(in_world)));
}
#endif

#if FEATURE_DISKS || FEATURE_CYLINDERS
// A point of object space that lies on the surface exactly, and its normal there, taken to world space.
INLINE void transformed_surface(__global const Analytic* shape, float3 on_shape, float3 shape_normal, Surface* s)
{
    float m[12], inverse[12];
    load_matrix(shape->to_world, m);
    load_matrix(shape->to_object, inverse);
    s->position = transform_point(m, on_shape);
    s->normal = unit(transform_normal(inverse, shape_normal));
    s->error = round_trip_error(m, inverse, on_shape, s->position);
}
#endif

#if FEATURE_ANALYTICS
INLINE Surface analytic_surface(const Geometry* g, uint index, float3 at)
{
    Surface s;
    __global const Analytic* shape = g->analytics + index;
#if FEATURE_SPHERES
    if (shape->kind == ANALYTIC_SPHERE) sphere_surface(shape, unit(at - LOAD3(0, shape->center)), &s);
#endif
#if FEATURE_DISKS || FEATURE_CYLINDERS
    if (shape->kind != ANALYTIC_SPHERE) {
        float to_object[12];
        load_matrix(shape->to_object, to_object);
        float3 on_shape = transform_point(to_object, at);
        float3 shape_normal = (float3)(0.0f, 0.0f, 1.0f);
        if (shape->kind == ANALYTIC_DISK) {
            on_shape.z = 0.0f;
        } else {
            on_shape.xy /= SQRT(dot2(on_shape.xy, on_shape.xy));
            shape_normal = (float3)(on_shape.xy, 0.0f);
        }
        transformed_surface(shape, on_shape, shape_normal, &s);
    }
#endif
    complete_analytic(g, index, &s);
    return s;
}
#endif

// The surface where a ray met `primitive`.
INLINE Surface surface_at(const Geometry* g, uint primitive, float3 origin, float3 direction, float t, float u, float v)
{
#if FEATURE_TRIANGLES && FEATURE_ANALYTICS
    if (!(primitive & ANALYTIC_BIT)) return triangle_surface(g, primitive, u, v);
#elif FEATURE_TRIANGLES
    return triangle_surface(g, primitive, u, v);
#endif
#if FEATURE_ANALYTICS
    return analytic_surface(g, primitive & ~ANALYTIC_BIT, origin + t * direction);
#elif !FEATURE_TRIANGLES
    const Surface none = {0.0f, 0.0f, 0.0f, 0.0f, 0, NONE};  // an empty scene: nothing is ever met
    return none;
#endif
}

#if FEATURE_INSTANCES
// The surface where a ray met `primitive` in an instance, NONE for one that stands in the world.
INLINE Surface instanced_surface_at(const Geometry* g, __global const Instance* instances, uint instance, uint primitive,
                                    float3 origin, float3 direction, float t, float u, float v)
{
    if (instance != NONE) ray_to_object(instances + instance, &origin, &direction);
    Surface s = surface_at(g, primitive, origin, direction, t, u, v);
    if (instance == NONE) return s;
    float m[12], inverse[12], magnitude[12];
    load_matrix(instances[instance].to_world, m);
    load_matrix(instances[instance].to_object, inverse);
    for (int i = 0; i < 12; ++i) magnitude[i] = abs1(m[i]);
    const float3 on_object = s.position;
    s.position = transform_point(m, on_object);
    s.error = transform_direction(magnitude, s.error) + round_trip_error(m, inverse, on_object, s.position);
    s.geometric_normal = unit(transform_normal(inverse, s.geometric_normal));
    s.normal = unit(transform_normal(inverse, s.normal));
    return s;
}
#endif
