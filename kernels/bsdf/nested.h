// Materials that wrap others: which of them a path meets, in which frame.
#pragma once
#include "bsdf/context.h"
#include "geometry/surface.h"

#define HAS_NESTED_BSDFS (FEATURE_FRONT_BACK || FEATURE_MASK || FEATURE_BLEND || FEATURE_BUMP || FEATURE_NORMAL_MAP)
#define HAS_PASS_THROUGH (FEATURE_MASK || FEATURE_NULL)

#if FEATURE_TWOSIDED || FEATURE_FRONT_BACK
// Materials of two sides show the same on both: what is behind the surface is mirrored to before it.
INLINE void flip_to_viewer(BsdfContext* ctx)
{
    ctx->normal = neg3(ctx->normal);
    ctx->cos_i = -ctx->cos_i;
#if HAS_BUMPS
    ctx->flipped = !ctx->flipped;
#endif
}
#endif

#if HAS_FRAMES
// The frame about at->normal whose s goes along dp/du, where there is such a direction.
INLINE void set_shading_frame(BsdfContext* ctx, const Surface* s)
{
#if FEATURE_UVS
    ctx->s = normalize3(sub3(s->dp_du, scale3(ctx->normal, dot3(ctx->normal, s->dp_du))));
    if (dot3(ctx->s, ctx->s) > 0.5f) {
        ctx->t = cross3(ctx->normal, ctx->s);
        return;
    }
#endif
    coordinate_system(ctx->normal, &ctx->s, &ctx->t);
}
#endif

#if HAS_BUMPS
// The normal of the surface that a height, or a map of normals, makes of this one, in the frame there. As Mitsuba 3
// (3.9, bumpmap.cpp, normalmap.cpp and what they share) has it.
INLINE Vec3 perturbed_normal(const BsdfContext* ctx, const Surface* s)
{
    Vec3 bumped = vec3(0.0f, 0.0f, 1.0f);
#if FEATURE_NORMAL_MAP
    if (material(ctx).kind & BSDF_NORMAL_MAP) bumped = sub3(scale3(lookup_rgb(ctx, 0), 2.0f), splat3(1.0f));
#endif
#if FEATURE_BUMP
    if (material(ctx).kind & BSDF_BUMP) {
        const Vec2 slope = scale2(texture_gradient(ctx->textures, material(ctx).textures[0], &ctx->point), material(ctx).values[3]);
        const Vec3 along_u = add3(s->dp_du, scale3(s->normal, slope.x - dot3(s->normal, s->dp_du)));
        const Vec3 along_v = add3(s->dp_dv, scale3(s->normal, slope.y - dot3(s->normal, s->dp_dv)));
        const Vec3 normal = cross3(along_u, along_v);
        const Vec3 outward = dot3(s->geometric_normal, normal) < 0.0f ? neg3(normal) : normal;
        bumped = vec3(dot3(outward, ctx->s), dot3(outward, ctx->t), dot3(outward, s->normal));
    }
#endif
    // seen from behind it is turned to the viewer: Schuessler et al., "Microfacet-Based Normal Mapping", 2017
    const Vec3 wi = to_local(ctx, ctx->wi);
    if (!(material(ctx).flags & BSDF_KEEP_INVALID_NORMALS) && wi.z * dot3(wi, bumped) <= 0.0f) bumped = vec3(-bumped.x, -bumped.y, bumped.z);
    bumped = normalize3(bumped);
    return dot3(bumped, bumped) > 0.0f ? bumped : vec3(0.0f, 0.0f, 1.0f);
}

// Takes the bumped normal for the shading normal; the frame stays as right- or left-handed as it is.
INLINE void perturb_frame(BsdfContext* ctx, const Surface* s)
{
    const Vec3 bumped = perturbed_normal(ctx, s), along = sub3(vec3(1.0f, 0.0f, 0.0f), scale3(bumped, bumped.x));
    const Vec3 s_bumped = dot3(along, along) > 0.0f ? normalize3(along) : vec3(0.0f, 1.0f, 0.0f);
    const Vec3 t_bumped = cross3(bumped, s_bumped);
    const Vec3 normal = to_world(ctx, bumped), first = to_world(ctx, s_bumped), second = to_world(ctx, t_bumped);
    ctx->normal = normal;
    ctx->s = first;
    ctx->t = second;
    ctx->cos_i = dot3(normal, ctx->wi);
    const float tan2 = dot2(vec2(bumped.x, bumped.y), vec2(bumped.x, bumped.y)) / (bumped.z * bumped.z);
    ctx->shadow = material(ctx).flags & BSDF_NO_BUMP_SHADOWING ? 0.0f : MIN(0.125f * tan2, 1.0f);
}

// What of the light from `direction` a bumped surface scatters: nothing where it lies on one side of the surface and on the
// other of the bump, and less where the bump casts a shadow. Estevez, Lecocq, Stein, "A Microfacet-Based Shadowing Function to
// Solve the Bump Terminator Problem", Ray Tracing Gems, 2019.
INLINE float bump_shadowing(const BsdfContext* ctx, const Surface* s, Vec3 direction)
{
    if (ctx->shadow == NO_BUMP) return 1.0f;
    const float cos_o = dot3(s->normal, direction), side = ctx->flipped ? -1.0f : 1.0f;
    if (!(side * cos_o * dot3(ctx->normal, direction) > 0.0f)) return 0.0f;
    return ctx->shadow > 0.0f ? 2.0f / (1.0f + SQRT(1.0f + ctx->shadow * (1.0f / (cos_o * cos_o) - 1.0f))) : 1.0f;
}
#endif

#if HAS_NESTED_BSDFS
#if FEATURE_MASK || FEATURE_BLEND
// A choice of probability p by `u`, which is spread over [0, 1) again for the next one.
INLINE bool sample_branch(float p, float* u)
{
    const bool first = *u < p;
    *u = first ? *u / p : (*u - p) / (1.0f - p);
    *u = MIN(*u, 0x1.fffffep-1f);
    return first;
}

// An opacity or a weight, within [0, 1].
INLINE float nested_weight(const BsdfContext* ctx)
{
    const float share = lookup_float(ctx, 0);
    return MIN(MAX(share, 0.0f), 1.0f);
}
#endif

// Goes through what wraps the material until it comes to one that wraps no other. Blends and masks choose one of two by
// `u`, with the probability of its weight: whatever is estimated from the one chosen is so on average for both.
// Returns whether the path goes through the surface as if there was none.
INLINE bool resolve_nested_bsdf(BsdfContext* ctx, const Surface* s, float u)
{
    for (;;) {
        const Bsdf wrapper = material(ctx);
        uint next = wrapper.nested[0];
        switch (wrapper.kind) {
#if FEATURE_FRONT_BACK
        case BSDF_FRONT_BACK:
            if (ctx->cos_i < 0.0f) {
                next = wrapper.nested[1];
                flip_to_viewer(ctx);
            }
            break;
#endif
#if FEATURE_MASK
        case BSDF_MASK:
            if (!sample_branch(nested_weight(ctx), &u)) return true;
            break;
#endif
#if FEATURE_BLEND
        case BSDF_BLEND:
            if (sample_branch(nested_weight(ctx), &u)) next = wrapper.nested[1];
            break;
#endif
#if FEATURE_BUMP
        case BSDF_BUMP: perturb_frame(ctx, s); break;
#endif
#if FEATURE_NORMAL_MAP
        case BSDF_NORMAL_MAP: perturb_frame(ctx, s); break;
#endif
#if FEATURE_NULL
        case BSDF_NULL: return true;
#endif
        default: return false;
        }
        ctx->bsdf = next;
    }
}
#endif
