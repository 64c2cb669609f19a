// What a loop over paths that is to become vector instructions cannot do itself: searches whose length differs from path to path,
// textures, materials that wrap others. A loop does this path by path, between one that makes the surfaces and one that goes on
// from them; what passes from one to the next is kept, member by member for all lanes.
#pragma once
#include "arrival.h"

#define KEEPS (LANES > 1 && (FEATURE_TEXTURES || HAS_WRAPPERS || FEATURE_LIGHT_TREE))

#if KEEPS
// Members by number. Of the surface,
#define KEPT_POSITION 0u
#define KEPT_ERROR 3u
#define KEPT_GEOMETRIC_NORMAL 6u
#define KEPT_SURFACE_NORMAL 9u
#define KEPT_SURFACE_BSDF 12u
#define KEPT_SURFACE_LIGHT 13u
#define KEPT_UV 14u  // uv, dp_du, dp_dv, barycentric, triangle
// of what is to scatter there,
#define KEPT_MARK (KEPT_UV + (FEATURE_UVS ? 11u : 0u))
#define KEPT_BSDF (KEPT_MARK + 1u)
#define KEPT_NORMAL (KEPT_MARK + 2u)
#define KEPT_COSINE (KEPT_MARK + 5u)
#define KEPT_PICK (KEPT_MARK + 6u)
#define KEPT_FRAME (KEPT_MARK + 8u)
#define KEPT_BUMP (KEPT_FRAME + (HAS_FRAMES ? 6u : 0u))        // whether turned, alpha^2
// and what textures show there.
#define KEPT_PARAMETERS (KEPT_BUMP + (HAS_BUMPS ? 2u : 0u))
#define KEPT (KEPT_PARAMETERS + (FEATURE_TEXTURES ? 3u * BSDF_SLOTS : 0u))

INLINE void keep_surface(const Surface* s, float* kept, size_t lane)
{
    keep3(s->position, kept, KEPT_POSITION, lane);
    keep3(s->error, kept, KEPT_ERROR, lane);
    keep3(s->geometric_normal, kept, KEPT_GEOMETRIC_NORMAL, lane);
    keep3(s->normal, kept, KEPT_SURFACE_NORMAL, lane);
    keep1(as_float(s->bsdf), kept, KEPT_SURFACE_BSDF, lane);
    keep1(as_float(s->light), kept, KEPT_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    keep1(s->uv.x, kept, KEPT_UV, lane);
    keep1(s->uv.y, kept, KEPT_UV + 1u, lane);
    keep3(s->dp_du, kept, KEPT_UV + 2u, lane);
    keep3(s->dp_dv, kept, KEPT_UV + 5u, lane);
    keep1(s->barycentric.x, kept, KEPT_UV + 8u, lane);
    keep1(s->barycentric.y, kept, KEPT_UV + 9u, lane);
    keep1(as_float(s->triangle), kept, KEPT_UV + 10u, lane);
#endif
}

INLINE Surface kept_surface(const float* kept, size_t lane)
{
    Surface s = no_surface();
    s.position = kept3(kept, KEPT_POSITION, lane);
    s.error = kept3(kept, KEPT_ERROR, lane);
    s.geometric_normal = kept3(kept, KEPT_GEOMETRIC_NORMAL, lane);
    s.normal = kept3(kept, KEPT_SURFACE_NORMAL, lane);
    s.bsdf = as_uint(kept1(kept, KEPT_SURFACE_BSDF, lane));
    s.light = as_uint(kept1(kept, KEPT_SURFACE_LIGHT, lane));
#if FEATURE_UVS
    s.uv = vec2(kept1(kept, KEPT_UV, lane), kept1(kept, KEPT_UV + 1u, lane));
    s.dp_du = kept3(kept, KEPT_UV + 2u, lane);
    s.dp_dv = kept3(kept, KEPT_UV + 5u, lane);
    s.barycentric = vec2(kept1(kept, KEPT_UV + 8u, lane), kept1(kept, KEPT_UV + 9u, lane));
    s.triangle = as_uint(kept1(kept, KEPT_UV + 10u, lane));
#endif
    return s;
}

INLINE void keep_mark(bool goes_on, float* kept, size_t lane)
{
    keep1(goes_on ? 1.0f : 0.0f, kept, KEPT_MARK, lane);
}

INLINE bool kept_mark(const float* kept, size_t lane)
{
    return kept1(kept, KEPT_MARK, lane) != 0.0f;
}

INLINE void keep_shading(const Scene* scene, const Shading* at, LightPick pick, float* kept, size_t lane)
{
    keep1(as_float((uint)(at->bsdf - scene->bsdfs)), kept, KEPT_BSDF, lane);
    keep3(at->normal, kept, KEPT_NORMAL, lane);
    keep1(at->cos_i, kept, KEPT_COSINE, lane);
    keep1(as_float(pick.light), kept, KEPT_PICK, lane);
    keep1(pick.probability, kept, KEPT_PICK + 1u, lane);
#if HAS_FRAMES
    keep3(at->s, kept, KEPT_FRAME, lane);
    keep3(at->t, kept, KEPT_FRAME + 3u, lane);
#endif
#if HAS_BUMPS
    keep1(at->turned ? 1.0f : 0.0f, kept, KEPT_BUMP, lane);
    keep1(at->shadow, kept, KEPT_BUMP + 1u, lane);
#endif
#if FEATURE_TEXTURES
    for (uint slot = 0; slot < BSDF_SLOTS; ++slot) {
        const uint texture = at->bsdf->textures[slot];
        if (texture == NONE) continue;
        const bool number = at->bsdf->numbers & (1u << slot);
        const Vec3 value = number ? all3(texture_number(at->textures, texture, &at->point))
                                  : texture_rgb(at->textures, texture, &at->point);
        keep3(value, kept, KEPT_PARAMETERS + 3u * slot, lane);
    }
#endif
}

INLINE LightPick kept_pick(const float* kept, size_t lane)
{
    const LightPick pick = {as_uint(kept1(kept, KEPT_PICK, lane)), kept1(kept, KEPT_PICK + 1u, lane)};
    return pick;
}

INLINE Shading kept_shading(const Scene* scene, const Path* p, const float* kept, size_t lane)
{
    Shading at;
    at.bsdf = scene->bsdfs + as_uint(kept1(kept, KEPT_BSDF, lane));
    at.normal = kept3(kept, KEPT_NORMAL, lane);
    at.cos_i = kept1(kept, KEPT_COSINE, lane);
    at.wi = neg3(p->direction);
#if FEATURE_ROUGH_PLASTIC
    at.tables = scene->boundaries;
#endif
#if HAS_FRAMES
    at.s = kept3(kept, KEPT_FRAME, lane);
    at.t = kept3(kept, KEPT_FRAME + 3u, lane);
#endif
#if HAS_BUMPS
    at.turned = kept1(kept, KEPT_BUMP, lane) != 0.0f;
    at.shadow = kept1(kept, KEPT_BUMP + 1u, lane);
#endif
#if FEATURE_TEXTURES
    at.parameters = kept + KEPT_PARAMETERS * LANES + lane;
#endif
    return at;
}
#endif
