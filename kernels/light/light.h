// Lights: selecting one, sampling it, and the pdf of both for a direction that was found otherwise. A kind of light is
// a row of host/isonoise/scene/light/light_kinds.py and a header; the generated header includes those and defines
// FOR_LIGHTS_WITHOUT_SURFACE over the kinds without a surface that the scene has.
#pragma once
#include "light/cdf_search.h"
#include "light/light_sample.h"
#include "generated/light_kinds.h"

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS
// Probability with which `select_light` selects a light for a point and its normal (`light_sampling_normal`). `pdf`: of
// the direction that hit the light; without MIS the probability does not matter and may be 0.
INLINE float light_pmf(const SceneView* scene, uint light, Vec3 point, Vec4 normal, float pdf)
{
#if FEATURE_LIGHT_LIST
    return is_mis_weighted(pdf) ? light_list_pmf(&scene->light_list, light, point, normal) : 0.0f;
#elif FEATURE_LIGHT_TREE
    return is_mis_weighted(pdf) ? light_tree_pmf(&scene->light_tree, light, point, normal) : 0.0f;
#elif FEATURE_MANY_LIGHTS
    return Light_at(scene->lights, light).power_pmf;
#else
    return 1.0f;
#endif
}
#endif

#if FEATURE_NEXT_EVENT
// A selected light and its probability; 0 if none was selected. `u`: the random number that selected it, rescaled to
// [0, 1). It still has 24 bits and, for numbers in order, is in order: it is the first coordinate of the position.
typedef struct {
    uint light;
    float probability;
    float u;
} LightSelection;

#if FEATURE_MANY_LIGHTS && !HAS_LIGHT_IMPORTANCE
// What is left of the random number u + 2^-24 u_low beyond the sum of the powers of the lights before this one, which
// `light_cdf` has in the same form. Its sign is exact.
INLINE float light_cdf_remainder(const SceneView* scene, uint light, float u, float u_low)
{
    __global const float* cdf = scene->light_cdf + 2 * (int)light;
    return (u - cdf[0]) + 0x1p-24f * (u_low - cdf[1]);
}

// A step of the search for the last light with a remainder that is not negative: moves on by `step` lights if it can.
INLINE uint advance_cdf_light(const SceneView* scene, uint light, uint step, float u, float u_low)
{
    const uint next = MIN(light + step, scene->light_count - 1u);
    return light + step == next && light_cdf_remainder(scene, next, u, u_low) >= 0.0f ? next : light;
}

INLINE LightSelection selection_by_power(const SceneView* scene, uint light, float u, float u_low)
{
    LightSelection selected;
    selected.light = light;
    selected.probability = Light_at(scene->lights, light).power_pmf;
    // a single light keeps the bits of the program without selection
    const float rescaled = light_cdf_remainder(scene, light, u, u_low) / selected.probability;
    selected.u = scene->light_count > 1u ? MIN(rescaled, 0x1.fffffep-1f) : u;
    return selected;
}

#if LANES > 1
// `select_light` for the first `count` lanes. Arrays of LANES floats per member: `random` (u, which receives the
// rescaled number, and u_low); `selections` receives light and probability.
INLINE void select_lights_by_power(const SceneView* scene, float* random, float* selections, uint count)
{
    FOR_LANES(k, count) store_lane(as_float(0u), selections, 0u, k);
    for (uint step = first_search_step(scene->light_count); step > 0u; step /= 2u) {
        FOR_LANES(k, count) {
            if (k >= count) continue;
            const uint light = as_uint(load_lane(selections, 0u, k));
            const uint advanced =
                advance_cdf_light(scene, light, step, load_lane(random, 0u, k), load_lane(random, 1u, k));
            store_lane(as_float(advanced), selections, 0u, k);
        }
    }
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const LightSelection selected = selection_by_power(scene, as_uint(load_lane(selections, 0u, k)),
                                                           load_lane(random, 0u, k), load_lane(random, 1u, k));
        store_lane(selected.probability, selections, 1u, k);
        store_lane(selected.u, random, 0u, k);
    }
}
#endif
#endif

#if LANES == 1 || (FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST)  // else lanes select together
// Selects a light for a point and its normal (`light_sampling_normal`), by the random number u + 2^-24 u_low.
INLINE LightSelection select_light(const SceneView* scene, Vec3 reference, Vec4 normal, float u, float u_low)
{
#if FEATURE_MANY_LIGHTS && !HAS_LIGHT_IMPORTANCE
    uint light = 0u;
    for (uint step = first_search_step(scene->light_count); step > 0u; step /= 2u)
        light = advance_cdf_light(scene, light, step, u, u_low);
    return selection_by_power(scene, light, u, u_low);
#else
    LightSelection selected = {0u, 1.0f, u};
#if FEATURE_LIGHT_LIST
    selected.light = select_from_list(&scene->light_list, reference, normal, &selected.u, u_low, &selected.probability);
#elif FEATURE_LIGHT_TREE
    selected.light = select_from_tree(&scene->light_tree, reference, normal, &selected.u, u_low, &selected.probability);
#endif
    return selected;
#endif
}
#endif

// Samples the selected light, which is of one of these kinds, for the point `reference`. `v`: the second coordinate of
// the position.
INLINE LightSample sample_light_of_kind(uint kinds, const SceneView* scene, LightSelection selected, Vec3 reference,
                                        float v)
{
    const Vec2 u = vec2(selected.u, v);
    LightSample sample = empty_light_sample();
    Light record = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? selected.light : 0u);
    record.kind &= kinds;
    if (kinds == LIGHT_MESH) {  // as far as possible a compile-time constant; the bit of triangles is not tested alone
        if (!FEATURE_TRIANGLE_LIGHTS) record.kind = LIGHT_PARALLELOGRAM;
        if (!FEATURE_PARALLELOGRAM_LIGHTS) record.kind = LIGHT_TRIANGLE;
        record.kind |= LIGHT_TRIANGLE;
    }
    const Light* light = &record;
    sample.pdf = selected.probability;
    sample.radiance = LOAD3(0, light->radiance);
#define SAMPLE_KIND_OF_LIGHT(BIT, sample_kind)            \
    if (light->kind & BIT) {                              \
        sample_kind(scene, light, reference, u, &sample); \
        return sample;                                    \
    }
    FOR_LIGHTS_WITHOUT_SURFACE(SAMPLE_KIND_OF_LIGHT)
#if FEATURE_AREA_LIGHTS
    sample_area_light(scene, light, reference, u, &sample);
#endif
    return sample;
}

INLINE LightSample sample_light(const SceneView* scene, LightSelection selected, Vec3 reference, float v)
{
    return sample_light_of_kind(HAS_NON_MESH_LIGHTS ? ~0u : LIGHT_MESH, scene, selected, reference, v);
}
#endif
