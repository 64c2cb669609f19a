// Rough metal. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, with Mitsuba 3's
// conventions. Directions are in the shading frame.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/microfacet.h"

#if FEATURE_ROUGH_CONDUCTOR
INLINE MicrofacetDistribution rough_conductor_microfacets(const BsdfContext* ctx)
{
    const float alpha_u = bsdf_float(ctx, SLOT_ROUGH_CONDUCTOR_ALPHA_U),
                alpha_v = bsdf_float(ctx, SLOT_ROUGH_CONDUCTOR_ALPHA_V);
    return make_microfacets(alpha_u, alpha_v, material(ctx).flags);
}

INLINE Vec3 rough_conductor_reflectance(const BsdfContext* ctx, float cos_m)
{
    return mul3(
        bsdf_rgb(ctx, SLOT_ROUGH_CONDUCTOR_SPECULAR_REFLECTANCE),
        fresnel_conductor(cos_m, bsdf_rgb(ctx, SLOT_ROUGH_CONDUCTOR_ETA), bsdf_rgb(ctx, SLOT_ROUGH_CONDUCTOR_K)));
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_conductor_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const Vec3 w = to_local(ctx, ctx->wi), o = to_local(ctx, wo), m = normalize3(add3(w, o));
    const float cos_m = dot3(w, m);
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f && cos_m > 0.0f)) return splat3(0.0f);
    const MicrofacetDistribution d = rough_conductor_microfacets(ctx);
    const float density = microfacet_d(&d, m);
    *pdf = microfacet_pdf(&d, w, m, density) / (4.0f * cos_m);
    return scale3(rough_conductor_reflectance(ctx, cos_m),
                  0.25f * density * smith_g1_over_cos(&d, w) * smith_g1(&d, o));
}
#endif

INLINE BsdfSample rough_conductor_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const Vec3 w = to_local(ctx, ctx->wi);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_conductor_microfacets(ctx);
    const Vec3 m = sample_microfacet(&d, w, vec2(u.y, u.z));
    const float cos_m = dot3(w, m);
    const Vec3 o = sub3(scale3(m, 2.0f * cos_m), w);
    const float pdf = microfacet_pdf(&d, w, m, microfacet_d(&d, m));
    if (!(cos_m > 0.0f && o.z > 0.0f && pdf > 0.0f)) return sample;
    const float seen_from_w = d.sample_all ? smith_g1_over_cos(&d, w) * cos_m / m.z : 1.0f;
    sample.direction = normalize3(to_world(ctx, o));
    sample.weight = scale3(rough_conductor_reflectance(ctx, cos_m), seen_from_w * smith_g1(&d, o));
    sample.pdf = pdf / (4.0f * cos_m);
    return sample;
}
#endif
