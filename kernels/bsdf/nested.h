// BSDFs that hold others (wrappers): which inner BSDF a path scatters at, and with which shading frame.
#pragma once
#include "bsdf/context.h"
#include "geometry/surface.h"

#if FEATURE_TWOSIDED || FEATURE_FRONT_BACK
// Turns a two-sided BSDF to the viewer: it scatters the same on both sides.
INLINE void flip_to_viewer(BsdfContext* ctx)
{
    ctx->normal = neg3(ctx->normal);
    ctx->cos_i = -ctx->cos_i;
#if HAS_BUMPS
    ctx->flipped = !ctx->flipped;
#endif
}
#endif

#if HAS_SHADING_FRAME
// The frame around the shading normal whose s goes along dp/du, if dp/du is not parallel to the normal.
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
// The normal of a bump or normal map, in the shading frame. As in Mitsuba 3 (3.9, bumpmap.cpp and normalmap.cpp).
INLINE Vec3 perturbed_normal(const BsdfContext* ctx, const Surface* s)
{
    Vec3 bumped = vec3(0.0f, 0.0f, 1.0f);
#if FEATURE_NORMAL_MAP
    if (material(ctx).kind & BSDF_NORMAL_MAP)
        bumped = sub3(scale3(lookup_rgb(ctx, SLOT_NORMAL_MAP_NORMALMAP), 2.0f), splat3(1.0f));
#endif
#if FEATURE_BUMP
    if (material(ctx).kind & BSDF_BUMP) {
        const uint height = material(ctx).textures[SLOT_BUMP_HEIGHT];
        const Vec2 slope =
            scale2(texture_gradient(ctx->textures, height, &ctx->point), material(ctx).constants[CONSTANT_BUMP_SCALE]);
        const Vec3 along_u = add3(s->dp_du, scale3(s->normal, slope.x - dot3(s->normal, s->dp_du)));
        const Vec3 along_v = add3(s->dp_dv, scale3(s->normal, slope.y - dot3(s->normal, s->dp_dv)));
        const Vec3 normal = cross3(along_u, along_v);
        const Vec3 outward = dot3(s->geometric_normal, normal) < 0.0f ? neg3(normal) : normal;
        bumped = vec3(dot3(outward, ctx->s), dot3(outward, ctx->t), dot3(outward, s->normal));
    }
#endif
    // a normal that faces away from the viewer is flipped: Schuessler et al., "Microfacet-Based Normal Mapping", 2017
    const Vec3 wi = to_local(ctx, ctx->wi);
    if (!(material(ctx).flags & BSDF_KEEP_INVALID_NORMALS) && wi.z * dot3(wi, bumped) <= 0.0f)
        bumped = vec3(-bumped.x, -bumped.y, bumped.z);
    bumped = normalize3(bumped);
    return dot3(bumped, bumped) > 0.0f ? bumped : vec3(0.0f, 0.0f, 1.0f);
}

// Replaces the shading normal and frame by those of the map. The handedness of the frame stays.
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
    ctx->bump_alpha2 = material(ctx).flags & BSDF_NO_BUMP_SHADOWING ? 0.0f : MIN(0.125f * tan2, 1.0f);
}

// Factor on the light from `direction` at a bumped surface: 0 if it is above the surface and below the bump or the
// other way round, and below 1 where the bump casts a shadow. Estevez, Lecocq, Stein, "A Microfacet-Based Shadowing
// Function to Solve the Bump Terminator Problem", Ray Tracing Gems, 2019.
INLINE float bump_shadowing(const BsdfContext* ctx, const Surface* s, Vec3 direction)
{
    if (ctx->bump_alpha2 == NO_BUMP) return 1.0f;
    const float cos_o = dot3(s->normal, direction), side = ctx->flipped ? -1.0f : 1.0f;
    if (!(side * cos_o * dot3(ctx->normal, direction) > 0.0f)) return 0.0f;
    return ctx->bump_alpha2 > 0.0f ? 2.0f / (1.0f + SQRT(1.0f + ctx->bump_alpha2 * (1.0f / (cos_o * cos_o) - 1.0f)))
                                   : 1.0f;
}
#endif

#if HAS_NESTED_BSDFS
#if FEATURE_MASK || FEATURE_BLEND
// True with probability p, by the random number `u`; then `u` is rescaled to [0, 1) so that it can be used again.
INLINE bool sample_branch(float p, float* u)
{
    const bool first = *u < p;
    *u = first ? *u / p : (*u - p) / (1.0f - p);
    *u = MIN(*u, 0x1.fffffep-1f);
    return first;
}

// A mask's opacity or a blend's weight, clamped to [0, 1].
INLINE float nested_weight(const BsdfContext* ctx, uint slot)
{
    const float weight = lookup_float(ctx, slot);
    return MIN(MAX(weight, 0.0f), 1.0f);
}
#endif

// Replaces a wrapper by the BSDF that it holds, until that is no wrapper. Blends and masks choose one of two with the
// probability of its weight, by the random number `u`; so every estimate is right on average. Of a blend with
// BSDF_EVALUATE_BOTH the other one is noted, too. Returns whether the path passes through.
INLINE bool resolve_nested_bsdf(BsdfContext* ctx, const Surface* s, float u)
{
#if HAS_BLEND_LIGHTING
    ctx->other_bsdf = 0u;
    ctx->other_weight = 0.0f;
#endif
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
                if (!sample_branch(nested_weight(ctx, SLOT_MASK_OPACITY), &u)) return true;
                break;
#endif
#if FEATURE_BLEND
            case BSDF_BLEND: {
                const float weight = nested_weight(ctx, SLOT_BLEND_WEIGHT);
                const bool second = sample_branch(weight, &u);
                if (second) next = wrapper.nested[1];
#if HAS_BLEND_LIGHTING
                if (wrapper.flags & BSDF_EVALUATE_BOTH) {
                    ctx->other_bsdf = wrapper.nested[second ? 0 : 1];
                    ctx->other_weight = second ? 1.0f - weight : weight;
                }
#endif
                break;
            }
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
