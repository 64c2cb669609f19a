// What a path does where it scatters: the light that it looks at, its next direction.
#pragma once
#include "path/path_vertex.h"

#if FEATURE_NEXT_EVENT
// Whether next-event estimation looks for light where a path that `looks` is scattered.
INLINE bool samples_light(const BsdfContext* ctx, bool looks)
{
    return looks && has_non_delta_lobes(ctx);
}

// Whether a light that was picked may send anything.
INLINE bool is_nonzero_light(const LightSample* light)
{
    return light->pdf > 0.0f && max_component3(light->radiance) > 0.0f;
}

// What arrives by way of a surface that scatters this share of the light, which it would itself have found with `bsdf_pdf`.
INLINE Vec3 direct_lighting(const Path* p, const Surface* s, const BsdfContext* ctx, const LightSample* light, Vec3 scattered, float bsdf_pdf)
{
    const float mis = light->is_delta ? 1.0f : mis_weight(light->pdf, bsdf_pdf);
    Vec3 radiance = scale3(mul3(mul3(p->throughput, scattered), light->radiance), mis / light->pdf);
#if HAS_BUMPS
    radiance = scale3(radiance, bump_shadowing(ctx, s, light->direction));
#endif
    return radiance;
}

// Leaves a shadow ray for the light, but for its radiance.
INLINE void write_shadow_ray(const PathState* paths, size_t i, const Path* p, const Surface* s, const LightSample* light)
{
    const Vec3 origin = spawn_origin(s, light->direction);
    // to a finite light the ray's length is 1, and both its ends are moved off their surfaces
    const Vec3 end = offset_ray_origin(light->position, light->error, light->normal, neg3(light->direction));
    const Vec3 direction = light->is_infinite ? light->direction : sub3(end, origin);
    store_planes4(vec4_from(origin, as_float(light->primitive)), paths->shadow_origin, i, paths->plane_stride);
    store_planes4(vec4_from(direction, light->is_infinite ? INFINITY : 1.0f), paths->shadow_direction, i, paths->plane_stride);
#if FEATURE_MEDIA
    PLANE(3, paths->shadow_radiance, paths->plane_stride)[i] = as_float(medium_towards(s, direction, p->medium));
#endif
}

#if LANES == 1
// Looks at the light that was picked; leaves a shadow ray, unless nothing could arrive.
INLINE void sample_direct(const SceneView* scene, const PathState* paths, size_t i, const Path* p, const Surface* s, const BsdfContext* ctx, bool looks)
{
    if (!samples_light(ctx, looks)) return;
    const Vec4 u = path_random(scene, p, BLOCK_LIGHT(dimension_of(p)));
    const LightSelection pick = select_light(scene, s->position,
                                      light_sampling_normal(ctx), u.x, u.w);
    if (!(pick.probability > 0.0f)) return;
    const LightSample light = sample_light(scene, pick, s->position, vec2(u.y, u.z));
    if (!is_nonzero_light(&light)) return;
    float bsdf_pdf = 0.0f;
    const Vec3 scattered = bsdf_eval(ctx, light.direction, &bsdf_pdf);
    const Vec3 radiance = direct_lighting(p, s, ctx, &light, scattered, bsdf_pdf);
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    write_shadow_ray(paths, i, p, s, &light);
    store_planes3(radiance, paths->shadow_radiance, i, paths->plane_stride);
}
#endif
#endif

// Goes on in the direction that was drawn, if the path does not end here.
INLINE void write_next_ray(const PathState* paths, size_t i, Path* p, const Surface* s, const BsdfContext* ctx, BsdfSample next, float u_roulette,
                  bool last, uint rr_depth)
{
    const bool straight = FEATURE_VOLPATH && next.pdf == STRAIGHT;
    if (last && !straight) return;
    Vec3 weight = mul3(p->throughput, next.weight);
#if HAS_BUMPS
    if (!straight) weight = scale3(weight, bump_shadowing(ctx, s, next.direction));
#endif
    const float total = weight.x + weight.y + weight.z;
    if (total == 0.0f) return;
    if (!(total < INFINITY)) {  // the statistics count such a sample apart; it must not end as a black one
        STORE3(splat3(NAN), p->sample, paths->samples);
        return;
    }
    const float eta = p->eta * next.eta;
#if FEATURE_RUSSIAN_ROULETTE
    if (!straight && p->depth + 1u >= rr_depth) {  // Mitsuba 3's rule
        // not below the least number that u may be under, 2^-24
        const float survival = MAX(MIN(max_component3(weight) * eta * eta, 0.95f), 0x1p-24f);
        if (u_roulette >= survival) return;
        weight = div_scalar3(weight, survival);
    }
#endif
    const uint plane_stride = paths->plane_stride;
    store_planes4(vec4_from(spawn_origin(s, next.direction), INFINITY), paths->ray_origin, i, plane_stride);
    store_planes4(vec4_from(next.direction, straight ? p->direction_pdf : next.pdf), paths->ray_direction, i, plane_stride);
    store_planes4(vec4_from(weight, eta), paths->throughput, i, plane_stride);
    PLANE(PATH_START_PRIMITIVE, paths->path, plane_stride)[i] = p->in_volume ? NONE : p->primitive;
    PLANE(PATH_DEPTH, paths->path, plane_stride)[i] = p->depth + (straight ? 0u : 1u);
#if FEATURE_VOLPATH
    paths->mis_distance[i] = straight ? p->mis_distance : 0.0f;
    paths->null_bounces[i] = p->null_bounces + (straight ? 1u : 0u);
#endif
#if FEATURE_MEDIA
    paths->medium[i] = medium_towards(s, next.direction, p->medium);
#endif
#if HAS_LIGHT_IMPORTANCE
    if (!straight) store_planes4(light_sampling_normal(ctx), paths->mis_normal, i, plane_stride);
#endif
    paths->alive[i] = 1;
}

