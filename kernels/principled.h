// The principled material: Burley, "Physically Based Shading at Disney", 2012, and "Extending the Disney BRDF to a BSDF with
// Integrated Subsurface Scattering", 2015, with the lobes, blends and bounds of Mitsuba 3. Directions are of the surface's frame,
// turned around where the path comes from inside: a distribution of normals looks the same from both sides.
#pragma once
#include "rough.h"

#if FEATURE_PRINCIPLED
typedef struct {
    Vec3 base;
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
    const Bsdf m = material(at);
    const float diffuse = p.diffuse * m.values[4], specular = m.values[16];
    const float clearcoat = 0.25f * number_parameter(at, 10) * m.values[17];
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
INLINE Vec3 tinted(Vec3 colour, float tint)
{
    const float luminance = dot3(colour, vec3(0.212671f, 0.715160f, 0.072169f));
    const Vec3 pure = luminance > 0.0f ? over3(colour, luminance) : all3(1.0f);
    return add3(all3(1.0f), scale3(sub3(pure, all3(1.0f)), tint));
}

// What the main lobe reflects: metal and the tinted part by Schlick's approximation, the rest by Fresnel's formula.
INLINE Vec3 principled_reflectance(const Shading* at, const Principled* p, float cosine, float reflectance)
{
    if (!p->front) return all3(p->glass * reflectance);
    const float towards_one = schlick(cosine, p->eta), tint = number_parameter(at, 6), n = (p->eta - 1.0f) / (p->eta + 1.0f);
    const Vec3 metal = add3(p->base, scale3(sub3(all3(1.0f), p->base), towards_one));
    const Vec3 normal_incidence = scale3(tinted(p->base, 1.0f), n * n);
    const Vec3 coloured = add3(normal_incidence, scale3(sub3(all3(1.0f), normal_incidence), towards_one));
    const Vec3 other = add3(all3((1.0f - tint) * reflectance), scale3(coloured, tint));
    return add3(scale3(metal, p->metallic), scale3(other, 1.0f - p->metallic));
}

// The second, coloured-by-nothing lobe: GTR1 with its logarithm of alpha squared. From sin^2 + alpha^2 cos^2: 1 - cos^2 would
// have lost its digits where the lobe is.
INLINE float coat_alpha2(const Shading* at)
{
    const float alpha = 0.1f + number_parameter(at, 11) * (0.001f - 0.1f);
    return alpha * alpha;
}

INLINE float coat_density(float alpha2, Vec3 m)
{
    return (alpha2 - 1.0f) / (M_PI_F * logarithm(alpha2) * (m.x * m.x + m.y * m.y + alpha2 * m.z * m.z));
}

INLINE Vec3 coat_facet(float alpha2, Vec2 u)
{
    const float power = exponential((1.0f - u.y) * logarithm(alpha2)), scale = 1.0f / (1.0f - alpha2);  // alpha^2(1 - u)
    const float radius = SQRT(GREATER(power - alpha2, 0.0f) * scale), z = SQRT(GREATER(1.0f - power, 0.0f) * scale);
    const Vec2 p = scale2(circle(u.x), radius);
    return vec3(p.x, p.y, z);
}

// Diffuse, retro-reflection, flattened subsurface scattering and sheen, over the cosine.
INLINE Vec3 principled_base(const Shading* at, const Principled* p, float cos_w, float cos_o, float cos_m)
{
    const float fw = schlick_weight(cos_w), fo = schlick_weight(cos_o), retro = 2.0f * p->roughness * cos_m * cos_m;
    const float flatness = number_parameter(at, 9), sheen = number_parameter(at, 7);
    const float lambert = (1.0f - 0.5f * fw) * (1.0f - 0.5f * fo) + retro * (fo + fw + fo * fw * (retro - 1.0f));
    const float flat = (1.0f + fo * (0.5f * retro - 1.0f)) * (1.0f + fw * (0.5f * retro - 1.0f));
    const float subsurface = 1.25f * (flat * (1.0f / (cos_o + cos_w) - 0.5f) + 0.5f);
    Vec3 value = scale3(p->base, p->diffuse * M_1_PI_F * (lambert + flatness * (subsurface - lambert)));
    if (sheen > 0.0f)
        value = add3(value, scale3(tinted(p->base, number_parameter(at, 8)),
                                   sheen * (1.0f - p->metallic) * schlick_weight(cos_m)));
    return value;
}

INLINE Vec3 principled_local(const Shading* at, const Principled* p, Vec3 w, Vec3 o, float* pdf)
{
    Vec3 value = all3(0.0f), m;
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && (p->front || p->glass > 0.0f))) return value;
    if (!boundary_facet(w, o, p->eta, &m, &cos_w, &cos_o, &jacobian)) return value;
    const float reflectance = fresnel_dielectric(cos_w, p->eta, &cos_t);
    const float density = facet_density(&p->facets, m), passed = transmission_probability(p, reflectance);
    const float facets = jacobian * facet_pdf(&p->facets, w, m, density), shown = facets * seen(&p->facets, o);
    if (o.z < 0.0f) {
        *pdf = p->specular_rate * passed * facets;
        const Vec3 colour = vec3(SQRT(p->base.x), SQRT(p->base.y), SQRT(p->base.z));
        return scale3(colour, p->glass * (1.0f - reflectance) * shown / (p->eta * p->eta));
    }
    *pdf = p->specular_rate * (p->front ? 1.0f - passed : reflectance) * facets;
    if (reflectance > 0.0f) value = scale3(principled_reflectance(at, p, cos_w, reflectance), shown);
    if (p->front) {
        const float clearcoat = number_parameter(at, 10);
        if (clearcoat > 0.0f) {
            const float alpha2 = coat_alpha2(at), coat = coat_density(alpha2, m);
            const Microfacets quarter = microfacets(0.25f, 0.25f, BSDF_GGX);
            const float coat_reflectance = 0.04f + 0.96f * schlick(cos_w, p->eta);
            value = add3(value, all3(0.25f * clearcoat * coat_reflectance * coat * seen(&quarter, w) * seen(&quarter, o) * o.z));
            *pdf += p->clearcoat_rate * coat * m.z * jacobian;
        }
        if (p->diffuse > 0.0f) value = add3(value, scale3(principled_base(at, p, w.z, o.z, cos_o), o.z));
        *pdf += p->diffuse_rate * o.z * M_1_PI_F;
    }
    return value;
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 principled_eval(const Shading* at, Vec3 wo, float* pdf)
{
    const Principled p = principled_parameters(at);
    const float side = with_sign(1.0f, at->cos_i);
    return principled_local(at, &p, scale3(to_local(at, at->wi), side), scale3(to_local(at, wo), side), pdf);
}
#endif

INLINE BsdfSample principled_sample(const Shading* at, Vec3 u)
{
    BsdfSample sample = nothing_sampled();
    const Principled p = principled_parameters(at);
    const float side = with_sign(1.0f, at->cos_i);
    const Vec3 w = scale3(to_local(at, at->wi), side);
    if (!(w.z > 0.0f)) return sample;
    Vec3 o = all3(0.0f);
    bool reflects = true;
    if (u.x < p.diffuse_rate) {
        o = square_to_hemisphere(vec2(u.y, u.z));
    } else if (u.x < p.diffuse_rate + p.clearcoat_rate) {
        const Vec3 m = coat_facet(coat_alpha2(at), vec2(u.y, u.z));
        o = unit(sub3(scale3(m, 2.0f * dot3(w, m)), w));
    } else {
        const Vec3 m = sample_facet(&p.facets, w, vec2(u.y, u.z));
        const float cos_w = dot3(w, m);
        float cos_t = 0.0f;
        const float passed = transmission_probability(&p, fresnel_dielectric(cos_w, p.eta, &cos_t));
        reflects = u.x - p.diffuse_rate - p.clearcoat_rate >= p.specular_rate * passed;
        o = unit(reflects ? sub3(scale3(m, 2.0f * cos_w), w) : sub3(scale3(m, cos_w / p.eta - cos_t), over3(w, p.eta)));
    }
    if (reflects != (o.z > 0.0f)) return sample;
    const Vec3 value = principled_local(at, &p, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = unit(scale3(to_world(at, o), side));
    sample.weight = over3(value, sample.pdf);
    sample.eta = reflects ? 1.0f : p.eta;
    return sample;
}
#endif
