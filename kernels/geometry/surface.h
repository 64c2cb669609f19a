// Surface interaction of a hit: position with error bound, normals, BSDF, light, media, texture coordinates.
// Called by `shade` and `shadow_transmittance`. Also declares SceneView, their view of the scene's buffers.
#pragma once
#include "geometry/instance.h"
#include "light/envmap.h"
#include "light/light_list.h"
#include "light/light_tree.h"
#include "media/grid.h"
#include "texture/texture.h"
#include "util/math.h"

// Higham's bound on the relative error of n rounded operations.
#define GAMMA(n) ((n) * 0x1p-24f / (1.0f - (n) * 0x1p-24f))

typedef struct {
    Vec3 position, error;   // |true position - position| <= error, per axis
    Vec3 geometric_normal;  // unit; zero for a triangle without area
    Vec3 normal;            // unit shading normal
    uint bsdf, light;       // indices; light is NONE if the surface is not an emitter
#if FEATURE_MEDIA
    uint media;  // interior | exterior << 16, the normal points outside; NONE if it is not a medium interface
#endif
#if FEATURE_UVS
    Vec2 uv;
    Vec3 dp_du, dp_dv;  // partial derivatives of the position
    uint triangle;      // NONE on analytic shapes
    Vec2 barycentric;   // weights of the triangle's second and third corner
#endif
} Surface;

// Every member gets a value: in a vectorised loop an unset one may keep the value of another path.
INLINE Surface empty_surface(void)
{
    Surface s;
    s.position = s.error = s.geometric_normal = s.normal = splat3(0.0f);
    s.bsdf = 0u;
    s.light = NONE;
#if FEATURE_MEDIA
    s.media = NONE;
#endif
#if FEATURE_UVS
    s.uv = s.barycentric = splat2(0.0f);
    s.dp_du = s.dp_dv = splat3(0.0f);
    s.triangle = NONE;
#endif
    return s;
}

#if FEATURE_TEXTURES
INLINE TexturePoint texture_point(const Surface* s)
{
    const TexturePoint point = {s->uv, s->triangle, s->barycentric};
    return point;
}
#endif

// Buffers and counts of the scene. Members that depend on a feature are absent without it.
typedef struct {
    __global const Triangle* triangles;
    __global const uint* faces;
    __global const float* corner_normals;  // three per triangle
    __global const float* uvs;
    __global const Analytic* analytics;
    __global const Shape* shapes;
    __global const Bsdf* bsdfs;
    __global const Light* lights;
    __global const float* light_cdf;  // two floats a light: light/light.h
    uint light_count, environment_light;
    uint2 seed;
#if HAS_ROUGH_TRANSMITTANCE
    __global const float* rough_transmittances;
#endif
#if FEATURE_TEXTURES
    Textures textures;
    uint textured_slots;  // bit mask of the BSDF slots that some material textures
#endif
#if FEATURE_INSTANCES
    __global const Instance* instances;
    uint world_triangle_count;  // triangles below this number belong to no instance group
#endif
#if FEATURE_MEDIA
    __global const Medium* media;
#endif
#if FEATURE_HETEROGENEOUS
    HeterogeneousMedia heterogeneous;
#endif
#if HAS_PROJECTIONS
    __global const Projection* projections;  // of textures of lights
#endif
#if FEATURE_ENVIRONMENT_MAP
    Envmap envmap;
#endif
#if FEATURE_LIGHT_LIST
    LightList light_list;
#elif FEATURE_LIGHT_TREE
    LightTree light_tree;
#endif
} SceneView;

#if FEATURE_UVS && FEATURE_TRIANGLES
// Texture coordinates of a triangle, dp_du and dp_dv. A mesh without UVs gets barycentric coordinates, in the corner
// order of the mesh. Degenerate UVs give an arbitrary dp_du and dp_dv. As in Mitsuba 3 (3.9.1).
INLINE void triangle_uv(const SceneView* scene, uint triangle, float u, float v, Vec3 edge1, Vec3 edge2, uint flags,
                        Surface* s)
{
    s->triangle = triangle;
    s->uv = s->barycentric = vec2(u, v);
    if (!(flags & SHAPE_UVS)) {
        const bool is_reversed = flags & TRIANGLE_REVERSED_WINDING;
        if (is_reversed) s->uv = vec2(u, 1.0f - u - v);
        s->dp_du = is_reversed ? sub3(edge1, edge2) : edge1;
        s->dp_dv = is_reversed ? neg3(edge2) : edge2;
        return;
    }
    coordinate_system(s->geometric_normal, &s->dp_du, &s->dp_dv);
    __global const uint* corner = scene->faces + 3u * triangle;
    const Vec2 uv0 = vec2(scene->uvs[2 * corner[0]], scene->uvs[2 * corner[0] + 1]);
    const Vec2 along1 = sub2(vec2(scene->uvs[2 * corner[1]], scene->uvs[2 * corner[1] + 1]), uv0);
    const Vec2 along2 = sub2(vec2(scene->uvs[2 * corner[2]], scene->uvs[2 * corner[2] + 1]), uv0);
    s->uv = add2(add2(uv0, scale2(along1, u)), scale2(along2, v));
    const float determinant = along1.x * along2.y - along1.y * along2.x;
    if (!(abs_float(determinant) > 1e-37f)) return;
    s->dp_du = div_scalar3(sub3(scale3(edge1, along2.y), scale3(edge2, along1.y)), determinant);
    s->dp_dv = div_scalar3(sub3(scale3(edge2, along1.x), scale3(edge1, along2.x)), determinant);
}
#endif

#if FEATURE_TRIANGLES
INLINE Surface triangle_surface(const SceneView* scene, uint triangle, float u, float v)
{
    const Triangle record = Triangle_at(scene->triangles, triangle);
    const Vec3 corner = LOAD3(0, record.corner), edge1 = LOAD3(0, record.edge1), edge2 = LOAD3(0, record.edge2);
    const Vec3 along1 = scale3(edge1, u), along2 = scale3(edge2, v);
    Surface s = empty_surface();
    s.position = add3(corner, add3(along1, along2));
    // an edge is the difference of two corners, with a rounding error of at most GAMMA(1) of itself
    s.error = scale3(add3(add3(abs3(corner), abs3(along1)), abs3(along2)), GAMMA(5));
    s.geometric_normal = s.normal = LOAD3(0, record.normal);
    s.bsdf = record.bsdf;
    s.light = record.light;
#if FEATURE_MEDIA
    s.media = record.media;
#endif
#if FEATURE_VERTEX_NORMALS
    if (record.flags & SHAPE_VERTEX_NORMALS) {
        const int first = 3 * (int)triangle;
        const Vec3 interpolated = normalize3(weighted_sum3(1.0f - u - v, LOAD3(first, scene->corner_normals), u,
                                                           LOAD3(first + 1, scene->corner_normals), v,
                                                           LOAD3(first + 2, scene->corner_normals)));
        s.normal = dot3(interpolated, interpolated) > 0.0f ? interpolated : s.geometric_normal;
    }
#endif
#if FEATURE_UVS
    triangle_uv(scene, triangle, u, v, edge1, edge2, record.flags, &s);
#endif
    return s;
}
#endif

#if FEATURE_ANALYTICS && FEATURE_UVS
// Texture coordinates of an analytic shape, as in Mitsuba 3: azimuth and polar angle of a sphere, radius and angle of a
// disk, angle and height of a cylinder. At the poles of a sphere dp_du is 0.
INLINE void analytic_uv(const Analytic* shape, Surface* s)
{
    const Vec3 p = transform_point(shape->to_object, s->position);
    const float radius = SQRT(p.x * p.x + p.y * p.y), turns = atan2_float(p.y, p.x) * (0.5f * M_1_PI_F);
    const Vec2 radial = radius > 0.0f ? vec2(p.x / radius, p.y / radius) : vec2(1.0f, 0.0f), tangent = vec2(-p.y, p.x);
    const float angle = turns < 0.0f ? turns + 1.0f : turns;
    s->triangle = NONE;
    s->barycentric = splat2(0.0f);
    s->uv = vec2(angle, p.z);
    s->dp_du = scale3(vec3(tangent.x, tangent.y, 0.0f), 2.0f * M_PI_F);
    s->dp_dv = vec3(0.0f, 0.0f, 1.0f);
#if FEATURE_SPHERES
    if (shape->kind & ANALYTIC_SPHERE) {
        s->uv = vec2(angle, atan2_float(radius, p.z) * M_1_PI_F);
        s->dp_dv = scale3(vec3_from(scale2(radial, p.z), -radius), M_PI_F);
    }
#endif
#if FEATURE_DISKS
    if (shape->kind & ANALYTIC_DISK) {
        s->uv = vec2(radius, angle);
        s->dp_du = vec3_from(radial, 0.0f);
        s->dp_dv = vec3(-radial.y, radial.x, 0.0f);
    }
#endif
    s->dp_du = transform_direction(shape->to_world, s->dp_du);
    s->dp_dv = transform_direction(shape->to_world, s->dp_dv);
}
#endif

#if FEATURE_ANALYTICS
// Fills in the members that come from the shape. Position and outward normal are already set.
INLINE void finish_analytic_surface(const SceneView* scene, uint index, const Analytic* analytic, Surface* s)
{
    const Shape shape_record = Shape_at(scene->shapes, analytic->shape), *shape = &shape_record;
    if (shape->flags & SHAPE_FLIP_NORMALS) s->normal = neg3(s->normal);
    s->geometric_normal = s->normal;
    s->bsdf = shape->bsdf;
    s->light = shape->light;
#if FEATURE_MEDIA
    s->media = shape->media;
#endif
#if FEATURE_UVS
    analytic_uv(analytic, s);
#endif
}
#endif

#if FEATURE_SPHERES
INLINE void sphere_surface(const Analytic* sphere, Vec3 outward, Surface* s)
{
    const Vec3 center = LOAD3(0, sphere->center), from_center = scale3(outward, sphere->radius);
    s->position = add3(center, from_center);
    s->error = scale3(add3(abs3(center), abs3(from_center)), GAMMA(6));
    s->normal = outward;
}
#endif

#if FEATURE_DISKS || FEATURE_CYLINDERS || FEATURE_INSTANCES
// Error bound of a point that was transformed from object to world space; the intersector will transform it back.
INLINE Vec3 round_trip_error(const float* to_world, const float* to_object, Vec3 object_point, Vec3 world_point)
{
    float abs_to_world[12], abs_to_object[12];
#pragma unroll
    for (int i = 0; i < 12; ++i) abs_to_world[i] = abs_float(to_world[i]);
#pragma unroll
    for (int i = 0; i < 12; ++i) abs_to_object[i] = abs_float(to_object[i]);
    const Vec3 forward = transform_point(abs_to_world, abs3(object_point));
    const Vec3 backward = transform_direction(abs_to_world, transform_point(abs_to_object, abs3(world_point)));
    return add3(scale3(forward, GAMMA(6)), scale3(backward, GAMMA(5)));
}
#endif

#if FEATURE_DISKS || FEATURE_CYLINDERS
// Transforms an exact surface point and its normal from object to world space.
INLINE void transformed_surface(const Analytic* shape, Vec3 object_point, Vec3 object_normal, Surface* s)
{
    s->position = transform_point(shape->to_world, object_point);
    s->normal = normalize3(transform_normal(shape->to_object, object_normal));
    s->error = round_trip_error(shape->to_world, shape->to_object, object_point, s->position);
}
#endif

#if FEATURE_ANALYTICS
INLINE Surface analytic_surface(const SceneView* scene, uint index, Vec3 origin, Vec3 direction, float t)
{
    Surface s = empty_surface();
    const Analytic analytic_record = Analytic_at(scene->analytics, index), *shape = &analytic_record;
#if FEATURE_SPHERES
    if (shape->kind & ANALYTIC_SPHERE) {
        // relative to the centre: a world-space point far from the origin has too few digits for a normal
        const Vec3 from_center = add3(sub3(origin, LOAD3(0, shape->center)), scale3(direction, t));
        sphere_surface(shape, normalize3(from_center), &s);
    }
#endif
#if FEATURE_DISKS || FEATURE_CYLINDERS
    if (!(shape->kind & ANALYTIC_SPHERE)) {
        Vec3 point = transform_point(shape->to_object, add3(origin, scale3(direction, t)));
        Vec3 normal = vec3(0.0f, 0.0f, 1.0f);
        if (shape->kind & ANALYTIC_DISK) {
            point.z = 0.0f;
        } else {
            const float from_axis = SQRT(point.x * point.x + point.y * point.y);
            point = vec3(point.x / from_axis, point.y / from_axis, point.z);
            normal = vec3(point.x, point.y, 0.0f);
        }
        transformed_surface(shape, point, normal, &s);
    }
#endif
    finish_analytic_surface(scene, index, shape, &s);
    return s;
}
#endif

// Surface interaction of a hit on `primitive`.
INLINE Surface surface_of_hit(const SceneView* scene, uint primitive, Vec3 origin, Vec3 direction, float t, float u,
                              float v)
{
#if FEATURE_TRIANGLES && FEATURE_ANALYTICS
    if (!(primitive & ANALYTIC_BIT)) return triangle_surface(scene, primitive, u, v);
#elif FEATURE_TRIANGLES
    return triangle_surface(scene, primitive, u, v);
#endif
#if FEATURE_ANALYTICS
    return analytic_surface(scene, primitive & ~ANALYTIC_BIT, origin, direction, t);
#elif !FEATURE_TRIANGLES
    return empty_surface();  // an empty scene has no hits
#endif
}

#if FEATURE_INSTANCES
// Surface interaction of a hit on `primitive` of an instance; NONE is the world.
INLINE Surface instanced_surface_of_hit(const SceneView* scene, uint instance, uint primitive, Vec3 origin,
                                        Vec3 direction, float t, float u, float v)
{
    if (instance != NONE) ray_to_object(scene->instances + instance, &origin, &direction);
    Surface s = surface_of_hit(scene, primitive, origin, direction, t, u, v);
    if (instance == NONE) return s;
    float m[12], inverse[12], abs_m[12];
    load_matrix(scene->instances[instance].to_world, m);
    load_matrix(scene->instances[instance].to_object, inverse);
#pragma unroll
    for (int i = 0; i < 12; ++i) abs_m[i] = abs_float(m[i]);
    const Vec3 object_point = s.position;
    s.position = transform_point(m, object_point);
    s.error = add3(transform_direction(abs_m, s.error), round_trip_error(m, inverse, object_point, s.position));
    s.geometric_normal = normalize3(transform_normal(inverse, s.geometric_normal));
    s.normal = normalize3(transform_normal(inverse, s.normal));
#if FEATURE_UVS
    s.dp_du = transform_direction(m, s.dp_du);
    s.dp_dv = transform_direction(m, s.dp_dv);
#endif
    return s;
}
#endif
