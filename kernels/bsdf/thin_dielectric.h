// A thin pane of smooth glass as one surface: a delta lobe for reflection; the rest goes straight on.
#pragma once
#include "bsdf/context.h"
#include "bsdf/fresnel.h"

#if FEATURE_THIN_DIELECTRIC
// Reflectance of two parallel interfaces: the sum over all reflections between them.
INLINE float thin_dielectric_reflectance(const BsdfContext* ctx)
{
    float cos_t = 0.0f;
    const float once = fresnel_dielectric(abs_float(ctx->cos_i), bsdf_float(ctx, SLOT_THIN_DIELECTRIC_IOR), &cos_t);
    return 2.0f * once / (1.0f + once);
}

INLINE BsdfSample thin_dielectric_sample(const BsdfContext* ctx, Vec3 u)
{
    const bool reflects = u.x <= thin_dielectric_reflectance(ctx);
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = reflects ? normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi)) : neg3(ctx->wi);
    sample.weight = bsdf_rgb(
        ctx, reflects ? SLOT_THIN_DIELECTRIC_SPECULAR_REFLECTANCE : SLOT_THIN_DIELECTRIC_SPECULAR_TRANSMITTANCE);
    sample.pdf = PDF_WITHOUT_MIS;
    sample.is_null = !reflects;
    return sample;
}
#endif
