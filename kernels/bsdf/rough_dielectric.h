// Rough glass. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, with Mitsuba 3's
// conventions. Directions are in the shading frame.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/microfacet.h"

#if FEATURE_ROUGH_DIELECTRIC
INLINE MicrofacetDistribution rough_dielectric_microfacets(const BsdfContext* ctx)
{
    const float alpha_u = bsdf_float(ctx, SLOT_ROUGH_DIELECTRIC_ALPHA_U),
                alpha_v = bsdf_float(ctx, SLOT_ROUGH_DIELECTRIC_ALPHA_V);
    return make_microfacets(alpha_u, alpha_v, material(ctx).flags);
}

INLINE Vec3 rough_dielectric_tint(const BsdfContext* ctx, bool reflects)
{
    return bsdf_rgb(
        ctx, reflects ? SLOT_ROUGH_DIELECTRIC_SPECULAR_REFLECTANCE : SLOT_ROUGH_DIELECTRIC_SPECULAR_TRANSMITTANCE);
}

// The distribution that normals are sampled from: rougher if all normals are sampled, which bounds the weights (Walter
// et al., 5.3).
INLINE MicrofacetDistribution sampling_distribution(const MicrofacetDistribution* d, float cos_w)
{
    MicrofacetDistribution sampled = *d;
    if (d->sample_all) {
        const float scale = 1.2f - 0.2f * SQRT(cos_w);
        sampled.alpha_u *= scale;
        sampled.alpha_v *= scale;
    }
    return sampled;
}

#if FEATURE_NEXT_EVENT
// For paths from inside, all directions are flipped: a distribution of normals is the same from both sides.
INLINE Vec3 rough_dielectric_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float side = copy_sign(1.0f, ctx->cos_i), index = bsdf_float(ctx, SLOT_ROUGH_DIELECTRIC_IOR);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side), o = scale3(to_local(ctx, wo), side);
    Vec3 m = splat3(0.0f);
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && generalized_half_vector(w, o, eta, &m, &cos_w, &cos_o, &jacobian)))
        return splat3(0.0f);
    const MicrofacetDistribution d = rough_dielectric_microfacets(ctx), sampled = sampling_distribution(&d, w.z);
    const float density = microfacet_d(&d, m), reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const float share = o.z > 0.0f ? reflectance : 1.0f - reflectance;
    *pdf = share * jacobian * microfacet_pdf(&sampled, w, m, microfacet_d(&sampled, m));
    const float scattered = share * jacobian * density * smith_g1_over_cos(&d, w) * cos_w * smith_g1(&d, o);
    return scale3(rough_dielectric_tint(ctx, o.z > 0.0f), o.z > 0.0f ? scattered : scattered / (eta * eta));
}
#endif

INLINE BsdfSample rough_dielectric_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const float side = copy_sign(1.0f, ctx->cos_i), index = bsdf_float(ctx, SLOT_ROUGH_DIELECTRIC_IOR);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_dielectric_microfacets(ctx), sampled = sampling_distribution(&d, w.z);
    const Vec3 m = sample_microfacet(&sampled, w, vec2(u.y, u.z));
    const float cos_w = dot3(w, m), density = microfacet_d(&sampled, m);
    const float facet = microfacet_pdf(&sampled, w, m, density);
    if (!(cos_w > 0.0f && facet > 0.0f)) return sample;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const bool reflects = u.x <= reflectance;
    const Vec3 o =
        reflects ? sub3(scale3(m, 2.0f * cos_w), w) : sub3(scale3(m, cos_w / eta - cos_t), div_scalar3(w, eta));
    if (!(reflects ? o.z > 0.0f : o.z < 0.0f)) return sample;
    const float length = cos_w - eta * cos_t;  // of w + eta * o
    const float jacobian = reflects ? 0.25f / cos_w : eta * eta * cos_t / (length * length);
    float weight = smith_g1(&d, o);
    if (d.sample_all) weight *= smith_g1_over_cos(&d, w) * cos_w / m.z * (microfacet_d(&d, m) / density);
    sample.pdf = (reflects ? reflectance : 1.0f - reflectance) * jacobian * facet;
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = normalize3(scale3(to_world(ctx, o), side));
    sample.weight = scale3(rough_dielectric_tint(ctx, reflects), reflects ? weight : weight / (eta * eta));
    sample.eta = reflects ? 1.0f : eta;
    return sample;
}
#endif
