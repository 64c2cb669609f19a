// Materials that wrap others: which of them a path meets, in which frame.
#pragma once
#include "shading.h"

#define HAS_WRAPPERS (FEATURE_SIDES || FEATURE_MASK || FEATURE_BLEND || FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_SEE_THROUGH (FEATURE_MASK || FEATURE_NULL)

#if HAS_WRAPPERS
INLINE void turn_to_viewer(Shading* at)
{
    at->normal = -at->normal;
    at->cos_i = -at->cos_i;
#if HAS_FRAMES
    at->t = -at->t;  // stays right-handed
#endif
}

// A choice of probability p by `u`, which is spread over [0, 1) again for the next one.
INLINE bool choose(float p, float* u)
{
    const bool first = *u < p;
    *u = first ? *u / p : (*u - p) / (1.0f - p);
    *u = LESSER(*u, 0x1.fffffep-1f);
    return first;
}

// An opacity or a weight, within [0, 1].
INLINE float share_parameter(const Shading* at)
{
    const float share = number_parameter(at, 0);
    return LESSER(GREATER(share, 0.0f), 1.0f);
}

// Goes through what wraps the material until it comes to one that wraps no other. Blends and masks choose one of two by
// `u`, with the probability of its weight: whatever is estimated from the one chosen is so on average for both.
// Returns whether the path goes through the surface as if there was none.
INLINE bool unwrap(Shading* at, __global const Bsdf* bsdfs, float u)
{
    for (;;) {
        __global const Bsdf* wrapper = at->bsdf;
        uint next = wrapper->nested[0];
        switch (wrapper->kind) {
#if FEATURE_SIDES
        case BSDF_SIDES:
            if (at->cos_i < 0.0f) {
                next = wrapper->nested[1];
                turn_to_viewer(at);
            }
            break;
#endif
#if FEATURE_MASK
        case BSDF_MASK:
            if (!choose(share_parameter(at), &u)) return true;
            break;
#endif
#if FEATURE_BLEND
        case BSDF_BLEND:
            if (choose(share_parameter(at), &u)) next = wrapper->nested[1];
            break;
#endif
        default: return HAS_SEE_THROUGH && wrapper->kind == BSDF_NULL;
        }
        at->bsdf = bsdfs + next;
    }
}
#endif
