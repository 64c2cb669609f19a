// Lights: picking one, sampling a point on it, and the density of that for a direction that was found otherwise.
#pragma once
#include "geometry/surface.h"

#define HAS_ENVIRONMENT_LIGHT (FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP)

#if FEATURE_NEXT_EVENT
typedef struct {
    Vec3 position, error, normal;  // normal is zero where the light has no surface
    uint primitive;                  // which the position lies on, and which is met there first; else NONE
    Vec3 direction;                // unit, from the reference point to the light
    Vec3 radiance;                 // what would arrive, before the division by pdf; 0 if the light faces away
    float pdf;                       // solid angle, times the probability of the pick; of delta lights: the pick alone
    bool is_delta, is_infinite;
} LightSample;

// Every member has a value, as in `empty_bsdf_sample`.
INLINE LightSample empty_light_sample(void)
{
    LightSample none;
    none.position = none.error = none.normal = none.direction = none.radiance = splat3(0.0f);
    none.primitive = NONE;
    none.pdf = 0.0f;
    none.is_delta = none.is_infinite = false;
    return none;
}
#endif

#if FEATURE_SPHERE_LIGHTS
// 1 - cos of half the angle under which a sphere appears, without cancellation when it is far away.
INLINE float sphere_one_minus_cos(float radius, float distance2)
{
    const float sin2 = radius * radius / distance2;
    return sin2 / (1.0f + SQRT(MAX(1.0f - sin2, 0.0f)));
}

// Whether the sphere is sampled by the cone under which it appears: if it shines outwards and is seen from outside. By the
// side it shines to, because rounding decides on which side a point of the sphere itself seems to be.
INLINE bool samples_visible_cone(const SceneView* scene, const Analytic* sphere, float distance2)
{
    return !(Shape_at(scene->shapes, sphere->shape).flags & SHAPE_FLIP_NORMALS) && distance2 > sphere->radius * sphere->radius;
}
#endif

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS
// Probability with which `sample_light` would have picked a light for a point and the side that is lit there (see `light_sampling_normal`).
// `pdf`: of the direction that found it; after a delta function, when it is negative, it is not asked for.
INLINE float light_pmf(const SceneView* scene, uint light, Vec3 point, Vec4 mis_normal, float pdf)
{
#if FEATURE_LIGHT_LIST
    return pdf < 0.0f ? 0.0f : light_list_pmf(&scene->light_list, light, point, mis_normal);
#elif FEATURE_LIGHT_TREE
    return pdf < 0.0f ? 0.0f : light_tree_pmf(&scene->light_tree, light, point, mis_normal);
#elif FEATURE_MANY_LIGHTS
    return Light_at(scene->lights, light).selection_pmf;
#else
    return 1.0f;
#endif
}
#endif

#if FEATURE_AREA_LIGHTS
// Density with which `sample_light` would have found the point at `distance` along `direction` on this light, had it picked it.
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
#endif

#if FEATURE_NEXT_EVENT && FEATURE_MANY_LIGHTS && !HAS_LIGHT_IMPORTANCE
// Walker's alias method with 48 random bits, so that a million lights are still picked with their exact probabilities.
INLINE uint select_light_by_power(__global const Alias* table, uint count, float u_high, float u_low)
{
    const ulong scaled = (ulong)(u_high * 0x1p24f) * count + (((ulong)(u_low * 0x1p24f) * count) >> 24);
    const uint index = MIN((uint)(scaled >> 24), count - 1u);
    const float fraction = (float)(scaled & 0xFFFFFFu) * 0x1p-24f;
    const Alias entry = Alias_at(table, index);
    return fraction < entry.threshold ? index : entry.alias;
}
#endif

#if FEATURE_NEXT_EVENT && FEATURE_SPHERE_LIGHTS
// Uniform over the cone under which the sphere appears (Wang 1992; without cancellation for small cones), else over its area.
INLINE float sample_sphere(const SceneView* scene, const Analytic* sphere, Vec3 reference, Vec2 u, Surface* s)
{
    const Vec3 arm = sub3(reference, LOAD3(0, sphere->center));
    const float distance2 = dot3(arm, arm), radius = sphere->radius;
    float cos_alpha = 1.0f, density = 0.0f;
    Vec3 axis = vec3(0.0f, 0.0f, 1.0f);
    if (samples_visible_cone(scene, sphere, distance2)) {
        const float sin2_max = radius * radius / distance2, sin_max = SQRT(sin2_max);
        const float cone = sphere_one_minus_cos(radius, distance2);
        const float one_minus_cos = u.x * cone, sin2 = one_minus_cos * (2.0f - one_minus_cos);
        // angle at the centre between the reference point and the point sampled
        cos_alpha = sin2 / sin_max + (1.0f - one_minus_cos) * SQRT(MAX(1.0f - sin2 / sin2_max, 0.0f));
        density = 0.5f * M_1_PI_F / cone;
        axis = normalize3(arm);
    } else {
        cos_alpha = 1.0f - 2.0f * u.x;
    }
    cos_alpha = MIN(cos_alpha, 1.0f);
    const float sin_alpha = SQRT(MAX(1.0f - cos_alpha * cos_alpha, 0.0f));
    Vec3 x, y;
    coordinate_system(axis, &x, &y);
    const Vec2 azimuth = scale2(cos_sin_turns(u.y), sin_alpha);
    sphere_surface(sphere, normalize3(weighted_sum3(azimuth.x, x, azimuth.y, y, cos_alpha, axis)), s);
    return density;
}
#endif

#if FEATURE_NEXT_EVENT && FEATURE_AREA_LIGHTS
// A point on the light's surface. Returns its density in solid angle, or 0 where it is uniform over the area instead.
INLINE float sample_surface(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, Surface* s)
{
    float density = 0.0f;
#if FEATURE_TRIANGLE_LIGHTS
    if (light->kind & LIGHT_TRIANGLE) {
        const float root = SQRT(1.0f - u.x);  // uniform over the triangle: Turk, Graphics Gems, 1990
        *s = triangle_surface(scene, light->primitive, 1.0f - root, root * u.y);
    }
#endif
#if FEATURE_SPHERE_LIGHTS || FEATURE_DISK_LIGHTS || FEATURE_CYLINDER_LIGHTS
    if (light->kind & LIGHT_TRIANGLE) return density;
    const Analytic shape = Analytic_at(scene->analytics, light->primitive);
#endif
#if FEATURE_SPHERE_LIGHTS
    if (light->kind & LIGHT_SPHERE) density = sample_sphere(scene, &shape, reference, u, s);
#endif
#if FEATURE_DISK_LIGHTS
    if (light->kind & LIGHT_DISK)
        transformed_surface(&shape, vec3_from(square_to_disk(u), 0.0f), vec3(0.0f, 0.0f, 1.0f), s);
#endif
#if FEATURE_CYLINDER_LIGHTS
    if (light->kind & LIGHT_CYLINDER) {
        const Vec2 side = cos_sin_turns(u.x);
        transformed_surface(&shape, vec3_from(side, u.y), vec3_from(side, 0.0f), s);
    }
#endif
#if FEATURE_SPHERE_LIGHTS || FEATURE_DISK_LIGHTS || FEATURE_CYLINDER_LIGHTS
    finish_analytic_surface(scene, light->primitive, &shape, s);
#endif
    return density;
}
#endif

#if FEATURE_AREA_LIGHTS
// Radiance that a light's surface emits at a point of it.
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
#endif

#if FEATURE_NEXT_EVENT && FEATURE_SPOT_LIGHTS
// Share of the spot's intensity that leaves along `direction`: falls linearly with the angle, as in Mitsuba 3. The angle is
// taken from the chord, which is exact for narrow spots too.
INLINE float spot_falloff(const Light* light, Vec3 direction)
{
    const Vec3 off = sub3(direction, LOAD3(0, light->axis));
    const float half_chord2 = MIN(0.25f * dot3(off, off), 1.0f);
    const float angle = 2.0f * atan2_float(SQRT(half_chord2), SQRT(1.0f - half_chord2));
    const float share = (light->cutoff - angle) * light->inverse_transition;
    return MIN(MAX(share, 0.0f), 1.0f);
}
#endif

#if HAS_ENVIRONMENT_LIGHT
// Radiance that arrives from beyond the scene, and the density with which `sample_light` would have found it, had it picked it.
INLINE Vec3 environment_radiance(const SceneView* scene, const Light* sky, Vec3 direction, float* pdf)
{
    Vec3 radiance = LOAD3(0, sky->radiance);
    *pdf = 0.25f * M_1_PI_F;
#if FEATURE_ENVIRONMENT_MAP
    if (!FEATURE_CONSTANT_LIGHT || sky->kind & LIGHT_ENVIRONMENT_MAP)
        radiance = envmap_radiance(&scene->envmap, direction, pdf);
#endif
    return radiance;
}
#endif

#if FEATURE_NEXT_EVENT
// A light that was picked, and the probability of that; 0 if none was.
typedef struct {
    uint light;
    float probability;
} LightSelection;

#if !FEATURE_LIGHT_LIST || LANES == 1  // from a list several paths pick together
// One light for the point `reference` and the side that is lit there, by a random number and what lies below its last bit.
INLINE LightSelection select_light(const SceneView* scene, Vec3 reference, Vec4 mis_normal, float u, float u_low)
{
    LightSelection pick;
#if FEATURE_LIGHT_LIST
    pick.light = select_from_list(&scene->light_list, reference, mis_normal, u, u_low, &pick.probability);
#elif FEATURE_LIGHT_TREE
    pick.light = select_from_tree(&scene->light_tree, reference, mis_normal, u, u_low, &pick.probability);
#elif FEATURE_MANY_LIGHTS
    pick.light = select_light_by_power(scene->light_alias, scene->light_count, u, u_low);
    pick.probability = Light_at(scene->lights, pick.light).selection_pmf;
#else
    pick.light = 0u;
    pick.probability = 1.0f;
#endif
    return pick;
}
#endif

// A point on the light that was picked, which is of one of these kinds, for the point `reference`.
INLINE LightSample sample_light_of_kind(uint kinds, const SceneView* scene, LightSelection pick, Vec3 reference, Vec2 u)
{
    LightSample sample = empty_light_sample();
    Light picked = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? pick.light : 0u);
    picked.kind = kinds == LIGHT_TRIANGLE ? kinds : picked.kind & kinds;  // a constant, where it may be one
    const Light* light = &picked;
    sample.pdf = pick.probability;
    sample.radiance = LOAD3(0, light->radiance);
#if FEATURE_POINT_LIGHTS
    if (light->kind & LIGHT_POINT) {
        sample.position = LOAD3(0, light->position);
        const Vec3 arm = sub3(sample.position, reference);
        sample.direction = normalize3(arm);
        sample.radiance = div_scalar3(sample.radiance, dot3(arm, arm));
        sample.is_delta = true;
        return sample;
    }
#endif
#if FEATURE_SPOT_LIGHTS
    if (light->kind & LIGHT_SPOT) {
        sample.position = LOAD3(0, light->position);
        const Vec3 arm = sub3(sample.position, reference);
        sample.direction = normalize3(arm);
        sample.radiance = scale3(sample.radiance, spot_falloff(light, neg3(sample.direction)) / dot3(arm, arm));
        sample.is_delta = true;
        return sample;
    }
#endif
#if FEATURE_DIRECTIONAL_LIGHTS
    if (light->kind & LIGHT_DIRECTIONAL) {
        sample.direction = neg3(LOAD3(0, light->position));
        sample.is_delta = sample.is_infinite = true;
        return sample;
    }
#endif
#if FEATURE_ENVIRONMENT_MAP
    if (light->kind & LIGHT_ENVIRONMENT_MAP) {
        float density;
        sample.radiance = envmap_sample(&scene->envmap, u, &sample.direction, &density);
        sample.pdf *= density;
        sample.is_infinite = true;
        return sample;
    }
#endif
#if FEATURE_CONSTANT_LIGHT
    if (light->kind & LIGHT_CONSTANT) {
        const float z = 1.0f - 2.0f * u.x, r = 2.0f * SQRT(MAX(u.x * (1.0f - u.x), 0.0f));
        sample.direction = vec3_from(scale2(cos_sin_turns(u.y), r), z);
        sample.pdf *= 0.25f * M_1_PI_F;
        sample.is_infinite = true;
        return sample;
    }
#endif
#if FEATURE_AREA_LIGHTS
    Surface s = empty_surface();
    const float density = sample_surface(scene, light, reference, u, &s);
    const Vec3 arm = sub3(s.position, reference);
    const float distance2 = dot3(arm, arm);
    sample.direction = normalize3(arm);
    const float cos_light = -dot3(s.normal, sample.direction);
    sample.radiance = cos_light > 0.0f ? emitted_radiance(scene, light, &s) : splat3(0.0f);
    sample.pdf *= density > 0.0f ? density : distance2 / (cos_light * light->area);
    sample.position = s.position;
    sample.error = s.error;
    sample.normal = s.geometric_normal;
    sample.primitive = light->kind & LIGHT_TRIANGLE ? light->primitive : ANALYTIC_BIT | light->primitive;
#if FEATURE_SPHERE_LIGHTS || FEATURE_CYLINDER_LIGHTS
    // what shines inwards may be seen through itself: then it is not left out of the shadow ray
    if ((light->kind & (LIGHT_SPHERE | LIGHT_CYLINDER)) &&
        (Shape_at(scene->shapes, Analytic_at(scene->analytics, light->primitive).shape).flags & SHAPE_FLIP_NORMALS))
        sample.primitive = NONE;
#endif
#endif
    return sample;
}

INLINE LightSample sample_light(const SceneView* scene, LightSelection pick, Vec3 reference, Vec2 u)
{
    return sample_light_of_kind(~0u, scene, pick, reference, u);
}
#endif
