// The principled BSDF of a thin sheet, without refraction: diffuse and specular lobes on both sides of the surface.
// Burley, "Extending the Disney BRDF to a BSDF with Integrated Subsurface Scattering", 2015, section 5, with the lobes
// and sampling of Mitsuba 3. Directions are in the shading frame, flipped for paths from below.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/principled_lobes.h"

#if FEATURE_PRINCIPLED_THIN
typedef struct {
    Vec3 base;
    float roughness, anisotropic, eta, spec_trans;
    float diff_trans;  // share of the diffuse light that is transmitted
    float specular_reflection_rate, specular_transmission_rate, diffuse_reflection_rate,
        diffuse_transmission_rate;  // probabilities of the lobes
} PrincipledThin;

INLINE PrincipledThin principled_thin_parameters(const BsdfContext* ctx)
{
    PrincipledThin p;
    p.base = bsdf_rgb(ctx, SLOT_PRINCIPLED_THIN_BASE_COLOR);
    p.roughness = bsdf_float(ctx, SLOT_PRINCIPLED_THIN_ROUGHNESS);
    p.anisotropic = bsdf_float(ctx, SLOT_PRINCIPLED_THIN_ANISOTROPIC);
    p.eta = bsdf_float(ctx, SLOT_PRINCIPLED_THIN_ETA);
    p.spec_trans = bsdf_float(ctx, SLOT_PRINCIPLED_THIN_SPEC_TRANS);
    p.diff_trans = 0.5f * bsdf_float(ctx, SLOT_PRINCIPLED_THIN_DIFF_TRANS);
    const Bsdf m = material(ctx);
    const float specular = 0.5f * p.spec_trans, diffuse = 1.0f - p.spec_trans;
    p.specular_reflection_rate = specular * m.constants[CONSTANT_PRINCIPLED_THIN_SPECULAR_REFLECTANCE_SAMPLING_RATE];
    p.specular_transmission_rate =
        specular * m.constants[CONSTANT_PRINCIPLED_THIN_SPECULAR_TRANSMITTANCE_SAMPLING_RATE];
    p.diffuse_reflection_rate =
        diffuse * (1.0f - p.diff_trans) * m.constants[CONSTANT_PRINCIPLED_THIN_DIFFUSE_REFLECTANCE_SAMPLING_RATE];
    p.diffuse_transmission_rate =
        diffuse * p.diff_trans * m.constants[CONSTANT_PRINCIPLED_THIN_DIFFUSE_TRANSMITTANCE_SAMPLING_RATE];
    const float total = p.specular_reflection_rate + p.specular_transmission_rate + p.diffuse_reflection_rate +
                        p.diffuse_transmission_rate;
    const float scale = total > 0.0f ? 1.0f / total : 0.0f;
    p.specular_reflection_rate *= scale;
    p.specular_transmission_rate *= scale;
    p.diffuse_reflection_rate *= scale;
    p.diffuse_transmission_rate *= scale;
    return p;
}

// Facets that reflect; for transmission a lobe of the same form, scaled by the index (Burley 2015, figure 15).
INLINE MicrofacetDistribution principled_thin_facets(const PrincipledThin* p, bool reflects)
{
    return principled_facets(p->roughness * (reflects ? 1.0f : 0.65f * p->eta - 0.35f), p->anisotropic);
}

// Transmission mirrors the reflected lobe at the surface: the facet is halfway between w and the mirrored o, and has to
// face w and not o.
INLINE Vec3 principled_thin_local(const BsdfContext* ctx, const PrincipledThin* p, Vec3 w, Vec3 o, float* pdf)
{
    Vec3 m;
    float cos_w, cos_o, jacobian, cos_t;
    const bool reflects = o.z > 0.0f;
    const float cosine = abs_float(o.z), diffuse = 1.0f - p->spec_trans;
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z != 0.0f)) return splat3(0.0f);
    if (!generalized_half_vector(w, vec3(o.x, o.y, cosine), 1.0f, &m, &cos_w, &cos_o, &jacobian)) return splat3(0.0f);
    const MicrofacetDistribution facets = principled_thin_facets(p, reflects);
    const float towards_facet = reflects || dot3(o, m) < 0.0f ? jacobian : 0.0f;
    const float specular_pdf = towards_facet * microfacet_pdf(&facets, w, m, microfacet_d(&facets, m));
    const float specular = p->spec_trans * specular_pdf * smith_g1(&facets, o);
    const float reflectance = fresnel_dielectric(cos_w, p->eta, &cos_t);
    if (!reflects) {
        *pdf = p->specular_transmission_rate * specular_pdf + p->diffuse_transmission_rate * M_1_PI_F * cosine;
        return scale3(p->base, (1.0f - reflectance) * specular + diffuse * p->diff_trans * M_1_PI_F * cosine);
    }
    *pdf = p->specular_reflection_rate * specular_pdf + p->diffuse_reflection_rate * M_1_PI_F * cosine;
    const float weight = diffuse * (1.0f - p->diff_trans) * cosine;
    const float shape = diffuse_shape(p->roughness, bsdf_float(ctx, SLOT_PRINCIPLED_THIN_FLATNESS), w.z, cosine, cos_o);
    const float sheen = bsdf_float(ctx, SLOT_PRINCIPLED_THIN_SHEEN);
    Vec3 value = scale3(p->base, weight * M_1_PI_F * shape);
    if (sheen > 0.0f)
        value = add3(value, scale3(tint_color(p->base, bsdf_float(ctx, SLOT_PRINCIPLED_THIN_SHEEN_TINT)),
                                   sheen * weight * schlick_weight(cos_o)));
    if (specular > 0.0f)
        value = add3(value, scale3(partly_tinted_reflectance(p->base, bsdf_float(ctx, SLOT_PRINCIPLED_THIN_SPEC_TINT),
                                                             p->eta, schlick_at_interface(cos_w, p->eta), reflectance),
                                   specular));
    return value;
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 principled_thin_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const PrincipledThin p = principled_thin_parameters(ctx);
    const float side = copy_sign(1.0f, ctx->cos_i);
    return principled_thin_local(ctx, &p, scale3(to_local(ctx, ctx->wi), side), scale3(to_local(ctx, wo), side), pdf);
}
#endif

INLINE BsdfSample principled_thin_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const PrincipledThin p = principled_thin_parameters(ctx);
    const float side = copy_sign(1.0f, ctx->cos_i);
    const Vec3 w = scale3(to_local(ctx, ctx->wi), side);
    if (!(w.z > 0.0f)) return sample;
    const float specular_rate = p.specular_reflection_rate + p.specular_transmission_rate;
    const bool is_specular = u.x < specular_rate;
    const bool reflects =
        is_specular ? u.x < p.specular_reflection_rate : u.x < specular_rate + p.diffuse_reflection_rate;
    Vec3 o;
    if (is_specular) {
        const MicrofacetDistribution facets = principled_thin_facets(&p, reflects);
        const Vec3 m = sample_microfacet(&facets, w, vec2(u.y, u.z));
        o = normalize3(sub3(scale3(m, 2.0f * dot3(w, m)), w));
        if (!(o.z > 0.0f)) return sample;
        if (!reflects) o.z = -o.z;
        if (!reflects && dot3(o, m) >= 0.0f) return sample;
    } else {
        o = scale3(square_to_hemisphere(vec2(u.y, u.z)), reflects ? 1.0f : -1.0f);
    }
    const Vec3 value = principled_thin_local(ctx, &p, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f && sample.pdf < INFINITY)) return sample;
    sample.direction = normalize3(scale3(to_world(ctx, o), side));
    sample.weight = div_scalar3(value, sample.pdf);
    return sample;
}
#endif
