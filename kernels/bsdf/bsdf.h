// Evaluation and sampling of BSDFs, dispatched on their kind. A kind is a row of
// host/isonoise/scene/material/bsdf_kinds.py and a header of its own; the generated header includes those and defines
// FOR_BSDFS over the kinds that the scene has.
#pragma once
#include "bsdf/context.h"
#include "generated/bsdf_kinds.h"

#if FEATURE_NEXT_EVENT
// Whether next-event estimation can find anything: some lobe is no delta function, and wi is on a side that scatters.
INLINE bool has_non_delta_lobes(const BsdfContext* ctx)
{
#if FEATURE_MEDIA
    if (material(ctx).kind & PHASE_FUNCTIONS) return !(material(ctx).flags & BSDF_NO_LIGHT_SAMPLING);
#endif
    if (!(ctx->cos_i > 0.0f || HAS_ROUGH_TRANSMISSION)) return false;
#if HAS_BLEND_LIGHTING && HAS_DELTA_BSDFS
    if (ctx->other_weight > 0.0f && !(ctx->bsdfs[ctx->other_bsdf].kind & DELTA_BSDFS)) return true;
#endif
#if HAS_DELTA_BSDFS
    return !(material(ctx).kind & DELTA_BSDFS);
#else
    return HAS_NON_DELTA_BSDFS;
#endif
}

#if FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST || LANES == 1
// The side from which light counts: (normal, 0), or (0, 0, 0, 1) for both sides.
INLINE Vec4 light_sampling_normal(const BsdfContext* ctx)
{
    return material(ctx).flags & BSDF_TRANSMITS ? vec4(0.0f, 0.0f, 0.0f, 1.0f) : vec4_from(ctx->normal, 0.0f);
}
#endif

// bsdf * |cos| for light from `wo`, and the pdf with which `bsdf_sample_kind` samples `wo`, for a BSDF of this kind.
INLINE Vec3 bsdf_eval_kind(uint kind, const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    *pdf = 0.0f;
    Vec3 value = splat3(0.0f);
#define EVAL_KIND(BIT, name) \
    if (kind & BIT) value = name##_eval(ctx, wo, pdf);
    FOR_NON_DELTA_BSDFS(EVAL_KIND)
    return value;
}

INLINE Vec3 bsdf_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    return bsdf_eval_kind(material(ctx).kind, ctx, wo, pdf);
}
#endif

// `u`: random numbers for lobe, direction x, direction y.
INLINE BsdfSample bsdf_sample_kind(uint kind, const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
#define SAMPLE_KIND(BIT, name) \
    if (kind & BIT) sample = name##_sample(ctx, u);
    FOR_BSDFS(SAMPLE_KIND)
    return sample;
}

INLINE BsdfSample bsdf_sample(const BsdfContext* ctx, Vec3 u)
{
    return bsdf_sample_kind(material(ctx).kind, ctx, u);
}
