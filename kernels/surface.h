// From a hit to the surface there: position with its error bound, normals, shape.
#pragma once
#include "instance.h"
#include "environment.h"
#include "light_tree.h"
#include "texture.h"
#include "vectors.h"

#define GAMMA(n) ((n) * 0x1p-24f / (1.0f - (n) * 0x1p-24f))  // Higham's bound on n rounded operations

typedef struct {
    float3 position, error;   // |true position - position| <= error, per axis
    float3 geometric_normal;  // unit; zero for a triangle without area
    float3 normal;            // unit shading normal
    uint bsdf, light;         // indices; light is NONE if the surface does not shine
#if FEATURE_MEDIA
    uint media;  // within | without << 16, where the normal points; NONE if the surface separates none
#endif
#if FEATURE_UVS
    float2 uv;
    float3 dp_du, dp_dv;  // how the position changes with uv
    uint triangle;        // NONE on other surfaces
    float2 barycentric;   // weights of the triangle's second and third corner
#endif
} Surface;

#if FEATURE_TEXTURES
INLINE TexturePoint texture_point(const Surface* s)
{
    const TexturePoint point = {s->uv, s->triangle, s->barycentric};
    return point;
}
#endif

// All that describes the surfaces of a scene; members that it does not need are NULL.
typedef struct {
    __global const float4* triangles;  // records of TRIANGLE_ROWS: host/isonoise/scene/structs.py
    __global const uint* faces;
    __global const float* vertex_normals;
    __global const float* uvs;
    __global const Analytic* analytics;
    __global const Shape* shapes;
#if FEATURE_ENVIRONMENT_MAP
    EnvironmentMap environment;
#endif
#if FEATURE_LIGHT_TREE
    LightTree light_tree;
#endif
#if FEATURE_TEXTURES
    Textures textures;
#endif
} Geometry;

#define TRIANGLE_ROWS 4

#if FEATURE_UVS && FEATURE_TRIANGLES
// Texture coordinates of a triangle, and how its points change with them. Without any they are the barycentric ones of its
// corners in the mesh's order; where they change nowhere, the changes are some basis. As in Mitsuba 3 (3.9.1).
INLINE void triangle_uv(const Geometry* g, uint triangle, float u, float v, float3 edge1, float3 edge2, uint flags, Surface* s)
{
    s->triangle = triangle;
    s->uv = s->barycentric = (float2)(u, v);
    if (!(flags & SHAPE_UVS)) {
        const bool rewound = flags & TRIANGLE_REWOUND;
        if (rewound) s->uv.y = 1.0f - u - v;
        s->dp_du = rewound ? edge1 - edge2 : edge1;
        s->dp_dv = rewound ? -edge2 : edge2;
        return;
    }
    basis(s->geometric_normal, &s->dp_du, &s->dp_dv);
    const uint3 index = LOAD3U(triangle, g->faces);
    const float2 uv0 = (float2)(g->uvs[2 * index.x], g->uvs[2 * index.x + 1]);
    const float2 along1 = (float2)(g->uvs[2 * index.y], g->uvs[2 * index.y + 1]) - uv0;
    const float2 along2 = (float2)(g->uvs[2 * index.z], g->uvs[2 * index.z + 1]) - uv0;
    s->uv = uv0 + u * along1 + v * along2;
    const float determinant = along1.x * along2.y - along1.y * along2.x;
    if (determinant == 0.0f) return;
    s->dp_du = (along2.y * edge1 - along1.y * edge2) / determinant;
    s->dp_dv = (along1.x * edge2 - along2.x * edge1) / determinant;
}
#endif

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
#if FEATURE_MEDIA
    s.media = as_uint(record[3].w) ^ LANE_BIAS;
#endif
#if FEATURE_VERTEX_NORMALS
    if ((as_uint(edge2.w) ^ LANE_BIAS) & SHAPE_VERTEX_NORMALS) {
        const uint3 index = LOAD3U(triangle, g->faces);
        const float3 interpolated = unit((1.0f - u - v) * LOAD3(index.x, g->vertex_normals) +
                                         u * LOAD3(index.y, g->vertex_normals) + v * LOAD3(index.z, g->vertex_normals));
        s.normal = dot3(interpolated, interpolated) > 0.0f ? interpolated : s.geometric_normal;
    }
#endif
#if FEATURE_UVS
    triangle_uv(g, triangle, u, v, edge1.xyz, edge2.xyz, as_uint(edge2.w) ^ LANE_BIAS, &s);
#endif
    return s;
}
#endif

#if FEATURE_ANALYTICS && FEATURE_UVS
// Texture coordinates of a point of an analytic shape, as Mitsuba 3 has them: of a sphere the angles around and from z, of a
// disk the radius and the angle, of a cylinder the angle and the height. At a pole, where they have no direction, dp_du is 0.
INLINE void analytic_uv(__global const Analytic* shape, Surface* s)
{
    float m[12], inverse[12];
    load_matrix(shape->to_world, m);
    load_matrix(shape->to_object, inverse);
    const float3 p = transform_point(inverse, s->position);
    const float around = SQRT(dot2(p.xy, p.xy)), turn = atan2(p.y, p.x) * (0.5f * M_1_PI_F);
    const float2 out = around > 0.0f ? p.xy / around : (float2)(1.0f, 0.0f), on = (float2)(-p.y, p.x);
    const float angle = turn < 0.0f ? turn + 1.0f : turn;
    s->triangle = NONE;
    s->barycentric = (float2)(0.0f);
    switch (shape->kind) {
#if FEATURE_SPHERES
    case ANALYTIC_SPHERE:
        s->uv = (float2)(angle, atan2(around, p.z) * M_1_PI_F);
        s->dp_du = transform_direction(m, 2.0f * M_PI_F * (float3)(on, 0.0f));
        s->dp_dv = transform_direction(m, M_PI_F * (float3)(p.z * out, -around));
        break;
#endif
#if FEATURE_DISKS
    case ANALYTIC_DISK:
        s->uv = (float2)(around, angle);
        s->dp_du = transform_direction(m, (float3)(out, 0.0f));
        s->dp_dv = transform_direction(m, (float3)(-out.y, out.x, 0.0f));
        break;
#endif
    default:
        s->uv = (float2)(angle, p.z);
        s->dp_du = transform_direction(m, 2.0f * M_PI_F * (float3)(on, 0.0f));
        s->dp_dv = transform_direction(m, (float3)(0.0f, 0.0f, 1.0f));
        break;
    }
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
#if FEATURE_MEDIA
    s->media = shape->media;
#endif
#if FEATURE_UVS
    analytic_uv(g->analytics + index, s);
#endif
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
    Surface none;  // an empty scene: nothing is ever met
    none.geometric_normal = (float3)(0.0f);
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
#if FEATURE_UVS
    s.dp_du = transform_direction(m, s.dp_du);
    s.dp_dv = transform_direction(m, s.dp_dv);
#endif
    return s;
}
#endif
