// Stage: shades the hits. Adds emission, samples a light for next-event estimation, samples the BSDF, applies Russian
// roulette. Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the
// path is alive.
//
// It has two forms that do the same, step by step. `shade_path` shades one path and keeps it in registers.
// `shade_lanes` shades LANES paths of a CPU's work-item; each step is a loop of its own over the lanes, because the
// compiler vectorises short loops only, and what a step needs from an earlier one is kept as lane state. On cornell,
// vectorised loops made this stage 2.9 times as fast, and a loop a step 1.25 times again. One form for both would cost
// `shade_path` its registers (70 floats of private memory a path), and `shade_lanes` would have to carry what media
// change of a path; it does not support FEATURE_VOLPATH.
#include "path/shade_lanes.h"

#if LANES == 1
INLINE void shade_path(const SceneView* scene, const PathState* paths, size_t i, uint max_depth, uint rr_depth)
{
    paths->alive[i] = 0;
#if FEATURE_NEXT_EVENT
    PLANE(3, paths->shadow_direction, paths->plane_stride)[i] = 0.0f;
#endif

    Path p = load_path(paths, i);
    Surface s = hit_surface(scene, paths, i, &p);
    bool hits_emitter;
    const bool scatters = process_hit(scene, paths, i, &p, &s, true, &hits_emitter);
#if FEATURE_AREA_LIGHTS
    if (hits_emitter) {
        const float pmf = previous_light_pmf(scene, &p, s.light);
        ADD3(emission_contribution(scene, &p, &s, pmf), p.sample, paths->samples);
    }
#endif

    const bool is_last = p.depth + 1u >= max_depth;
    if (!scatters) return;
#if !FEATURE_VOLPATH
    if (is_last) return;
#endif
    BsdfContext ctx;
    const bool passes_through = make_bsdf_context(scene, &p, &s, &ctx);
#if HAS_PASS_THROUGH && !FEATURE_VOLPATH
    if (passes_through) {
        continue_behind_unweighted(paths, i, &p, &s);
        return;
    }
#endif

#if FEATURE_NEXT_EVENT
    if (!passes_through && !is_last) sample_direct(scene, paths, i, &p, &s, &ctx);
#endif

    const Vec4 u = path_random(scene, &p, BLOCK_BSDF(dimension_of(&p)));
    const BsdfSample sample = passes_through ? null_bsdf_sample(p.direction) : bsdf_sample(&ctx, xyz(u));
    write_next_ray(paths, i, &p, &s, &ctx, sample, u.w, is_last, rr_depth);
}
#else
INLINE void shade_lanes(const SceneView* scene, const PathState* paths, size_t begin, uint count, uint max_depth,
                        uint rr_depth)
{
    clear_outputs(paths, begin, count);

#if COMPACT_ESCAPED
    int hit_lanes[LANES + 1], escaped_lanes[LANES + 1];
    __global const uint* hit_primitives = (__global const uint*)PLANE(3, paths->hit, paths->plane_stride) + begin;
    COMPACT_LANES(hit_lanes, hit_count, k, count, hit_primitives[k] != NONE)
    COMPACT_LANES(escaped_lanes, escaped_count, k, count, hit_primitives[k] == NONE)
    handle_escaped_rays(scene, paths, begin, escaped_lanes, escaped_count);
    const LaneBatch hits = {begin, hit_lanes, hit_count};
#else
    const LaneBatch hits = {begin, 0, count};
#endif
    const LaneBatch* batch = &hits;
    float lane_state[LANE_FLOATS * LANES];
    process_hits(scene, paths, batch, max_depth, lane_state);
#if FEATURE_AREA_LIGHTS
    handle_emissive_hits(scene, paths, batch, lane_state);
#endif

    draw_random_numbers(scene, paths, batch, lane_state);
#if FEATURE_NEXT_EVENT
#if HAS_LIGHT_IMPORTANCE
    select_lights(scene, batch, lane_state);
#endif
    sample_direct_lanes(scene, paths, batch, lane_state);
#endif

#if FEATURE_TEXTURES
    evaluate_textures(scene, batch, lane_state);
#endif
#define SCATTER_KIND(BIT, name) scatter_lanes(scene, paths, batch, BIT, lane_state);
    FOR_BSDFS(SCATTER_KIND)
    write_rays(scene, paths, batch, rr_depth, lane_state);
}
#endif

__kernel void shade(
#include "generated/shade_parameters.h"
)
{
    SceneView scene;
#include "generated/shade_scene_view.h"
    scene.environment_light = FEATURE_MANY_LIGHTS ? environment_light : 0u;
    PathState paths;
#include "generated/shade_path_state.h"
    const size_t begin = get_global_id(0) * LANES;
    if (begin >= path_count) return;
#if LANES == 1
    shade_path(&scene, &paths, begin, max_depth, rr_depth);
#else
    shade_lanes(&scene, &paths, begin, (uint)MIN(path_count - begin, (size_t)LANES), max_depth, rr_depth);
#endif
}
