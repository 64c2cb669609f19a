// Shading in steps, where one loop over paths would do too much: each step is a loop over those that it concerns, and so becomes
// vector instructions by itself. Paths are listed by what they met, by the kind of light they look at, by the kind of material;
// what cannot be done as vector instructions - wrapped materials, checkerboards, the tree of lights - is done path by path.
#pragma once
#include "path/lane_state.h"

#if LANES > 1
// The paths of a work-item.
typedef struct {
    size_t begin;
    const int* hit_lanes;  // of them, those that met something, where others are listed apart
    uint count;
} LaneBatch;

INLINE size_t batch_path(const LaneBatch* batch, size_t k)
{
    return COMPACT_ESCAPED ? (size_t)((int)batch->begin + batch->hit_lanes[k]) : batch->begin + k;
}

// The same of a lane from a list: by a signed place, of which 16 are gathered at once.
INLINE size_t compacted_path(const LaneBatch* batch, int lane)
{
    return (size_t)((int)batch->begin + (COMPACT_ESCAPED ? batch->hit_lanes[lane] : lane));
}

// Lanes for which a condition holds, 0 or 1; `k` is the lane. No jump depends on it, none can be mispredicted.
#define COMPACT_LANES(list, compacted_count, k, count, condition) \
    uint compacted_count = 0u;                              \
    for (uint k = 0u; k < (count); ++k) {         \
        list[compacted_count] = (int)k;                        \
        compacted_count += (uint)(condition);               \
    }

#if FEATURE_LIGHT_LIST && (HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS)
// Asks for the probability with which a path's last vertex would have picked a light.
INLINE void write_light_pdf_query(const Path* p, uint light, float* queries, size_t lane)
{
    store_lane3(p->mis_origin, queries, QUERY_POINT, lane);
    store_lane4(p->mis_normal, queries, QUERY_NORMAL, lane);
    store_lane(as_float(light), queries, QUERY_LIGHT, lane);
}

// Lights are weighed for all lanes of a vector, also for those beyond the last.
INLINE void clear_light_pdf_queries(float* queries, uint count)
{
    FOR_LANES(k, count) {
        store_lane3(splat3(0.0f), queries, QUERY_POINT, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), queries, QUERY_NORMAL, k);
        store_lane(as_float(0u), queries, QUERY_LIGHT, k);
    }
}

INLINE float light_pdf_result(const Path* p, const float* queries, size_t lane)
{
    return p->direction_pdf < 0.0f ? 0.0f : load_lane(queries, QUERY_PMF, lane);
}
#endif

#if COMPACT_ESCAPED
// What paths bring that leave the scene.
INLINE void handle_escaped_rays(const SceneView* scene, const PathState* paths, size_t begin, const int* escaped_lanes, uint count)
{
#if FEATURE_LIGHT_LIST
    float queries[QUERY_FLOATS * LANES];
    clear_light_pdf_queries(queries, count);
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, (size_t)((int)begin + escaped_lanes[k]));
        write_light_pdf_query(&p, scene->environment_light, queries, k);
    }
    evaluate_light_pdf_queries(&scene->light_list, queries, count);
#endif
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, (size_t)((int)begin + escaped_lanes[k]));
#if FEATURE_LIGHT_LIST
        const float pick = light_pdf_result(&p, queries, k);
#else
        const float pick = previous_light_pmf(scene, &p, scene->environment_light);
#endif
        if (!FEATURE_HIDE_EMITTERS || p.depth > 0u) ADD3(environment_contribution(scene, &p, pick), p.sample, paths->samples);
    }
}
#endif

INLINE void set_lane_flags(uint bits, float* lane_state, size_t lane)
{
    store_lane(as_float(load_lane_uint(lane_state, LANE_FLAGS, lane) | bits), lane_state, LANE_FLAGS, lane);
}

INLINE bool has_lane_flag(uint bit, const float* lane_state, size_t lane)
{
    return load_lane_uint(lane_state, LANE_FLAGS, lane) & bit;
}

// The material that a path meets, and whether it looks for a light.
INLINE void prepare_bsdf_lane(const SceneView* scene, const PathState* paths, size_t i, const Path* p, const Surface* s, float* lane_state, size_t lane)
{
    BsdfContext ctx;
    if (make_bsdf_context(scene, p, s, &ctx)) {
#if HAS_PASS_THROUGH
        continue_behind_unweighted(paths, i, p, s);
#endif
        store_lane(as_float(0u), lane_state, LANE_KIND, lane);
        return;
    }
    store_bsdf_context_lane(&ctx, lane_state, lane);
    uint flags = LANE_SCATTERS;
#if FEATURE_NEXT_EVENT
    flags |= samples_light(&ctx, true) ? LANE_SAMPLES_LIGHT : 0u;
#endif
    set_lane_flags(flags, lane_state, lane);
}

// Brings a path to `primitive`. Wrapped materials are left to a loop of their own.
INLINE void process_hit_lane(const SceneView* scene, const PathState* paths, size_t i, uint primitive, uint max_depth, float* lane_state, size_t lane)
{
    Path p = load_path(paths, i);
    p.primitive = primitive;
    Surface s = hit_surface(scene, paths, i, &p);
    bool shines;
    const bool scatters = process_hit(scene, paths, i, &p, &s, false, &shines) && p.depth + 1u < max_depth;
    store_surface_lane(&s, lane_state, lane);
    store_lane(as_float((shines ? LANE_HIT_EMITTER : 0u) | (scatters && HAS_NESTED_BSDFS ? LANE_SCATTERS : 0u)), lane_state, LANE_FLAGS, lane);
#if !HAS_NESTED_BSDFS
    if (scatters) prepare_bsdf_lane(scene, paths, i, &p, &s, lane_state, lane);
#endif
}

INLINE void process_hits(const SceneView* scene, const PathState* paths, const LaneBatch* batch, uint max_depth, float* lane_state)
{
    const uint count = batch->count;
    __global const uint* hit_lanes = (__global const uint*)PLANE(3, paths->hit, paths->plane_stride);
    FOR_LANES(k, count) {
        store_lane(as_float(0u), lane_state, LANE_FLAGS, k);
        store_lane(as_float(0u), lane_state, LANE_KIND, k);
        store_lane(as_float(0u), lane_state, LANE_BSDF, k);
#if FEATURE_NEXT_EVENT
        store_lane3(splat3(0.0f), lane_state, LANE_LIGHT_SAMPLE, k);
#endif
#if FEATURE_LIGHT_LIST  // lights are weighed for all lanes
        store_lane3(splat3(0.0f), lane_state, LANE_POSITION, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), lane_state, LANE_MIS_NORMAL, k);
        store_lane4(vec4(0.0f, 0.0f, 0.0f, 0.0f), lane_state, LANE_LIGHT_RANDOM, k);
#endif
    }
#if FEATURE_TRIANGLES
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const uint primitive = hit_lanes[batch_path(batch, k)];
        if (primitive & ANALYTIC_BIT) continue;
        process_hit_lane(scene, paths, batch_path(batch, k), primitive & ~ANALYTIC_BIT, max_depth, lane_state, k);
    }
#endif
#if FEATURE_ANALYTICS
    int list[LANES + 1];
    COMPACT_LANES(list, compacted_count, k, count, (hit_lanes[batch_path(batch, k)] >= ANALYTIC_BIT) & (hit_lanes[batch_path(batch, k)] != NONE))
    FOR_LANES(j, compacted_count) {
        if (j >= compacted_count) continue;
        const size_t i = compacted_path(batch, list[j]);
        process_hit_lane(scene, paths, i, hit_lanes[i] | ANALYTIC_BIT, max_depth, lane_state, list[j]);
    }
#endif
#if HAS_NESTED_BSDFS
    for (uint k = 0u; k < count; ++k) {
        if (!has_lane_flag(LANE_SCATTERS, lane_state, k)) continue;
        const size_t i = batch_path(batch, k);
        const Path p = load_path(paths, i);
        const Surface s = load_surface_lane(lane_state, k);
        store_lane(as_float(load_lane_uint(lane_state, LANE_FLAGS, k) & ~LANE_SCATTERS), lane_state, LANE_FLAGS, k);
        prepare_bsdf_lane(scene, paths, i, &p, &s, lane_state, k);
    }
#endif
}

#if FEATURE_AREA_LIGHTS
// What paths bring that met lights.
INLINE void handle_emissive_hits(const SceneView* scene, const PathState* paths, const LaneBatch* batch, const float* lane_state)
{
    int list[LANES + 1];
    COMPACT_LANES(list, compacted_count, k, batch->count, has_lane_flag(LANE_HIT_EMITTER, lane_state, k))
#if FEATURE_LIGHT_LIST
    float queries[QUERY_FLOATS * LANES];
    clear_light_pdf_queries(queries, compacted_count);
    FOR_LANES(j, compacted_count) {
        if (j >= compacted_count) continue;
        const Path p = load_path(paths, compacted_path(batch, list[j]));
        write_light_pdf_query(&p, load_lane_uint(lane_state, LANE_SURFACE_LIGHT, list[j]), queries, j);
    }
    evaluate_light_pdf_queries(&scene->light_list, queries, compacted_count);
#endif
    FOR_LANES(j, compacted_count) {
        if (j >= compacted_count) continue;
        const Path p = load_path(paths, compacted_path(batch, list[j]));
        const Surface s = load_surface_lane(lane_state, list[j]);
#if FEATURE_LIGHT_LIST
        const float pick = light_pdf_result(&p, queries, j);
#else
        const float pick = previous_light_pmf(scene, &p, s.light);
#endif
        ADD3(emission_contribution(scene, &p, &s, pick), (int)p.sample, paths->samples);
    }
}
#endif

// Four random numbers for every path: of the light, which is picked at once if that is soon done, and of the direction in which
// it goes on.
INLINE void draw_random_numbers(const SceneView* scene, const PathState* paths, const LaneBatch* batch, float* lane_state)
{
    const uint count = batch->count;
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, batch_path(batch, k));
        const Vec4 u = path_random(scene, &p, BLOCK_BSDF(dimension_of(&p)));
        store_lane4(u, lane_state, LANE_BSDF_RANDOM, k);
#if FEATURE_NEXT_EVENT
        const Vec4 v = path_random(scene, &p, BLOCK_LIGHT(dimension_of(&p)));
        store_lane4(vec4(v.x, v.w, v.y, v.z), lane_state, LANE_LIGHT_RANDOM, k);
#if !HAS_LIGHT_IMPORTANCE
        store_light_selection_lane(select_light(scene, splat3(0.0f),
                             p.mis_normal, v.x, v.w), lane_state, k);
#endif
#endif
    }
}

#if FEATURE_NEXT_EVENT
#if FEATURE_LIGHT_LIST
INLINE void select_lights(const SceneView* scene, uint count, float* lane_state)
{
    select_lights_from_list(&scene->light_list, lane_state + LANE_POSITION * LANES, lane_state + LANE_MIS_NORMAL * LANES,
                       lane_state + LANE_LIGHT_RANDOM * LANES, lane_state + LANE_LIGHT_SELECTION * LANES, count);
}
#elif FEATURE_LIGHT_TREE
INLINE void select_lights(const SceneView* scene, uint count, float* lane_state)
{
    for (uint k = 0u; k < count; ++k) {
        LightSelection pick = {0u, 0.0f};
        if (has_lane_flag(LANE_SAMPLES_LIGHT, lane_state, k))
            pick = select_light(scene, load_lane3(lane_state, LANE_POSITION, k), load_lane4(lane_state, LANE_MIS_NORMAL, k), load_lane(lane_state, LANE_LIGHT_RANDOM, k),
                              load_lane(lane_state, LANE_LIGHT_RANDOM + 1u, k));
        store_light_selection_lane(pick, lane_state, k);
    }
}
#endif

// Looks at the light that was picked, if it is of one of these kinds; leaves the shadow ray, and keeps the sample.
INLINE void sample_direct_lane(const SceneView* scene, const PathState* paths, size_t i, uint kinds, float* lane_state, size_t lane)
{
    const LightSelection pick = load_light_selection_lane(lane_state, lane);
    const Path p = load_path(paths, i);
    const Surface s = load_surface_lane(lane_state, lane);
    const Vec2 u = vec2(load_lane(lane_state, LANE_LIGHT_RANDOM + 2u, lane), load_lane(lane_state, LANE_LIGHT_RANDOM + 3u, lane));
    const LightSample light = sample_light_of_kind(kinds, scene, pick, s.position, u);
    if (pick.probability > 0.0f && is_nonzero_light(&light)) {
        write_shadow_ray(paths, i, &p, &s, &light);
        store_light_sample_lane(&light, lane_state, lane);
    } else {
        store_lane(as_float(load_lane_uint(lane_state, LANE_FLAGS, lane) & ~LANE_SAMPLES_LIGHT), lane_state, LANE_FLAGS, lane);
    }
}

#define HAS_OTHER_LIGHTS                                                                                                  \
    (FEATURE_SPHERE_LIGHTS || FEATURE_DISK_LIGHTS || FEATURE_CYLINDER_LIGHTS || FEATURE_POINT_LIGHTS || FEATURE_SPOT_LIGHTS || \
     FEATURE_DIRECTIONAL_LIGHTS || FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP)

#if FEATURE_TRIANGLE_LIGHTS && HAS_OTHER_LIGHTS
INLINE bool selected_triangle_light(const SceneView* scene, const float* lane_state, size_t lane)
{
    return Light_at(scene->lights, load_lane_uint(lane_state, LANE_LIGHT_SELECTION, lane)).kind & LIGHT_TRIANGLE;
}
#endif

INLINE void sample_direct_lanes(const SceneView* scene, const PathState* paths, const LaneBatch* batch, float* lane_state)
{
    const uint count = batch->count;
#if FEATURE_TRIANGLE_LIGHTS && HAS_OTHER_LIGHTS
    int list[LANES + 1];
    COMPACT_LANES(list, others, k, count, has_lane_flag(LANE_SAMPLES_LIGHT, lane_state, k) & !selected_triangle_light(scene, lane_state, k))
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_SAMPLES_LIGHT, lane_state, k) || !selected_triangle_light(scene, lane_state, k)) continue;
        sample_direct_lane(scene, paths, batch_path(batch, k), LIGHT_TRIANGLE, lane_state, k);
    }
    FOR_LANES(j, others) {
        if (j >= others) continue;
        sample_direct_lane(scene, paths, compacted_path(batch, list[j]), ~LIGHT_TRIANGLE, lane_state, list[j]);
    }
#else
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_SAMPLES_LIGHT, lane_state, k)) continue;
        sample_direct_lane(scene, paths, batch_path(batch, k), ~0u, lane_state, k);
    }
#endif
}
#endif

#if FEATURE_TEXTURES
// What textures show, slot by slot of those in which the scene has some.
INLINE void evaluate_textures(const SceneView* scene, const LaneBatch* batch, float* lane_state)
{
    int list[LANES + 1];
    for (uint slot = 0u; slot < BSDF_SLOTS; ++slot) {
        if (!(scene->textured_slots & (1u << slot))) continue;
        COMPACT_LANES(list, compacted_count, k, batch->count, has_lane_flag(LANE_SCATTERS, lane_state, k) &
                (scene->bsdfs[load_lane_uint(lane_state, LANE_BSDF, k)].textures[slot] != NONE))
        FOR_LANES(j, compacted_count) {
            if (j >= compacted_count) continue;
            const Surface s = load_surface_lane(lane_state, list[j]);
            const TexturePoint point = texture_point(&s);
            __global const Bsdf* bsdf = scene->bsdfs + load_lane_uint(lane_state, LANE_BSDF, list[j]);
            const bool number = bsdf->numbers & (1u << slot);
            const Vec3 value = number ? splat3(texture_float(&scene->textures, bsdf->textures[slot], &point))
                                      : texture_rgb(&scene->textures, bsdf->textures[slot], &point);
            store_lane3(value, lane_state, LANE_PARAMETERS + 3u * slot, list[j]);
        }
    }
}
#endif

// What a material of this kind scatters of the light, and where a path goes on from it.
INLINE void scatter_lane(const SceneView* scene, const PathState* paths, size_t i, uint kind, float* lane_state, size_t lane)
{
    const BsdfContext ctx = load_bsdf_context_lane(scene, kind, load_planes3(paths->ray_direction, i, paths->plane_stride), lane_state, lane);
#if FEATURE_NEXT_EVENT
    if (kind & ~DELTA_BSDFS) {  // of all: those that looked at no light have none to be asked about, and do no harm
        float pdf = 0.0f;
        const Vec3 scattered = bsdf_eval_kind(kind, &ctx, load_lane3(lane_state, LANE_LIGHT_SAMPLE, lane), &pdf);
        store_lane4(vec4_from(scattered, pdf), lane_state, LANE_BSDF_VALUE, lane);
    }
#endif
    const BsdfSample next = bsdf_sample_kind(kind, &ctx, load_lane3(lane_state, LANE_BSDF_RANDOM, lane));
    store_bsdf_sample_lane(&next, lane_state, lane);
}

// All of one kind. What is soon done is done for all that there are, without a list: to gather them would cost more.
INLINE void scatter_lanes(const SceneView* scene, const PathState* paths, const LaneBatch* batch, uint kind, float* lane_state)
{
    if (kind == BSDF_DIFFUSE) {
        FOR_LANES(k, batch->count) {
            if (k >= batch->count || load_lane_uint(lane_state, LANE_KIND, k) != kind) continue;
            scatter_lane(scene, paths, batch_path(batch, k), kind, lane_state, k);
        }
    } else {
        int list[LANES + 1];
        COMPACT_LANES(list, compacted_count, k, batch->count, load_lane_uint(lane_state, LANE_KIND, k) == kind)
        FOR_LANES(j, compacted_count) {
            if (j >= compacted_count) continue;
            scatter_lane(scene, paths, compacted_path(batch, list[j]), kind, lane_state, list[j]);
        }
    }
}

// Leaves what is to arrive by the shadow rays, and the paths that go on.
INLINE void write_rays(const SceneView* scene, const PathState* paths, const LaneBatch* batch, uint max_depth, uint rr_depth, const float* lane_state)
{
    const uint count = batch->count;
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_SCATTERS, lane_state, k)) continue;
        const size_t i = batch_path(batch, k);
        Path p = load_path(paths, i);
        const Surface s = load_surface_lane(lane_state, k);
        const BsdfContext ctx = load_bsdf_context_lane(scene, 0u, p.direction, lane_state, k);
#if FEATURE_NEXT_EVENT
        if (has_lane_flag(LANE_SAMPLES_LIGHT, lane_state, k)) {
            const LightSample light = load_light_sample_lane(lane_state, k);
            const Vec3 radiance = direct_lighting(&p, &s, &ctx, &light, load_lane3(lane_state, LANE_BSDF_VALUE, k), load_lane(lane_state, LANE_BSDF_VALUE + 3u, k));
            store_planes3(radiance, paths->shadow_radiance, i, paths->plane_stride);
            if (radiance.x + radiance.y + radiance.z == 0.0f) PLANE(3, paths->shadow_direction, paths->plane_stride)[i] = 0.0f;
        }
#endif
        const BsdfSample next = load_bsdf_sample_lane(lane_state, k);
        write_next_ray(paths, i, &p, &s, &ctx, next, load_lane(lane_state, LANE_BSDF_RANDOM + 3u, k), false, rr_depth);
    }
}

INLINE void shade_lanes(const SceneView* scene, const PathState* paths, size_t begin, uint count, uint max_depth, uint rr_depth)
{
    FOR_LANES(k, count) {
        if (k >= count) continue;
        paths->alive[begin + k] = 0;
#if FEATURE_NEXT_EVENT
        PLANE(3, paths->shadow_direction, paths->plane_stride)[begin + k] = 0.0f;
#endif
    }
#if COMPACT_ESCAPED
    int hit_lanes[LANES + 1], escaped_lanes[LANES + 1];
    __global const uint* primitives = (__global const uint*)PLANE(3, paths->hit, paths->plane_stride) + begin;
    COMPACT_LANES(hit_lanes, hit_count, k, count, primitives[k] != NONE)
    COMPACT_LANES(escaped_lanes, escaped_count, k, count, primitives[k] == NONE)
    handle_escaped_rays(scene, paths, begin, escaped_lanes, escaped_count);
    const LaneBatch lane_batch = {begin, hit_lanes, hit_count};
#else
    const LaneBatch lane_batch = {begin, 0, count};
#endif
    const LaneBatch* batch = &lane_batch;
    float lane_state[LANE_FLOATS * LANES];
    process_hits(scene, paths, batch, max_depth, lane_state);
#if FEATURE_AREA_LIGHTS
    handle_emissive_hits(scene, paths, batch, lane_state);
#endif
    draw_random_numbers(scene, paths, batch, lane_state);
#if FEATURE_NEXT_EVENT
#if HAS_LIGHT_IMPORTANCE
    select_lights(scene, batch->count, lane_state);
#endif
    sample_direct_lanes(scene, paths, batch, lane_state);
#endif
#if FEATURE_TEXTURES
    evaluate_textures(scene, batch, lane_state);
#endif
#if FEATURE_DIFFUSE
    scatter_lanes(scene, paths, batch, BSDF_DIFFUSE, lane_state);
#endif
#if FEATURE_DIELECTRIC
    scatter_lanes(scene, paths, batch, BSDF_DIELECTRIC, lane_state);
#endif
#if FEATURE_THIN_DIELECTRIC
    scatter_lanes(scene, paths, batch, BSDF_THIN_DIELECTRIC, lane_state);
#endif
#if FEATURE_CONDUCTOR
    scatter_lanes(scene, paths, batch, BSDF_CONDUCTOR, lane_state);
#endif
#if FEATURE_ROUGH_CONDUCTOR
    scatter_lanes(scene, paths, batch, BSDF_ROUGH_CONDUCTOR, lane_state);
#endif
#if FEATURE_ROUGH_DIELECTRIC
    scatter_lanes(scene, paths, batch, BSDF_ROUGH_DIELECTRIC, lane_state);
#endif
#if FEATURE_PLASTIC
    scatter_lanes(scene, paths, batch, BSDF_PLASTIC, lane_state);
#endif
#if FEATURE_ROUGH_PLASTIC
    scatter_lanes(scene, paths, batch, BSDF_ROUGH_PLASTIC, lane_state);
#endif
#if FEATURE_PRINCIPLED
    scatter_lanes(scene, paths, batch, BSDF_PRINCIPLED, lane_state);
#endif
    write_rays(scene, paths, batch, max_depth, rr_depth, lane_state);
}
#endif
