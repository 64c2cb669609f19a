// Picking one of some lights: each is looked at, by how much light it could send to the point that is lit. The bounds are those of
// the leaves of a tree of lights (light/light_tree.h); for few of them a loop over all costs less than a walk.
#pragma once
#include "path/path_state.h"
#include "util/math.h"

// Whether lights are picked by what they could send to a point: then paths carry the normal of their last vertex.
#define HAS_LIGHT_IMPORTANCE (FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST)

#if FEATURE_LIGHT_LIST
#define POWER_FRACTION 0x1p-10f  // of the picks: so that nothing that a bound misses by rounding is never picked
#define MIN_TOTAL_IMPORTANCE 1e-30f  // of all weights: its inverse is a number; below it the shares decide

typedef struct {
    __global const LightBound* bounds;  // of every light; those without power have no share
    uint lights;
} LightList;

// 1 / sqrt(x), to 5e-6 of it: two of Newton's steps from a first guess by the bits. Weights need no more, as long as those that
// a light is picked by and those of its probability are the same; root and division would cost four times as much.
INLINE float rsqrt_approx(float x)
{
    float y = as_float(0x5F375A86u - (as_uint(x) >> 1));
    y *= 1.5f - 0.5f * x * y * y;
    return y * (1.5f - 0.5f * x * y * y);
}

// Twice `distance` times a cosine: between the one of a sphere's middle and its bound over the sphere, from which the light that
// arrives is left out only if none does. Both are given times the distance.
INLINE float cosine_estimate_sum(float middle, float radius, float distance)
{
    return MIN(MAX(middle + radius, 0.0f), distance) + MAX(middle, 0.0f);
}

// How much light a light could send to a point, in a unit of its own. `normal`: there; its w is 1 where light from all sides
// counts (then the rest is 0), else 0. The sine of half the angle under which a sphere appears is radius / distance; adding it
// to a cosine comes close to the cosine of the difference, and is 0 where that is.
// `wide`: whether its normals may differ.
INLINE float light_importance(__global const LightBound* light, bool wide, Vec3 point, Vec4 normal)
{
    const Vec3 arm = sub3(LOAD3(0, light->center), point);
    const float distance2 = MAX(dot3(arm, arm), 1e-36f), inverse = rsqrt_approx(distance2), distance = distance2 * inverse;
    const float incidence = dot3(xyz(normal), arm) + normal.w * distance;
    float emission = -dot3(LOAD3(0, light->axis), arm);
    if (wide) {
        const float across2 = MAX(distance2 - emission * emission, 1e-36f), across = across2 * rsqrt_approx(across2);
        emission = emission > light->cos_spread * distance ? distance
                                                           : emission * light->cos_spread + across * light->sin_spread;
    }
    const float radius = light->radius, inverse2 = inverse * inverse;
    const float weight = cosine_estimate_sum(emission, radius, distance) * cosine_estimate_sum(incidence, radius, distance) * inverse2 *
                         MIN(light->intensity * inverse2, light->most);
    return emission + radius > light->cos_edge * distance ? weight : 0.0f;
}

// How weights and shares become probabilities, by the sum of the weights: POWER_FRACTION of the picks goes by shares alone.
typedef struct {
    float importance_scale, power_fraction;
    float unused[3];
} ImportanceMixture;

INLINE ImportanceMixture make_importance_mixture(float total)
{
    const bool some = total > MIN_TOTAL_IMPORTANCE;
    ImportanceMixture m;
    m.importance_scale = some ? (1.0f - POWER_FRACTION) / total : 0.0f;
    m.power_fraction = some ? POWER_FRACTION : 1.0f;
    return m;
}

INLINE float mixture_pmf(ImportanceMixture m, float weight, float share)
{
    return m.importance_scale * weight + m.power_fraction * share;
}

// A pick in progress. The random number has 48 bits, as the sum of two floats; probabilities are taken off until less than nothing
// is left. So a light is picked with its own probability, be it far below the last bit of the others'.
typedef struct {
    float left, rest;
    uint light;         // the one that was picked; until then, and where all leave something to rounding, the likeliest so far
    float probability;  // of picking it
    float unused;
} LightDraw;

INLINE LightDraw begin_light_draw(float u, float u_low)
{
    LightDraw d;
    d.left = u;
    d.rest = 0x1p-24f * u_low;
    d.light = 0u;
    d.probability = 0.0f;
    return d;
}

INLINE void advance_light_draw(LightDraw* d, uint light, float probability)
{
    const bool searches = d->left >= 0.0f;
    const float past = d->left - probability, lost = (d->left - past) - probability, rest = d->rest + lost;
    d->left = past + rest;
    d->rest = rest - (d->left - past);
    const bool takes = searches && (d->left < 0.0f || probability > d->probability);
    d->light = takes ? light : d->light;
    d->probability = takes ? probability : d->probability;
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Probability with which a light is picked for a point.
INLINE float light_list_pmf(const LightList* list, uint light, Vec3 point, Vec4 normal)
{
    float total = 0.0f, of_light = 0.0f;
    for (uint other = 0u; other < list->lights; ++other) {
        const float weight = light_importance(list->bounds + other, true, point, normal);
        total += weight;
        of_light = other == light ? weight : of_light;
    }
    return mixture_pmf(make_importance_mixture(total), of_light, list->bounds[light].share);
}
#endif

// Picks a light by a random number in [0, 1), given as `u` and what lies below its last bit.
INLINE uint select_from_list(const LightList* list, Vec3 point, Vec4 normal, float u, float u_low, float* probability)
{
    float total = 0.0f;
    for (uint light = 0u; light < list->lights; ++light) total += light_importance(list->bounds + light, true, point, normal);
    const ImportanceMixture m = make_importance_mixture(total);
    LightDraw d = begin_light_draw(u, u_low);
    for (uint light = 0u; light < list->lights; ++light)
        advance_light_draw(&d, light, mixture_pmf(m, light_importance(list->bounds + light, true, point, normal), list->bounds[light].share));
    *probability = d.probability;
    return d.light;
}

#if LANES > 1
// Adds a light's weights for the first `count` lanes to their totals.
INLINE void add_light_importance(__global const LightBound* light, const float* points, const float* normals, float* weights,
                        float* totals, uint count)
{
    if (light->sin_spread != 0.0f) {
        FOR_LANES(k, count) {
            weights[k] = light_importance(light, true, load_lane3(points, 0u, k), load_lane4(normals, 0u, k));
            totals[k] += weights[k];
        }
    } else {
        FOR_LANES(k, count) {
            weights[k] = light_importance(light, false, load_lane3(points, 0u, k), load_lane4(normals, 0u, k));
            totals[k] += weights[k];
        }
    }
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Whose probabilities are asked for, LANES numbers a member.
#define QUERY_POINT 0u
#define QUERY_NORMAL 3u
#define QUERY_LIGHT 7u
#define QUERY_PMF 8u  // the answer
#define QUERY_FLOATS 9u

// Probabilities with which lights are picked, for the first `count` lanes.
INLINE void evaluate_light_pmf_queries(const LightList* list, float* queries, uint count)
{
    float weights[LANES], totals[LANES];
    FOR_LANES(k, count) {
        totals[k] = 0.0f;
        store_lane(0.0f, queries, QUERY_PMF, k);
    }
    for (uint light = 0u; light < list->lights; ++light) {
        add_light_importance(list->bounds + light, queries + QUERY_POINT * LANES, queries + QUERY_NORMAL * LANES, weights, totals, count);
        FOR_LANES(k, count) {
            const float before = load_lane(queries, QUERY_PMF, k);
            store_lane(as_uint(load_lane(queries, QUERY_LIGHT, k)) == light ? weights[k] : before, queries, QUERY_PMF, k);
        }
    }
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const float share = list->bounds[(int)as_uint(load_lane(queries, QUERY_LIGHT, k))].share;
        store_lane(mixture_pmf(make_importance_mixture(totals[k]), load_lane(queries, QUERY_PMF, k), share), queries, QUERY_PMF, k);
    }
}
#endif

// Picks lights for the first `count` lanes of what a work-item keeps: of points (3 members), normals (4) and random numbers (2),
// to lights and probabilities (2).
INLINE void select_lights_from_list(const LightList* list, const float* points, const float* normals, const float* u, float* picks,
                               uint count)
{
    float weights[MAX_LISTED_LIGHTS * LANES], totals[LANES], importance_scale[LANES], power_fraction[LANES], left[LANES], rest[LANES];
    FOR_LANES(k, count) totals[k] = 0.0f;
    for (uint light = 0u; light < list->lights; ++light)
        add_light_importance(list->bounds + light, points, normals, weights + light * LANES, totals, count);
    FOR_LANES(k, count) {
        const ImportanceMixture m = make_importance_mixture(totals[k]);
        const LightDraw d = begin_light_draw(load_lane(u, 0u, k), load_lane(u, 1u, k));
        importance_scale[k] = m.importance_scale;
        power_fraction[k] = m.power_fraction;
        left[k] = d.left;
        rest[k] = d.rest;
        store_lane(as_float(d.light), picks, 0u, k);
        store_lane(d.probability, picks, 1u, k);
    }
    for (uint light = 0u; light < list->lights; ++light) {
        FOR_LANES(k, count) {
            ImportanceMixture m;
            m.importance_scale = importance_scale[k];
            m.power_fraction = power_fraction[k];
            LightDraw d;
            d.left = left[k];
            d.rest = rest[k];
            d.light = as_uint(load_lane(picks, 0u, k));
            d.probability = load_lane(picks, 1u, k);
            advance_light_draw(&d, light, mixture_pmf(m, weights[light * LANES + k], list->bounds[light].share));
            left[k] = d.left;
            rest[k] = d.rest;
            store_lane(as_float(d.light), picks, 0u, k);
            store_lane(d.probability, picks, 1u, k);
        }
    }
}
#endif
#endif
