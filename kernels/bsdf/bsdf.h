// Scattering at a surface: evaluation and sampling by kind of material.
#pragma once
#include "media/phase.h"
#include "bsdf/plastic.h"
#include "bsdf/principled.h"
#include "bsdf/rough.h"
#include "bsdf/smooth.h"

#define HAS_NON_DELTA_BSDFS                                                                                          \
    (FEATURE_DIFFUSE || FEATURE_ROUGH_CONDUCTOR || FEATURE_ROUGH_DIELECTRIC || FEATURE_PLASTIC ||                      \
     FEATURE_ROUGH_PLASTIC || FEATURE_PRINCIPLED || FEATURE_MEDIA)

#define HAS_DELTA_BSDFS (FEATURE_DIELECTRIC || FEATURE_THIN_DIELECTRIC || FEATURE_CONDUCTOR)
#define HAS_ROUGH_TRANSMISSION (FEATURE_ROUGH_DIELECTRIC || FEATURE_PRINCIPLED)

#if FEATURE_NEXT_EVENT
// Whether next-event estimation can find anything: some lobe is no delta function, and the side is one that scatters.
INLINE bool has_non_delta_lobes(const BsdfContext* ctx)
{
#if FEATURE_MEDIA
    if (material(ctx).kind & BSDF_HG) return !(material(ctx).flags & BSDF_NO_LIGHT_SAMPLING);
#endif
    if (!(ctx->cos_i > 0.0f || HAS_ROUGH_TRANSMISSION)) return false;
#if HAS_DELTA_BSDFS
    return !(material(ctx).kind & DELTA_BSDFS);
#else
    return HAS_NON_DELTA_BSDFS;
#endif
}

#if FEATURE_LIGHT_TREE || FEATURE_LIGHT_LIST || LANES == 1
// From where light counts: the normal, its w 0; or (0, 0, 0, 1) if from all sides.
INLINE Vec4 light_sampling_normal(const BsdfContext* ctx)
{
    uint from_all_sides = BSDF_HG | BSDF_ROUGH_DIELECTRIC;
#if FEATURE_PRINCIPLED
    if (material(ctx).values[12] > 0.0f || material(ctx).textures[4] != NONE) from_all_sides |= BSDF_PRINCIPLED;  // spec_trans
#endif
    return material(ctx).kind & from_all_sides ? vec4(0.0f, 0.0f, 0.0f, 1.0f) : vec4_from(ctx->normal, 0.0f);
}
#endif
#endif

#if FEATURE_NEXT_EVENT
// Of a material of this kind: bsdf * |cos| for light from `wo`, and the pdf with which `bsdf_sample_kind` finds it.
INLINE Vec3 bsdf_eval_kind(uint kind, const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    *pdf = 0.0f;
    Vec3 value = splat3(0.0f);
#if FEATURE_DIFFUSE
    if (kind & BSDF_DIFFUSE) value = diffuse_eval(ctx, wo, pdf);
#endif
#if FEATURE_ROUGH_CONDUCTOR
    if (kind & BSDF_ROUGH_CONDUCTOR) value = rough_conductor_eval(ctx, wo, pdf);
#endif
#if FEATURE_ROUGH_DIELECTRIC
    if (kind & BSDF_ROUGH_DIELECTRIC) value = rough_dielectric_eval(ctx, wo, pdf);
#endif
#if FEATURE_PLASTIC
    if (kind & BSDF_PLASTIC) value = plastic_eval(ctx, wo, pdf);
#endif
#if FEATURE_ROUGH_PLASTIC
    if (kind & BSDF_ROUGH_PLASTIC) value = rough_plastic_eval(ctx, wo, pdf);
#endif
#if FEATURE_PRINCIPLED
    if (kind & BSDF_PRINCIPLED) value = principled_eval(ctx, wo, pdf);
#endif
#if FEATURE_MEDIA
    if (kind & BSDF_HG) value = hg_eval(ctx, wo, pdf);
#endif
    return value;
}

INLINE Vec3 bsdf_eval(const BsdfContext* ctx, Vec3 wo, float* pdf)
{
    return bsdf_eval_kind(material(ctx).kind, ctx, wo, pdf);
}
#endif

// `u`: lobe, direction x, direction y.
INLINE BsdfSample bsdf_sample_kind(uint kind, const BsdfContext* ctx, Vec3 u)
{
    BsdfSample sample = empty_bsdf_sample();
#if FEATURE_DIFFUSE
    if (kind & BSDF_DIFFUSE) sample = diffuse_sample(ctx, vec2(u.y, u.z));
#endif
#if FEATURE_DIELECTRIC
    if (kind & BSDF_DIELECTRIC) sample = dielectric_sample(ctx, u.x);
#endif
#if FEATURE_THIN_DIELECTRIC
    if (kind & BSDF_THIN_DIELECTRIC) sample = thin_dielectric_sample(ctx, u.x);
#endif
#if FEATURE_CONDUCTOR
    if (kind & BSDF_CONDUCTOR) sample = conductor_sample(ctx);
#endif
#if FEATURE_ROUGH_CONDUCTOR
    if (kind & BSDF_ROUGH_CONDUCTOR) sample = rough_conductor_sample(ctx, vec2(u.y, u.z));
#endif
#if FEATURE_ROUGH_DIELECTRIC
    if (kind & BSDF_ROUGH_DIELECTRIC) sample = rough_dielectric_sample(ctx, u);
#endif
#if FEATURE_PLASTIC
    if (kind & BSDF_PLASTIC) sample = plastic_sample(ctx, u);
#endif
#if FEATURE_ROUGH_PLASTIC
    if (kind & BSDF_ROUGH_PLASTIC) sample = rough_plastic_sample(ctx, u);
#endif
#if FEATURE_PRINCIPLED
    if (kind & BSDF_PRINCIPLED) sample = principled_sample(ctx, u);
#endif
#if FEATURE_MEDIA
    if (kind & BSDF_HG) sample = hg_sample(ctx, vec2(u.y, u.z));
#endif
    return sample;
}

INLINE BsdfSample bsdf_sample(const BsdfContext* ctx, Vec3 u)
{
    return bsdf_sample_kind(material(ctx).kind, ctx, u);
}
