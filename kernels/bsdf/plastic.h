// Plastic: a diffuse base under a smooth or a rough boundary. Light that the boundary sends back to the base is scattered there
// again, so that the base's reflectance becomes r / (1 - r R), R its mean inner reflectance; the conventions are Mitsuba 3's.
#pragma once
#include "bsdf/microfacet.h"
#include "bsdf/smooth.h"

#if FEATURE_PLASTIC || FEATURE_ROUGH_PLASTIC
// Reflectance of the base with all that goes on between it and the boundary, over the boundary's index squared.
INLINE Vec3 diffuse_base_reflectance(const BsdfContext* ctx)
{
    const Vec3 base = bsdf_rgb(ctx, 1);
    const float inner = material(ctx).values[9], eta = bsdf_float(ctx, 2);
    const Vec3 again = material(ctx).flags & BSDF_NONLINEAR ? scale3(base, inner) : splat3(inner);
    return div3(base, scale3(sub3(splat3(1.0f), again), eta * eta));
}

// The probability of sampling the boundary, of which this share reflects: by what the two would send back.
INLINE float specular_probability(const BsdfContext* ctx, float reflected)
{
    const Vec3 mirror = bsdf_rgb(ctx, 0), base = bsdf_rgb(ctx, 1);
    const float by_boundary = reflected * (mirror.x + mirror.y + mirror.z);
    const float total = by_boundary + (1.0f - reflected) * (base.x + base.y + base.z);
    return total > 0.0f ? by_boundary / total : 0.0f;
}
#endif

#if FEATURE_PLASTIC
// The base alone: the boundary is a delta function.
INLINE Vec3 plastic_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(ctx->normal, wo), eta = bsdf_float(ctx, 2);
    *pdf = 0.0f;
    if (!(ctx->cos_i > 0.0f && cos_o > 0.0f)) return splat3(0.0f);
    float cos_t = 0.0f;
    const float reflected_i = fresnel_dielectric(ctx->cos_i, eta, &cos_t);
    const float reflected_o = fresnel_dielectric(cos_o, eta, &cos_t);
    *pdf = (1.0f - specular_probability(ctx, reflected_i)) * cos_o * M_1_PI_F;
    return scale3(diffuse_base_reflectance(ctx), (1.0f - reflected_i) * (1.0f - reflected_o) * cos_o * M_1_PI_F);
}

INLINE BsdfSample plastic_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    if (!(ctx->cos_i > 0.0f)) return sample;
    float cos_t = 0.0f;
    const float eta = bsdf_float(ctx, 2), reflected = fresnel_dielectric(ctx->cos_i, eta, &cos_t);
    const float probability = specular_probability(ctx, reflected);
    sample.eta = 1.0f;
    if (u.x < probability) {
        sample.direction = normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi));
        sample.weight = scale3(bsdf_rgb(ctx, 0), reflected / probability);
        sample.pdf = -1.0f;
    } else {
        sample.direction = to_world_around(ctx->normal, square_to_hemisphere(vec2(u.y, u.z)));
        sample.weight = plastic_eval(ctx, sample.direction, &sample.pdf);
        sample.weight = sample.pdf > 0.0f ? div_scalar3(sample.weight, sample.pdf) : splat3(0.0f);
    }
    return sample;
}
#endif

#if FEATURE_ROUGH_PLASTIC
#define ROUGH_TRANSMITTANCE_NODES 64  // of a table, as in `scene.boundaries`

// The share of the light from a direction that gets through the rough boundary.
INLINE float rough_transmittance(const BsdfContext* ctx, float cos_w)
{
    __global const float* table = ctx->rough_transmittances + ROUGH_TRANSMITTANCE_NODES * (uint)material(ctx).values[10];
    const float place = cos_w * (ROUGH_TRANSMITTANCE_NODES - 1);
    const int node = MIN((int)place, ROUGH_TRANSMITTANCE_NODES - 2);
    return table[node] + (place - (float)node) * (table[node + 1] - table[node]);
}

// In the surface's frame.
INLINE Vec3 rough_plastic_local(const BsdfContext* ctx, const MicrofacetDistribution* d, Vec3 w, Vec3 o, float* pdf)
{
    *pdf = 0.0f;
    if (!(w.z > 0.0f && o.z > 0.0f)) return splat3(0.0f);
    const Vec3 m = normalize3(add3(w, o));
    const float cos_m = dot3(w, m), density = microfacet_d(d, m);
    const float through_w = rough_transmittance(ctx, w.z), through_o = rough_transmittance(ctx, o.z);
    const float probability = specular_probability(ctx, 1.0f - through_w);
    *pdf = (1.0f - probability) * o.z * M_1_PI_F;
    Vec3 value = scale3(diffuse_base_reflectance(ctx), through_w * through_o * o.z * M_1_PI_F);
    if (cos_m > 0.0f) {
        float cos_t = 0.0f;
        const float reflected = fresnel_dielectric(cos_m, bsdf_float(ctx, 2), &cos_t);
        value = add3(value, scale3(bsdf_rgb(ctx, 0), 0.25f * reflected * density * smith_g1_over_cos(d, w) * smith_g1(d, o)));
        *pdf += probability * microfacet_pdf(d, w, m, density) / (4.0f * cos_m);
    }
    return value;
}

INLINE MicrofacetDistribution rough_plastic_microfacets(const BsdfContext* ctx)
{
    return make_microfacets(bsdf_float(ctx, 4), bsdf_float(ctx, 4), material(ctx).flags);
}

#if FEATURE_NEXT_EVENT
INLINE Vec3 rough_plastic_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const MicrofacetDistribution d = rough_plastic_microfacets(ctx);
    return rough_plastic_local(ctx, &d, to_local(ctx, ctx->wi), to_local(ctx, wo), pdf);
}
#endif

INLINE BsdfSample rough_plastic_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    const Vec3 w = to_local(ctx, ctx->wi);
    if (!(w.z > 0.0f)) return sample;
    const MicrofacetDistribution d = rough_plastic_microfacets(ctx);
    Vec3 o = splat3(0.0f);
    if (u.x < specular_probability(ctx, 1.0f - rough_transmittance(ctx, w.z))) {
        const Vec3 m = sample_microfacet(&d, w, vec2(u.y, u.z));
        o = normalize3(sub3(scale3(m, 2.0f * dot3(w, m)), w));
    } else {
        o = square_to_hemisphere(vec2(u.y, u.z));
    }
    const Vec3 value = rough_plastic_local(ctx, &d, w, o, &sample.pdf);
    if (!(sample.pdf > 0.0f)) return sample;
    sample.direction = normalize3(to_world(ctx, o));
    sample.weight = div_scalar3(value, sample.pdf);
    sample.eta = 1.0f;
    return sample;
}
#endif
