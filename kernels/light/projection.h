// Textures that lights project. Called by the headers of these kinds of light.
#pragma once
#include "light/light_sample.h"

#if FEATURE_NEXT_EVENT && HAS_PROJECTIONS
// Texture coordinates, and w, of a vector that starts at the light. They have no meaning unless w > 0.
INLINE Vec3 project_to_uv(const SceneView* scene, const Light* light, Vec3 arm)
{
    const Projection rows = Projection_at(scene->projections, light->primitive);
    const float w = dot3(LOAD3(2, rows.to_uv), arm);
    return vec3(dot3(LOAD3(0, rows.to_uv), arm) / w, dot3(LOAD3(1, rows.to_uv), arm) / w, w);
}

INLINE Vec3 projected_rgb(const SceneView* scene, const Light* light, Vec2 uv)
{
    const TexturePoint point = {uv, NONE, splat2(0.0f)};
    return texture_rgb(&scene->textures, light->texture, &point);
}
#endif
