// Diffuse reflection.
#pragma once
#include "bsdf/context.h"

#if FEATURE_DIFFUSE
#if FEATURE_NEXT_EVENT
INLINE Vec3 diffuse_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(ctx->normal, wo);
    const bool same_side = ctx->cos_i > 0.0f && cos_o > 0.0f;
    *pdf = same_side ? cos_o * M_1_PI_F : 0.0f;
    return scale3(bsdf_rgb(ctx, SLOT_DIFFUSE_REFLECTANCE), *pdf);
}
#endif

INLINE BsdfSample diffuse_sample(const BsdfContext* ctx, Vec3 u)
{
    const Vec3 local_direction = square_to_hemisphere(vec2(u.y, u.z));
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = rotate_to_normal(ctx->normal, local_direction);
    sample.weight =
        ctx->cos_i > 0.0f && local_direction.z > 0.0f ? bsdf_rgb(ctx, SLOT_DIFFUSE_REFLECTANCE) : splat3(0.0f);
    sample.pdf = local_direction.z * M_1_PI_F;
    return sample;
}
#endif
