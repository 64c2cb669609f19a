// What a path does where it scatters: the light that it looks at, its next direction.
#pragma once
#include "arrival.h"

#if FEATURE_NEXT_EVENT
// Whether next-event estimation looks for light where a path that `looks` is scattered.
INLINE bool looks_for_light(const Shading* at, bool looks)
{
    return looks && bsdf_is_smooth(at);
}

// Whether a light that was picked may send anything.
INLINE bool may_light(const LightSample* light)
{
    return light->pdf > 0.0f && largest(light->radiance) > 0.0f;
}

// What arrives by way of a surface that scatters this share of the light, which it would itself have found with `bsdf_pdf`.
INLINE Vec3 direct_light(const Path* p, const Surface* s, const Shading* at, const LightSample* light, Vec3 scattered, float bsdf_pdf)
{
    const float mis = light->is_delta ? 1.0f : mis_weight(light->pdf, bsdf_pdf);
    Vec3 radiance = scale3(mul3(mul3(p->weight, scattered), light->radiance), mis / light->pdf);
#if HAS_BUMPS
    radiance = scale3(radiance, bump_share(at, s, light->direction));
#endif
    return radiance;
}

// Leaves a shadow ray for the light, but for its radiance.
INLINE void leave_shadow_ray(const Paths* of, size_t i, const Path* p, const Surface* s, const LightSample* light)
{
    const Vec3 origin = leave(s, light->direction);
    // to a finite light the ray's length is 1, and both its ends are moved off their surfaces
    const Vec3 end = offset_origin(light->position, light->error, light->normal, neg3(light->direction));
    const Vec3 direction = light->is_infinite ? light->direction : sub3(end, origin);
    store_planes4(with_w(origin, as_float(light->primitive)), of->shadow_origin, i, of->pool);
    store_planes4(with_w(direction, light->is_infinite ? INFINITY : 1.0f), of->shadow_direction, i, of->pool);
#if FEATURE_MEDIA
    PLANE(3, of->shadow_radiance, of->pool)[i] = as_float(medium_behind(s, direction, p->within));
#endif
}

#if LANES == 1
// Looks at the light that was picked; leaves a shadow ray, unless nothing could arrive.
INLINE void next_event(const Scene* scene, const Paths* of, size_t i, const Path* p, const Surface* s, const Shading* at, bool looks)
{
    if (!looks_for_light(at, looks)) return;
    const Vec4 u = path_random(scene, p, BLOCK_LIGHT(event_of(p)));
    const LightPick pick = pick_light(&scene->geometry, scene->lights, scene->light_alias, scene->light_count, s->position,
                                      lit_side(at), u.x, u.w);
    if (!(pick.probability > 0.0f)) return;
    const LightSample light = sample_light(&scene->geometry, scene->lights, pick, s->position, vec2(u.y, u.z));
    if (!may_light(&light)) return;
    float bsdf_pdf = 0.0f;
    const Vec3 scattered = bsdf_eval(at, light.direction, &bsdf_pdf);
    const Vec3 radiance = direct_light(p, s, at, &light, scattered, bsdf_pdf);
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    leave_shadow_ray(of, i, p, s, &light);
    store_planes3(radiance, of->shadow_radiance, i, of->pool);
}
#endif
#endif

// Goes on in the direction that was drawn, if the path does not end here.
INLINE void go_on(const Paths* of, size_t i, Path* p, const Surface* s, const Shading* at, BsdfSample next, float u_roulette,
                  bool last, uint rr_depth)
{
    const bool straight = FEATURE_VOLPATH && next.pdf == STRAIGHT;
    if (last && !straight) return;
    Vec3 weight = mul3(p->weight, next.weight);
#if HAS_BUMPS
    if (!straight) weight = scale3(weight, bump_share(at, s, next.direction));
#endif
    const float total = weight.x + weight.y + weight.z;
    if (total == 0.0f) return;
    if (!(total < INFINITY)) {  // the statistics count such a sample apart; it must not end as a black one
        STORE3(all3(NAN), p->sample, of->samples);
        return;
    }
    const float eta = p->eta * next.eta;
#if FEATURE_RUSSIAN_ROULETTE
    if (!straight && p->depth + 1u >= rr_depth) {  // Mitsuba 3's rule
        // not below the least number that u may be under, 2^-24
        const float survival = GREATER(LESSER(largest(weight) * eta * eta, 0.95f), 0x1p-24f);
        if (u_roulette >= survival) return;
        weight = over3(weight, survival);
    }
#endif
    const uint pool = of->pool;
    store_planes4(with_w(leave(s, next.direction), INFINITY), of->ray_origin, i, pool);
    store_planes4(with_w(next.direction, straight ? p->direction_pdf : next.pdf), of->ray_direction, i, pool);
    store_planes4(with_w(weight, eta), of->throughput, i, pool);
    PLANE(PATH_START, of->path, pool)[i] = p->in_volume ? NONE : p->primitive;
    PLANE(PATH_DEPTH, of->path, pool)[i] = p->depth + (straight ? 0u : 1u);
#if FEATURE_VOLPATH
    of->crossing[i] = as_uint(straight ? p->since_vertex : 0.0f);
    PLANE(1, of->crossing, pool)[i] = p->crossed + (straight ? 1u : 0u);
#endif
#if FEATURE_MEDIA
    of->medium[i] = medium_behind(s, next.direction, p->within);
#endif
#if HAS_LIT
    if (!straight) store_planes4(lit_side(at), of->lit, i, pool);
#endif
    of->alive[i] = 1;
}

