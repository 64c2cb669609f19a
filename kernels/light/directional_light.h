// Parallel light from infinity.
#pragma once
#include "light/light_sample.h"

#if FEATURE_NEXT_EVENT && FEATURE_DIRECTIONAL_LIGHTS
INLINE void sample_directional_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u,
                                     LightSample* sample)
{
    sample->direction = neg3(LOAD3(0, light->position));
    sample->is_delta = sample->is_infinite = true;
}
#endif
