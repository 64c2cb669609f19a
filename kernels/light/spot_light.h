// A point that emits into a cone.
#pragma once
#include "light/light_sample.h"

#if FEATURE_NEXT_EVENT && (FEATURE_SPOT_LIGHTS || FEATURE_TEXTURED_SPOT_LIGHTS)
// Factor on the intensity along `direction`: falls linearly with the angle, as in Mitsuba 3. The angle is computed from
// the chord, which is exact for narrow spots too.
INLINE float spot_falloff(const Light* light, Vec3 direction)
{
    const Vec3 off = sub3(direction, LOAD3(0, light->axis));
    const float half_chord2 = MIN(0.25f * dot3(off, off), 1.0f);
    const float angle = 2.0f * atan2_float(SQRT(half_chord2), SQRT(1.0f - half_chord2));
    const float share = (light->cutoff - angle) * light->inverse_transition;
    return MIN(MAX(share, 0.0f), 1.0f);
}

INLINE void sample_spot_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u, LightSample* sample)
{
    sample->position = LOAD3(0, light->position);
    const Vec3 arm = sub3(sample->position, reference);
    sample->direction = normalize3(arm);
    sample->radiance = scale3(sample->radiance, spot_falloff(light, neg3(sample->direction)) / dot3(arm, arm));
    sample->is_delta = true;
}
#endif
