// Rough metal and rough glass. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; the
// conventions are Mitsuba 3's. All directions within are of the surface's frame.
#pragma once
#include "bsdf/microfacet.h"
#include "bsdf/smooth.h"

#if FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC
INLINE MicrofacetDistribution rough_microfacets(const BsdfContext* ctx)
{
    return make_microfacets(bsdf_float(ctx, 4), bsdf_float(ctx, 5), material(ctx).flags);
}
#endif

#if FEATURE_ROUGH_CONDUCTOR
INLINE Vec3 rough_conductor_reflectance(const BsdfContext* ctx, float cos_m)
{
    return mul3(bsdf_rgb(ctx, 0), fresnel_conductor(cos_m, bsdf_rgb(ctx, 2), bsdf_rgb(ctx, 3)));
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_conductor_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const Vec3 w = to_local(ctx, ctx->wi), o = to_local(ctx, wo), m = normalize3(add3(w, o));
    const float cos_m = dot3(w, m);
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f && cos_m > 0.0f)) return splat3(0.0f);
    const MicrofacetDistribution d = rough_microfacets(ctx);
    const float density = microfacet_d(&d, m);
    *pdf = microfacet_pdf(&d, w, m, density) / (4.0f * cos_m);
    return scale3(rough_conductor_reflectance(ctx, cos_m), 0.25f * density * smith_g1_over_cos(&d, w) * smith_g1(&d, o));
}
#endif

INLINE BsdfSample rough_conductor_sample(const BsdfContext* ctx, Vec2 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const Vec3 w = to_local(ctx, ctx->wi);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_microfacets(ctx);
    const Vec3 m = sample_microfacet(&d, w, u);
    const float cos_m = dot3(w, m);
    const Vec3 o = sub3(scale3(m, 2.0f * cos_m), w);
    const float pdf = microfacet_pdf(&d, w, m, microfacet_d(&d, m));
    if (!(cos_m > 0.0f && o.z > 0.0f && pdf > 0.0f)) return sample;
    const float seen_from_w = d.sample_all ? smith_g1_over_cos(&d, w) * cos_m / m.z : 1.0f;
    sample.direction = normalize3(to_world(ctx, o));
    sample.weight = scale3(rough_conductor_reflectance(ctx, cos_m), seen_from_w * smith_g1(&d, o));
    sample.pdf = pdf / (4.0f * cos_m);
    sample.eta = 1.0f;
    return sample;
}
#endif

#if (FEATURE_ROUGH_DIELECTRIC && FEATURE_NEXT_EVENT) || FEATURE_PRINCIPLED
// Of a rough boundary that a path from w meets, w.z > 0: the facet that leads to o, the cosines to it, and the density over
// directions o for one over facets. `eta`: index of the far side over that of the near side. Returns whether there is one.
INLINE bool generalized_half_vector(Vec3 w, Vec3 o, float eta, Vec3* m, float* cos_w, float* cos_o, float* jacobian)
{
    const bool reflects = o.z > 0.0f;
    const Vec3 between = reflects ? add3(w, o) : add3(w, scale3(o, eta));
    *m = normalize3(between);
    *m = scale3(*m, copy_sign(1.0f, (*m).z));
    *cos_w = dot3(w, *m);
    *cos_o = dot3(o, *m);
    *jacobian = reflects ? 0.25f / *cos_o : eta * eta * abs_float(*cos_o) / dot3(between, between);
    return *cos_w > 0.0f && *cos_o * o.z > 0.0f && *jacobian < INFINITY;
}
#endif

#if FEATURE_ROUGH_DIELECTRIC
// The microfacets of which a facet is sampled: rougher ones where all normals are, which bounds the weights (Walter et al., 5.3).
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
// Seen from inside all is turned around: a distribution of normals looks the same from both sides.
INLINE Vec3 rough_dielectric_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float side = copy_sign(1.0f, ctx->cos_i), index = bsdf_float(ctx, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side), o = scale3(to_local(ctx, wo), side);
    Vec3 m = splat3(0.0f);
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && generalized_half_vector(w, o, eta, &m, &cos_w, &cos_o, &jacobian))) return splat3(0.0f);
    const MicrofacetDistribution d = rough_microfacets(ctx), sampled = sampling_distribution(&d, w.z);
    const float density = microfacet_d(&d, m), reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const float share = o.z > 0.0f ? reflectance : 1.0f - reflectance;
    *pdf = share * jacobian * microfacet_pdf(&sampled, w, m, microfacet_d(&sampled, m));
    const float scattered = share * jacobian * density * smith_g1_over_cos(&d, w) * cos_w * smith_g1(&d, o);
    return scale3(bsdf_rgb(ctx, o.z > 0.0f ? 0 : 1), o.z > 0.0f ? scattered : scattered / (eta * eta));
}
#endif

INLINE BsdfSample rough_dielectric_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const float side = copy_sign(1.0f, ctx->cos_i), index = bsdf_float(ctx, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_microfacets(ctx), sampled = sampling_distribution(&d, w.z);
    const Vec3 m = sample_microfacet(&sampled, w, vec2(u.y, u.z));
    const float cos_w = dot3(w, m), density = microfacet_d(&sampled, m);
    const float facet = microfacet_pdf(&sampled, w, m, density);
    if (!(cos_w > 0.0f && facet > 0.0f)) return sample;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const bool reflects = u.x <= reflectance;
    const Vec3 o = reflects ? sub3(scale3(m, 2.0f * cos_w), w) : sub3(scale3(m, cos_w / eta - cos_t), div_scalar3(w, eta));
    if (!(reflects ? o.z > 0.0f : o.z < 0.0f)) return sample;
    const float length = cos_w - eta * cos_t;  // of w + eta * o
    const float jacobian = reflects ? 0.25f / cos_w : eta * eta * cos_t / (length * length);
    float weight = smith_g1(&d, o);
    if (d.sample_all) weight *= smith_g1_over_cos(&d, w) * cos_w / m.z * (microfacet_d(&d, m) / density);
    sample.pdf = (reflects ? reflectance : 1.0f - reflectance) * jacobian * facet;
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = normalize3(scale3(to_world(ctx, o), side));
    sample.weight = scale3(bsdf_rgb(ctx, reflects ? 0 : 1), reflects ? weight : weight / (eta * eta));
    sample.eta = reflects ? 1.0f : eta;
    return sample;
}
#endif
