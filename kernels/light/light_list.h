// Light sampling for scenes of few lights, called by next-event estimation and MIS in `shade`: selects a light with
// probability proportional to an estimate of the light it can send to the shading point. It loops over all lights; for
// few of them this is cheaper than the traversal of a tree (light/light_tree.h).
// host/isonoise/scene/light/light_list.py makes the bounds.
#pragma once
#include "light/cdf_search.h"
#include "path/path_state.h"
#include "util/math.h"

// Whether lights are selected by their importance for a point: then paths carry the normal of the previous vertex for
// MIS.
#define HAS_LIGHT_IMPORTANCE (FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST)

#if FEATURE_LIGHT_LIST
#define DEFENSIVE_FRACTION 0x1p-10f  // of the selections go by power alone, in case rounding makes an importance 0
#define MIN_TOTAL_IMPORTANCE 1e-30f  // its inverse is finite; below it selections go by power alone

typedef struct {
    __global const LightBound* bounds;  // of every light; power_fraction is 0 for a light without power
    uint light_count;
} LightList;

// 1 / sqrt(x) with a relative error of 5e-6: an initial guess from the bits and two Newton steps. That is exact enough
// for an importance if selection and pmf use the same value; square root and division would cost four times as much.
INLINE float rsqrt_approx(float x)
{
    float y = as_float(0x5F375A86u - (as_uint(x) >> 1));
    y *= 1.5f - 0.5f * x * y * y;
    return y * (1.5f - 0.5f * x * y * y);
}

// Estimates a cosine over a bounding sphere: the sum of the cosine at the centre and its upper bound over the sphere,
// both clamped to [0, 1]. It is 0 only if no light can arrive. The cosine and the result are multiplied by the
// distance.
INLINE float twice_cosine_estimate(float center_cosine, float radius, float distance)
{
    return MIN(MAX(center_cosine + radius, 0.0f), distance) + MAX(center_cosine, 0.0f);
}

// Importance of a light for a point: an estimate of the irradiance, without unit. `normal`: at the point; w is 1 where
// light from all sides counts (then xyz is 0), else 0. A sphere subtends an angle with sine radius / distance to either
// side of its centre; adding this sine to a cosine approximates the cosine of the angle minus that, and is 0 where it
// is 0. `has_spread`: whether the normals of the light may differ.
INLINE float light_importance(__global const LightBound* light, bool has_spread, Vec3 point, Vec4 normal)
{
    const Vec3 to_light = sub3(LOAD3(0, light->center), point);
    const float distance2 = MAX(dot3(to_light, to_light), 1e-36f);
    const float inverse = rsqrt_approx(distance2), distance = distance2 * inverse;
    // cosines times the distance
    const float incidence = dot3(xyz(normal), to_light) + normal.w * distance;
    float emission = -dot3(LOAD3(0, light->axis), to_light);
    if (has_spread) {
        const float sine2 = MAX(distance2 - emission * emission, 1e-36f), sine = sine2 * rsqrt_approx(sine2);
        emission = emission > light->cos_spread * distance ? distance
                                                           : emission * light->cos_spread + sine * light->sin_spread;
    }
    const float radius = light->radius, inverse2 = inverse * inverse;
    const float importance = twice_cosine_estimate(emission, radius, distance) *
                             twice_cosine_estimate(incidence, radius, distance) * inverse2 *
                             MIN(light->intensity * inverse2, light->max_irradiance);
    return emission + radius > light->cos_edge * distance ? importance : 0.0f;
}

// Mixture of two selection pmfs, by importance and by power: a light's pmf is the sum of both, each times its scale.
// `padding`: see Vec3 in util/vec.h.
typedef struct {
    float importance_scale, power_scale;
    float padding[3];
} ImportanceMixture;

INLINE ImportanceMixture make_importance_mixture(float total_importance)
{
    const bool uses_importance = total_importance > MIN_TOTAL_IMPORTANCE;
    ImportanceMixture m;
    m.importance_scale = uses_importance ? (1.0f - DEFENSIVE_FRACTION) / total_importance : 0.0f;
    m.power_scale = uses_importance ? DEFENSIVE_FRACTION : 1.0f;
    return m;
}

INLINE float mixture_pmf(ImportanceMixture m, float importance, float power_fraction)
{
    return m.importance_scale * importance + m.power_scale * power_fraction;
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Probability of selecting a light for a point, for MIS.
INLINE float light_list_pmf(const LightList* list, uint light, Vec3 point, Vec4 normal)
{
    float total = 0.0f, selected = 0.0f;
    for (uint other = 0u; other < list->light_count; ++other) {
        const float importance = light_importance(list->bounds + other, true, point, normal);
        total += importance;
        selected = other == light ? importance : selected;
    }
    return mixture_pmf(make_importance_mixture(total), selected, list->bounds[light].power_fraction);
}
#endif

// Selects a light by the random number *random + 2^-24 u_low, in [0, 1). `pmf` receives its probability, *random the
// rescaled number.
INLINE uint select_from_list(const LightList* list, Vec3 point, Vec4 normal, float* random, float u_low, float* pmf)
{
    __global const LightBound* bounds = list->bounds;
    float total = 0.0f;
    for (uint light = 0u; light < list->light_count; ++light)
        total += light_importance(bounds + light, true, point, normal);
    const ImportanceMixture m = make_importance_mixture(total);
    CdfSearch search = begin_cdf_search(*random, 0x1p-24f * u_low);
    for (uint light = 0u; light < list->light_count; ++light) {
        const float importance = light_importance(bounds + light, true, point, normal);
        advance_cdf_search(&search, light, mixture_pmf(m, importance, bounds[light].power_fraction));
    }
    *pmf = search.pmf;
    *random = rescaled_random(search.remainder, search.pmf);
    return search.item;
}

#if LANES > 1
// The importance of a light for the first `count` lanes: stored in `importances` and added to `totals`.
INLINE void add_light_importance(__global const LightBound* light, const float* points, const float* normals,
                                 float* importances, float* totals, uint count)
{
    if (light->sin_spread != 0.0f) {
        FOR_LANES(k, count) {
            importances[k] = light_importance(light, true, load_lane3(points, 0u, k), load_lane4(normals, 0u, k));
            totals[k] += importances[k];
        }
    } else {
        FOR_LANES(k, count) {
            importances[k] = light_importance(light, false, load_lane3(points, 0u, k), load_lane4(normals, 0u, k));
            totals[k] += importances[k];
        }
    }
}

#if FEATURE_AREA_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
// Members of the light pdf queries, each an array of LANES floats.
#define QUERY_POINT 0u
#define QUERY_NORMAL 3u
#define QUERY_LIGHT 7u
#define QUERY_PMF 8u  // the result
#define QUERY_FLOATS 9u

// `light_list_pmf` for the first `count` lanes.
INLINE void evaluate_light_pmf_queries(const LightList* list, float* queries, uint count)
{
    float importances[LANES], totals[LANES];
    FOR_LANES(k, count) {
        totals[k] = 0.0f;
        store_lane(0.0f, queries, QUERY_PMF, k);
    }
    for (uint light = 0u; light < list->light_count; ++light) {
        add_light_importance(list->bounds + light, queries + QUERY_POINT * LANES, queries + QUERY_NORMAL * LANES,
                             importances, totals, count);
        FOR_LANES(k, count) {
            const float selected = load_lane(queries, QUERY_PMF, k);
            const bool is_light = as_uint(load_lane(queries, QUERY_LIGHT, k)) == light;
            store_lane(is_light ? importances[k] : selected, queries, QUERY_PMF, k);
        }
    }
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const float power_fraction = list->bounds[(int)as_uint(load_lane(queries, QUERY_LIGHT, k))].power_fraction;
        const ImportanceMixture m = make_importance_mixture(totals[k]);
        store_lane(mixture_pmf(m, load_lane(queries, QUERY_PMF, k), power_fraction), queries, QUERY_PMF, k);
    }
}
#endif

// `select_from_list` for the first `count` lanes. Arrays of LANES floats per member: `points` (3 members), `normals`
// (4) and `random` (2: u, which receives the rescaled number, and u_low); `selections` receives light and pmf (2).
INLINE void select_lights_from_list(const LightList* list, const float* points, const float* normals, float* random,
                                    float* selections, uint count)
{
    float importances[MAX_LISTED_LIGHTS * LANES], totals[LANES], importance_scale[LANES], power_scale[LANES];
    float u[LANES], u_low[LANES];
    FOR_LANES(k, count) totals[k] = 0.0f;
    for (uint light = 0u; light < list->light_count; ++light)
        add_light_importance(list->bounds + light, points, normals, importances + light * LANES, totals, count);
    FOR_LANES(k, count) {
        const ImportanceMixture m = make_importance_mixture(totals[k]);
        const CdfSearch search = begin_cdf_search(load_lane(random, 0u, k), 0x1p-24f * load_lane(random, 1u, k));
        importance_scale[k] = m.importance_scale;
        power_scale[k] = m.power_scale;
        u[k] = search.u;
        u_low[k] = search.u_low;
        store_lane(search.remainder, random, 0u, k);
        store_lane(as_float(search.item), selections, 0u, k);
        store_lane(search.pmf, selections, 1u, k);
    }
    for (uint light = 0u; light < list->light_count; ++light) {
        FOR_LANES(k, count) {
            ImportanceMixture m;
            m.importance_scale = importance_scale[k];
            m.power_scale = power_scale[k];
            CdfSearch search;
            search.u = u[k];
            search.u_low = u_low[k];
            search.item = as_uint(load_lane(selections, 0u, k));
            search.pmf = load_lane(selections, 1u, k);
            search.remainder = load_lane(random, 0u, k);
            const float pmf = mixture_pmf(m, importances[light * LANES + k], list->bounds[light].power_fraction);
            advance_cdf_search(&search, light, pmf);
            u[k] = search.u;
            u_low[k] = search.u_low;
            store_lane(as_float(search.item), selections, 0u, k);
            store_lane(search.pmf, selections, 1u, k);
            store_lane(search.remainder, random, 0u, k);
        }
    }
    FOR_LANES(k, count)
        store_lane(rescaled_random(load_lane(random, 0u, k), load_lane(selections, 1u, k)), random, 0u, k);
}
#endif
#endif
