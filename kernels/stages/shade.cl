// Stage: what happens where the rays ended: emission, next-event estimation, the next direction, roulette.
// Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the path is alive.
//
// On devices where a work-item takes several paths, they are shaded together, in steps: path/shade_lanes.h.
#undef LANES
#define LANES SHADE_LANES
#include "path/shade_lanes.h"

#if LANES == 1
INLINE void shade_path(const SceneView* scene, const PathState* paths, size_t i, uint max_depth, uint rr_depth)
{
    Path p = load_path(paths, i);
    Surface s = hit_surface(scene, paths, i, &p);
    bool shines;
    const bool scatters = process_hit(scene, paths, i, &p, &s, true, &shines);
#if FEATURE_AREA_LIGHTS
    if (shines) ADD3(emission_contribution(scene, &p, &s, previous_light_pmf(scene, &p, s.light)), p.sample, paths->samples);
#endif
    const bool last = p.depth + 1u >= max_depth;
    if (!scatters) return;
    if (!FEATURE_VOLPATH && last) return;
    BsdfContext ctx;
    const bool passes = make_bsdf_context(scene, &p, &s, &ctx);
#if HAS_PASS_THROUGH && !FEATURE_VOLPATH
    if (passes) {
        continue_behind_unweighted(paths, i, &p, &s);
        return;
    }
#endif
#if FEATURE_NEXT_EVENT
    sample_direct(scene, paths, i, &p, &s, &ctx, !passes && !last);
#endif
    const Vec4 u = path_random(scene, &p, BLOCK_BSDF(dimension_of(&p)));
    const BsdfSample next = passes ? null_bsdf_sample(p.direction) : bsdf_sample(&ctx, xyz(u));
    write_next_ray(paths, i, &p, &s, &ctx, next, u.w, last, rr_depth);
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
#if LANES > 1
    shade_lanes(&scene, &paths, begin, (uint)MIN(path_count - begin, (size_t)LANES), max_depth, rr_depth);
#else
    alive[begin] = 0;
#if FEATURE_NEXT_EVENT
    PLANE(3, shadow_direction, plane_stride)[begin] = 0.0f;
#endif
    shade_path(&scene, &paths, begin, max_depth, rr_depth);
#endif
}
