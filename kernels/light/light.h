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

#if FEATURE_NEXT_EVENT && FEATURE_MANY_LIGHTS && !HAS_LIGHT_IMPORTANCE
// Walker's alias method with 48 random bits, so that a million lights are still selected with their exact
// probabilities.
INLINE uint select_light_by_power(__global const Alias* table, uint count, float u_high, float u_low)
{
    const ulong scaled = (ulong)(u_high * 0x1p24f) * count + (((ulong)(u_low * 0x1p24f) * count) >> 24);
    const uint index = MIN((uint)(scaled >> 24), count - 1u);
    const float fraction = (float)(scaled & 0xFFFFFFu) * 0x1p-24f;
    const Alias entry = Alias_at(table, index);
    return fraction < entry.threshold ? index : entry.alias;
}
#endif

#if FEATURE_NEXT_EVENT
// A selected light and its probability; 0 if none was selected.
typedef struct {
    uint light;
    float probability;
} LightSelection;

#if !FEATURE_LIGHT_LIST || LANES == 1  // with a list, lanes select together
// Selects a light for a point and its normal (`light_sampling_normal`), by a random number and its low bits.
INLINE LightSelection select_light(const SceneView* scene, Vec3 reference, Vec4 normal, float u, float u_low)
{
    LightSelection selected;
#if FEATURE_LIGHT_LIST
    selected.light = select_from_list(&scene->light_list, reference, normal, u, u_low, &selected.probability);
#elif FEATURE_LIGHT_TREE
    selected.light = select_from_tree(&scene->light_tree, reference, normal, u, u_low, &selected.probability);
#elif FEATURE_MANY_LIGHTS
    selected.light = select_light_by_power(scene->light_alias, scene->light_count, u, u_low);
    selected.probability = Light_at(scene->lights, selected.light).power_pmf;
#else
    selected.light = 0u;
    selected.probability = 1.0f;
#endif
    return selected;
}
#endif

// Samples the selected light, which is of one of these kinds, for the point `reference`.
INLINE LightSample sample_light_of_kind(uint kinds, const SceneView* scene, LightSelection selected, Vec3 reference,
                                        Vec2 u)
{
    LightSample sample = empty_light_sample();
    Light record = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? selected.light : 0u);
    record.kind =
        kinds == LIGHT_TRIANGLE ? kinds : record.kind & kinds;  // a compile-time constant if there is one kind
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

INLINE LightSample sample_light(const SceneView* scene, LightSelection selected, Vec3 reference, Vec2 u)
{
    return sample_light_of_kind(~0u, scene, selected, reference, u);
}
#endif
