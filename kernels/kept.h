// What a work-item that takes several paths keeps of them from one loop to the next, member by member for all lanes: steps.h.
#pragma once
#include "vertex.h"

// Paths that left the scene are listed apart from those that met something: in one loop all lanes would do the work of both.
#define SPLITS (LANES > 1 && HAS_SKY)

#if LANES > 1
// What is to be done about a path.
#define MARK_SCATTERS 1u  // it goes on from the surface,
#define MARK_SHINES 2u    // meets a light there,
#define MARK_LOOKS 4u     // and looks for one

// Members by number. Of the surface,
#define KEPT_POSITION 0u
#define KEPT_ERROR 3u
#define KEPT_GEOMETRIC_NORMAL 6u
#define KEPT_SURFACE_NORMAL 9u
#define KEPT_SURFACE_LIGHT 12u
#define KEPT_UV 13u  // uv, barycentric, triangle, dp_du, dp_dv
// of the material there: its number and kind, the normal, the cosine, what of a bump is asked for later,
#define KEPT_MARKS (KEPT_UV + (FEATURE_UVS ? 11u : 0u))
#define KEPT_BSDF (KEPT_MARKS + 1u)
#define KEPT_KIND (KEPT_MARKS + 2u)
#define KEPT_NORMAL (KEPT_MARKS + 3u)
#define KEPT_COSINE (KEPT_MARKS + 6u)
#define KEPT_BUMP (KEPT_MARKS + 7u)  // frame, whether turned, alpha^2
// of the light: the side that is lit, random numbers, the pick, the sample, the share that is scattered and its density,
#define KEPT_LIT (KEPT_BUMP + (HAS_BUMPS ? 8u : 0u))
#define KEPT_LIGHT_RANDOM (KEPT_LIT + 4u)  // pick, low bits of it, position
#define KEPT_PICK (KEPT_LIT + 8u)
#define KEPT_LIGHT (KEPT_LIT + 10u)  // direction, radiance, density, whether it is a delta function
#define KEPT_SCATTERED (KEPT_LIT + 18u)
// of what comes next: random numbers, and the sample,
#define KEPT_RANDOM (KEPT_LIT + 22u)
#define KEPT_NEXT (KEPT_LIT + 26u)
// and what textures show.
#define KEPT_PARAMETERS (KEPT_LIT + 34u)
#define KEPT (KEPT_PARAMETERS + (FEATURE_TEXTURES ? 3u * BSDF_SLOTS : 0u))

INLINE uint kept_bits(const float* kept, uint member, size_t lane)
{
    return as_uint(kept1(kept, member, lane));
}

INLINE void keep_surface(const Surface* s, float* kept, size_t lane)
{
    keep3(s->position, kept, KEPT_POSITION, lane);
    keep3(s->error, kept, KEPT_ERROR, lane);
    keep3(s->geometric_normal, kept, KEPT_GEOMETRIC_NORMAL, lane);
    keep3(s->normal, kept, KEPT_SURFACE_NORMAL, lane);
    keep1(as_float(s->bsdf), kept, KEPT_BSDF, lane);
    keep1(as_float(s->light), kept, KEPT_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    keep1(s->uv.x, kept, KEPT_UV, lane);
    keep1(s->uv.y, kept, KEPT_UV + 1u, lane);
    keep1(s->barycentric.x, kept, KEPT_UV + 2u, lane);
    keep1(s->barycentric.y, kept, KEPT_UV + 3u, lane);
    keep1(as_float(s->triangle), kept, KEPT_UV + 4u, lane);
    keep3(s->dp_du, kept, KEPT_UV + 5u, lane);
#if HAS_BUMPS
    keep3(s->dp_dv, kept, KEPT_UV + 8u, lane);
#endif
#endif
}

INLINE Surface kept_surface(const float* kept, size_t lane)
{
    Surface s = no_surface();
    s.position = kept3(kept, KEPT_POSITION, lane);
    s.error = kept3(kept, KEPT_ERROR, lane);
    s.geometric_normal = kept3(kept, KEPT_GEOMETRIC_NORMAL, lane);
    s.normal = kept3(kept, KEPT_SURFACE_NORMAL, lane);
    s.bsdf = kept_bits(kept, KEPT_BSDF, lane);
    s.light = kept_bits(kept, KEPT_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    s.uv = vec2(kept1(kept, KEPT_UV, lane), kept1(kept, KEPT_UV + 1u, lane));
    s.barycentric = vec2(kept1(kept, KEPT_UV + 2u, lane), kept1(kept, KEPT_UV + 3u, lane));
    s.triangle = kept_bits(kept, KEPT_UV + 4u, lane);
    s.dp_du = kept3(kept, KEPT_UV + 5u, lane);
#if HAS_BUMPS
    s.dp_dv = kept3(kept, KEPT_UV + 8u, lane);
#endif
#endif
    return s;
}

INLINE void keep_shading(const Shading* at, float* kept, size_t lane)
{
    keep1(as_float(at->bsdf), kept, KEPT_BSDF, lane);
    keep1(as_float(material(at).kind), kept, KEPT_KIND, lane);
    keep3(at->normal, kept, KEPT_NORMAL, lane);
    keep1(at->cos_i, kept, KEPT_COSINE, lane);
#if HAS_LIT
    keep4(lit_side(at), kept, KEPT_LIT, lane);
#endif
#if HAS_BUMPS
    keep3(at->s, kept, KEPT_BUMP, lane);
    keep3(at->t, kept, KEPT_BUMP + 3u, lane);
    keep1(at->turned ? 1.0f : 0.0f, kept, KEPT_BUMP + 6u, lane);
    keep1(at->shadow, kept, KEPT_BUMP + 7u, lane);
#endif
}

// `of_kind`: one of which the material may be; `direction`: of the path.
INLINE Shading kept_shading(const Scene* scene, uint of_kind, Vec3 direction, const float* kept, size_t lane)
{
    Shading at;
    at.bsdfs = scene->bsdfs;
    at.bsdf = kept_bits(kept, KEPT_BSDF, lane);
    at.normal = kept3(kept, KEPT_NORMAL, lane);
    at.cos_i = kept1(kept, KEPT_COSINE, lane);
    at.wi = neg3(direction);
#if FEATURE_ROUGH_PLASTIC
    at.tables = scene->boundaries;
#endif
#if HAS_BUMPS
    at.s = kept3(kept, KEPT_BUMP, lane);
    at.t = kept3(kept, KEPT_BUMP + 3u, lane);
    at.turned = kept1(kept, KEPT_BUMP + 6u, lane) != 0.0f;
    at.shadow = kept1(kept, KEPT_BUMP + 7u, lane);
#elif HAS_FRAMES
    at.s = at.t = all3(0.0f);
    if (of_kind & FRAMED_BSDFS) {
        const Surface s = kept_surface(kept, lane);
        set_frame(&at, &s);
    }
#endif
#if FEATURE_TEXTURES
    at.parameters = kept + KEPT_PARAMETERS * LANES + lane;
#endif
    return at;
}

#if FEATURE_NEXT_EVENT
#if !FEATURE_LIGHT_LIST
INLINE void keep_pick(LightPick pick, float* kept, size_t lane)
{
    keep1(as_float(pick.light), kept, KEPT_PICK, lane);
    keep1(pick.probability, kept, KEPT_PICK + 1u, lane);
}
#endif

INLINE LightPick kept_pick(const float* kept, size_t lane)
{
    const LightPick pick = {kept_bits(kept, KEPT_PICK, lane), kept1(kept, KEPT_PICK + 1u, lane)};
    return pick;
}

INLINE void keep_light(const LightSample* light, float* kept, size_t lane)
{
    keep3(light->direction, kept, KEPT_LIGHT, lane);
    keep3(light->radiance, kept, KEPT_LIGHT + 3u, lane);
    keep1(light->pdf, kept, KEPT_LIGHT + 6u, lane);
    keep1(light->is_delta ? 1.0f : 0.0f, kept, KEPT_LIGHT + 7u, lane);
}

// The sample but for its place: the shadow ray has been left.
INLINE LightSample kept_light(const float* kept, size_t lane)
{
    LightSample light = no_light();
    light.direction = kept3(kept, KEPT_LIGHT, lane);
    light.radiance = kept3(kept, KEPT_LIGHT + 3u, lane);
    light.pdf = kept1(kept, KEPT_LIGHT + 6u, lane);
    light.is_delta = kept1(kept, KEPT_LIGHT + 7u, lane) != 0.0f;
    return light;
}
#endif

INLINE void keep_next(const BsdfSample* next, float* kept, size_t lane)
{
    keep3(next->direction, kept, KEPT_NEXT, lane);
    keep3(next->weight, kept, KEPT_NEXT + 3u, lane);
    keep1(next->pdf, kept, KEPT_NEXT + 6u, lane);
    keep1(next->eta, kept, KEPT_NEXT + 7u, lane);
}

INLINE BsdfSample kept_next(const float* kept, size_t lane)
{
    const BsdfSample next = {kept3(kept, KEPT_NEXT, lane), kept3(kept, KEPT_NEXT + 3u, lane),
                             kept1(kept, KEPT_NEXT + 6u, lane), kept1(kept, KEPT_NEXT + 7u, lane)};
    return next;
}
#endif
