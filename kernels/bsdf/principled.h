// The principled BSDF: Burley, "Physically Based Shading at Disney", 2012, and "Extending the Disney BRDF to a BSDF
// with Integrated Subsurface Scattering", 2015, with the lobes, blends and bounds of Mitsuba 3. Directions are in the
// shading frame, flipped for paths from inside: a distribution of normals is the same from both sides.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/principled_lobes.h"

#if FEATURE_PRINCIPLED
typedef struct {
    Vec3 base;
    float roughness, metallic, glass;  // glass: share of specular transmission, without metal
    float diffuse;                     // weight of the diffuse base
    float eta;                         // index of the far side over that of the near side
    bool front;
    MicrofacetDistribution facets;
    float diffuse_rate, clearcoat_rate,
        specular_rate;  // probabilities of the lobes; the last has reflection and transmission
} Principled;

INLINE Principled principled_parameters(const BsdfContext* ctx)
{
    Principled p;
    p.front = ctx->cos_i > 0.0f;
    p.base = bsdf_rgb(ctx, SLOT_PRINCIPLED_BASE_COLOR);
    p.roughness = bsdf_float(ctx, SLOT_PRINCIPLED_ROUGHNESS);
    p.metallic = bsdf_float(ctx, SLOT_PRINCIPLED_METALLIC);
    const float spec_trans = bsdf_float(ctx, SLOT_PRINCIPLED_SPEC_TRANS), index = bsdf_float(ctx, SLOT_PRINCIPLED_ETA);
    p.glass = (1.0f - p.metallic) * spec_trans;
    p.diffuse = (1.0f - p.metallic) * (1.0f - spec_trans);
    p.eta = p.front ? index : 1.0f / index;
    p.facets = principled_facets(p.roughness, bsdf_float(ctx, SLOT_PRINCIPLED_ANISOTROPIC));
    const Bsdf m = material(ctx);
    const float diffuse = p.diffuse * m.constants[CONSTANT_PRINCIPLED_DIFFUSE_REFLECTANCE_SAMPLING_RATE];
    const float specular = m.constants[CONSTANT_PRINCIPLED_MAIN_SPECULAR_SAMPLING_RATE];
    const float clearcoat =
        0.25f * bsdf_float(ctx, SLOT_PRINCIPLED_CLEARCOAT) * m.constants[CONSTANT_PRINCIPLED_CLEARCOAT_SAMPLING_RATE];
    const float total = diffuse + clearcoat + specular, scale = total > 0.0f ? 1.0f / total : 0.0f;
    p.diffuse_rate = p.front ? diffuse * scale : 0.0f;
    p.clearcoat_rate = p.front ? clearcoat * scale : 0.0f;
    p.specular_rate = p.front ? specular * scale : 1.0f;
    return p;
}

// Share of the main specular lobe that is transmitted, for this Fresnel reflectance.
INLINE float transmission_probability(const Principled* p, float reflectance)
{
    return (p->front ? p->glass : 1.0f) * (1.0f - reflectance);
}

// Reflectance of the main specular lobe: Schlick's approximation for metal and the tinted part, Fresnel's formula for
// the rest.
INLINE Vec3 principled_reflectance(const BsdfContext* ctx, const Principled* p, float cosine, float reflectance)
{
    if (!p->front) return splat3(p->glass * reflectance);
    const float towards_one = schlick_at_interface(cosine, p->eta), tint = bsdf_float(ctx, SLOT_PRINCIPLED_SPEC_TINT);
    const Vec3 metal = add3(p->base, scale3(sub3(splat3(1.0f), p->base), towards_one));
    const Vec3 other = partly_tinted_reflectance(p->base, tint, p->eta, towards_one, reflectance);
    return add3(scale3(metal, p->metallic), scale3(other, 1.0f - p->metallic));
}

// The clearcoat: an untinted lobe with the GTR1 distribution. `gtr1_d` uses sin^2 + alpha^2 cos^2: 1 - cos^2 cancels
// near the peak.
INLINE float clearcoat_alpha2(const BsdfContext* ctx)
{
    const float alpha = 0.1f + bsdf_float(ctx, SLOT_PRINCIPLED_CLEARCOAT_GLOSS) * (0.001f - 0.1f);
    return alpha * alpha;
}

INLINE float gtr1_d(float alpha2, Vec3 m)
{
    return (alpha2 - 1.0f) / (M_PI_F * log_approx(alpha2) * (m.x * m.x + m.y * m.y + alpha2 * m.z * m.z));
}

// 1 - r^2 of the disk is the exponent of alpha^2 in alpha^2 + (1 - alpha^2) sin^2.
INLINE Vec3 sample_gtr1(float alpha2, Vec2 u)
{
    const Vec2 p = square_to_disk(u);
    const float r2 = MIN(dot2(p, p), 1.0f), scale = 1.0f / (1.0f - alpha2);
    const float power = exp_approx((1.0f - r2) * log_approx(alpha2));
    const float stretch = SQRT(MAX(power - alpha2, 0.0f) * scale / MAX(r2, 1e-20f));
    return vec3_from(scale2(p, stretch), SQRT(MAX(1.0f - power, 0.0f) * scale));
}

// Diffuse base and sheen, over the cosine.
INLINE Vec3 principled_diffuse(const BsdfContext* ctx, const Principled* p, float cos_w, float cos_o, float cos_m)
{
    const float shape = diffuse_shape(p->roughness, bsdf_float(ctx, SLOT_PRINCIPLED_FLATNESS), cos_w, cos_o, cos_m);
    const float sheen = bsdf_float(ctx, SLOT_PRINCIPLED_SHEEN);
    Vec3 value = scale3(p->base, p->diffuse * M_1_PI_F * shape);
    if (sheen > 0.0f)
        value = add3(value, scale3(tint_color(p->base, bsdf_float(ctx, SLOT_PRINCIPLED_SHEEN_TINT)),
                                   sheen * (1.0f - p->metallic) * schlick_weight(cos_m)));
    return value;
}

INLINE Vec3 principled_local(const BsdfContext* ctx, const Principled* p, Vec3 w, Vec3 o, float* pdf)
{
    Vec3 value = splat3(0.0f), m;
    float cos_w, cos_o, jacobian, cos_t;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f && (p->front || p->glass > 0.0f))) return value;
    if (!generalized_half_vector(w, o, p->eta, &m, &cos_w, &cos_o, &jacobian)) return value;
    const float reflectance = fresnel_dielectric(cos_w, p->eta, &cos_t);
    const float density = microfacet_d(&p->facets, m), transmitted = transmission_probability(p, reflectance);
    const float facets = jacobian * microfacet_pdf(&p->facets, w, m, density),
                specular_lobe = facets * smith_g1(&p->facets, o);
    if (o.z < 0.0f) {
        *pdf = p->specular_rate * transmitted * facets;
        const Vec3 colour = vec3(SQRT(p->base.x), SQRT(p->base.y), SQRT(p->base.z));
        return scale3(colour, p->glass * (1.0f - reflectance) * specular_lobe / (p->eta * p->eta));
    }
    *pdf = p->specular_rate * (p->front ? 1.0f - transmitted : reflectance) * facets;
    if (reflectance > 0.0f) value = scale3(principled_reflectance(ctx, p, cos_w, reflectance), specular_lobe);
    if (p->front) {
        const float clearcoat = bsdf_float(ctx, SLOT_PRINCIPLED_CLEARCOAT);
        if (clearcoat > 0.0f) {
            const float alpha2 = clearcoat_alpha2(ctx), coat = gtr1_d(alpha2, m);
            const MicrofacetDistribution quarter = make_microfacets(0.25f, 0.25f, 0u);
            const float coat_reflectance = 0.04f + 0.96f * schlick_at_interface(cos_w, p->eta);
            value = add3(value, splat3(0.25f * clearcoat * coat_reflectance * coat * smith_g1(&quarter, w) *
                                       smith_g1(&quarter, o) * o.z));
            *pdf += p->clearcoat_rate * coat * m.z * jacobian;
        }
        if (p->diffuse > 0.0f) value = add3(value, scale3(principled_diffuse(ctx, p, w.z, o.z, cos_o), o.z));
        *pdf += p->diffuse_rate * o.z * M_1_PI_F;
    }
    return value;
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 principled_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const Principled p = principled_parameters(ctx);
    const float side = copy_sign(1.0f, ctx->cos_i);
    return principled_local(ctx, &p, scale3(to_local(ctx, ctx->wi), side), scale3(to_local(ctx, wo), side), pdf);
}
#endif

INLINE BsdfSample principled_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const Principled p = principled_parameters(ctx);
    const float side = copy_sign(1.0f, ctx->cos_i);
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side);
    if (!(w.z > 0.0f)) return sample;
    Vec3 o = splat3(0.0f);
    bool reflects = true;
    if (u.x < p.diffuse_rate) {
        o = square_to_hemisphere(vec2(u.y, u.z));
    } else if (u.x < p.diffuse_rate + p.clearcoat_rate) {
        const Vec3 m = sample_gtr1(clearcoat_alpha2(ctx), vec2(u.y, u.z));
        o = normalize3(sub3(scale3(m, 2.0f * dot3(w, m)), w));
    } else {
        const Vec3 m = sample_microfacet(&p.facets, w, vec2(u.y, u.z));
        const float cos_w = dot3(w, m);
        float cos_t = 0.0f;
        const float transmitted = transmission_probability(&p, fresnel_dielectric(cos_w, p.eta, &cos_t));
        reflects = u.x - p.diffuse_rate - p.clearcoat_rate >= p.specular_rate * transmitted;
        o = normalize3(reflects ? sub3(scale3(m, 2.0f * cos_w), w)
                                : sub3(scale3(m, cos_w / p.eta - cos_t), div_scalar3(w, p.eta)));
    }
    if (reflects != (o.z > 0.0f)) return sample;
    const Vec3 value = principled_local(ctx, &p, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = normalize3(scale3(to_world(ctx, o), side));
    sample.weight = div_scalar3(value, sample.pdf);
    sample.eta = reflects ? 1.0f : p.eta;
    return sample;
}
#endif
