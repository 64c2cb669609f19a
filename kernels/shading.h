// Where a path scatters: the material there, its frame and its parameters. Directions point away from the surface and are unit.
#pragma once
#include "paths.h"
#include "texture.h"
#include "vectors.h"

#define HAS_BUMPS (FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_FRAMES (HAS_BUMPS || FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC || FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED)

#define FRAMED_BSDFS (BSDF_ROUGH_CONDUCTOR | BSDF_ROUGH_DIELECTRIC | BSDF_ROUGH_PLASTIC | BSDF_PRINCIPLED)
#define DELTA_BSDFS (BSDF_DIELECTRIC | BSDF_THIN_DIELECTRIC | BSDF_CONDUCTOR)

#define NO_BUMP (-1.0f)

typedef struct {
    __global const Bsdf* bsdfs;
    uint bsdf;  // of them, one that wraps no other
    Vec3 normal;              // shading normal
    Vec3 wi;                  // where the path came from, in world space
    float cos_i;                // of wi to the normal; not negative for materials of two sides
#if HAS_FRAMES
    Vec3 s, t;  // with the normal, an orthonormal frame; s goes along dp/du. Right-handed, but for turned materials
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
#if FEATURE_TEXTURES && LANES > 1
    const float* parameters;  // what textures show in the slots, LANES numbers a member: kept.h
#endif
} Shading;

INLINE Bsdf material(const Shading* at)
{
    return Bsdf_at(at->bsdfs, at->bsdf);
}

// A parameter of the material that is a colour, and one that is a number.
INLINE Vec3 shown_rgb(const Shading* at, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = material(at).textures[slot];
    if (texture != NONE) return texture_rgb(at->textures, texture, &at->point);
#endif
    const Bsdf m = material(at);
    return LOAD3(slot, m.values);
}

INLINE float shown_number(const Shading* at, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = material(at).textures[slot];
    if (texture != NONE) return texture_number(at->textures, texture, &at->point);
#endif
    return material(at).values[3u * slot];
}

// The same where light is scattered: there what textures show may have been kept (kept.h).
#if FEATURE_TEXTURES && LANES > 1
INLINE Vec3 rgb_parameter(const Shading* at, uint slot)
{
    const Bsdf m = material(at);
    return m.textures[slot] == NONE ? LOAD3(slot, m.values) : kept3(at->parameters, 3u * slot, 0);
}

INLINE float number_parameter(const Shading* at, uint slot)
{
    const Bsdf m = material(at);
    return m.textures[slot] == NONE ? m.values[3u * slot] : kept1(at->parameters, 3u * slot, 0);
}
#else
#define rgb_parameter shown_rgb
#define number_parameter shown_number
#endif

#if HAS_FRAMES
INLINE Vec3 to_local(const Shading* at, Vec3 world)
{
    return vec3(dot3(world, at->s), dot3(world, at->t), dot3(world, at->normal));
}

INLINE Vec3 to_world(const Shading* at, Vec3 v)
{
    return add3(add3(scale3(at->s, v.x), scale3(at->t, v.y)), scale3(at->normal, v.z));
}
#endif

#define STRAIGHT -2.0f

// Mirrored and refracted directions are made unit again: over a path of many such steps their rounding would add up.
typedef struct {
    Vec3 direction;  // unit, in world space
    Vec3 weight;     // bsdf * |cos| / pdf; 0 if the path ends
    float pdf;         // solid angle; negative if the lobe is a delta function, STRAIGHT if the path goes on as it came
    float eta;         // index of the side that `direction` is on over that of the incident side
} BsdfSample;

// Every member has a value: what has none in one path would be taken from the one before it in a loop over paths.
INLINE BsdfSample nothing_sampled(void)
{
    const BsdfSample sample = {all3(0.0f), all3(0.0f), 1.0f, 1.0f};
    return sample;
}

// What lets a path through as if nothing was there.
INLINE BsdfSample straight_on(Vec3 direction)
{
    const BsdfSample sample = {direction, all3(1.0f), STRAIGHT, 1.0f};
    return sample;
}
