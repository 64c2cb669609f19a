// Smooth metal: one delta lobe.
#pragma once
#include "bsdf/context.h"
#include "bsdf/fresnel.h"

#if FEATURE_CONDUCTOR
INLINE BsdfSample conductor_sample(const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
    sample.direction = normalize3(sub3(scale3(ctx->normal, 2.0f * ctx->cos_i), ctx->wi));
    if (ctx->cos_i > 0.0f)
        sample.weight =
            mul3(bsdf_rgb(ctx, SLOT_CONDUCTOR_SPECULAR_REFLECTANCE),
                 fresnel_conductor(ctx->cos_i, bsdf_rgb(ctx, SLOT_CONDUCTOR_ETA), bsdf_rgb(ctx, SLOT_CONDUCTOR_K)));
    sample.pdf = PDF_WITHOUT_MIS;
    return sample;
}
#endif
