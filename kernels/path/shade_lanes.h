// The steps of `shade_lanes` (stages/shade.cl) that scatter the paths: next-event estimation, textures, BSDFs, the
// next rays. Each is a loop over the lanes that need it, short enough to be vectorised. Lanes are compacted by the kind
// of the selected light and by the kind of BSDF. Checkerboards cannot be vectorised and run lane by lane.
#pragma once
#include "path/hit_lanes.h"

#if LANES > 1
// Random numbers of every path for its light sample and its BSDF sample.
INLINE void draw_random_numbers(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits,
                                float* lane_state)
{
    const uint count = hits->count;
    FOR_LANES(k, count) {
        if (k >= count) continue;
        const Path p = load_path(paths, hit_path(hits, k));
        const Vec4 u = path_random(scene, &p, BLOCK_BSDF(random_vertex_index(&p)));
        store_lane4(vec4(u.z, u.x, u.y, u.w), lane_state, LANE_BSDF_RANDOM, k);  // in the order of use
#if FEATURE_NEXT_EVENT
        const Vec4 v = path_random(scene, &p, BLOCK_LIGHT(random_vertex_index(&p)));
        store_lane(v.x, lane_state, LANE_LIGHT_U, k);
        store_lane(v.y, lane_state, LANE_LIGHT_V, k);
#if FEATURE_MANY_LIGHTS
        store_lane(v.z, lane_state, LANE_LIGHT_U_LOW, k);
#endif
#endif
    }
}

#if FEATURE_NEXT_EVENT
#if FEATURE_LIGHT_LIST
INLINE void select_lights(const SceneView* scene, const HitLanes* hits, float* lane_state)
{
    select_lights_from_list(&scene->light_list, lane_state + LANE_POSITION * LANES,
                            lane_state + LANE_MIS_NORMAL * LANES, lane_state + LANE_LIGHT_U * LANES,
                            lane_state + LANE_SELECTED_LIGHT * LANES, hits->count);
}
#elif FEATURE_LIGHT_TREE
INLINE void select_lights(const SceneView* scene, const HitLanes* hits, float* lane_state)
{
    int list[LANES + 1];
    COMPACT_LANES(list, list_count, k, hits->count, has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k))
    select_lights_from_tree(&scene->light_tree, lane_state + LANE_POSITION * LANES,
                            lane_state + LANE_MIS_NORMAL * LANES, list, list_count, lane_state + LANE_LIGHT_U * LANES,
                            lane_state + LANE_SELECTED_LIGHT * LANES, hits->count);
}
#elif FEATURE_MANY_LIGHTS
INLINE void select_lights(const SceneView* scene, const HitLanes* hits, float* lane_state)
{
    select_lights_by_power(scene, lane_state + LANE_LIGHT_U * LANES, lane_state + LANE_SELECTED_LIGHT * LANES,
                           hits->count);
}
#endif

// Samples the selected light, which is of one of `kinds`, and writes the shadow ray.
INLINE void sample_light_lane(const SceneView* scene, const PathBuffers* paths, size_t i, uint kinds, float* lane_state,
                              size_t lane)
{
    const LightSelection selection = load_light_selection_lane(lane_state, lane);
    const Path p = load_path(paths, i);
    const Surface s = load_surface_lane(lane_state, lane);
    const float v = load_lane(lane_state, LANE_LIGHT_V, lane);
    const LightSample light = sample_light_of_kind(kinds, scene, selection, s.position, v);
    if (selection.probability > 0.0f && can_contribute(&light)) {
        write_shadow_ray(paths, i, &p, &s, &light);
        store_light_sample_lane(&light, lane_state, lane);
    } else {
        clear_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, lane);
    }
}

#if HAS_MESH_LIGHTS && HAS_NON_MESH_LIGHTS
INLINE bool selected_mesh_light(const SceneView* scene, const float* lane_state, size_t lane)
{
    return Light_at(scene->lights, load_lane_uint(lane_state, LANE_SELECTED_LIGHT, lane)).kind & LIGHT_MESH;
}
#endif

#if FEATURE_ENVIRONMENT_MAP
// Where the environment map was selected: replaces the random numbers of the position by the position in the map.
INLINE void find_envmap_positions(const SceneView* scene, uint count, float* lane_state)
{
    float x[LANES], y[LANES];
    FOR_LANES(k, count) {
        x[k] = k < count ? load_lane(lane_state, LANE_LIGHT_U, k) : 0.0f;
        y[k] = k < count ? load_lane(lane_state, LANE_LIGHT_V, k) : 0.0f;
    }
    envmap_positions(&scene->envmap, x, y, count);
    FOR_LANES(k, count) {
        if (k >= count) continue;
#if FEATURE_MANY_LIGHTS
        const uint light = load_lane_uint(lane_state, LANE_SELECTED_LIGHT, k);
        if (!(Light_at(scene->lights, light).kind & LIGHT_ENVIRONMENT_MAP)) continue;
#endif
        store_lane(x[k], lane_state, LANE_LIGHT_U, k);
        store_lane(y[k], lane_state, LANE_LIGHT_V, k);
    }
}
#endif

INLINE void sample_lights(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits, float* lane_state)
{
    const uint count = hits->count;
#if FEATURE_ENVIRONMENT_MAP
    find_envmap_positions(scene, count, lane_state);
#endif
#if HAS_MESH_LIGHTS && HAS_NON_MESH_LIGHTS
    int list[LANES + 1];
    COMPACT_LANES(list, other_count, k, count,
                  has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k) & !selected_mesh_light(scene, lane_state, k))
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k) ||
            !selected_mesh_light(scene, lane_state, k))
            continue;
        sample_light_lane(scene, paths, hit_path(hits, k), LIGHT_MESH, lane_state, k);
    }
    FOR_LANES(j, other_count) {
        if (j >= other_count) continue;
        sample_light_lane(scene, paths, compacted_path(hits, list[j]), ~LIGHT_MESH, lane_state, list[j]);
    }
#else
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k)) continue;
        sample_light_lane(scene, paths, hit_path(hits, k), HAS_MESH_LIGHTS ? LIGHT_MESH : ~0u, lane_state, k);
    }
#endif
}
#endif

#if FEATURE_TEXTURES
// Texture values of all BSDF parameters, BSDF slot by BSDF slot. `member`: the BSDF is in LANE_BSDF or LANE_OTHER_BSDF.
INLINE void evaluate_textures(const SceneView* scene, const HitLanes* hits, uint flag, uint member, float* lane_state)
{
    int list[LANES + 1];
    for (uint slot = 0u; slot < BSDF_SLOTS; ++slot) {
        if (!(scene->textured_slots & (1u << slot))) continue;
        COMPACT_LANES(list, textured_count, k, hits->count,
                      has_lane_flag(flag, lane_state, k) &
                          (scene->bsdfs[load_lane_uint(lane_state, member, k)].textures[slot] != NONE))
        FOR_LANES(j, textured_count) {
            if (j >= textured_count) continue;
            const Surface s = load_surface_lane(lane_state, list[j]);
            const TexturePoint point = texture_point(&s);
            __global const Bsdf* bsdf = scene->bsdfs + load_lane_uint(lane_state, member, list[j]);
            const bool is_number = bsdf->number_slots & (1u << slot);
            const Vec3 value = is_number ? splat3(texture_float(&scene->textures, bsdf->textures[slot], &point))
                                         : texture_rgb(&scene->textures, bsdf->textures[slot], &point);
            store_lane3(value, lane_state, LANE_PARAMETERS + 3u * slot, list[j]);
        }
    }
}
#endif

// Evaluates a BSDF of this kind for the light sample, and samples it for the next direction.
INLINE void scatter_lane(const SceneView* scene, const PathBuffers* paths, size_t i, uint kind, float* lane_state,
                         size_t lane)
{
    const Vec3 direction = load_planes3(paths->ray_direction, i, paths->plane_stride);
    const BsdfContext ctx = load_bsdf_context_lane(scene, kind, direction, lane_state, lane);
#if FEATURE_NEXT_EVENT
    if (kind &
        ~DELTA_BSDFS) {  // also for lanes without a light sample, whose result is not used: cheaper than to skip them
        float pdf = 0.0f;
        const Vec3 value = bsdf_eval_kind(kind, &ctx, load_lane3(lane_state, LANE_LIGHT_DIRECTION, lane), &pdf);
        store_lane4(vec4_from(value, pdf), lane_state, LANE_BSDF_VALUE, lane);
    }
#endif
    const BsdfSample sample = bsdf_sample_kind(kind, &ctx, load_lane3(lane_state, LANE_BSDF_RANDOM, lane));
    store_bsdf_sample_lane(&sample, lane_state, lane);
}

// All lanes of one kind of BSDF. Some kinds are so cheap that compaction would cost more than masking.
INLINE void scatter_lanes(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits, uint kind,
                          float* lane_state)
{
    if (kind & UNCOMPACTED_BSDFS) {
        FOR_LANES(k, hits->count) {
            if (k >= hits->count || load_lane_uint(lane_state, LANE_BSDF_KIND, k) != kind) continue;
            scatter_lane(scene, paths, hit_path(hits, k), kind, lane_state, k);
        }
    } else {
        int list[LANES + 1];
        COMPACT_LANES(list, kind_count, k, hits->count, load_lane_uint(lane_state, LANE_BSDF_KIND, k) == kind)
        FOR_LANES(j, kind_count) {
            if (j >= kind_count) continue;
            scatter_lane(scene, paths, compacted_path(hits, list[j]), kind, lane_state, list[j]);
        }
    }
}

#if HAS_BLEND_LIGHTING
// Evaluates the other parts of blends that are of this kind for the light sample.
INLINE void evaluate_other_lanes(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits, uint kind,
                                 float* lane_state)
{
    int list[LANES + 1];
    COMPACT_LANES(list, kind_count, k, hits->count,
                  has_lane_flag(LANE_FLAG_BLENDS, lane_state, k) &
                      has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k) &
                      (scene->bsdfs[load_lane_uint(lane_state, LANE_OTHER_BSDF, k)].kind == kind))
    FOR_LANES(j, kind_count) {
        if (j >= kind_count) continue;
        const size_t lane = list[j];
        const Vec3 direction = load_planes3(paths->ray_direction, compacted_path(hits, list[j]), paths->plane_stride);
        BsdfContext ctx = load_bsdf_context_lane(scene, kind, direction, lane_state, lane);
        ctx.bsdf = load_lane_uint(lane_state, LANE_OTHER_BSDF, lane);
        float pdf = 0.0f;
        const Vec3 value = bsdf_eval_kind(kind, &ctx, load_lane3(lane_state, LANE_LIGHT_DIRECTION, lane), &pdf);
        store_lane4(vec4_from(value, pdf), lane_state, LANE_OTHER_VALUE, lane);
    }
}
#endif

// Writes the radiance of the shadow rays, and the rays of the paths that continue.
INLINE void write_rays(const SceneView* scene, const PathBuffers* paths, const HitLanes* hits, uint rr_depth,
                       const float* lane_state)
{
    const uint count = hits->count;
    FOR_LANES(k, count) {
        if (k >= count || !has_lane_flag(LANE_FLAG_SCATTERS, lane_state, k)) continue;
        const size_t i = hit_path(hits, k);
        const Path p = load_path(paths, i);
        const Surface s = load_surface_lane(lane_state, k);
        const BsdfContext ctx = load_bsdf_context_lane(scene, 0u, p.direction, lane_state, k);
#if FEATURE_NEXT_EVENT
        if (has_lane_flag(LANE_FLAG_SAMPLES_LIGHT, lane_state, k)) {
            const LightSample light = load_light_sample_lane(lane_state, k);
            Vec4 value = load_lane4(lane_state, LANE_BSDF_VALUE, k);
#if HAS_BLEND_LIGHTING
            if (has_lane_flag(LANE_FLAG_BLENDS, lane_state, k))
                value = blend_value(&light, value, load_lane4(lane_state, LANE_OTHER_VALUE, k),
                                    load_lane(lane_state, LANE_OTHER_WEIGHT, k));
#endif
            const Vec3 radiance = direct_lighting(&p, &s, &ctx, &light, xyz(value), value.w);
            store_planes3(radiance, paths->shadow_radiance, i, paths->plane_stride);
            if (radiance.x + radiance.y + radiance.z == 0.0f)
                PLANE(3, paths->shadow_direction, paths->plane_stride)[i] = 0.0f;
        }
#endif
        const BsdfSample sample = load_bsdf_sample_lane(lane_state, k);
        continue_path(paths, i, &p, &s, &ctx, sample, load_lane(lane_state, LANE_BSDF_RANDOM + 3, k), false, rr_depth);
    }
}
#endif
