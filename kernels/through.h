// What goes straight through a surface, as if there was none.
#pragma once
#include "material.h"
#include "smooth.h"

#define PENDING_BLENDS 8u  // host/isonoise/scene/bsdfs.py admits no more

// The share of the light that a material lets through unturned: of what is wrapped, in proportion to its part.
INLINE Vec3 straight_share(Shading* at)
{
    Vec3 passed = all3(0.0f);
    float share = 1.0f;
#if FEATURE_BLEND
    uint pending[PENDING_BLENDS], count = 0u;  // the other halves of blends, their shares
    float shares[PENDING_BLENDS];
#endif
    for (;;) {
        uint next = NONE;
        switch (material(at).flags & BSDF_SEE_THROUGH ? material(at).kind : NONE) {
#if FEATURE_NULL
        case BSDF_NULL: passed = add3(passed, all3(share)); break;
#endif
#if FEATURE_THIN_DIELECTRIC
        case BSDF_THIN_DIELECTRIC: 
            passed = add3(passed, scale3(rgb_parameter(at, 1), share * (1.0f - thin_dielectric_reflectance(at))));
            break;
#endif
#if FEATURE_MASK
        case BSDF_MASK: {
            const float opacity = share_parameter(at);
            passed = add3(passed, all3(share * (1.0f - opacity)));
            share *= opacity;
            next = material(at).nested[0];
            break;
        }
#endif
#if FEATURE_BLEND
        case BSDF_BLEND: {
            const float second = share_parameter(at);
            pending[count] = material(at).nested[1];
            shares[count++] = share * second;
            share *= 1.0f - second;
            next = material(at).nested[0];
            break;
        }
#endif
#if FEATURE_BUMP
        case BSDF_BUMP: next = material(at).nested[0]; break;
#endif
#if FEATURE_NORMAL_MAP
        case BSDF_NORMAL_MAP: next = material(at).nested[0]; break;
#endif
        default: break;
        }
#if FEATURE_BLEND
        if (next == NONE && count > 0u) {
            next = pending[--count];
            share = shares[count];
        }
#endif
        if (next == NONE) return passed;
        at->bsdf = next;
    }
}
