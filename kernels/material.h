// Materials that wrap others: which of them a path meets, in which frame.
#pragma once
#include "shading.h"
#include "surface.h"

#define HAS_WRAPPERS (FEATURE_SIDES || FEATURE_MASK || FEATURE_BLEND || FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_SEE_THROUGH (FEATURE_MASK || FEATURE_NULL)

// Materials of two sides show the same on both: what is behind the surface is mirrored to before it.
INLINE void turn_to_viewer(Shading* at)
{
    at->normal = -at->normal;
    at->cos_i = -at->cos_i;
}

#if HAS_BUMPS
// Whether a direction lies on one side of the surface and on the other of what bumps make of it: nothing scatters there.
INLINE bool through_the_bump(const Shading* at, const Surface* s, float3 direction)
{
    const float side = dot3(s->normal, at->wi) * at->cos_i < 0.0f ? -1.0f : 1.0f;
    return side * dot3(s->normal, direction) * dot3(at->normal, direction) <= 0.0f;
}
#endif

#if HAS_FRAMES
// The frame about at->normal whose s goes along dp/du, where there is such a direction.
INLINE void set_frame(Shading* at, const Surface* s)
{
#if FEATURE_UVS
    at->s = unit(s->dp_du - dot3(at->normal, s->dp_du) * at->normal);
    if (dot3(at->s, at->s) > 0.5f) {
        at->t = cross3(at->normal, at->s);
        return;
    }
#endif
    basis(at->normal, &at->s, &at->t);
}
#endif

#if HAS_BUMPS
// The normal of the surface that a height, or a map of normals, makes of this one; local to the frame of `s`'s own normal.
// As Mitsuba 3's bumpmap.cpp and normalmap.cpp (3.9) have it.
INLINE float3 bumped_normal(const Shading* at, const Surface* s)
{
#if FEATURE_NORMAL_MAP
    if (at->bsdf->kind == BSDF_NORMAL_MAP) return unit(2.0f * rgb_parameter(at, 0) - 1.0f);
#endif
#if FEATURE_BUMP
    const float2 slope = at->bsdf->values[3] * texture_gradient(at->textures, at->bsdf->textures[0], &at->point);
    const float3 along_u = s->dp_du + (slope.x - dot3(s->normal, s->dp_du)) * s->normal;
    const float3 along_v = s->dp_dv + (slope.y - dot3(s->normal, s->dp_dv)) * s->normal;
    const float3 normal = unit(cross3(along_u, along_v));
    const float3 outward = dot3(s->geometric_normal, normal) < 0.0f ? -normal : normal;
    return (float3)(dot3(outward, at->s), dot3(outward, at->t), dot3(outward, s->normal));
#endif
}

// Takes the bumped normal for the shading normal; the frame stays as right- or left-handed as it is.
INLINE void bump(Shading* at, const Surface* s)
{
    const float3 normal = to_world(at, bumped_normal(at, s));
    const bool turned = dot3(cross3(at->s, at->t), at->normal) < 0.0f;
    at->normal = normal;
    at->cos_i = dot3(normal, at->wi);
    set_frame(at, s);
    if (turned) at->t = -at->t;
}
#endif

#if HAS_WRAPPERS
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
INLINE bool unwrap(Shading* at, __global const Bsdf* bsdfs, const Surface* s, float u)
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
#if FEATURE_BUMP
        case BSDF_BUMP: bump(at, s); break;
#endif
#if FEATURE_NORMAL_MAP
        case BSDF_NORMAL_MAP: bump(at, s); break;
#endif
        default: return HAS_SEE_THROUGH && wrapper->kind == BSDF_NULL;
        }
        at->bsdf = bsdfs + next;
    }
}
#endif
