// Stage: shades the hits. Adds emission, samples a light for next-event estimation, samples the BSDF, applies Russian
// roulette. Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the
// path is alive.
//
// Two forms compute the same. `shade_lanes` shades LANES paths: on CPUs with PoCL, without FEATURE_VOLPATH. Every step
// is a loop over the lanes, because the compiler vectorises short loops only, and values go from step to step as lane
// state. On cornell, vectorised loops made this stage 2.9 times as fast, and a loop for every step 1.25 times again.
// `shade_path` shades one path and keeps it in registers: on all other devices, and with FEATURE_VOLPATH. One form for
// both would spill 70 floats a path to memory on GPUs, and the lane state would have to hold what a medium changes of a
// path.
//
//   step                    shade_path                            shade_lanes
//   environment, hits       advance_to_vertex                     handle_escaped_rays, advance_to_vertices
//   emission                emission_contribution                 handle_emissive_hits
//   BSDF                    prepare_bsdf                          advance_to_vertices
//   next-event estimation   sample_direct                         draw_random_numbers, select_lights, sample_lights,
//                                                                 scatter_lanes (eval), write_rays (MIS)
//   BSDF sample             bsdf_sample                           evaluate_textures, scatter_lanes
//   next ray                continue_path                         write_rays
#include "path/shade_lanes.h"

#if LANES == 1
INLINE void shade_path(const SceneView* scene, const PathBuffers* paths, size_t i, uint max_depth, uint rr_depth)
{
    paths->alive[i] = 0;
#if FEATURE_NEXT_EVENT
    PLANE(3, paths->shadow_direction, paths->plane_stride)[i] = 0.0f;
#endif

    Path p = load_path(paths, i);
    Surface s = hit_surface(scene, paths, i, &p);
    bool hits_emitter;
    const bool scatters = advance_to_vertex(scene, paths, i, &p, &s, true, &hits_emitter);
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
    const bool passes_through = prepare_bsdf(scene, &p, &s, &ctx);
#if HAS_NULL_BSDFS && !FEATURE_VOLPATH
    if (passes_through) {
        continue_behind_unweighted(paths, i, &p, &s);
        return;
    }
#endif

#if FEATURE_NEXT_EVENT
    if (!passes_through && !is_last) sample_direct(scene, paths, i, &p, &s, &ctx);
#endif

    const Vec4 u = path_random(scene, &p, BLOCK_BSDF(random_vertex_index(&p)));
    const BsdfSample sample = passes_through ? null_bsdf_sample(p.direction) : bsdf_sample(&ctx, vec3(u.z, u.x, u.y));
    continue_path(paths, i, &p, &s, &ctx, sample, u.w, is_last, rr_depth);
}
#else
INLINE void shade_lanes(const SceneView* scene, const PathBuffers* paths, size_t begin, uint count, uint max_depth,
                        uint rr_depth)
{
    clear_outputs(paths, begin, count);

#if COMPACT_ESCAPED
    int hit_lanes[LANES + 1], escaped_lanes[LANES + 1];
    __global const uint* hit_primitives = (__global const uint*)PLANE(3, paths->hit, paths->plane_stride) + begin;
    COMPACT_LANES(hit_lanes, hit_count, k, count, hit_primitives[k] != NONE)
    COMPACT_LANES(escaped_lanes, escaped_count, k, count, hit_primitives[k] == NONE)
    handle_escaped_rays(scene, paths, begin, escaped_lanes, escaped_count);
    const HitLanes compacted = {begin, hit_lanes, hit_count};
#else
    const HitLanes compacted = {begin, 0, count};
#endif
    const HitLanes* hits = &compacted;
    float lane_state[LANE_FLOATS * LANES];
    advance_to_vertices(scene, paths, hits, max_depth, lane_state);
#if FEATURE_AREA_LIGHTS
    handle_emissive_hits(scene, paths, hits, lane_state);
#endif

    draw_random_numbers(scene, paths, hits, lane_state);
#if FEATURE_NEXT_EVENT
#if FEATURE_MANY_LIGHTS
    select_lights(scene, hits, lane_state);
#endif
    sample_lights(scene, paths, hits, lane_state);
#endif

#if FEATURE_TEXTURES
    evaluate_textures(scene, hits, LANE_FLAG_SCATTERS, LANE_BSDF, lane_state);
#endif
#define SCATTER_KIND(BIT, name) scatter_lanes(scene, paths, hits, BIT, lane_state);
    FOR_BSDFS(SCATTER_KIND)
#if HAS_BLEND_LIGHTING
#if FEATURE_TEXTURES
    evaluate_textures(scene, hits, LANE_FLAG_BLENDS, LANE_OTHER_BSDF, lane_state);
#endif
#define EVALUATE_OTHER(BIT, name) evaluate_other_lanes(scene, paths, hits, BIT, lane_state);
    FOR_NON_DELTA_BSDFS(EVALUATE_OTHER)
#endif
    write_rays(scene, paths, hits, rr_depth, lane_state);
}
#endif

__kernel void shade(
#include "generated/shade_parameters.h"
)
{
    SceneView scene;
#include "generated/shade_scene_view.h"
    scene.environment_light = FEATURE_MANY_LIGHTS ? environment_light : 0u;
    PathBuffers paths;
#include "generated/shade_path_buffers.h"
    const size_t begin = get_global_id(0) * LANES;
    if (begin >= path_count) return;
#if LANES == 1
    shade_path(&scene, &paths, begin, max_depth, rr_depth);
#else
    shade_lanes(&scene, &paths, begin, (uint)MIN(path_count - begin, (size_t)LANES), max_depth, rr_depth);
#endif
}
