// From a hit to the surface there: position with its error bound, normals, shape.
#pragma once
#include "analytic.h"
#include "vectors.h"

#define GAMMA(n) ((n) * 0x1p-24f / (1.0f - (n) * 0x1p-24f))  // Higham's bound on n rounded operations

typedef struct {
    float3 position, error;   // |true position - position| <= error, per axis
    float3 geometric_normal;  // unit; zero for a triangle without area
    float3 normal;            // unit shading normal
    uint shape;
} Surface;

// All that describes the surfaces of a scene; members that it does not need are NULL.
typedef struct {
    __global const float* vertices;
    __global const uint* faces;
    __global const float* vertex_normals;
    __global const uint* triangle_shape;
    __global const Analytic* analytics;
    __global const Shape* shapes;
} Geometry;

#if FEATURE_TRIANGLES
INLINE Surface triangle_surface(const Geometry* g, uint triangle, float u, float v)
{
    Surface s;
    const uint3 corner = LOAD3U(triangle, g->faces);
    const float3 a = LOAD3(corner.x, g->vertices), b = LOAD3(corner.y, g->vertices), c = LOAD3(corner.z, g->vertices);
    const float w = 1.0f - u - v;
    s.position = w * a + u * b + v * c;
    s.error = GAMMA(7) * (abs3(w * a) + abs3(u * b) + abs3(v * c));
    s.geometric_normal = s.normal = unit(cross3(b - a, c - a));
    s.shape = g->triangle_shape[triangle];
#if FEATURE_VERTEX_NORMALS
    if (g->shapes[s.shape].flags & SHAPE_VERTEX_NORMALS) {
        const float3 interpolated = unit(w * LOAD3(corner.x, g->vertex_normals) + u * LOAD3(corner.y, g->vertex_normals) +
                                         v * LOAD3(corner.z, g->vertex_normals));
        s.normal = dot3(interpolated, interpolated) > 0.0f ? interpolated : s.geometric_normal;
    }
#endif
    return s;
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

#if FEATURE_DISKS || FEATURE_CYLINDERS
// A point of object space that lies on the surface exactly, and its normal there, taken to world space.
INLINE void transformed_surface(__global const Analytic* shape, float3 on_shape, float3 shape_normal, Surface* s)
{
    float m[12], inverse[12];
    load_matrix(shape->to_world, m);
    load_matrix(shape->to_object, inverse);
    s->position = transform_point(m, on_shape);
    s->normal = unit(transform_normal(inverse, shape_normal));
    float magnitude[12];
    for (int i = 0; i < 12; ++i) magnitude[i] = abs1(m[i]);
    s->error = GAMMA(6) * transform_point(magnitude, abs3(on_shape));
    // the intersection stage takes the point back to object space, which rounds again
    for (int i = 0; i < 12; ++i) inverse[i] = abs1(inverse[i]);
    s->error += GAMMA(5) * transform_direction(magnitude, transform_point(inverse, abs3(s->position)));
}
#endif

#if FEATURE_ANALYTICS
INLINE Surface analytic_surface(const Geometry* g, uint index, float3 at)
{
    Surface s;
    __global const Analytic* shape = g->analytics + index;
    s.shape = shape->shape;
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
    s.geometric_normal = s.normal;
    return s;
}
#endif

// The surface where a ray met `primitive`.
INLINE Surface surface_at(const Geometry* g, uint primitive, float3 origin, float3 direction, float t, float u, float v)
{
    Surface s;
#if FEATURE_TRIANGLES
    if (!(primitive & ANALYTIC_BIT)) s = triangle_surface(g, primitive, u, v);
#endif
#if FEATURE_ANALYTICS
    if (primitive & ANALYTIC_BIT) s = analytic_surface(g, primitive & ~ANALYTIC_BIT, origin + t * direction);
#endif
    if (g->shapes[s.shape].flags & SHAPE_FLIP_NORMALS) {
        s.normal = -s.normal;
        s.geometric_normal = -s.geometric_normal;
    }
    return s;
}
