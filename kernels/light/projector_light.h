// A point that projects an image.
#pragma once
#include "light/projection.h"

#if FEATURE_NEXT_EVENT && FEATURE_PROJECTOR_LIGHTS
INLINE void sample_projector_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u,
                                   LightSample* sample)
{
    sample->position = LOAD3(0, light->position);
    const Vec3 arm = sub3(reference, sample->position);
    sample->direction = neg3(normalize3(arm));
    sample->is_delta = true;
    const Vec3 at = project_to_uv(scene, light, arm);
    const bool is_inside = at.z > 0.0f && at.x >= 0.0f && at.x <= 1.0f && at.y >= 0.0f && at.y <= 1.0f;
    if (!is_inside) {
        sample->radiance = splat3(0.0f);
        return;
    }
    const float cosine = -dot3(LOAD3(0, light->axis), sample->direction);
    const Vec3 rgb = projected_rgb(scene, light, vec2(at.x, at.y));
    sample->radiance = scale3(mul3(sample->radiance, rgb), 1.0f / (at.z * at.z * cosine));
}
#endif
