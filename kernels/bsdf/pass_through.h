// Light that goes straight through a surface: null BSDFs, masks, thin glass, and wrappers that hold them.
// Included by stages/shadow_transmittance.cl.
#pragma once
#include "bsdf/nested.h"
#include "bsdf/thin_dielectric.h"

// Share of the light that goes straight through; the weighted sum over the BSDFs that a wrapper holds.
INLINE Vec3 pass_through_transmittance(BsdfContext* ctx)
{
    Vec3 transmittance = splat3(0.0f);
    float weight = 1.0f;
#if FEATURE_BLEND
    uint pending[MAX_NESTED_BLENDS], count = 0u;  // second BSDFs of blends, with their weights
    float weights[MAX_NESTED_BLENDS];
#endif
    for (;;) {
        uint next = NONE;
        switch (material(ctx).flags & BSDF_PASS_THROUGH ? material(ctx).kind : NONE) {
#if FEATURE_NULL
            case BSDF_NULL: transmittance = add3(transmittance, splat3(weight)); break;
#endif
#if FEATURE_THIN_DIELECTRIC
            case BSDF_THIN_DIELECTRIC: {
                const Vec3 tint = bsdf_rgb(ctx, SLOT_THIN_DIELECTRIC_SPECULAR_TRANSMITTANCE);
                transmittance = add3(transmittance, scale3(tint, weight * (1.0f - thin_dielectric_reflectance(ctx))));
                break;
            }
#endif
#if FEATURE_MASK
            case BSDF_MASK: {
                const float opacity = nested_weight(ctx, SLOT_MASK_OPACITY);
                transmittance = add3(transmittance, splat3(weight * (1.0f - opacity)));
                weight *= opacity;
                next = material(ctx).nested[0];
                break;
            }
#endif
#if FEATURE_BLEND
            case BSDF_BLEND: {
                const float second = nested_weight(ctx, SLOT_BLEND_WEIGHT);
                pending[count] = material(ctx).nested[1];
                weights[count++] = weight * second;
                weight *= 1.0f - second;
                next = material(ctx).nested[0];
                break;
            }
#endif
#if FEATURE_BUMP
            case BSDF_BUMP: next = material(ctx).nested[0]; break;
#endif
#if FEATURE_NORMAL_MAP
            case BSDF_NORMAL_MAP: next = material(ctx).nested[0]; break;
#endif
            default: break;
        }
#if FEATURE_BLEND
        if (next == NONE && count > 0u) {
            next = pending[--count];
            weight = weights[count];
        }
#endif
        if (next == NONE) return transmittance;
        ctx->bsdf = next;
    }
}
