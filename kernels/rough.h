// Rough metal and rough glass. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; the
// conventions are Mitsuba 3's. All directions within are of the surface's frame.
#pragma once
#include "microfacet.h"
#include "smooth.h"

#if FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC
INLINE Microfacets rough_microfacets(const Shading* at)
{
    return microfacets(number_parameter(at, 4), number_parameter(at, 5), material(at).flags);
}
#endif

#if FEATURE_ROUGH_CONDUCTOR
INLINE Vec3 rough_conductor_reflectance(const Shading* at, float cos_m)
{
    return mul3(rgb_parameter(at, 0), fresnel_conductor(cos_m, rgb_parameter(at, 2), rgb_parameter(at, 3)));
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_conductor_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const Vec3 w = to_local(at, at->wi), o = to_local(at, wo), m = unit(add3(w, o));
    const float cos_m = dot3(w, m);
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f && cos_m > 0.0f)) return all3(0.0f);
    const Microfacets d = rough_microfacets(at);
    const float density = facet_density(&d, m);
    *pdf = facet_pdf(&d, w, m, density) / (4.0f * cos_m);
    return scale3(rough_conductor_reflectance(at, cos_m), 0.25f * density * seen_per_cosine(&d, w) * seen(&d, o));
}
#endif

INLINE BsdfSample rough_conductor_sample(const Shading* at, Vec2 u)
{
    BsdfSample sample = nothing_sampled();
    const Vec3 w = to_local(at, at->wi);
    if (!(w.z > 0.0f)) return sample;
    const Microfacets d = rough_microfacets(at);
    const Vec3 m = sample_facet(&d, w, u);
    const float cos_m = dot3(w, m);
    const Vec3 o = sub3(scale3(m, 2.0f * cos_m), w);
    const float pdf = facet_pdf(&d, w, m, facet_density(&d, m));
    if (!(cos_m > 0.0f && o.z > 0.0f && pdf > 0.0f)) return sample;
    const float seen_from_w = d.sample_all ? seen_per_cosine(&d, w) * cos_m / m.z : 1.0f;
    sample.direction = unit(to_world(at, o));
    sample.weight = scale3(rough_conductor_reflectance(at, cos_m), seen_from_w * seen(&d, o));
    sample.pdf = pdf / (4.0f * cos_m);
    sample.eta = 1.0f;
    return sample;
}
#endif

#if (FEATURE_ROUGH_DIELECTRIC && FEATURE_NEXT_EVENT) || FEATURE_PRINCIPLED
// Of a rough boundary that a path from w meets, w.z > 0: the facet that leads to o, the cosines to it, and the density over
// directions o for one over facets. `eta`: index of the far side over that of the near side. Returns whether there is one.
INLINE bool boundary_facet(Vec3 w, Vec3 o, float eta, Vec3* m, float* cos_w, float* cos_o, float* jacobian)
{
    const bool reflects = o.z > 0.0f;
    const Vec3 between = reflects ? add3(w, o) : add3(w, scale3(o, eta));
    *m = unit(between);
    *m = scale3(*m, with_sign(1.0f, (*m).z));
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

#if FEATURE_NEXT_EVENT
// Seen from inside all is turned around: a distribution of normals looks the same from both sides.
INLINE Vec3 rough_dielectric_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const float side = with_sign(1.0f, at->cos_i), index = number_parameter(at, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(at, at->wi), side), o = scale3(to_local(at, wo), side);
    Vec3 m = all3(0.0f);
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && boundary_facet(w, o, eta, &m, &cos_w, &cos_o, &jacobian))) return all3(0.0f);
    const Microfacets d = rough_microfacets(at), sampled = sampled_microfacets(&d, w.z);
    const float density = facet_density(&d, m), reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const float share = o.z > 0.0f ? reflectance : 1.0f - reflectance;
    *pdf = share * jacobian * facet_pdf(&sampled, w, m, facet_density(&sampled, m));
    const float scattered = share * jacobian * density * seen_per_cosine(&d, w) * cos_w * seen(&d, o);
    return scale3(rgb_parameter(at, o.z > 0.0f ? 0 : 1), o.z > 0.0f ? scattered : scattered / (eta * eta));
}
#endif

INLINE BsdfSample rough_dielectric_sample(const Shading* at, Vec3 u)
{
    BsdfSample sample = nothing_sampled();
    const float side = with_sign(1.0f, at->cos_i), index = number_parameter(at, 2);
    const float eta = side > 0.0f ? index : 1.0f / index;
    const Vec3 w = scale3(to_local(at, at->wi), side);
    if (!(w.z > 0.0f)) return sample;
    const Microfacets d = rough_microfacets(at), sampled = sampled_microfacets(&d, w.z);
    const Vec3 m = sample_facet(&sampled, w, vec2(u.y, u.z));
    const float cos_w = dot3(w, m), density = facet_density(&sampled, m);
    const float facet = facet_pdf(&sampled, w, m, density);
    if (!(cos_w > 0.0f && facet > 0.0f)) return sample;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_w, eta, &cos_t);
    const bool reflects = u.x <= reflectance;
    const Vec3 o = reflects ? sub3(scale3(m, 2.0f * cos_w), w) : sub3(scale3(m, cos_w / eta - cos_t), over3(w, eta));
    if (!(reflects ? o.z > 0.0f : o.z < 0.0f)) return sample;
    const float length = cos_w - eta * cos_t;  // of w + eta * o
    const float jacobian = reflects ? 0.25f / cos_w : eta * eta * cos_t / (length * length);
    float weight = seen(&d, o);
    if (d.sample_all) weight *= seen_per_cosine(&d, w) * cos_w / m.z * (facet_density(&d, m) / density);
    sample.pdf = (reflects ? reflectance : 1.0f - reflectance) * jacobian * facet;
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = unit(scale3(to_world(at, o), side));
    sample.weight = scale3(rgb_parameter(at, reflects ? 0 : 1), reflects ? weight : weight / (eta * eta));
    sample.eta = reflects ? 1.0f : eta;
    return sample;
}
#endif
