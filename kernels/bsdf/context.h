// Where a path scatters: the material there, its frame and its parameters. Directions point away from the surface and are unit.
#pragma once
#include "path/path_state.h"
#include "texture/texture.h"
#include "util/math.h"

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
    __global const float* rough_transmittances;  // of `scene.boundaries`
#endif
#if HAS_BUMPS
    bool flipped;  // to the viewer: the normal is the surface's from behind
    float shadow;  // alpha^2 of what shadows the bump, NO_BUMP where there is none
#endif
#if FEATURE_TEXTURES
    const Textures* textures;
    TexturePoint point;
#endif
#if FEATURE_TEXTURES && LANES > 1
    const float* parameters;  // what textures show in the slots, LANES numbers a member: path/lane_state.h
#endif
} BsdfContext;

INLINE Bsdf material(const BsdfContext* ctx)
{
    return Bsdf_at(ctx->bsdfs, ctx->bsdf);
}

// A parameter of the material that is a colour, and one that is a number.
INLINE Vec3 lookup_rgb(const BsdfContext* ctx, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = material(ctx).textures[slot];
    if (texture != NONE) return texture_rgb(ctx->textures, texture, &ctx->point);
#endif
    const Bsdf m = material(ctx);
    return LOAD3(slot, m.values);
}

INLINE float lookup_float(const BsdfContext* ctx, uint slot)
{
#if FEATURE_TEXTURES
    const uint texture = material(ctx).textures[slot];
    if (texture != NONE) return texture_float(ctx->textures, texture, &ctx->point);
#endif
    return material(ctx).values[3u * slot];
}

// The same where light is scattered: there what textures show may have been kept (path/lane_state.h).
#if FEATURE_TEXTURES && LANES > 1
INLINE Vec3 bsdf_rgb(const BsdfContext* ctx, uint slot)
{
    const Bsdf m = material(ctx);
    return m.textures[slot] == NONE ? LOAD3(slot, m.values) : load_lane3(ctx->parameters, 3u * slot, 0);
}

INLINE float bsdf_float(const BsdfContext* ctx, uint slot)
{
    const Bsdf m = material(ctx);
    return m.textures[slot] == NONE ? m.values[3u * slot] : load_lane(ctx->parameters, 3u * slot, 0);
}
#else
#define bsdf_rgb lookup_rgb
#define bsdf_float lookup_float
#endif

#if HAS_FRAMES
INLINE Vec3 to_local(const BsdfContext* ctx, Vec3 world)
{
    return vec3(dot3(world, ctx->s), dot3(world, ctx->t), dot3(world, ctx->normal));
}

INLINE Vec3 to_world(const BsdfContext* ctx, Vec3 v)
{
    return add3(add3(scale3(ctx->s, v.x), scale3(ctx->t, v.y)), scale3(ctx->normal, v.z));
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
INLINE BsdfSample empty_bsdf_sample(void)
{
    const BsdfSample sample = {splat3(0.0f), splat3(0.0f), 1.0f, 1.0f};
    return sample;
}

// What lets a path through as if nothing was there.
INLINE BsdfSample null_bsdf_sample(Vec3 direction)
{
    const BsdfSample sample = {direction, splat3(1.0f), STRAIGHT, 1.0f};
    return sample;
}
