// The principled material: Burley, "Physically Based Shading at Disney", 2012, and "Extending the Disney BRDF to a BSDF with
// Integrated Subsurface Scattering", 2015, with the lobes, blends and bounds of Mitsuba 3. Directions are of the surface's frame,
// turned around where the path comes from inside: a distribution of normals looks the same from both sides.
#pragma once
#include "rough.h"

#if FEATURE_PRINCIPLED
typedef struct {
    float3 base;
    float roughness, metallic, glass;  // glass: share of the light that is no metal's and may pass
    float diffuse;                     // share of the diffuse base
    float eta;                         // index of the far side over that of the near side
    bool front;
    Microfacets facets;
    float diffuse_rate, clearcoat_rate, specular_rate;  // probabilities of the lobes; the last has reflection and transmission
} Principled;

INLINE Principled principled_parameters(const Shading* at)
{
    Principled p;
    p.front = at->cos_i > 0.0f;
    p.base = rgb_parameter(at, 0);
    p.roughness = number_parameter(at, 1);
    p.metallic = number_parameter(at, 3);
    const float anisotropic = number_parameter(at, 2), spec_trans = number_parameter(at, 4), index = number_parameter(at, 5);
    p.glass = (1.0f - p.metallic) * spec_trans;
    p.diffuse = (1.0f - p.metallic) * (1.0f - spec_trans);
    p.eta = p.front ? index : 1.0f / index;
    const float aspect = SQRT(1.0f - 0.9f * anisotropic), square = p.roughness * p.roughness;
    p.facets = microfacets(GREATER(square / aspect, 1e-3f), GREATER(square * aspect, 1e-3f), BSDF_GGX);
    // rates of the three lobes, in places of their numbers that are free: slot 1, and 5 twice
    __global const float* values = at->bsdf->values;
    const float diffuse = p.diffuse * values[4], specular = values[16], clearcoat = 0.25f * number_parameter(at, 10) * values[17];
    const float total = diffuse + clearcoat + specular, scale = total > 0.0f ? 1.0f / total : 0.0f;
    p.diffuse_rate = p.front ? diffuse * scale : 0.0f;
    p.clearcoat_rate = p.front ? clearcoat * scale : 0.0f;
    p.specular_rate = p.front ? specular * scale : 1.0f;
    return p;
}

// Of what the main lobe sends on, how much is transmitted, if the boundary reflects this share.
INLINE float transmission_probability(const Principled* p, float reflectance)
{
    return (p->front ? p->glass : 1.0f) * (1.0f - reflectance);
}

INLINE float schlick_weight(float cosine)
{
    const float m = LESSER(GREATER(1.0f - cosine, 0.0f), 1.0f), m2 = m * m;
    return m2 * m2 * m;
}

// How far Schlick's reflectance is from that at normal incidence to 1; from the denser side by the angle of refraction.
INLINE float schlick(float cosine, float eta)
{
    return schlick_weight(eta > 1.0f ? cosine : SQRT(GREATER(1.0f - (1.0f - cosine * cosine) / (eta * eta), 0.0f)));
}

// The colour without its luminance (Rec. 709, in Mitsuba's digits), `tint` of the way from white to it.
INLINE float3 tinted(float3 colour, float tint)
{
    const float luminance = dot3(colour, (float3)(0.212671f, 0.715160f, 0.072169f));
    return 1.0f + tint * ((luminance > 0.0f ? colour / luminance : (float3)(1.0f)) - 1.0f);
}

// What the main lobe reflects: metal and the tinted part by Schlick's approximation, the rest by Fresnel's formula.
INLINE float3 principled_reflectance(const Shading* at, const Principled* p, float cosine, float reflectance)
{
    if (!p->front) return (float3)(p->glass * reflectance);
    const float towards_one = schlick(cosine, p->eta), tint = number_parameter(at, 6), n = (p->eta - 1.0f) / (p->eta + 1.0f);
    const float3 metal = p->base + towards_one * (1.0f - p->base), normal_incidence = n * n * tinted(p->base, 1.0f);
    const float3 coloured = normal_incidence + towards_one * (1.0f - normal_incidence);
    return p->metallic * metal + (1.0f - p->metallic) * ((1.0f - tint) * reflectance + tint * coloured);
}

// The second, coloured-by-nothing lobe: GTR1 with its logarithm of alpha squared. From sin^2 + alpha^2 cos^2: 1 - cos^2 would
// have lost its digits where the lobe is.
INLINE float coat_alpha2(const Shading* at)
{
    const float alpha = 0.1f + number_parameter(at, 11) * (0.001f - 0.1f);
    return alpha * alpha;
}

INLINE float coat_density(float alpha2, float3 m)
{
    return (alpha2 - 1.0f) / (M_PI_F * logarithm(alpha2) * (m.x * m.x + m.y * m.y + alpha2 * m.z * m.z));
}

INLINE float3 coat_facet(float alpha2, float2 u)
{
    const float power = exponential((1.0f - u.y) * logarithm(alpha2)), scale = 1.0f / (1.0f - alpha2);  // alpha^2(1 - u)
    const float radius = SQRT(GREATER(power - alpha2, 0.0f) * scale), z = SQRT(GREATER(1.0f - power, 0.0f) * scale);
    const float2 p = radius * circle(u.x);
    return (float3)(p.x, p.y, z);
}

// Diffuse, retro-reflection, flattened subsurface scattering and sheen, over the cosine.
INLINE float3 principled_base(const Shading* at, const Principled* p, float cos_w, float cos_o, float cos_m)
{
    const float fw = schlick_weight(cos_w), fo = schlick_weight(cos_o), retro = 2.0f * p->roughness * cos_m * cos_m;
    const float flatness = number_parameter(at, 9), sheen = number_parameter(at, 7);
    const float lambert = (1.0f - 0.5f * fw) * (1.0f - 0.5f * fo) + retro * (fo + fw + fo * fw * (retro - 1.0f));
    const float flat = (1.0f + fo * (0.5f * retro - 1.0f)) * (1.0f + fw * (0.5f * retro - 1.0f));
    const float subsurface = 1.25f * (flat * (1.0f / (cos_o + cos_w) - 0.5f) + 0.5f);
    float3 value = p->base * (p->diffuse * M_1_PI_F * (lambert + flatness * (subsurface - lambert)));
    if (sheen > 0.0f)
        value += tinted(p->base, number_parameter(at, 8)) * (sheen * (1.0f - p->metallic) * schlick_weight(cos_m));
    return value;
}

INLINE float3 principled_local(const Shading* at, const Principled* p, float3 w, float3 o, float* pdf)
{
    float3 value = (float3)(0.0f), m;
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && (p->front || p->glass > 0.0f))) return value;
    if (!boundary_facet(w, o, p->eta, &m, &cos_w, &cos_o, &jacobian)) return value;
    const float reflectance = fresnel_dielectric(cos_w, p->eta, &cos_t);
    const float density = facet_density(&p->facets, m), passed = transmission_probability(p, reflectance);
    const float facets = jacobian * facet_pdf(&p->facets, w, m, density), shown = facets * seen(&p->facets, o);
    if (o.z < 0.0f) {
        *pdf = p->specular_rate * passed * facets;
        const float3 colour = (float3)(SQRT(p->base.x), SQRT(p->base.y), SQRT(p->base.z));
        return colour * (p->glass * (1.0f - reflectance) * shown / (p->eta * p->eta));
    }
    *pdf = p->specular_rate * (p->front ? 1.0f - passed : reflectance) * facets;
    if (reflectance > 0.0f) value = shown * principled_reflectance(at, p, cos_w, reflectance);
    if (p->front) {
        const float clearcoat = number_parameter(at, 10);
        if (clearcoat > 0.0f) {
            const float alpha2 = coat_alpha2(at), coat = coat_density(alpha2, m);
            const Microfacets quarter = microfacets(0.25f, 0.25f, BSDF_GGX);
            const float coat_reflectance = 0.04f + 0.96f * schlick(cos_w, p->eta);
            value += 0.25f * clearcoat * coat_reflectance * coat * seen(&quarter, w) * seen(&quarter, o) * o.z;
            *pdf += p->clearcoat_rate * coat * m.z * jacobian;
        }
        if (p->diffuse > 0.0f) value += o.z * principled_base(at, p, w.z, o.z, cos_o);
        *pdf += p->diffuse_rate * o.z * M_1_PI_F;
    }
    return value;
}

INLINE float3 principled_eval(const Shading* at, float3 wo, float* pdf)
{
    const Principled p = principled_parameters(at);
    const float side = with_sign(1.0f, at->cos_i);
    return principled_local(at, &p, side * to_local(at, at->wi), side * to_local(at, wo), pdf);
}

INLINE BsdfSample principled_sample(const Shading* at, float3 u)
{
    BsdfSample sample;
    sample.weight = (float3)(0.0f);
    const Principled p = principled_parameters(at);
    const float side = with_sign(1.0f, at->cos_i);
    const float3 w = side * to_local(at, at->wi);
    if (!(w.z > 0.0f)) return sample;
    float3 o;
    bool reflects = true;
    if (u.x < p.diffuse_rate) {
        o = square_to_hemisphere(u.yz);
    } else if (u.x < p.diffuse_rate + p.clearcoat_rate) {
        const float3 m = coat_facet(coat_alpha2(at), u.yz);
        o = unit(2.0f * dot3(w, m) * m - w);
    } else {
        const float3 m = sample_facet(&p.facets, w, u.yz);
        const float cos_w = dot3(w, m);
        float cos_t;
        const float passed = transmission_probability(&p, fresnel_dielectric(cos_w, p.eta, &cos_t));
        reflects = u.x - p.diffuse_rate - p.clearcoat_rate >= p.specular_rate * passed;
        o = unit(reflects ? 2.0f * cos_w * m - w : (cos_w / p.eta - cos_t) * m - w / p.eta);
    }
    if (reflects != (o.z > 0.0f)) return sample;
    const float3 value = principled_local(at, &p, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = unit(side * to_world(at, o));
    sample.weight = value / sample.pdf;
    sample.eta = reflects ? 1.0f : p.eta;
    return sample;
}
#endif
