// Materials that wrap others: which of them a path meets, in which frame.
#pragma once
#include "shading.h"
#include "surface.h"

#define HAS_WRAPPERS (FEATURE_SIDES || FEATURE_MASK || FEATURE_BLEND || FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_SEE_THROUGH (FEATURE_MASK || FEATURE_NULL)

#if FEATURE_TWOSIDED || FEATURE_SIDES
// Materials of two sides show the same on both: what is behind the surface is mirrored to before it.
INLINE void turn_to_viewer(Shading* at)
{
    at->normal = neg3(at->normal);
    at->cos_i = -at->cos_i;
#if HAS_BUMPS
    at->turned = !at->turned;
#endif
}
#endif

#if HAS_FRAMES
// The frame about at->normal whose s goes along dp/du, where there is such a direction.
INLINE void set_frame(Shading* at, const Surface* s)
{
#if FEATURE_UVS
    at->s = unit(sub3(s->dp_du, scale3(at->normal, dot3(at->normal, s->dp_du))));
    if (dot3(at->s, at->s) > 0.5f) {
        at->t = cross3(at->normal, at->s);
        return;
    }
#endif
    basis(at->normal, &at->s, &at->t);
}
#endif

#if HAS_BUMPS
// The normal of the surface that a height, or a map of normals, makes of this one, in the frame there. As Mitsuba 3
// (3.9, bumpmap.cpp, normalmap.cpp and what they share) has it.
INLINE Vec3 bumped_normal(const Shading* at, const Surface* s)
{
    Vec3 bumped = vec3(0.0f, 0.0f, 1.0f);
#if FEATURE_NORMAL_MAP
    if (material(at).kind & BSDF_NORMAL_MAP) bumped = sub3(scale3(shown_rgb(at, 0), 2.0f), all3(1.0f));
#endif
#if FEATURE_BUMP
    if (material(at).kind & BSDF_BUMP) {
        const Vec2 slope = scale2(texture_gradient(at->textures, material(at).textures[0], &at->point), material(at).values[3]);
        const Vec3 along_u = add3(s->dp_du, scale3(s->normal, slope.x - dot3(s->normal, s->dp_du)));
        const Vec3 along_v = add3(s->dp_dv, scale3(s->normal, slope.y - dot3(s->normal, s->dp_dv)));
        const Vec3 normal = cross3(along_u, along_v);
        const Vec3 outward = dot3(s->geometric_normal, normal) < 0.0f ? neg3(normal) : normal;
        bumped = vec3(dot3(outward, at->s), dot3(outward, at->t), dot3(outward, s->normal));
    }
#endif
    // seen from behind it is turned to the viewer: Schuessler et al., "Microfacet-Based Normal Mapping", 2017
    const Vec3 wi = to_local(at, at->wi);
    if (!(material(at).flags & BSDF_ANY_NORMAL) && wi.z * dot3(wi, bumped) <= 0.0f) bumped = vec3(-bumped.x, -bumped.y, bumped.z);
    bumped = unit(bumped);
    return dot3(bumped, bumped) > 0.0f ? bumped : vec3(0.0f, 0.0f, 1.0f);
}

// Takes the bumped normal for the shading normal; the frame stays as right- or left-handed as it is.
INLINE void bump(Shading* at, const Surface* s)
{
    const Vec3 bumped = bumped_normal(at, s), along = sub3(vec3(1.0f, 0.0f, 0.0f), scale3(bumped, bumped.x));
    const Vec3 s_bumped = dot3(along, along) > 0.0f ? unit(along) : vec3(0.0f, 1.0f, 0.0f);
    const Vec3 t_bumped = cross3(bumped, s_bumped);
    const Vec3 normal = to_world(at, bumped), first = to_world(at, s_bumped), second = to_world(at, t_bumped);
    at->normal = normal;
    at->s = first;
    at->t = second;
    at->cos_i = dot3(normal, at->wi);
    const float tan2 = dot2(vec2(bumped.x, bumped.y), vec2(bumped.x, bumped.y)) / (bumped.z * bumped.z);
    at->shadow = material(at).flags & BSDF_NO_SHADOW ? 0.0f : LESSER(0.125f * tan2, 1.0f);
}

// What of the light from `direction` a bumped surface scatters: nothing where it lies on one side of the surface and on the
// other of the bump, and less where the bump casts a shadow. Estevez, Lecocq, Stein, "A Microfacet-Based Shadowing Function to
// Solve the Bump Terminator Problem", Ray Tracing Gems, 2019.
INLINE float bump_share(const Shading* at, const Surface* s, Vec3 direction)
{
    if (at->shadow == NO_BUMP) return 1.0f;
    const float cos_o = dot3(s->normal, direction), side = at->turned ? -1.0f : 1.0f;
    if (!(side * cos_o * dot3(at->normal, direction) > 0.0f)) return 0.0f;
    return at->shadow > 0.0f ? 2.0f / (1.0f + SQRT(1.0f + at->shadow * (1.0f / (cos_o * cos_o) - 1.0f))) : 1.0f;
}
#endif

#if HAS_WRAPPERS
#if FEATURE_MASK || FEATURE_BLEND
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
    const float share = shown_number(at, 0);
    return LESSER(GREATER(share, 0.0f), 1.0f);
}
#endif

// Goes through what wraps the material until it comes to one that wraps no other. Blends and masks choose one of two by
// `u`, with the probability of its weight: whatever is estimated from the one chosen is so on average for both.
// Returns whether the path goes through the surface as if there was none.
INLINE bool unwrap(Shading* at, const Surface* s, float u)
{
    for (;;) {
        const Bsdf wrapper = material(at);
        uint next = wrapper.nested[0];
        switch (wrapper.kind) {
#if FEATURE_SIDES
        case BSDF_SIDES:
            if (at->cos_i < 0.0f) {
                next = wrapper.nested[1];
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
            if (choose(share_parameter(at), &u)) next = wrapper.nested[1];
            break;
#endif
#if FEATURE_BUMP
        case BSDF_BUMP: bump(at, s); break;
#endif
#if FEATURE_NORMAL_MAP
        case BSDF_NORMAL_MAP: bump(at, s); break;
#endif
#if FEATURE_NULL
        case BSDF_NULL: return true;
#endif
        default: return false;
        }
        at->bsdf = next;
    }
}
#endif
