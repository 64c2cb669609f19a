// Plastic: a diffuse base under a smooth or a rough boundary. Light that the boundary sends back to the base is scattered there
// again, so that the base's reflectance becomes r / (1 - r R), R its mean inner reflectance; the conventions are Mitsuba 3's.
#pragma once
#include "microfacet.h"
#include "smooth.h"

#if FEATURE_PLASTIC || FEATURE_ROUGH_PLASTIC
// Reflectance of the base with all that goes on between it and the boundary, over the boundary's index squared.
INLINE Vec3 base_reflectance(const Shading* at)
{
    const Vec3 base = rgb_parameter(at, 1);
    const float inner = material(at).values[9], eta = number_parameter(at, 2);
    const Vec3 again = material(at).flags & BSDF_NONLINEAR ? scale3(base, inner) : all3(inner);
    return div3(base, scale3(sub3(all3(1.0f), again), eta * eta));
}

// The probability of sampling the boundary, of which this share reflects: by what the two would send back.
INLINE float boundary_probability(const Shading* at, float reflected)
{
    const Vec3 mirror = rgb_parameter(at, 0), base = rgb_parameter(at, 1);
    const float by_boundary = reflected * (mirror.x + mirror.y + mirror.z);
    const float total = by_boundary + (1.0f - reflected) * (base.x + base.y + base.z);
    return total > 0.0f ? by_boundary / total : 0.0f;
}
#endif

#if FEATURE_PLASTIC
// The base alone: the boundary is a delta function.
INLINE Vec3 plastic_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(at->normal, wo), eta = number_parameter(at, 2);
    *pdf = 0.0f;
    if (!(at->cos_i > 0.0f && cos_o > 0.0f)) return all3(0.0f);
    float cos_t = 0.0f;
    const float reflected_i = fresnel_dielectric(at->cos_i, eta, &cos_t);
    const float reflected_o = fresnel_dielectric(cos_o, eta, &cos_t);
    *pdf = (1.0f - boundary_probability(at, reflected_i)) * cos_o * M_1_PI_F;
    return scale3(base_reflectance(at), (1.0f - reflected_i) * (1.0f - reflected_o) * cos_o * M_1_PI_F);
}

INLINE BsdfSample plastic_sample(const Shading* at, Vec3 u)
{
    BsdfSample sample = nothing_sampled();
    if (!(at->cos_i > 0.0f)) return sample;
    float cos_t = 0.0f;
    const float eta = number_parameter(at, 2), reflected = fresnel_dielectric(at->cos_i, eta, &cos_t);
    const float probability = boundary_probability(at, reflected);
    sample.eta = 1.0f;
    if (u.x < probability) {
        sample.direction = unit(sub3(scale3(at->normal, 2.0f * at->cos_i), at->wi));
        sample.weight = scale3(rgb_parameter(at, 0), reflected / probability);
        sample.pdf = -1.0f;
    } else {
        sample.direction = around(at->normal, square_to_hemisphere(vec2(u.y, u.z)));
        sample.weight = plastic_eval(at, sample.direction, &sample.pdf);
        sample.weight = sample.pdf > 0.0f ? over3(sample.weight, sample.pdf) : all3(0.0f);
    }
    return sample;
}
#endif

#if FEATURE_ROUGH_PLASTIC
#define BOUNDARY_NODES 64  // of a table, as in `scene.boundaries`

// The share of the light from a direction that gets through the rough boundary.
INLINE float boundary_transmittance(const Shading* at, float cos_w)
{
    __global const float* table = at->tables + BOUNDARY_NODES * (uint)material(at).values[10];
    const float place = cos_w * (BOUNDARY_NODES - 1);
    const int node = LESSER((int)place, BOUNDARY_NODES - 2);
    return table[node] + (place - (float)node) * (table[node + 1] - table[node]);
}

// In the surface's frame.
INLINE Vec3 rough_plastic_local(const Shading* at, const Microfacets* d, Vec3 w, Vec3 o, float* pdf)
{
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f)) return all3(0.0f);
    const Vec3 m = unit(add3(w, o));
    const float cos_m = dot3(w, m), density = facet_density(d, m);
    const float through_w = boundary_transmittance(at, w.z), through_o = boundary_transmittance(at, o.z);
    const float probability = boundary_probability(at, 1.0f - through_w);
    *pdf = (1.0f - probability) * o.z * M_1_PI_F;
    Vec3 value = scale3(base_reflectance(at), through_w * through_o * o.z * M_1_PI_F);
    if (cos_m > 0.0f) {
        float cos_t = 0.0f;
        const float reflected = fresnel_dielectric(cos_m, number_parameter(at, 2), &cos_t);
        value = add3(value, scale3(rgb_parameter(at, 0), 0.25f * reflected * density * seen_per_cosine(d, w) * seen(d, o)));
        *pdf += probability * facet_pdf(d, w, m, density) / (4.0f * cos_m);
    }
    return value;
}

INLINE Microfacets rough_plastic_microfacets(const Shading* at)
{
    return microfacets(number_parameter(at, 4), number_parameter(at, 4), material(at).flags);
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_plastic_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const Microfacets d = rough_plastic_microfacets(at);
    return rough_plastic_local(at, &d, to_local(at, at->wi), to_local(at, wo), pdf);
}
#endif

INLINE BsdfSample rough_plastic_sample(const Shading* at, Vec3 u)
{
    BsdfSample sample = nothing_sampled();
    const Vec3 w = to_local(at, at->wi);
    if (!(w.z > 0.0f)) return sample;
    const Microfacets d = rough_plastic_microfacets(at);
    Vec3 o = all3(0.0f);
    if (u.x < boundary_probability(at, 1.0f - boundary_transmittance(at, w.z))) {
        const Vec3 m = sample_facet(&d, w, vec2(u.y, u.z));
        o = unit(sub3(scale3(m, 2.0f * dot3(w, m)), w));
    } else {
        o = square_to_hemisphere(vec2(u.y, u.z));
    }
    const Vec3 value = rough_plastic_local(at, &d, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f)) return sample;
    sample.direction = unit(to_world(at, o));
    sample.weight = over3(value, sample.pdf);
    sample.eta = 1.0f;
    return sample;
}
#endif
