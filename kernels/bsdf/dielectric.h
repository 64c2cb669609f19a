// Smooth glass: a delta lobe for reflection, one for refraction.
#pragma once
#include "bsdf/context.h"
#include "bsdf/fresnel.h"

#if FEATURE_DIELECTRIC
INLINE BsdfSample dielectric_sample(const BsdfContext* ctx, Vec3 u)
{
    const bool inside = ctx->cos_i < 0.0f;
    const float index = bsdf_float(ctx, SLOT_DIELECTRIC_IOR), eta = inside ? 1.0f / index : index,
                cos_i = abs_float(ctx->cos_i);
    const Vec3 facing = inside ? neg3(ctx->normal) : ctx->normal;
    float cos_t = 0.0f;
    const float reflectance = fresnel_dielectric(cos_i, eta, &cos_t);
    BsdfSample sample = empty_bsdf_sample();
    sample.pdf = PDF_WITHOUT_MIS;
    if (u.x <= reflectance) {
        sample.direction = normalize3(sub3(scale3(facing, 2.0f * cos_i), ctx->wi));
        sample.weight = bsdf_rgb(ctx, SLOT_DIELECTRIC_SPECULAR_REFLECTANCE);
    } else {
        sample.direction = normalize3(sub3(scale3(facing, cos_i / eta - cos_t), scale3(ctx->wi, 1.0f / eta)));
        // radiance scales with the solid angle: Veach's thesis, 5.2
        sample.weight = div_scalar3(bsdf_rgb(ctx, SLOT_DIELECTRIC_SPECULAR_TRANSMITTANCE), eta * eta);
        sample.eta = eta;
    }
    return sample;
}
#endif
