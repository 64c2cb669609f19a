// The phase function of media. To a path it is a BSDF without a normal.
#pragma once
#include "bsdf/context.h"

#if FEATURE_MEDIA
// Henyey and Greenstein, "Diffuse Radiation in the Galaxy", 1941. g is the mean cosine; 0 is isotropic. Formulas use 1
// - cos of the angle to the axis, and 1 - |g|: neither cancels for |g| near 1, and there is no division by g.
INLINE float hg_g(const BsdfContext* ctx)
{
    return material(ctx).constants[CONSTANT_HG_G];
}

// The axis along which most light scatters: forwards if g > 0, else backwards.
INLINE Vec3 phase_axis(const BsdfContext* ctx)
{
    return hg_g(ctx) < 0.0f ? ctx->wi : neg3(ctx->wi);
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
    *pdf = hg_phase(abs_float(hg_g(ctx)), 0.5f * dot3(off, off));
    return splat3(*pdf);
}
#endif

// Inverse of the cosine's distribution function: 1 - cos = 2 (1 - u) (1 + |g| u) ((1 - |g|) / (1 - |g| + 2 |g| u))^2.
// u and the azimuth are those of a uniform direction, u = (1 + z) / 2, so that the map distorts little at both ends.
INLINE BsdfSample hg_sample(const BsdfContext* ctx, Vec3 u)
{
    const float narrow = abs_float(hg_g(ctx)), wide = 1.0f - narrow;
    const SpherePoint uniform_point = square_to_sphere_point(vec2(u.y, u.z));
    const float nearer = 0.5f * uniform_point.one_minus_z;
    const float below = uniform_point.is_upper ? 1.0f - nearer : nearer;
    const float above = uniform_point.is_upper ? nearer : 1.0f - nearer;
    const float ratio = wide / (wide + 2.0f * narrow * below);
    const float one_minus_cos = 2.0f * above * (1.0f + narrow * below) * ratio * ratio;
    const Vec3 axis = phase_axis(ctx);
    Vec3 x, y;
    coordinate_system(axis, &x, &y);
    const Vec2 azimuth = scale2(uniform_point.azimuth, SQRT(MAX(one_minus_cos * (2.0f - one_minus_cos), 0.0f)));
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = normalize3(weighted_sum3(azimuth.x, x, azimuth.y, y, 1.0f - one_minus_cos, axis));
    sample.weight = splat3(1.0f);
    sample.pdf = material(ctx).flags & BSDF_NO_LIGHT_SAMPLING ? PDF_WITHOUT_MIS : hg_phase(narrow, one_minus_cos);
    return sample;
}
#endif
