// What a work-item that takes several paths keeps of them from one loop to the next, member by member for all lanes: path/shade_lanes.h.
#pragma once
#include "path/scatter.h"

// Paths that left the scene are listed apart from those that met something: in one loop all lanes would do the work of both.
#define COMPACT_ESCAPED (LANES > 1 && HAS_ENVIRONMENT_LIGHT)

#if LANES > 1
// What is to be done about a path.
#define LANE_SCATTERS 1u  // it goes on from the surface,
#define LANE_HIT_EMITTER 2u    // meets a light there,
#define LANE_SAMPLES_LIGHT 4u     // and looks for one

// Members by number. Of the surface,
#define LANE_POSITION 0u
#define LANE_ERROR 3u
#define LANE_GEOMETRIC_NORMAL 6u
#define LANE_SURFACE_NORMAL 9u
#define LANE_SURFACE_LIGHT 12u
#define LANE_UV 13u  // uv, barycentric, triangle, dp_du, dp_dv
// of the material there: its number and kind, the normal, the cosine, what of a bump is asked for later,
#define LANE_FLAGS (LANE_UV + (FEATURE_UVS ? 11u : 0u))
#define LANE_BSDF (LANE_FLAGS + 1u)
#define LANE_KIND (LANE_FLAGS + 2u)
#define LANE_NORMAL (LANE_FLAGS + 3u)
#define LANE_COSINE (LANE_FLAGS + 6u)
#define LANE_BUMP (LANE_FLAGS + 7u)  // frame, whether turned, alpha^2
// of the light: the side that is lit, random numbers, the pick, the sample, the share that is scattered and its density,
#define LANE_MIS_NORMAL (LANE_BUMP + (HAS_BUMPS ? 8u : 0u))
#define LANE_LIGHT_RANDOM (LANE_MIS_NORMAL + 4u)  // pick, low bits of it, position
#define LANE_LIGHT_SELECTION (LANE_MIS_NORMAL + 8u)
#define LANE_LIGHT_SAMPLE (LANE_MIS_NORMAL + 10u)  // direction, radiance, density, whether it is a delta function
#define LANE_BSDF_VALUE (LANE_MIS_NORMAL + 18u)
// of what comes next: random numbers, and the sample,
#define LANE_BSDF_RANDOM (LANE_MIS_NORMAL + 22u)
#define LANE_BSDF_SAMPLE (LANE_MIS_NORMAL + 26u)
// and what textures show.
#define LANE_PARAMETERS (LANE_MIS_NORMAL + 34u)
#define LANE_FLOATS (LANE_PARAMETERS + (FEATURE_TEXTURES ? 3u * BSDF_SLOTS : 0u))

INLINE uint load_lane_uint(const float* lane_state, uint member, size_t lane)
{
    return as_uint(load_lane(lane_state, member, lane));
}

INLINE void store_surface_lane(const Surface* s, float* lane_state, size_t lane)
{
    store_lane3(s->position, lane_state, LANE_POSITION, lane);
    store_lane3(s->error, lane_state, LANE_ERROR, lane);
    store_lane3(s->geometric_normal, lane_state, LANE_GEOMETRIC_NORMAL, lane);
    store_lane3(s->normal, lane_state, LANE_SURFACE_NORMAL, lane);
    store_lane(as_float(s->bsdf), lane_state, LANE_BSDF, lane);
    store_lane(as_float(s->light), lane_state, LANE_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    store_lane(s->uv.x, lane_state, LANE_UV, lane);
    store_lane(s->uv.y, lane_state, LANE_UV + 1u, lane);
    store_lane(s->barycentric.x, lane_state, LANE_UV + 2u, lane);
    store_lane(s->barycentric.y, lane_state, LANE_UV + 3u, lane);
    store_lane(as_float(s->triangle), lane_state, LANE_UV + 4u, lane);
    store_lane3(s->dp_du, lane_state, LANE_UV + 5u, lane);
#if HAS_BUMPS
    store_lane3(s->dp_dv, lane_state, LANE_UV + 8u, lane);
#endif
#endif
}

INLINE Surface load_surface_lane(const float* lane_state, size_t lane)
{
    Surface s = empty_surface();
    s.position = load_lane3(lane_state, LANE_POSITION, lane);
    s.error = load_lane3(lane_state, LANE_ERROR, lane);
    s.geometric_normal = load_lane3(lane_state, LANE_GEOMETRIC_NORMAL, lane);
    s.normal = load_lane3(lane_state, LANE_SURFACE_NORMAL, lane);
    s.bsdf = load_lane_uint(lane_state, LANE_BSDF, lane);
    s.light = load_lane_uint(lane_state, LANE_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    s.uv = vec2(load_lane(lane_state, LANE_UV, lane), load_lane(lane_state, LANE_UV + 1u, lane));
    s.barycentric = vec2(load_lane(lane_state, LANE_UV + 2u, lane), load_lane(lane_state, LANE_UV + 3u, lane));
    s.triangle = load_lane_uint(lane_state, LANE_UV + 4u, lane);
    s.dp_du = load_lane3(lane_state, LANE_UV + 5u, lane);
#if HAS_BUMPS
    s.dp_dv = load_lane3(lane_state, LANE_UV + 8u, lane);
#endif
#endif
    return s;
}

INLINE void store_bsdf_context_lane(const BsdfContext* ctx, float* lane_state, size_t lane)
{
    store_lane(as_float(ctx->bsdf), lane_state, LANE_BSDF, lane);
    store_lane(as_float(material(ctx).kind), lane_state, LANE_KIND, lane);
    store_lane3(ctx->normal, lane_state, LANE_NORMAL, lane);
    store_lane(ctx->cos_i, lane_state, LANE_COSINE, lane);
#if HAS_LIGHT_IMPORTANCE
    store_lane4(light_sampling_normal(ctx), lane_state, LANE_MIS_NORMAL, lane);
#endif
#if HAS_BUMPS
    store_lane3(ctx->s, lane_state, LANE_BUMP, lane);
    store_lane3(ctx->t, lane_state, LANE_BUMP + 3u, lane);
    store_lane(ctx->flipped ? 1.0f : 0.0f, lane_state, LANE_BUMP + 6u, lane);
    store_lane(ctx->shadow, lane_state, LANE_BUMP + 7u, lane);
#endif
}

// `of_kind`: one of which the material may be; `direction`: of the path.
INLINE BsdfContext load_bsdf_context_lane(const SceneView* scene, uint of_kind, Vec3 direction, const float* lane_state, size_t lane)
{
    BsdfContext ctx;
    ctx.bsdfs = scene->bsdfs;
    ctx.bsdf = load_lane_uint(lane_state, LANE_BSDF, lane);
    ctx.normal = load_lane3(lane_state, LANE_NORMAL, lane);
    ctx.cos_i = load_lane(lane_state, LANE_COSINE, lane);
    ctx.wi = neg3(direction);
#if FEATURE_ROUGH_PLASTIC
    ctx.rough_transmittances = scene->rough_transmittances;
#endif
#if HAS_BUMPS
    ctx.s = load_lane3(lane_state, LANE_BUMP, lane);
    ctx.t = load_lane3(lane_state, LANE_BUMP + 3u, lane);
    ctx.flipped = load_lane(lane_state, LANE_BUMP + 6u, lane) != 0.0f;
    ctx.shadow = load_lane(lane_state, LANE_BUMP + 7u, lane);
#elif HAS_FRAMES
    ctx.s = ctx.t = splat3(0.0f);
    if (of_kind & FRAMED_BSDFS) {
        const Surface s = load_surface_lane(lane_state, lane);
        set_shading_frame(&ctx, &s);
    }
#endif
#if FEATURE_TEXTURES
    ctx.parameters = lane_state + LANE_PARAMETERS * LANES + lane;
#endif
    return ctx;
}

#if FEATURE_NEXT_EVENT
#if !FEATURE_LIGHT_LIST
INLINE void store_light_selection_lane(LightSelection pick, float* lane_state, size_t lane)
{
    store_lane(as_float(pick.light), lane_state, LANE_LIGHT_SELECTION, lane);
    store_lane(pick.probability, lane_state, LANE_LIGHT_SELECTION + 1u, lane);
}
#endif

INLINE LightSelection load_light_selection_lane(const float* lane_state, size_t lane)
{
    const LightSelection pick = {load_lane_uint(lane_state, LANE_LIGHT_SELECTION, lane), load_lane(lane_state, LANE_LIGHT_SELECTION + 1u, lane)};
    return pick;
}

INLINE void store_light_sample_lane(const LightSample* light, float* lane_state, size_t lane)
{
    store_lane3(light->direction, lane_state, LANE_LIGHT_SAMPLE, lane);
    store_lane3(light->radiance, lane_state, LANE_LIGHT_SAMPLE + 3u, lane);
    store_lane(light->pdf, lane_state, LANE_LIGHT_SAMPLE + 6u, lane);
    store_lane(light->is_delta ? 1.0f : 0.0f, lane_state, LANE_LIGHT_SAMPLE + 7u, lane);
}

// The sample but for its place: the shadow ray has been left.
INLINE LightSample load_light_sample_lane(const float* lane_state, size_t lane)
{
    LightSample light = empty_light_sample();
    light.direction = load_lane3(lane_state, LANE_LIGHT_SAMPLE, lane);
    light.radiance = load_lane3(lane_state, LANE_LIGHT_SAMPLE + 3u, lane);
    light.pdf = load_lane(lane_state, LANE_LIGHT_SAMPLE + 6u, lane);
    light.is_delta = load_lane(lane_state, LANE_LIGHT_SAMPLE + 7u, lane) != 0.0f;
    return light;
}
#endif

INLINE void store_bsdf_sample_lane(const BsdfSample* next, float* lane_state, size_t lane)
{
    store_lane3(next->direction, lane_state, LANE_BSDF_SAMPLE, lane);
    store_lane3(next->weight, lane_state, LANE_BSDF_SAMPLE + 3u, lane);
    store_lane(next->pdf, lane_state, LANE_BSDF_SAMPLE + 6u, lane);
    store_lane(next->eta, lane_state, LANE_BSDF_SAMPLE + 7u, lane);
}

INLINE BsdfSample load_bsdf_sample_lane(const float* lane_state, size_t lane)
{
    const BsdfSample next = {load_lane3(lane_state, LANE_BSDF_SAMPLE, lane), load_lane3(lane_state, LANE_BSDF_SAMPLE + 3u, lane),
                             load_lane(lane_state, LANE_BSDF_SAMPLE + 6u, lane), load_lane(lane_state, LANE_BSDF_SAMPLE + 7u, lane)};
    return next;
}
#endif
