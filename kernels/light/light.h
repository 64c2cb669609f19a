// Lights: selecting one, sampling it, and the pdf of both for a direction that was found otherwise. A kind of light is
// a row of host/isonoise/scene/light/light_kinds.py and a header; the generated header includes those and defines
// FOR_LIGHTS_WITHOUT_SURFACE over the kinds without a surface that the scene has.
#pragma once
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
// Inversion of the discrete CDF of the lights' powers, `light_cdf`: in units of 2^-48, without the sum of all.
INLINE LightSelection select_light_by_power(const SceneView* scene, float u, float u_low)
{
    const ulong number = (ulong)(u * 0x1p24f) << 24 | (ulong)(u_low * 0x1p24f);
    __global const ulong* cdf = scene->light_cdf;
    uint light = 0u, end = scene->light_count;
    while (end - light > 1u) {
        const uint middle = light + (end - light) / 2u;
        const bool is_above = cdf[middle] <= number;
        light = is_above ? middle : light;
        end = is_above ? end : middle;
    }
    const ulong upper = end < scene->light_count ? cdf[end] : 1ul << 48;
    LightSelection selected;
    selected.light = light;
    selected.probability = Light_at(scene->lights, light).power_pmf;
    selected.u = MIN((float)(number - cdf[light]) / (float)(upper - cdf[light]), 0x1.fffffep-1f);
    return selected;
}
#endif

#if LANES == 1 || (FEATURE_MANY_LIGHTS && !FEATURE_LIGHT_LIST)  // with a list, lanes select together
// Selects a light for a point and its normal (`light_sampling_normal`), by the random number u + 2^-24 u_low.
INLINE LightSelection select_light(const SceneView* scene, Vec3 reference, Vec4 normal, float u, float u_low)
{
#if FEATURE_MANY_LIGHTS && !HAS_LIGHT_IMPORTANCE
    return select_light_by_power(scene, u, u_low);
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
