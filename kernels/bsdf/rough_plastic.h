// Rough plastic: a diffuse base below a rough coat.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/microfacet.h"
#include "bsdf/plastic_base.h"
#include "bsdf/rough_transmittance.h"

#if FEATURE_ROUGH_PLASTIC
INLINE float rough_plastic_transmittance(const BsdfContext* ctx, float cos_w)
{
    return rough_transmittance(ctx, (uint)material(ctx).constants[CONSTANT_ROUGH_PLASTIC_TRANSMITTANCE_TABLE], cos_w);
}

// Directions are in the shading frame.
INLINE Vec3 rough_plastic_local(const BsdfContext* ctx, const MicrofacetDistribution* d, Vec3 w, Vec3 o, float* pdf)
{
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f)) return splat3(0.0f);
    const Vec3 m = normalize3(add3(w, o));
    const float cos_m = dot3(w, m), density = microfacet_d(d, m);
    const float through_w = rough_plastic_transmittance(ctx, w.z), through_o = rough_plastic_transmittance(ctx, o.z);
    const float probability = specular_probability(ctx, 1.0f - through_w);
    *pdf = (1.0f - probability) * o.z * M_1_PI_F;
    Vec3 value = scale3(diffuse_base_reflectance(ctx), through_w * through_o * o.z * M_1_PI_F);
    if (cos_m > 0.0f) {
        float cos_t = 0.0f;
        const float reflected = fresnel_dielectric(cos_m, bsdf_float(ctx, SLOT_ROUGH_PLASTIC_IOR), &cos_t);
        value = add3(value, scale3(bsdf_rgb(ctx, SLOT_ROUGH_PLASTIC_SPECULAR_REFLECTANCE),
                                   0.25f * reflected * density * smith_g1_over_cos(d, w) * smith_g1(d, o)));
        *pdf += probability * microfacet_pdf(d, w, m, density) / (4.0f * cos_m);
    }
    return value;
}

INLINE MicrofacetDistribution rough_plastic_microfacets(const BsdfContext* ctx)
{
    return make_microfacets(bsdf_float(ctx, SLOT_ROUGH_PLASTIC_ALPHA), bsdf_float(ctx, SLOT_ROUGH_PLASTIC_ALPHA),
                            material(ctx).flags);
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_plastic_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const MicrofacetDistribution d = rough_plastic_microfacets(ctx);
    return rough_plastic_local(ctx, &d, to_local(ctx, ctx->wi), to_local(ctx, wo), pdf);
}
#endif

INLINE BsdfSample rough_plastic_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const Vec3 w = to_local(ctx, ctx->wi);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_plastic_microfacets(ctx);
    Vec3 o = splat3(0.0f);
    if (u.x < specular_probability(ctx, 1.0f - rough_plastic_transmittance(ctx, w.z))) {
        const Vec3 m = sample_microfacet(&d, w, vec2(u.y, u.z));
        o = normalize3(sub3(scale3(m, 2.0f * dot3(w, m)), w));
    } else {
        o = square_to_hemisphere(vec2(u.y, u.z));
    }
    const Vec3 value = rough_plastic_local(ctx, &d, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f)) return sample;
    sample.direction = normalize3(to_world(ctx, o));
    sample.weight = div_scalar3(value, sample.pdf);
    return sample;
}
#endif
