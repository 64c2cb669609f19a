// Where a path scatters: the material there, its frame and its parameters. Directions point away from the surface and are unit.
#pragma once
#include "texture.h"
#include "vectors.h"

#define HAS_BUMPS (FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_FRAMES (HAS_BUMPS || FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC || FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED)

#define NO_BUMP (-1.0f)

typedef struct {
    __global const Bsdf* bsdf;  // one that wraps no other
    float3 normal;              // shading normal
    float3 wi;                  // where the path came from, in world space
    float cos_i;                // of wi to the normal; not negative for materials of two sides
#if HAS_FRAMES
    float3 s, t;  // with the normal, an orthonormal frame; s goes along dp/du. Right-handed, but for turned materials
#endif
#if FEATURE_ROUGH_PLASTIC
    __global const float* tables;  // of `scene.boundaries`
#endif
#if HAS_BUMPS
    bool turned;  // to the viewer: the normal is the surface's from behind
    float shadow;  // alpha^2 of what shadows the bump, NO_BUMP where there is none
#endif
#if FEATURE_TEXTURES
    const Textures* textures;
    TexturePoint point;
#endif
} Shading;

// A parameter of the material that is a colour, and one that is a number.
INLINE float3 rgb_parameter(const Shading* at, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = at->bsdf->textures[slot];
    if (texture != NONE) return texture_rgb(at->textures, texture, &at->point);
#endif
    return LOAD3(slot, at->bsdf->values);
}

INLINE float number_parameter(const Shading* at, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = at->bsdf->textures[slot];
    if (texture != NONE) return texture_number(at->textures, texture, &at->point);
#endif
    return at->bsdf->values[3u * slot];
}

#if HAS_FRAMES
INLINE float3 to_local(const Shading* at, float3 world)
{
    return (float3)(dot3(world, at->s), dot3(world, at->t), dot3(world, at->normal));
}

INLINE float3 to_world(const Shading* at, float3 v)
{
    return v.x * at->s + v.y * at->t + v.z * at->normal;
}
#endif

#define STRAIGHT -2.0f

// Mirrored and refracted directions are made unit again: over a path of many such steps their rounding would add up.
typedef struct {
    float3 direction;  // unit, in world space
    float3 weight;     // bsdf * |cos| / pdf; 0 if the path ends
    float pdf;         // solid angle; negative if the lobe is a delta function, STRAIGHT if the path goes on as it came
    float eta;         // index of the side that `direction` is on over that of the incident side
} BsdfSample;

// What lets a path through as if nothing was there.
INLINE BsdfSample straight_on(float3 direction)
{
    const BsdfSample sample = {direction, (float3)(1.0f), STRAIGHT, 1.0f};
    return sample;
}
