// Light from infinity, from all directions: constant, or an image (light/envmap.h).
#pragma once
#include "light/light_sample.h"

#if HAS_ENVIRONMENT_LIGHT
// Radiance from infinity along `direction`, and the pdf with which `sample_light` samples it, without the selection
// probability.
INLINE Vec3 environment_radiance(const SceneView* scene, const Light* sky, Vec3 direction, float* pdf)
{
    Vec3 radiance = LOAD3(0, sky->radiance);
    *pdf = 0.25f * M_1_PI_F;
#if FEATURE_ENVIRONMENT_MAP
    if (!FEATURE_CONSTANT_LIGHT || sky->kind & LIGHT_ENVIRONMENT_MAP)
        radiance = envmap_radiance(&scene->envmap, direction, pdf);
#endif
    return radiance;
}
#endif

#if FEATURE_NEXT_EVENT && FEATURE_CONSTANT_LIGHT
INLINE void sample_constant_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u,
                                  LightSample* sample)
{
    sample->direction = square_to_sphere(u);
    sample->pdf *= 0.25f * M_1_PI_F;
    sample->is_infinite = true;
}
#endif

#if FEATURE_NEXT_EVENT && FEATURE_ENVIRONMENT_MAP
// With LANES > 1, u is the position in the map already (path/shade_lanes.h).
INLINE void sample_environment_map_light(const SceneView* scene, const Light* light, Vec3 reference, Vec2 u,
                                         LightSample* sample)
{
    const Vec2 position = LANES == 1 ? envmap_position(&scene->envmap, u) : u;
    float density;
    sample->radiance = envmap_sample(&scene->envmap, position, &sample->direction, &density);
    sample->pdf *= density;
    sample->is_infinite = true;
}
#endif
