// Plastic: a diffuse base below a smooth coat.
#pragma once
#include "bsdf/fresnel.h"
#include "bsdf/plastic_base.h"

#if FEATURE_PLASTIC
// The base alone: the specular lobe is a delta function.
INLINE Vec3 plastic_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    const float cos_o = dot3(ctx->normal, wo), eta = bsdf_float(ctx, SLOT_PLASTIC_IOR);
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
    const float eta = bsdf_float(ctx, SLOT_PLASTIC_IOR), reflected = fresnel_dielectric(ctx->cos_i, eta, &cos_t);
    const float probability = specular_probability(ctx, reflected);
    if (u.x < probability) {
        sample.direction = normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi));
        sample.weight = scale3(bsdf_rgb(ctx, SLOT_PLASTIC_SPECULAR_REFLECTANCE), reflected / probability);
        sample.pdf = PDF_WITHOUT_MIS;
    } else {
        sample.direction = rotate_to_normal(ctx->normal, square_to_hemisphere(vec2(u.y, u.z)));
        sample.weight = plastic_eval(ctx, sample.direction, &sample.pdf);
        sample.weight = sample.pdf > 0.0f ? div_scalar3(sample.weight, sample.pdf) : splat3(0.0f);
    }
    return sample;
}
#endif
