// Picking one of some lights: each is looked at, by how much light it could send to the point that is lit. The bounds are those of
// the leaves of a tree of lights (light_tree.h); for few of them a loop over all costs less than a walk.
#pragma once
#include "paths.h"
#include "vectors.h"

// Whether lights are picked by what they could send to a point: then paths carry the normal of their last vertex.
#define HAS_LIT (FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST)

#if FEATURE_LIGHT_LIST
#define BY_INTENSITY 0x1p-10f  // of the picks: so that nothing that a bound misses by rounding is never picked
#define LEAST_TOTAL 1e-30f  // of all weights: its inverse is a number; below it the shares decide

typedef struct {
    __global const LightBound* bounds;  // of every light; those without power have no share
    uint lights;
} LightList;

// 1 / sqrt(x), to 5e-6 of it: two of Newton's steps from a first guess by the bits. Weights need no more, as long as those that
// a light is picked by and those of its probability are the same; root and division would cost four times as much.
INLINE float inverse_root(float x)
{
    float y = as_float(0x5F375A86u - (as_uint(x) >> 1));
    y *= 1.5f - 0.5f * x * y * y;
    return y * (1.5f - 0.5f * x * y * y);
}

// Twice `distance` times a cosine: between the one of a sphere's middle and its bound over the sphere, from which the light that
// arrives is left out only if none does. Both are given times the distance.
INLINE float likely_part(float middle, float radius, float distance)
{
    return LESSER(GREATER(middle + radius, 0.0f), distance) + GREATER(middle, 0.0f);
}

// How much light a light could send to a point, in a unit of its own. `normal`: there; its w is 1 where light from all sides
// counts (then the rest is 0), else 0. The sine of half the angle under which a sphere appears is radius / distance; adding it
// to a cosine comes close to the cosine of the difference, and is 0 where that is.
// `wide`: whether its normals may differ.
INLINE float light_weight(__global const LightBound* light, bool wide, Vec3 point, Vec4 normal)
{
    const Vec3 arm = sub3(LOAD3(0, light->center), point);
    const float distance2 = GREATER(dot3(arm, arm), 1e-36f), inverse = inverse_root(distance2), distance = distance2 * inverse;
    const float incidence = dot3(xyz(normal), arm) + normal.w * distance;
    float emission = -dot3(LOAD3(0, light->axis), arm);
    if (wide) {
        const float across2 = GREATER(distance2 - emission * emission, 1e-36f), across = across2 * inverse_root(across2);
        emission = emission > light->cos_spread * distance ? distance
                                                           : emission * light->cos_spread + across * light->sin_spread;
    }
    const float radius = light->radius, inverse2 = inverse * inverse;
    const float weight = likely_part(emission, radius, distance) * likely_part(incidence, radius, distance) * inverse2 *
                         LESSER(light->intensity * inverse2, light->most);
    return emission + radius > light->cos_edge * distance ? weight : 0.0f;
}

// How weights and shares become probabilities, by the sum of the weights: BY_INTENSITY of the picks goes by shares alone.
typedef struct {
    float by_weight, by_share;
    float unused[3];
} Mixture;

INLINE Mixture mixture(float total)
{
    const bool some = total > LEAST_TOTAL;
    Mixture m;
    m.by_weight = some ? (1.0f - BY_INTENSITY) / total : 0.0f;
    m.by_share = some ? BY_INTENSITY : 1.0f;
    return m;
}

INLINE float light_probability(Mixture m, float weight, float share)
{
    return m.by_weight * weight + m.by_share * share;
}

// A pick in progress. The random number has 48 bits, as the sum of two floats; probabilities are taken off until less than nothing
// is left. So a light is picked with its own probability, be it far below the last bit of the others'.
typedef struct {
    float left, rest;
    uint light;         // the one that was picked; until then, and where all leave something to rounding, the likeliest so far
    float probability;  // of picking it
    float unused;
} Draw;

INLINE Draw begin_draw(float u, float u_low)
{
    Draw d;
    d.left = u;
    d.rest = 0x1p-24f * u_low;
    d.light = 0u;
    d.probability = 0.0f;
    return d;
}

INLINE void take_off(Draw* d, uint light, float probability)
{
    const bool searches = d->left >= 0.0f;
    const float past = d->left - probability, lost = (d->left - past) - probability, rest = d->rest + lost;
    d->left = past + rest;
    d->rest = rest - (d->left - past);
    const bool takes = searches && (d->left < 0.0f || probability > d->probability);
    d->light = takes ? light : d->light;
    d->probability = takes ? probability : d->probability;
}

// Probability with which a light is picked for a point.
INLINE float light_list_probability(const LightList* list, uint light, Vec3 point, Vec4 normal)
{
    float total = 0.0f, of_light = 0.0f;
    for (uint other = 0u; other < list->lights; ++other) {
        const float weight = light_weight(list->bounds + other, true, point, normal);
        total += weight;
        of_light = other == light ? weight : of_light;
    }
    return light_probability(mixture(total), of_light, list->bounds[light].share);
}

// Picks a light by a random number in [0, 1), given as `u` and what lies below its last bit.
INLINE uint pick_from_list(const LightList* list, Vec3 point, Vec4 normal, float u, float u_low, float* probability)
{
    float total = 0.0f;
    for (uint light = 0u; light < list->lights; ++light) total += light_weight(list->bounds + light, true, point, normal);
    const Mixture m = mixture(total);
    Draw d = begin_draw(u, u_low);
    for (uint light = 0u; light < list->lights; ++light)
        take_off(&d, light, light_probability(m, light_weight(list->bounds + light, true, point, normal), list->bounds[light].share));
    *probability = d.probability;
    return d.light;
}

#if LANES > 1
// Adds a light's weights for the first `count` lanes to their totals.
INLINE void weigh_light(__global const LightBound* light, const float* points, const float* normals, float* weights,
                        float* totals, uint count)
{
    if (light->sin_spread != 0.0f) {
        EACH_OF(k, count) {
            weights[k] = light_weight(light, true, kept3(points, 0u, k), kept4(normals, 0u, k));
            totals[k] += weights[k];
        }
    } else {
        EACH_OF(k, count) {
            weights[k] = light_weight(light, false, kept3(points, 0u, k), kept4(normals, 0u, k));
            totals[k] += weights[k];
        }
    }
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Whose probabilities are asked for, LANES numbers a member.
#define ASKED_POINT 0u
#define ASKED_NORMAL 3u
#define ASKED_LIGHT 7u
#define ASKED_PROBABILITY 8u  // the answer
#define ASKED 9u

// Probabilities with which lights are picked, for the first `count` lanes.
INLINE void answer_from_list(const LightList* list, float* asked, uint count)
{
    float weights[LANES], totals[LANES];
    EACH_OF(k, count) {
        totals[k] = 0.0f;
        keep1(0.0f, asked, ASKED_PROBABILITY, k);
    }
    for (uint light = 0u; light < list->lights; ++light) {
        weigh_light(list->bounds + light, asked + ASKED_POINT * LANES, asked + ASKED_NORMAL * LANES, weights, totals, count);
        EACH_OF(k, count) {
            const float before = kept1(asked, ASKED_PROBABILITY, k);
            keep1(as_uint(kept1(asked, ASKED_LIGHT, k)) == light ? weights[k] : before, asked, ASKED_PROBABILITY, k);
        }
    }
    EACH_OF(k, count) {
        if (k >= count) continue;
        const float share = list->bounds[(int)as_uint(kept1(asked, ASKED_LIGHT, k))].share;
        keep1(light_probability(mixture(totals[k]), kept1(asked, ASKED_PROBABILITY, k), share), asked, ASKED_PROBABILITY, k);
    }
}
#endif

// Picks lights for the first `count` lanes of what a work-item keeps: of points (3 members), normals (4) and random numbers (2),
// to lights and probabilities (2).
INLINE void pick_all_from_list(const LightList* list, const float* points, const float* normals, const float* u, float* picks,
                               uint count)
{
    float weights[MOST_LISTED_LIGHTS * LANES], totals[LANES], by_weight[LANES], by_share[LANES], left[LANES], rest[LANES];
    EACH_OF(k, count) totals[k] = 0.0f;
    for (uint light = 0u; light < list->lights; ++light)
        weigh_light(list->bounds + light, points, normals, weights + light * LANES, totals, count);
    EACH_OF(k, count) {
        const Mixture m = mixture(totals[k]);
        const Draw d = begin_draw(kept1(u, 0u, k), kept1(u, 1u, k));
        by_weight[k] = m.by_weight;
        by_share[k] = m.by_share;
        left[k] = d.left;
        rest[k] = d.rest;
        keep1(as_float(d.light), picks, 0u, k);
        keep1(d.probability, picks, 1u, k);
    }
    for (uint light = 0u; light < list->lights; ++light) {
        EACH_OF(k, count) {
            Mixture m;
            m.by_weight = by_weight[k];
            m.by_share = by_share[k];
            Draw d;
            d.left = left[k];
            d.rest = rest[k];
            d.light = as_uint(kept1(picks, 0u, k));
            d.probability = kept1(picks, 1u, k);
            take_off(&d, light, light_probability(m, weights[light * LANES + k], list->bounds[light].share));
            left[k] = d.left;
            rest[k] = d.rest;
            keep1(as_float(d.light), picks, 0u, k);
            keep1(d.probability, picks, 1u, k);
        }
    }
}
#endif
#endif
