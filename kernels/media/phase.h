// Scattering within a medium: its phase function, which is to a path what a material is, without a normal.
#pragma once
#include "bsdf/context.h"

#if FEATURE_MEDIA
// Henyey and Greenstein, "Diffuse Radiation in the Galaxy", 1941; g, the mean cosine, is slot 0, and 0 is isotropic. Light goes
// preferably along an axis, onwards (g > 0) or back. All is written with the distance from that axis, 1 - its cosine, and with
// 1 - |g|: neither cancels where |g| is nearly 1, and nothing is divided by a g of 0.
INLINE Vec3 phase_axis(const BsdfContext* ctx)
{
    return material(ctx).values[0] < 0.0f ? ctx->wi : neg3(ctx->wi);
}

INLINE float hg_phase(float narrow, float one_minus_cos)
{
    const float wide = 1.0f - narrow, square = wide * wide + 2.0f * narrow * one_minus_cos;
    return 0.25f * M_1_PI_F * wide * (1.0f + narrow) / (square * SQRT(square));
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 hg_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const Vec3 off = sub3(wo, phase_axis(ctx));
    *pdf = hg_phase(abs_float(material(ctx).values[0]), 0.5f * dot3(off, off));
    return splat3(*pdf);
}
#endif

// The cosine's distribution inverted: 1 - cos = 2 (1 - u) (1 + |g| u) ((1 - |g|) / (1 - |g| + 2 |g| u))^2.
INLINE BsdfSample hg_sample(const BsdfContext* ctx, Vec2 u)
{
    const float narrow = abs_float(material(ctx).values[0]), wide = 1.0f - narrow;
    const float ratio = wide / (wide + 2.0f * narrow * u.x);
    const float one_minus_cos = 2.0f * (1.0f - u.x) * (1.0f + narrow * u.x) * ratio * ratio;
    const Vec3 axis = phase_axis(ctx);
    Vec3 x, y;
    coordinate_system(axis, &x, &y);
    const Vec2 azimuth = scale2(cos_sin_turns(u.y), SQRT(MAX(one_minus_cos * (2.0f - one_minus_cos), 0.0f)));
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = normalize3(weighted_sum3(azimuth.x, x, azimuth.y, y, 1.0f - one_minus_cos, axis));
    sample.weight = splat3(1.0f);
    sample.pdf = material(ctx).flags & BSDF_NO_LIGHT_SAMPLING ? -1.0f : hg_phase(narrow, one_minus_cos);
    sample.eta = 1.0f;
    return sample;
}
#endif
