// Emissive primitives: triangles, parallelograms of two triangles, spheres, disks, cylinders.
#pragma once
#include "light/light_sample.h"

#if FEATURE_AREA_LIGHTS
#if FEATURE_SPHERE_LIGHTS
// 1 - cos of half the angle that a sphere subtends, without cancellation if it is far away.
INLINE float sphere_one_minus_cos(float radius, float distance2)
{
    const float sin2 = radius * radius / distance2;
    return sin2 / (1.0f + SQRT(MAX(1.0f - sin2, 0.0f)));
}

// Whether a sphere is sampled by the cone that it subtends: if it emits outwards and the reference point is outside.
// The emitting side is tested because for points on the sphere rounding decides which side they are on.
INLINE bool samples_visible_cone(const SceneView* scene, const Analytic* sphere, float distance2)
{
    return !(Shape_at(scene->shapes, sphere->shape).flags & SHAPE_FLIP_NORMALS) &&
           distance2 > sphere->radius * sphere->radius;
}
#endif

// Pdf in solid angle with which `sample_light` samples the point at `distance` along `direction` on this light, without
// the selection probability.
INLINE float light_pdf(const SceneView* scene, const Light* light, Vec3 reference, Vec3 direction, float distance,
                       Vec3 normal)
{
    const float to_solid_angle = distance * distance / abs_float(dot3(normal, direction));
    float density = to_solid_angle / light->area;
#if FEATURE_SPHERE_LIGHTS
    if (light->kind & LIGHT_SPHERE) {
        const Analytic sphere = Analytic_at(scene->analytics, light->primitive);
        const Vec3 arm = sub3(LOAD3(0, sphere.center), reference);
        const float distance2 = dot3(arm, arm);
        if (samples_visible_cone(scene, &sphere, distance2))
            density = 0.5f * M_1_PI_F / sphere_one_minus_cos(sphere.radius, distance2);
    }
#endif
    return density;
}

// Radiance that an area light emits at a point of its surface.
INLINE Vec3 emitted_radiance(const SceneView* scene, const Light* light, const Surface* s)
{
    Vec3 radiance = LOAD3(0, light->radiance);
#if FEATURE_TEXTURED_LIGHTS
    if (light->texture != NONE) {
        const TexturePoint point = texture_point(s);
        radiance = mul3(radiance, texture_rgb(&scene->textures, light->texture, &point));
    }
#endif
    return radiance;
}

#if FEATURE_NEXT_EVENT
#if FEATURE_SPHERE_LIGHTS
// Samples the cone that the sphere subtends (Wang 1992; without cancellation for small cones), else uniformly its area.
// The square is mapped to a disk (low distortion), whose squared radius is uniform like the cosines of cone and sphere.
INLINE float sample_sphere_light(const SceneView* scene, const Analytic* sphere, Vec3 reference, Vec2 u, Surface* s)
{
    const Vec3 arm = sub3(reference, LOAD3(0, sphere->center));
    const float distance2 = dot3(arm, arm), radius = sphere->radius;
    const Vec2 disk = square_to_disk(u);
    const float r2 = MIN(dot2(disk, disk), 1.0f);
    // of the angle at the centre between `axis` and the point sampled: its cosine, and its sine over the disk's radius
    float cosine = 1.0f - 2.0f * r2, sine_over_r = 2.0f * SQRT(1.0f - r2), density = 0.0f;
    Vec3 axis = vec3(0.0f, 0.0f, 1.0f);
    if (samples_visible_cone(scene, sphere, distance2)) {
        const float sin2_max = radius * radius / distance2, sin_max = SQRT(sin2_max);
        const float cone = sphere_one_minus_cos(radius, distance2);
        // theta: angle at the reference point
        const float cos_theta = 1.0f - r2 * cone, sin2_over_r2 = cone * (1.0f + cos_theta), sin2 = r2 * sin2_over_r2;
        const float root = SQRT(MAX(sin2_max - sin2, 0.0f));
        cosine = (sin2 + cos_theta * root) / sin_max;
        // law of sines, with the distance to the sphere in units of its radius
        sine_over_r = SQRT(sin2_over_r2) * (1.0f - sin2_max) / (sin_max * (cos_theta + root));
        density = 0.5f * M_1_PI_F / cone;
        axis = normalize3(arm);
    }
    Vec3 x, y;
    coordinate_system(axis, &x, &y);
    const Vec2 across = scale2(disk, sine_over_r);
    sphere_surface(sphere, normalize3(weighted_sum3(across.x, x, across.y, y, cosine, axis)), s);
    return density;
}
#endif

#if FEATURE_DISK_LIGHTS
INLINE float sample_disk_light(const SceneView* scene, const Analytic* shape, Vec3 reference, Vec2 u, Surface* s)
{
    transformed_surface(shape, vec3_from(square_to_disk(u), 0.0f), vec3(0.0f, 0.0f, 1.0f), s);
    return 0.0f;
}
#endif

#if FEATURE_CYLINDER_LIGHTS
INLINE float sample_cylinder_light(const SceneView* scene, const Analytic* shape, Vec3 reference, Vec2 u, Surface* s)
{
    const Vec2 side = cos_sin_turns(u.x);
    transformed_surface(shape, vec3_from(side, u.y), vec3_from(side, 0.0f), s);
    return 0.0f;
}
#endif

#if HAS_MESH_LIGHTS
// Samples a point uniformly on a triangle or a parallelogram.
INLINE Surface sample_mesh_light(const SceneView* scene, const Light* light, Vec2 u)
{
    uint triangle = light->primitive;
#if FEATURE_PARALLELOGRAM_LIGHTS
    if (light->kind & LIGHT_PARALLELOGRAM) {
        // beyond the diagonal: the second triangle, which is the first one turned by half a turn
        const bool is_second = u.x + u.y > 1.0f;
        const float x = is_second ? 1.0f - u.x : u.x, y = is_second ? 1.0f - u.y : u.y;
        const float rest = MAX(1.0f - x - y, 0.0f);
        const uint apex = is_second ? light->apexes >> 2 : light->apexes & 3u;
        return triangle_surface(scene, triangle + (is_second ? 1u : 0u),
                                apex == 0u   ? x
                                : apex == 1u ? rest
                                             : y,
                                apex == 0u   ? y
                                : apex == 1u ? x
                                             : rest);
    }
#endif
    const Vec2 barycentric = square_to_triangle(u);
    return triangle_surface(scene, triangle, barycentric.x, barycentric.y);
}
#endif

// Samples a point on the light's surface. Returns its pdf in solid angle, or 0 if it is uniform over the area.
INLINE float sample_surface(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, Surface* s)
{
    float density = 0.0f;
#if HAS_MESH_LIGHTS
    if (light->kind & LIGHT_MESH) *s = sample_mesh_light(scene, light, u);
#endif
#if HAS_ANALYTIC_LIGHTS
    if (light->kind & LIGHT_MESH) return density;
    const Analytic shape = Analytic_at(scene->analytics, light->primitive);
#define SAMPLE_SHAPE(BIT, sample_shape) \
    if (light->kind & BIT) density = sample_shape(scene, &shape, reference, u, s);
    FOR_ANALYTIC_LIGHTS(SAMPLE_SHAPE)
    finish_analytic_surface(scene, light->primitive, &shape, s);
#endif
    return density;
}

INLINE void sample_area_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, LightSample* sample)
{
    Surface s = empty_surface();
    const float density = sample_surface(scene, light, reference, u, &s);
    const Vec3 arm = sub3(s.position, reference);
    const float distance2 = dot3(arm, arm);
    sample->direction = normalize3(arm);
    const float cos_light = -dot3(s.normal, sample->direction);
    sample->radiance = cos_light > 0.0f ? emitted_radiance(scene, light, &s) : splat3(0.0f);
    sample->pdf *= density > 0.0f ? density : distance2 / (cos_light * light->area);
    sample->position = s.position;
    sample->error = s.error;
    sample->normal = s.geometric_normal;
    sample->primitive = light->primitive;
    if (!(light->kind & LIGHT_MESH)) sample->primitive |= ANALYTIC_BIT;
    if (light->kind & LIGHT_PARALLELOGRAM) sample->primitive |= TWO_TRIANGLES_BIT;
#if FEATURE_SPHERE_LIGHTS || FEATURE_CYLINDER_LIGHTS
    // a light that emits inwards may be hit from behind first: then the shadow ray must not skip it
    if ((light->kind & (LIGHT_SPHERE | LIGHT_CYLINDER)) &&
        (Shape_at(scene->shapes, Analytic_at(scene->analytics, light->primitive).shape).flags & SHAPE_FLIP_NORMALS))
        sample->primitive = NONE;
#endif
}
#endif
#endif
