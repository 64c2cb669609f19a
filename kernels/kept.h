// What a loop over paths that is to become vector instructions cannot do itself: searches whose length differs from path to path,
// textures, surfaces of several kinds, of which each lane would do all. A loop before it does this path by path, and keeps the
// outcome, member by member for all lanes, where the other takes it up.
#pragma once
#include "arrival.h"

#define KEEPS (LANES > 1 && (FEATURE_TEXTURES || HAS_WRAPPERS || FEATURE_LIGHT_TREE))

#if KEEPS
// Members by number.
#define KEPT_MARK 0u
#define KEPT_POSITION 1u
#define KEPT_ERROR 4u
#define KEPT_GEOMETRIC_NORMAL 7u
#define KEPT_NORMAL 10u
#define KEPT_BSDF 13u
#define KEPT_COSINE 14u
#define KEPT_LIGHT 15u  // position, error, normal, direction, radiance, density, primitive, kind
#define KEPT_FRAME (KEPT_LIGHT + (FEATURE_NEXT_EVENT ? 18u : 0u))
#define KEPT_BUMP (KEPT_FRAME + (HAS_FRAMES ? 6u : 0u))          // the surface's normal, whether turned, alpha^2
#define KEPT_PARAMETERS (KEPT_BUMP + (HAS_BUMPS ? 5u : 0u))      // from textures
#define KEPT (KEPT_PARAMETERS + (FEATURE_TEXTURES ? 3u * BSDF_SLOTS : 0u))

#define IS_DELTA 1u
#define IS_INFINITE 2u

INLINE void keep_mark(bool goes_on, float* kept, size_t lane)
{
    keep1(goes_on ? 1.0f : 0.0f, kept, KEPT_MARK, lane);
}

INLINE bool kept_mark(const float* kept, size_t lane)
{
    return kept1(kept, KEPT_MARK, lane) != 0.0f;
}

INLINE void keep(const Scene* scene, const Surface* s, const Shading* at, const LightSample* light, float* kept, size_t lane)
{
    keep3(s->position, kept, KEPT_POSITION, lane);
    keep3(s->error, kept, KEPT_ERROR, lane);
    keep3(s->geometric_normal, kept, KEPT_GEOMETRIC_NORMAL, lane);
    keep3(at->normal, kept, KEPT_NORMAL, lane);
    keep1(at->cos_i, kept, KEPT_COSINE, lane);
    keep1(as_float((uint)(at->bsdf - scene->bsdfs)), kept, KEPT_BSDF, lane);
#if FEATURE_NEXT_EVENT
    keep3(light->position, kept, KEPT_LIGHT, lane);
    keep3(light->error, kept, KEPT_LIGHT + 3u, lane);
    keep3(light->normal, kept, KEPT_LIGHT + 6u, lane);
    keep3(light->direction, kept, KEPT_LIGHT + 9u, lane);
    keep3(light->radiance, kept, KEPT_LIGHT + 12u, lane);
    keep1(light->pdf, kept, KEPT_LIGHT + 15u, lane);
    keep1(as_float(light->primitive), kept, KEPT_LIGHT + 16u, lane);
    const uint kind = (light->is_delta ? IS_DELTA : 0u) | (light->is_infinite ? IS_INFINITE : 0u);
    keep1(as_float(kind), kept, KEPT_LIGHT + 17u, lane);
#endif
#if HAS_FRAMES
    keep3(at->s, kept, KEPT_FRAME, lane);
    keep3(at->t, kept, KEPT_FRAME + 3u, lane);
#endif
#if HAS_BUMPS
    keep3(s->normal, kept, KEPT_BUMP, lane);
    keep1(at->turned ? 1.0f : 0.0f, kept, KEPT_BUMP + 3u, lane);
    keep1(at->shadow, kept, KEPT_BUMP + 4u, lane);
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

INLINE void take_back(const Scene* scene, const Path* p, Surface* s, Shading* at, LightSample* light, const float* kept,
                      size_t lane)
{
    *s = no_surface();
    s->position = kept3(kept, KEPT_POSITION, lane);
    s->error = kept3(kept, KEPT_ERROR, lane);
    s->geometric_normal = kept3(kept, KEPT_GEOMETRIC_NORMAL, lane);
    at->normal = kept3(kept, KEPT_NORMAL, lane);
    at->cos_i = kept1(kept, KEPT_COSINE, lane);
    at->wi = neg3(p->direction);
#if FEATURE_ROUGH_PLASTIC
    at->tables = scene->boundaries;
#endif
    at->bsdf = scene->bsdfs + as_uint(kept1(kept, KEPT_BSDF, lane));
    *light = no_light();
#if FEATURE_NEXT_EVENT
    light->position = kept3(kept, KEPT_LIGHT, lane);
    light->error = kept3(kept, KEPT_LIGHT + 3u, lane);
    light->normal = kept3(kept, KEPT_LIGHT + 6u, lane);
    light->direction = kept3(kept, KEPT_LIGHT + 9u, lane);
    light->radiance = kept3(kept, KEPT_LIGHT + 12u, lane);
    light->pdf = kept1(kept, KEPT_LIGHT + 15u, lane);
    light->primitive = as_uint(kept1(kept, KEPT_LIGHT + 16u, lane));
    const uint kind = as_uint(kept1(kept, KEPT_LIGHT + 17u, lane));
    light->is_delta = kind & IS_DELTA;
    light->is_infinite = kind & IS_INFINITE;
#endif
#if HAS_FRAMES
    at->s = kept3(kept, KEPT_FRAME, lane);
    at->t = kept3(kept, KEPT_FRAME + 3u, lane);
#endif
#if HAS_BUMPS
    s->normal = kept3(kept, KEPT_BUMP, lane);
    at->turned = kept1(kept, KEPT_BUMP + 3u, lane) != 0.0f;
    at->shadow = kept1(kept, KEPT_BUMP + 4u, lane);
#endif
#if FEATURE_TEXTURES
    at->parameters = kept + KEPT_PARAMETERS * LANES + lane;
#endif
}
#endif
