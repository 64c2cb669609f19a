// A spot whose cone projects a texture.
#pragma once
#include "light/projection.h"
#include "light/spot_light.h"

#if FEATURE_NEXT_EVENT && FEATURE_TEXTURED_SPOT_LIGHTS
INLINE void sample_textured_spot_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u,
                                       LightSample* sample)
{
    sample_spot_light(scene, light, reference, u, sample);
    const Vec3 at = project_to_uv(scene, light, neg3(sample->direction));
    if (at.z > 0.0f) sample->radiance = mul3(sample->radiance, projected_rgb(scene, light, vec2(at.x, at.y)));
}
#endif
