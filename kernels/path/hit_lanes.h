// The first steps of `shade_lanes` (stages/shade.cl): escaped rays, hits and emission. They read hit and the path
// state, and write the surface and the BSDF context of every lane to the lane state. Nested BSDFs cannot be vectorised
// and run lane by lane.
#pragma once
#include "path/lane_state.h"

#if LANES > 1
// The paths of a work-item that the shading steps treat. Without COMPACT_ESCAPED these are all its paths, escaped
// ones too.
typedef struct {
    size_t begin;          // first path of the work-item
    const int* hit_lanes;  // lanes that hit something, where escaped rays are compacted apart; else unused
    uint count;
} HitLanes;

INLINE size_t hit_path(const HitLanes* hits, size_t k)
{
    return COMPACT_ESCAPED ? (size_t)((int)hits->begin + hits->hit_lanes[k]) : hits->begin + k;
}

// The same for a lane of a compacted list. Its signed 32-bit index lets the compiler gather 16 paths with one
// instruction.
INLINE size_t compacted_path(const HitLanes* hits, int lane)
{
    return (size_t)((int)hits->begin + (COMPACT_ESCAPED ? hits->hit_lanes[lane] : lane));
}

// Branch-free compaction of the lanes where `condition` (0 or 1) holds. Declares `compacted_count`; `list` has LANES +
// 1 entries.
#define COMPACT_LANES(list, compacted_count, k, count, condition) \
    uint compacted_count = 0u;                                    \
    for (uint k = 0u; k < (count); ++k) {                         \
        list[compacted_count] = (int)k;                           \
        compacted_count += (uint)(condition);                     \
    }

#if FEATURE_LIGHT_LIST && (HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS)
// Queues a light-selection pmf query at the previous vertex (for MIS).
INLINE void write_light_pmf_query(const Path* p, uint light, float* queries, size_t lane)
{
    store_lane3(p->mis_origin, queries, QUERY_POINT, lane);
    store_lane4(p->mis_normal, queries, QUERY_NORMAL, lane);
    store_lane_uint(light, queries, QUERY_LIGHT, lane);
}

// Queries are evaluated for whole vectors, so the lanes behind the last query need values too.
INLINE void clear_light_pmf_queries(float* queries, uint count)
{
    FOR_LANES(k, count) {
        store_lane3(splat3(0.0f), queries, QUERY_POINT, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), queries, QUERY_NORMAL, k);
        store_lane_uint(0u, queries, QUERY_LIGHT, k);
    }
}

INLINE float light_pmf_result(const Path* p, const float* queries, size_t lane)
{
    return is_mis_weighted(p->direction_pdf) ? load_lane(queries, QUERY_PMF, lane) : 0.0f;
}
#endif

INLINE void clear_outputs(const PathBuffers* paths, size_t begin, uint count)
{
    FOR_LANES(k, count) {
        if (k >= count) continue;
        paths->alive[begin + k] = 0;
#if FEATURE_NEXT_EVENT
        PLANE(3, paths->shadow_direction, paths->plane_stride)[begin + k] = 0.0f;
#endif
    }
}

#if COMPACT_ESCAPED
// Adds the environment's radiance for the rays that left the scene.
INLINE void handle_escaped_rays(const SceneView* scene, const PathBuffers* paths, size_t begin,
                                const int* escaped_lanes, uint count)
{
#if FEATURE_LIGHT_LIST
    float queries[QUERY_FLOATS * LANES];
    clear_light_pmf_queries(queries, count);
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, (size_t)((int)begin + escaped_lanes[k]));
        write_light_pmf_query(&p, scene->environment_light, queries, k);
    }
    evaluate_light_pmf_queries(&scene->light_list, queries, count);
#endif
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, (size_t)((int)begin + escaped_lanes[k]));
#if FEATURE_LIGHT_LIST
        const float pmf = light_pmf_result(&p, queries, k);
#else
        const float pmf = previous_light_pmf(scene, &p, scene->environment_light);
#endif
        if (!FEATURE_HIDE_EMITTERS || p.depth > 0u)
            ADD3(environment_contribution(scene, &p, pmf), p.sample, paths->samples);
    }
}
#endif

INLINE bool has_lane_flag(uint flag, const float* lane_state, size_t lane)
{
    return load_lane_uint(lane_state, LANE_FLAGS, lane) & flag;
}

INLINE void set_lane_flags(uint flags, float* lane_state, size_t lane)
{
    store_lane_uint(load_lane_uint(lane_state, LANE_FLAGS, lane) | flags, lane_state, LANE_FLAGS, lane);
}

#if HAS_NESTED_BSDFS || FEATURE_NEXT_EVENT
INLINE void clear_lane_flag(uint flag, float* lane_state, size_t lane)
{
    store_lane_uint(load_lane_uint(lane_state, LANE_FLAGS, lane) & ~flag, lane_state, LANE_FLAGS, lane);
}
#endif

// Stores the BSDF context of a lane that is scattered, and whether it samples a light.
INLINE void prepare_bsdf_lane(const SceneView* scene, const PathBuffers* paths, size_t i, const Path* p,
                              const Surface* s, float* lane_state, size_t lane)
{
    BsdfContext ctx;
    if (prepare_bsdf(scene, p, s, &ctx)) {
#if HAS_NULL_BSDFS
        continue_behind_unweighted(paths, i, p, s);
#endif
        store_lane_uint(0u, lane_state, LANE_BSDF_KIND, lane);
        return;
    }
    store_bsdf_context_lane(&ctx, lane_state, lane);
    uint flags = LANE_FLAG_SCATTERS;
#if FEATURE_NEXT_EVENT
    flags |= has_non_delta_lobes(&ctx) ? LANE_FLAG_SAMPLES_LIGHT : 0u;
#if HAS_BLEND_LIGHTING
    flags |= ctx.other_weight > 0.0f ? LANE_FLAG_BLENDS : 0u;
#endif
#endif
    set_lane_flags(flags, lane_state, lane);
}

// Moves a path to its hit on `primitive`. Nested BSDFs are left to a loop of their own.
INLINE void advance_to_vertex_lane(const SceneView* scene, const PathBuffers* paths, size_t i, uint primitive,
                                   uint max_depth, float* lane_state, size_t lane)
{
    Path p = load_path(paths, i);
    p.primitive = primitive;
    Surface s = hit_surface(scene, paths, i, &p);
    bool hits_emitter;
    const bool scatters = advance_to_vertex(scene, paths, i, &p, &s, false, &hits_emitter) && p.depth + 1u < max_depth;
    store_surface_lane(&s, lane_state, lane);
    const uint flags =
        (hits_emitter ? LANE_FLAG_HIT_EMITTER : 0u) | (scatters && HAS_NESTED_BSDFS ? LANE_FLAG_SCATTERS : 0u);
    store_lane_uint(flags, lane_state, LANE_FLAGS, lane);
#if !HAS_NESTED_BSDFS
    if (scatters) prepare_bsdf_lane(scene, paths, i, &p, &s, lane_state, lane);
#endif
}

INLINE void advance_to_vertices(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits, uint max_depth,
                                float* lane_state)
{
    const uint count = hits->count;
    __global const uint* hit_primitives = (__global const uint*)PLANE(3, paths->hit, paths->plane_stride);
    FOR_LANES(k, count) {
        store_lane_uint(0u, lane_state, LANE_FLAGS, k);
        store_lane_uint(0u, lane_state, LANE_BSDF_KIND, k);
        store_lane_uint(0u, lane_state, LANE_BSDF, k);
#if FEATURE_NEXT_EVENT
        store_lane3(splat3(0.0f), lane_state, LANE_LIGHT_DIRECTION, k);
#endif
#if HAS_BLEND_LIGHTING
        store_lane_uint(0u, lane_state, LANE_OTHER_BSDF, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), lane_state, LANE_BSDF_VALUE, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), lane_state, LANE_OTHER_VALUE, k);
#endif
#if FEATURE_LIGHT_LIST  // lights are selected for all lanes
        store_lane3(splat3(0.0f), lane_state, LANE_POSITION, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), lane_state, LANE_MIS_NORMAL, k);
        store_lane(0.0f, lane_state, LANE_LIGHT_U, k);
        store_lane(0.0f, lane_state, LANE_LIGHT_U_LOW, k);
#endif
    }
#if FEATURE_TRIANGLES
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const uint primitive = hit_primitives[hit_path(hits, k)];
        if (primitive & ANALYTIC_BIT) continue;
        // the bit is known to be clear here, and to be set below: it lets the compiler drop the other kind of shape
        advance_to_vertex_lane(scene, paths, hit_path(hits, k), primitive & ~ANALYTIC_BIT, max_depth, lane_state, k);
    }
#endif
#if FEATURE_ANALYTICS
    int list[LANES + 1];
    COMPACT_LANES(list, analytic_count, k, count,
                  (hit_primitives[hit_path(hits, k)] >= ANALYTIC_BIT) & (hit_primitives[hit_path(hits, k)] != NONE))
    FOR_LANES(j, analytic_count) {
        if (j >= analytic_count) continue;
        const size_t i = compacted_path(hits, list[j]);
        advance_to_vertex_lane(scene, paths, i, hit_primitives[i] | ANALYTIC_BIT, max_depth, lane_state, list[j]);
    }
#endif
#if HAS_NESTED_BSDFS
    for (uint k = 0u; k < count; ++k) {
        if (!has_lane_flag(LANE_FLAG_SCATTERS, lane_state, k)) continue;
        const size_t i = hit_path(hits, k);
        const Path p = load_path(paths, i);
        const Surface s = load_surface_lane(lane_state, k);
        clear_lane_flag(LANE_FLAG_SCATTERS, lane_state, k);
        prepare_bsdf_lane(scene, paths, i, &p, &s, lane_state, k);
    }
#endif
}

#if FEATURE_AREA_LIGHTS
// Adds the radiance of the emitters that were hit.
INLINE void handle_emissive_hits(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits,
                                 const float* lane_state)
{
    int list[LANES + 1];
    COMPACT_LANES(list, emissive_count, k, hits->count, has_lane_flag(LANE_FLAG_HIT_EMITTER, lane_state, k))
#if FEATURE_LIGHT_LIST
    float queries[QUERY_FLOATS * LANES];
    clear_light_pmf_queries(queries, emissive_count);
    FOR_LANES(j, emissive_count) {
        if (j >= emissive_count) continue;
        const Path p = load_path(paths, compacted_path(hits, list[j]));
        write_light_pmf_query(&p, load_lane_uint(lane_state, LANE_SURFACE_LIGHT, list[j]), queries, j);
    }
    evaluate_light_pmf_queries(&scene->light_list, queries, emissive_count);
#endif
    FOR_LANES(j, emissive_count) {
        if (j >= emissive_count) continue;
        const Path p = load_path(paths, compacted_path(hits, list[j]));
        const Surface s = load_surface_lane(lane_state, list[j]);
#if FEATURE_LIGHT_LIST
        const float pmf = light_pmf_result(&p, queries, j);
#else
        const float pmf = previous_light_pmf(scene, &p, s.light);
#endif
        ADD3(emission_contribution(scene, &p, &s, pmf), (int)p.sample, paths->samples);
    }
}
#endif
#endif
