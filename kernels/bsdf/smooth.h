// Diffuse reflection and smooth boundaries, to one side, of a thin sheet or into a body.
#pragma once
#include "bsdf/context.h"

#if FEATURE_DIFFUSE || FEATURE_PLASTIC || FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED
// A direction about z with density cos / pi.
INLINE Vec3 square_to_hemisphere(Vec2 u)
{
    const Vec2 disk = square_to_disk(u);
    return vec3(disk.x, disk.y, SQRT(MAX(1.0f - dot2(disk, disk), 0.0f)));
}
#endif

#if FEATURE_DIFFUSE || FEATURE_PLASTIC
// A direction about z as one about n.
INLINE Vec3 to_world_around(Vec3 n, Vec3 about_z)
{
    Vec3 s, t;
    coordinate_system(n, &s, &t);
    return weighted_sum3(about_z.x, s, about_z.y, t, about_z.z, n);
}
#endif

#if FEATURE_DIFFUSE
#if FEATURE_NEXT_EVENT
// bsdf * cos and the pdf of sampling `wo`.
INLINE Vec3 diffuse_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(ctx->normal, wo);
    const bool same_side = ctx->cos_i > 0.0f && cos_o > 0.0f;
    *pdf = same_side ? cos_o * M_1_PI_F : 0.0f;
    return scale3(bsdf_rgb(ctx, 0), *pdf);
}
#endif

INLINE BsdfSample diffuse_sample(const BsdfContext* ctx, Vec2 u)
{
    const Vec3 about_z = square_to_hemisphere(u);
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = to_world_around(ctx->normal, about_z);
    sample.weight = ctx->cos_i > 0.0f && about_z.z > 0.0f ? bsdf_rgb(ctx, 0) : splat3(0.0f);
    sample.pdf = about_z.z * M_1_PI_F;
    sample.eta = 1.0f;
    return sample;
}
#endif

#define HAS_DIELECTRIC_FRESNEL                                                                                            \
    (FEATURE_DIELECTRIC || FEATURE_THIN_DIELECTRIC || FEATURE_ROUGH_DIELECTRIC || FEATURE_PLASTIC ||                   \
     FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED)

#if HAS_DIELECTRIC_FRESNEL
// Unpolarised reflectance of a smooth boundary; cos_t gets the cosine of the refracted direction, 0 if all is reflected.
// Born and Wolf, Principles of Optics, 7th ed., 1.5.2. `eta` is index of the far side over that of the near side.
INLINE float fresnel_dielectric(float cos_i, float eta, float* cos_t)
{
    const float sin2_t = (1.0f - cos_i * cos_i) / (eta * eta);
    *cos_t = 0.0f;
    if (eta == 1.0f) {
        *cos_t = cos_i;
        return 0.0f;
    }
    if (sin2_t >= 1.0f) return 1.0f;
    *cos_t = SQRT(1.0f - sin2_t);
    const float parallel = (eta * cos_i - *cos_t) / (eta * cos_i + *cos_t);
    const float perpendicular = (cos_i - eta * *cos_t) / (cos_i + eta * *cos_t);
    return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}
#endif

#if FEATURE_DIELECTRIC
INLINE BsdfSample dielectric_sample(const BsdfContext* ctx, float u)
{
    const bool inside = ctx->cos_i < 0.0f;
    const float index = bsdf_float(ctx, 2), eta = inside ? 1.0f / index : index, cos_i = abs_float(ctx->cos_i);
    const Vec3 facing = inside ? neg3(ctx->normal) : ctx->normal;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_i, eta, &cos_t);
    BsdfSample sample = empty_bsdf_sample();
    sample.pdf = -1.0f;
    if (u <= reflectance) {
        sample.direction = normalize3(sub3(scale3(facing, 2.0f * cos_i), ctx->wi));
        sample.weight = bsdf_rgb(ctx, 0);
        sample.eta = 1.0f;
    } else {
        sample.direction = normalize3(sub3(scale3(facing, cos_i / eta - cos_t), scale3(ctx->wi, 1.0f / eta)));
        // radiance is squeezed into a smaller solid angle: Veach's thesis, 5.2
        sample.weight = div_scalar3(bsdf_rgb(ctx, 1), eta * eta);
        sample.eta = eta;
    }
    return sample;
}
#endif

#if FEATURE_THIN_DIELECTRIC
// Two boundaries so close that what is refracted goes on as it came; reflections between them are summed.
INLINE float thin_dielectric_reflectance(const BsdfContext* ctx)
{
    float cos_t = 0.0f;
    const float once = fresnel_dielectric(abs_float(ctx->cos_i), bsdf_float(ctx, 2), &cos_t);
    return 2.0f * once / (1.0f + once);
}

INLINE BsdfSample thin_dielectric_sample(const BsdfContext* ctx, float u)
{
    const bool reflects = u <= thin_dielectric_reflectance(ctx);
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = reflects ? normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi)) : neg3(ctx->wi);
    sample.weight = bsdf_rgb(ctx, reflects ? 0 : 1);
    sample.pdf = reflects ? -1.0f : STRAIGHT;
    sample.eta = 1.0f;
    return sample;
}
#endif

#if FEATURE_CONDUCTOR || FEATURE_ROUGH_CONDUCTOR
// Square roots; rounding may have made of 0 less than that.
INLINE Vec3 safe_sqrt3(Vec3 v)
{
    return vec3(SQRT(MAX(v.x, 0.0f)), SQRT(MAX(v.y, 0.0f)), SQRT(MAX(v.z, 0.0f)));
}

// Unpolarised reflectance of a metal, from eta + ik per colour. Born and Wolf, 14.2, in the form of
// S. Lagarde, "Memo on Fresnel equations", 2013.
INLINE Vec3 fresnel_conductor(float cos_i, Vec3 eta, Vec3 k)
{
    const float cos2 = cos_i * cos_i, sin2 = 1.0f - cos2;
    const Vec3 eta2 = mul3(eta, eta), k2 = mul3(k, k);
    const Vec3 t0 = sub3(sub3(eta2, k2), splat3(sin2));
    const Vec3 a2_plus_b2 = safe_sqrt3(add3(mul3(t0, t0), mul3(scale3(eta2, 4.0f), k2)));
    const Vec3 a = safe_sqrt3(scale3(add3(a2_plus_b2, t0), 0.5f));
    const Vec3 t1 = add3(a2_plus_b2, splat3(cos2)), t2 = scale3(a, 2.0f * cos_i);
    const Vec3 perpendicular = div3(sub3(t1, t2), add3(t1, t2));
    // at normal incidence all of t3 and t4 vanishes where eta and k are 0, as of some metal in one colour
    const Vec3 t3 = add3(add3(scale3(a2_plus_b2, cos2), splat3(sin2 * sin2)), splat3(1e-30f)), t4 = scale3(t2, sin2);
    const Vec3 parallel = div3(mul3(perpendicular, sub3(t3, t4)), add3(t3, t4));
    return scale3(add3(parallel, perpendicular), 0.5f);
}
#endif

#if FEATURE_CONDUCTOR
INLINE BsdfSample conductor_sample(const BsdfContext* ctx)
{
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi));
    if (ctx->cos_i > 0.0f)
        sample.weight = mul3(bsdf_rgb(ctx, 0), fresnel_conductor(ctx->cos_i, bsdf_rgb(ctx, 2), bsdf_rgb(ctx, 3)));
    sample.pdf = -1.0f;
    sample.eta = 1.0f;
    return sample;
}
#endif
