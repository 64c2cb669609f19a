// Rough metal and rough glass. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; the
// conventions are Mitsuba 3's. All directions within are of the surface's frame.
#pragma once
#include "microfacet.h"
#include "smooth.h"

#if FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC
INLINE Microfacets rough_microfacets(const Shading* at)
{
    return microfacets(number_parameter(at, 4), number_parameter(at, 5), at->bsdf->flags);
}
#endif

#if FEATURE_ROUGH_CONDUCTOR
INLINE float3 rough_conductor_reflectance(const Shading* at, float cos_m)
{
    return rgb_parameter(at, 0) * fresnel_conductor(cos_m, rgb_parameter(at, 2), rgb_parameter(at, 3));
}

INLINE float3 rough_conductor_eval(const Shading* at, float3 wo, float* pdf)
{
    const float3 w = to_local(at, at->wi), o = to_local(at, wo), m = unit(w + o);
    const float cos_m = dot3(w, m);
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f && cos_m > 0.0f)) return (float3)(0.0f);
    const Microfacets d = rough_microfacets(at);
    const float density = facet_density(&d, m);
    *pdf = facet_pdf(&d, w, m, density) / (4.0f * cos_m);
    return rough_conductor_reflectance(at, cos_m) * (0.25f * density * seen_per_cosine(&d, w) * seen(&d, o));
}

INLINE BsdfSample rough_conductor_sample(const Shading* at, float2 u)
{
    BsdfSample sample;
    sample.weight = (float3)(0.0f);
    const float3 w = to_local(at, at->wi);
    if (!(w.z > 0.0f)) return sample;
    const Microfacets d = rough_microfacets(at);
    const float3 m = sample_facet(&d, w, u);
    const float cos_m = dot3(w, m);
    const float3 o = 2.0f * cos_m * m - w;
    const float pdf = facet_pdf(&d, w, m, facet_density(&d, m));
    if (!(cos_m > 0.0f && o.z > 0.0f && pdf > 0.0f)) return sample;
    const float seen_from_w = d.sample_all ? seen_per_cosine(&d, w) * cos_m / m.z : 1.0f;
    sample.direction = unit(to_world(at, o));
    sample.weight = rough_conductor_reflectance(at, cos_m) * (seen_from_w * seen(&d, o));
    sample.pdf = pdf / (4.0f * cos_m);
    sample.eta = 1.0f;
    return sample;
}
#endif

#if FEATURE_ROUGH_DIELECTRIC || FEATURE_PRINCIPLED
// Of a rough boundary that a path from w meets, w.z > 0: the facet that leads to o, the cosines to it, and the density over
// directions o for one over facets. `eta`: index of the far side over that of the near side. Returns whether there is one.
INLINE bool boundary_facet(float3 w, float3 o, float eta, float3* m, float* cos_w, float* cos_o, float* jacobian)
{
    const bool reflects = o.z > 0.0f;
    const float3 between = reflects ? w + o : w + eta * o;
    *m = unit(between);
    *m = with_sign(1.0f, (*m).z) * *m;
    *cos_w = dot3(w, *m);
    *cos_o = dot3(o, *m);
    *jacobian = reflects ? 0.25f / *cos_o : eta * eta * abs1(*cos_o) / dot3(between, between);
    return *cos_w > 0.0f && *cos_o * o.z > 0.0f && *jacobian < INFINITY;
}
#endif

#if FEATURE_ROUGH_DIELECTRIC
// The microfacets of which a facet is sampled: rougher ones where all normals are, which bounds the weights (Walter et al., 5.3).
INLINE Microfacets sampled_microfacets(const Microfacets* d, float cos_w)
{
    Microfacets sampled = *d;
    if (d->sample_all) {
        const float scale = 1.2f - 0.2f * SQRT(cos_w);
        sampled.alpha_u *= scale;
        sampled.alpha_v *= scale;
    }
    return sampled;
}

// Seen from inside all is turned around: a distribution of normals looks the same from both sides.
INLINE float3 rough_dielectric_eval(const Shading* at, float3 wo, float* pdf)
{
    const float side = with_sign(1.0f, at->cos_i), index = number_parameter(at, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const float3 w = side * to_local(at, at->wi), o = side * to_local(at, wo);
    float3 m;
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && boundary_facet(w, o, eta, &m, &cos_w, &cos_o, &jacobian))) return (float3)(0.0f);
    const Microfacets d = rough_microfacets(at), sampled = sampled_microfacets(&d, w.z);
    const float density = facet_density(&d, m), reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const float share = o.z > 0.0f ? reflectance : 1.0f - reflectance;
    *pdf = share * jacobian * facet_pdf(&sampled, w, m, facet_density(&sampled, m));
    const float scattered = share * jacobian * density * seen_per_cosine(&d, w) * cos_w * seen(&d, o);
    return rgb_parameter(at, o.z > 0.0f ? 0 : 1) * (o.z > 0.0f ? scattered : scattered / (eta * eta));
}

INLINE BsdfSample rough_dielectric_sample(const Shading* at, float3 u)
{
    BsdfSample sample;
    sample.weight = (float3)(0.0f);
    const float side = with_sign(1.0f, at->cos_i), index = number_parameter(at, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const float3 w = side * to_local(at, at->wi);
    if (!(w.z > 0.0f)) return sample;
    const Microfacets d = rough_microfacets(at), sampled = sampled_microfacets(&d, w.z);
    const float3 m = sample_facet(&sampled, w, u.yz);
    const float cos_w = dot3(w, m), density = facet_density(&sampled, m);
    const float facet = facet_pdf(&sampled, w, m, density);
    if (!(cos_w > 0.0f && facet > 0.0f)) return sample;
    float cos_t;
    const float reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const bool reflects = u.x <= reflectance;
    const float3 o = reflects ? 2.0f * cos_w * m - w : (cos_w / eta - cos_t) * m - w / eta;
    if (!(reflects ? o.z > 0.0f : o.z < 0.0f)) return sample;
    const float length = cos_w - eta * cos_t;  // of w + eta * o
    const float jacobian = reflects ? 0.25f / cos_w : eta * eta * cos_t / (length * length);
    float weight = seen(&d, o);
    if (d.sample_all) weight *= seen_per_cosine(&d, w) * cos_w / m.z * (facet_density(&d, m) / density);
    sample.pdf = (reflects ? reflectance : 1.0f - reflectance) * jacobian * facet;
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = unit(side * to_world(at, o));
    sample.weight = rgb_parameter(at, reflects ? 0 : 1) * (reflects ? weight : weight / (eta * eta));
    sample.eta = reflects ? 1.0f : eta;
    return sample;
}
#endif
