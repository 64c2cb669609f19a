// The BSDF at a path vertex: its record, shading frame and parameters, and the sample that a BSDF returns.
// Directions are unit and point away from the surface.
#pragma once
#include "path/path_state.h"
#include "texture/texture.h"
#include "util/math.h"

#define HAS_BUMPS (FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define NO_BUMP (-1.0f)
// Next-event estimation at a blend evaluates both parts where that is cheap, with the weights of the blend.
#define HAS_BLEND_LIGHTING (FEATURE_BLEND && FEATURE_NEXT_EVENT)

typedef struct {
    __global const Bsdf* bsdfs;
    uint bsdf;    // index of a BSDF that is no wrapper
    Vec3 normal;  // shading normal
    Vec3 wi;      // where the path came from, in world space
    float cos_i;  // of wi and the normal; not negative for two-sided BSDFs
#if HAS_SHADING_FRAME
    Vec3 s, t;  // orthonormal frame with the normal; s goes along dp/du. Right-handed, unless flipped to the viewer
#endif
#if HAS_ROUGH_TRANSMITTANCE
    __global const float* rough_transmittances;  // tables of host/isonoise/scene/material/rough_transmittance.py
#endif
#if HAS_BUMPS
    bool flipped;       // to the viewer: the normal is opposite to the surface's
    float bump_alpha2;  // alpha^2 of the bump shadowing function, NO_BUMP without a bump or normal map
#endif
#if HAS_BLEND_LIGHTING
    uint other_bsdf;     // the part of a blend that was not chosen
    float other_weight;  // its weight in the blend, 0 if only `bsdf` is evaluated
#endif
#if FEATURE_TEXTURES
    const Textures* textures;
    TexturePoint point;
#endif
#if FEATURE_TEXTURES && LANES > 1
    const float* parameters;  // texture values of the slots, LANES numbers a member: path/lane_state.h
#endif
} BsdfContext;

INLINE Bsdf material(const BsdfContext* ctx)
{
    return Bsdf_at(ctx->bsdfs, ctx->bsdf);
}

// The parameter in a slot (SLOT_<KIND>_<NAME>), as a colour or as a number.
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

// The same for evaluation and sampling, where textures may have been looked up before (path/lane_state.h).
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

#if HAS_SHADING_FRAME
INLINE Vec3 to_local(const BsdfContext* ctx, Vec3 world)
{
    return vec3(dot3(world, ctx->s), dot3(world, ctx->t), dot3(world, ctx->normal));
}

INLINE Vec3 to_world(const BsdfContext* ctx, Vec3 v)
{
    return add3(add3(scale3(ctx->s, v.x), scale3(ctx->t, v.y)), scale3(ctx->normal, v.z));
}
#endif

// Reflected and refracted directions are normalised: over a path of many such bounces their rounding would add up.
typedef struct {
    Vec3 direction;  // unit, in world space
    Vec3 weight;     // bsdf * |cos| / pdf; 0 if the path ends
    float pdf;       // solid angle; PDF_WITHOUT_MIS (negative) where NEE could not have found this direction
    float eta;       // index of refraction on the side of `direction` over that of the incident side
    bool is_null;    // the path goes straight on, as if there was no surface
} BsdfSample;

// A sample that ends the path. Every member is set: in a loop over lanes an unset one would be the previous lane's.
INLINE BsdfSample empty_bsdf_sample(void)
{
    const BsdfSample sample = {splat3(0.0f), splat3(0.0f), 1.0f, 1.0f, false};
    return sample;
}

INLINE BsdfSample null_bsdf_sample(Vec3 direction)
{
    const BsdfSample sample = {direction, splat3(1.0f), PDF_WITHOUT_MIS, 1.0f, true};
    return sample;
}
