// A point that emits the same to all sides.
#pragma once
#include "light/light_sample.h"

#if FEATURE_NEXT_EVENT && FEATURE_POINT_LIGHTS
INLINE void sample_point_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, LightSample* sample)
{
    sample->position = LOAD3(0, light->position);
    const Vec3 arm = sub3(sample->position, reference);
    sample->direction = normalize3(arm);
    sample->radiance = div_scalar3(sample->radiance, dot3(arm, arm));
    sample->is_delta = true;
}
#endif
