// Lane state: what a work-item that shades LANES paths keeps of them from one shading step to the next. It is a private
// array of planes, one for each 4-byte member, of LANES numbers each. The steps of path/hit_lanes.h and
// path/shade_lanes.h load and store it.
#pragma once
#include "path/scatter.h"

// Escaped rays are compacted into a list of their own: in one loop with hits, all lanes would do the work of both.
#define COMPACT_ESCAPED (LANES > 1 && HAS_ENVIRONMENT_LIGHT)

#if LANES > 1
// Bits of LANE_FLAGS. With HAS_NESTED_BSDFS, advance_to_vertices also uses LANE_FLAG_SCATTERS for lanes whose BSDF,
// which may be nested, is still to be resolved.
#define LANE_FLAG_SCATTERS 1u       // the path is scattered at the surface
#define LANE_FLAG_HIT_EMITTER 2u    // the surface emits towards the path
#define LANE_FLAG_SAMPLES_LIGHT 4u  // next-event estimation is done for the path
#define LANE_FLAG_BLENDS 8u         // it evaluates both parts of a blend

// Members of the lane state: LANE_<name> is the plane of the first of `floats` members.
// clang-format off
#define LANE_FIELD(name, floats) LANE_##name, LANE_##name##_LAST = LANE_##name + (floats) - 1,
enum {
    // surface
    LANE_FIELD(POSITION, 3)
    LANE_FIELD(ERROR, 3)
    LANE_FIELD(GEOMETRIC_NORMAL, 3)
    LANE_FIELD(SURFACE_NORMAL, 3)
    LANE_FIELD(SURFACE_LIGHT, 1)
#if FEATURE_UVS
    LANE_FIELD(UV, 2)
    LANE_FIELD(BARYCENTRIC, 2)
    LANE_FIELD(TRIANGLE, 1)
    LANE_FIELD(DP_DU, 3)
    LANE_FIELD(DP_DV, 3)
#endif
    // BSDF context
    LANE_FIELD(FLAGS, 1)
    LANE_FIELD(BSDF, 1)
    LANE_FIELD(BSDF_KIND, 1)
    LANE_FIELD(SHADING_NORMAL, 3)
    LANE_FIELD(COS_I, 1)
#if HAS_BUMPS
    LANE_FIELD(FRAME_S, 3)
    LANE_FIELD(FRAME_T, 3)
    LANE_FIELD(IS_FLIPPED, 1)
    LANE_FIELD(BUMP_ALPHA2, 1)
#endif
#if FEATURE_NEXT_EVENT
    // next-event estimation
#if HAS_LIGHT_IMPORTANCE
    LANE_FIELD(MIS_NORMAL, 4)
#endif
    LANE_FIELD(LIGHT_V, 1)  // second coordinate of the position on the light
    LANE_FIELD(LIGHT_U, 1)  // selects the light; rescaled, it is the first coordinate
#if FEATURE_MANY_LIGHTS
    LANE_FIELD(LIGHT_U_LOW, 1)     // low bits; directly behind LIGHT_U: both are passed as one array
    LANE_FIELD(SELECTED_LIGHT, 1)
    LANE_FIELD(SELECTED_PMF, 1)    // directly behind SELECTED_LIGHT
#endif
    LANE_FIELD(LIGHT_DIRECTION, 3)
    LANE_FIELD(LIGHT_RADIANCE, 3)
    LANE_FIELD(LIGHT_PDF, 1)
    LANE_FIELD(LIGHT_IS_DELTA, 1)
    LANE_FIELD(BSDF_VALUE, 3)
    LANE_FIELD(BSDF_VALUE_PDF, 1)  // directly behind BSDF_VALUE: both are accessed as one Vec4
#if HAS_BLEND_LIGHTING
    LANE_FIELD(OTHER_BSDF, 1)
    LANE_FIELD(OTHER_WEIGHT, 1)
    LANE_FIELD(OTHER_VALUE, 4)  // and pdf
#endif
#endif
    // BSDF sample
    LANE_FIELD(BSDF_RANDOM, 4)  // lobe, direction x and y, roulette
    LANE_FIELD(SAMPLE_DIRECTION, 3)
    LANE_FIELD(SAMPLE_WEIGHT, 3)
    LANE_FIELD(SAMPLE_PDF, 1)
    LANE_FIELD(SAMPLE_ETA, 1)
#if FEATURE_TEXTURES
    LANE_FIELD(PARAMETERS, 3 * BSDF_SLOTS)  // texture values, a colour for each BSDF slot
#endif
    LANE_FLOATS
};
// clang-format on

INLINE uint load_lane_uint(const float* lane_state, uint member, size_t lane)
{
    return as_uint(load_lane(lane_state, member, lane));
}

INLINE void store_lane_uint(uint value, float* lane_state, uint member, size_t lane)
{
    store_lane(as_float(value), lane_state, member, lane);
}

INLINE void store_surface_lane(const Surface* s, float* lane_state, size_t lane)
{
    store_lane3(s->position, lane_state, LANE_POSITION, lane);
    store_lane3(s->error, lane_state, LANE_ERROR, lane);
    store_lane3(s->geometric_normal, lane_state, LANE_GEOMETRIC_NORMAL, lane);
    store_lane3(s->normal, lane_state, LANE_SURFACE_NORMAL, lane);
    store_lane_uint(s->bsdf, lane_state, LANE_BSDF, lane);
    store_lane_uint(s->light, lane_state, LANE_SURFACE_LIGHT, lane);
#if FEATURE_UVS
    store_lane(s->uv.x, lane_state, LANE_UV, lane);
    store_lane(s->uv.y, lane_state, LANE_UV + 1, lane);
    store_lane(s->barycentric.x, lane_state, LANE_BARYCENTRIC, lane);
    store_lane(s->barycentric.y, lane_state, LANE_BARYCENTRIC + 1, lane);
    store_lane_uint(s->triangle, lane_state, LANE_TRIANGLE, lane);
    store_lane3(s->dp_du, lane_state, LANE_DP_DU, lane);
#if HAS_BUMPS
    store_lane3(s->dp_dv, lane_state, LANE_DP_DV, lane);
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
    s.uv = vec2(load_lane(lane_state, LANE_UV, lane), load_lane(lane_state, LANE_UV + 1, lane));
    s.barycentric =
        vec2(load_lane(lane_state, LANE_BARYCENTRIC, lane), load_lane(lane_state, LANE_BARYCENTRIC + 1, lane));
    s.triangle = load_lane_uint(lane_state, LANE_TRIANGLE, lane);
    s.dp_du = load_lane3(lane_state, LANE_DP_DU, lane);
#if HAS_BUMPS
    s.dp_dv = load_lane3(lane_state, LANE_DP_DV, lane);
#endif
#endif
    return s;
}

INLINE void store_bsdf_context_lane(const BsdfContext* ctx, float* lane_state, size_t lane)
{
    store_lane_uint(ctx->bsdf, lane_state, LANE_BSDF, lane);
    store_lane_uint(material(ctx).kind, lane_state, LANE_BSDF_KIND, lane);
    store_lane3(ctx->normal, lane_state, LANE_SHADING_NORMAL, lane);
    store_lane(ctx->cos_i, lane_state, LANE_COS_I, lane);
#if HAS_BLEND_LIGHTING
    store_lane_uint(ctx->other_bsdf, lane_state, LANE_OTHER_BSDF, lane);
    store_lane(ctx->other_weight, lane_state, LANE_OTHER_WEIGHT, lane);
#endif
#if HAS_LIGHT_IMPORTANCE
    store_lane4(light_sampling_normal(ctx), lane_state, LANE_MIS_NORMAL, lane);
#endif
#if HAS_BUMPS
    store_lane3(ctx->s, lane_state, LANE_FRAME_S, lane);
    store_lane3(ctx->t, lane_state, LANE_FRAME_T, lane);
    store_lane(ctx->flipped ? 1.0f : 0.0f, lane_state, LANE_IS_FLIPPED, lane);
    store_lane(ctx->bump_alpha2, lane_state, LANE_BUMP_ALPHA2, lane);
#endif
}

// `kind`: the BSDF is of this kind, 0 if its frame is not needed. `direction`: of the path.
INLINE BsdfContext load_bsdf_context_lane(const SceneView* scene, uint kind, Vec3 direction, const float* lane_state,
                                          size_t lane)
{
    BsdfContext ctx;
    ctx.bsdfs = scene->bsdfs;
    ctx.bsdf = load_lane_uint(lane_state, LANE_BSDF, lane);
    ctx.normal = load_lane3(lane_state, LANE_SHADING_NORMAL, lane);
    ctx.cos_i = load_lane(lane_state, LANE_COS_I, lane);
    ctx.wi = neg3(direction);
#if HAS_ROUGH_TRANSMITTANCE
    ctx.rough_transmittances = scene->rough_transmittances;
#endif
#if HAS_BUMPS
    ctx.s = load_lane3(lane_state, LANE_FRAME_S, lane);
    ctx.t = load_lane3(lane_state, LANE_FRAME_T, lane);
    ctx.flipped = load_lane(lane_state, LANE_IS_FLIPPED, lane) != 0.0f;
    ctx.bump_alpha2 = load_lane(lane_state, LANE_BUMP_ALPHA2, lane);
#elif HAS_SHADING_FRAME
    ctx.s = ctx.t = splat3(0.0f);
    if (kind & FRAMED_BSDFS) {
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
#if FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST
INLINE void store_light_selection_lane(LightSelection selection, float* lane_state, size_t lane)
{
    store_lane_uint(selection.light, lane_state, LANE_SELECTED_LIGHT, lane);
    store_lane(selection.probability, lane_state, LANE_SELECTED_PMF, lane);
    store_lane(selection.u, lane_state, LANE_LIGHT_U, lane);
}
#endif

INLINE LightSelection load_light_selection_lane(const float* lane_state, size_t lane)
{
    LightSelection selection = {0u, 1.0f, load_lane(lane_state, LANE_LIGHT_U, lane)};
#if FEATURE_MANY_LIGHTS
    selection.light = load_lane_uint(lane_state, LANE_SELECTED_LIGHT, lane);
    selection.probability = load_lane(lane_state, LANE_SELECTED_PMF, lane);
#endif
    return selection;
}

INLINE void store_light_sample_lane(const LightSample* light, float* lane_state, size_t lane)
{
    store_lane3(light->direction, lane_state, LANE_LIGHT_DIRECTION, lane);
    store_lane3(light->radiance, lane_state, LANE_LIGHT_RADIANCE, lane);
    store_lane(light->pdf, lane_state, LANE_LIGHT_PDF, lane);
    store_lane(light->is_delta ? 1.0f : 0.0f, lane_state, LANE_LIGHT_IS_DELTA, lane);
}

// The light sample without its position, which only the shadow ray needs; that has been written before.
INLINE LightSample load_light_sample_lane(const float* lane_state, size_t lane)
{
    LightSample light = empty_light_sample();
    light.direction = load_lane3(lane_state, LANE_LIGHT_DIRECTION, lane);
    light.radiance = load_lane3(lane_state, LANE_LIGHT_RADIANCE, lane);
    light.pdf = load_lane(lane_state, LANE_LIGHT_PDF, lane);
    light.is_delta = load_lane(lane_state, LANE_LIGHT_IS_DELTA, lane) != 0.0f;
    return light;
}
#endif

INLINE void store_bsdf_sample_lane(const BsdfSample* sample, float* lane_state, size_t lane)
{
    store_lane3(sample->direction, lane_state, LANE_SAMPLE_DIRECTION, lane);
    store_lane3(sample->weight, lane_state, LANE_SAMPLE_WEIGHT, lane);
    store_lane(sample->pdf, lane_state, LANE_SAMPLE_PDF, lane);
    store_lane(sample->eta, lane_state, LANE_SAMPLE_ETA, lane);
}

INLINE BsdfSample load_bsdf_sample_lane(const float* lane_state, size_t lane)
{
    const BsdfSample sample = {
        load_lane3(lane_state, LANE_SAMPLE_DIRECTION, lane), load_lane3(lane_state, LANE_SAMPLE_WEIGHT, lane),
        load_lane(lane_state, LANE_SAMPLE_PDF, lane), load_lane(lane_state, LANE_SAMPLE_ETA, lane),
        false};  // null bounces need FEATURE_VOLPATH, which has no lanes
    return sample;
}
#endif
