// Where paths arrive: what shines there, and what there is to scatter them.
#pragma once
#include "bsdf/bsdf.h"
#include "light/light.h"
#include "bsdf/nested.h"
#include "media/medium.h"
#include "path/path_state.h"
#include "util/random.h"

// Buffers of the paths in flight, one plane a member: host/isonoise/integrator/kernel_table.py.
typedef struct {
#include "generated/path_state_members.h"
} PathState;

// A path at the end of its ray.
typedef struct {
    Vec3 origin, direction, throughput;
    float direction_pdf;       // negative if a delta lobe was sampled
    float eta;                 // relative index of refraction so far, for Russian roulette
    float distance, u, v;      // of the hit
    uint primitive;            // that was hit, NONE if the ray escaped
    uint start_primitive;      // that the ray starts on
    uint sample, pixel, index, depth;
    Vec3 mis_origin;           // the vertex that the direction was sampled at
    bool in_volume;            // scattered in the medium before the hit
    // null_bounces: pass-through surfaces so far; mis_distance: distance from mis_origin to the hit;
    // medium: that the ray runs through; mis_normal: `light_sampling_normal` at mis_origin
#include "generated/path_members.h"
} Path;

INLINE Path load_path(const PathState* paths, size_t i)
{
    const uint plane_stride = paths->plane_stride;
    const Vec4 hit = load_planes4(paths->hit, i, plane_stride), throughput = load_planes4(paths->throughput, i, plane_stride);
    const Vec4 direction = load_planes4(paths->ray_direction, i, plane_stride);
    Path p;
    p.origin = load_planes3(paths->ray_origin, i, plane_stride);
    p.direction = xyz(direction);
    p.direction_pdf = direction.w;
    p.throughput = xyz(throughput);
    p.eta = throughput.w;
    p.distance = hit.x;
    p.u = hit.y;
    p.v = hit.z;
    p.primitive = as_uint(hit.w);
    p.start_primitive = PLANE(PATH_START_PRIMITIVE, paths->path, plane_stride)[i];
    p.sample = PLANE(PATH_SAMPLE, paths->path, plane_stride)[i];
    p.pixel = paths->sample_pixel[(int)p.sample];
    p.index = PLANE(PATH_SAMPLE_INDEX, paths->path, plane_stride)[i];
    p.depth = PLANE(PATH_DEPTH, paths->path, plane_stride)[i];
    p.in_volume = false;
    p.mis_origin = p.origin;
#include "generated/load_path_members.h"
#if FEATURE_VOLPATH
    // a pass-through surface is no vertex: mis_distance is that from the last vertex to the ray's origin
    p.mis_origin = sub3(p.origin, scale3(p.direction, p.mis_distance));
    p.mis_distance += p.distance;
#else
    p.mis_distance = p.distance;
#endif
    return p;
}

INLINE Vec4 path_random(const SceneView* scene, const Path* p, uint block)
{
    return random_block(scene->seed, p->pixel, p->index, block);
}

// Places in a path's order of events, by which its random numbers are counted.
INLINE uint dimension_of(const Path* p)
{
    return p->depth + p->null_bounces;
}

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS || FEATURE_NEXT_EVENT
// Veach and Guibas, "Optimally Combining Sampling Techniques", 1995: power heuristic with exponent 2; `pdf` made the sample.
// A negative pdf stands for a delta function, which no other technique can sample.
INLINE float mis_weight(float pdf, float other)
{
    const float ratio = other / pdf;
    return pdf < 0.0f ? 1.0f : 1.0f / (1.0f + ratio * ratio);
}
#endif

#if FEATURE_TRIANGLES
// Whether a ray that starts on a triangle has met one that goes on in its plane; where one of them is an instance's, or it starts
// on none, whether it grazes.
INLINE bool hits_coplanar_neighbour(const SceneView* scene, const PathState* paths, size_t i, const Path* p, const Surface* s)
{
#if FEATURE_INSTANCES
    const bool both_in_world = p->start_primitive < scene->world_triangles && paths->instance[i] == NONE;
#else
    const bool both_in_world = !(p->start_primitive & ANALYTIC_BIT);
#endif
    if (both_in_world) {
        const Vec3 normal = LOAD3_AT((int)TRIANGLE_FLOATS * (int)p->start_primitive + 12, scene->triangles);
        return abs_float(dot3(normal, s->geometric_normal)) > 0.999f;
    }
    return abs_float(dot3(p->direction, s->geometric_normal)) < 0.5f;
}

// Whether a ray's origin lies in the plane of the surface that it seems to have met, as far as rounding can tell: it comes from a
// neighbour in the same plane, and may be said to come from the wrong side of it. Such a path ends; it is one in millions, where
// the light of the other side would be seen to leak through. Both points carry an error, the origin was moved by its own. Beside
// an edge with a wall at an angle origins lie in its plane too, far from the world's origin even most of them: those go on.
INLINE bool origin_lies_in_plane(const SceneView* scene, const PathState* paths, size_t i, const Path* p, const Surface* s)
{
    const float distance = abs_float(dot3(sub3(p->origin, s->position), s->geometric_normal));
    const Vec3 error = add3(s->error, scale3(abs3(p->origin), GAMMA(7)));
    return distance <= 1.25f * dot3(abs3(s->geometric_normal), error) && hits_coplanar_neighbour(scene, paths, i, p, s);
}
#endif

#if (FEATURE_HIDE_EMITTERS && FEATURE_AREA_LIGHTS) || (HAS_PASS_THROUGH && !FEATURE_VOLPATH)
// Lets a path go on behind a surface as if there was none. Returns where it starts then.
INLINE void continue_behind(const PathState* paths, size_t i, const Path* p, const Surface* s)
{
    const Vec3 behind = offset_ray_origin(s->position, s->error, s->geometric_normal, p->direction);
    store_planes4(vec4_from(behind, INFINITY), paths->ray_origin, i, paths->plane_stride);
    PLANE(PATH_START_PRIMITIVE, paths->path, paths->plane_stride)[i] = p->primitive;
    paths->alive[i] = 1;
}
#endif

#if HAS_PASS_THROUGH && !FEATURE_VOLPATH
// The same where a material lets a path through: next-event estimation did not see what is behind, it takes part in no weight.
INLINE void continue_behind_unweighted(const PathState* paths, size_t i, const Path* p, const Surface* s)
{
    continue_behind(paths, i, p, s);
    PLANE(3, paths->ray_direction, paths->plane_stride)[i] = -1.0f;
    PLANE(PATH_DEPTH, paths->path, paths->plane_stride)[i] = p->depth + 1u;
}
#endif

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS
// Probability with which a light would have been picked at a path's last vertex.
INLINE float previous_light_pmf(const SceneView* scene, const Path* p, uint light)
{
    return light_pmf(scene, light, p->mis_origin, p->mis_normal, p->direction_pdf);
}
#endif

#if HAS_ENVIRONMENT_LIGHT
// What a path brings that leaves the scene; `pick`: the probability with which the sky would have been picked at its last vertex.
INLINE Vec3 environment_contribution(const SceneView* scene, const Path* p, float pick)
{
    float pdf = 0.0f;
    const Light sky = Light_at(scene->lights, scene->environment_light);
    const Vec3 radiance = environment_radiance(scene, &sky, p->direction, &pdf);
    return scale3(mul3(p->throughput, radiance), mis_weight(p->direction_pdf, pick * pdf));
}
#endif

#if FEATURE_AREA_LIGHTS
// What a path brings that meets a light; `pick`: the probability with which it would have been picked.
INLINE Vec3 emission_contribution(const SceneView* scene, const Path* p, const Surface* s, float pick)
{
    const Light light_record = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? s->light : 0u), *light = &light_record;
    const float pdf = pick * light_pdf(scene, light, p->mis_origin, p->direction, p->mis_distance, s->normal);
    return scale3(mul3(p->throughput, emitted_radiance(scene, light, s)), mis_weight(p->direction_pdf, pdf));
}
#endif

// The surface that the path met, if it met one.
INLINE Surface hit_surface(const SceneView* scene, const PathState* paths, size_t i, const Path* p)
{
    if (p->primitive == NONE) return empty_surface();
#if FEATURE_INSTANCES
    return instanced_surface_of_hit(scene, paths->instance[i], p->primitive, p->origin, p->direction,
                                p->distance, p->u, p->v);
#else
    return surface_of_hit(scene, p->primitive, p->origin, p->direction, p->distance, p->u, p->v);
#endif
}

// Brings the path to the surface, or to a volume before it that takes its place. Returns whether it may be scattered there.
// `may_miss`: whether there may be none. `shines`: whether it met a light, whose emission is still to be added.
INLINE bool process_hit(const SceneView* scene, const PathState* paths, size_t i, Path* p, Surface* s, bool may_miss, bool* shines)
{
    bool from_volume = false;
    *shines = false;
#if FEATURE_MEDIA
    float flown = p->distance;
    if (p->medium != MEDIUM_NONE)
        p->in_volume = sample_medium(scene->media + p->medium, path_random(scene, p, BLOCK_MEDIUM(dimension_of(p))), &flown, &p->throughput);
    from_volume = p->start_primitive == NONE;
#endif
    if (may_miss && !p->in_volume && p->primitive == NONE) {
#if HAS_ENVIRONMENT_LIGHT
        if (!FEATURE_HIDE_EMITTERS || p->depth > 0u) ADD3(environment_contribution(scene, p, previous_light_pmf(scene, p, scene->environment_light)), p->sample, paths->samples);
#endif
        return false;
    }
    if (!p->in_volume && dot3(s->geometric_normal, s->geometric_normal) == 0.0f) return false;
#if FEATURE_TRIANGLES
    if (!(p->in_volume || from_volume) && !(p->primitive & ANALYTIC_BIT) && origin_lies_in_plane(scene, paths, i, p, s)) return false;
#endif
#if FEATURE_MEDIA
    if (p->in_volume) {
        make_medium_vertex(s, p->primitive != NONE, p->origin, p->direction, flown, p->distance, scene->media[p->medium].phase);
        PLANE(3, paths->hit, paths->plane_stride)[i] = as_float(NONE);  // the shadow ray starts on no primitive
    }
#endif
#if FEATURE_AREA_LIGHTS
    if (s->light != NONE) {
#if FEATURE_HIDE_EMITTERS
        if (p->depth == 0u) {  // seen by the camera, the light is not there
            continue_behind(paths, i, p, s);
#if FEATURE_VOLPATH
            store_planes3(p->throughput, paths->throughput, i, paths->plane_stride);
            paths->null_bounces[i] = p->null_bounces + 1u;
#endif
            return false;
        }
#endif
        *shines = dot3(s->normal, p->direction) < 0.0f;
    }
#endif
    return true;
}

// The material there. Returns whether it lets the path through as if there was none.
INLINE bool make_bsdf_context(const SceneView* scene, const Path* p, const Surface* s, BsdfContext* ctx)
{
    ctx->bsdfs = scene->bsdfs;
    ctx->bsdf = s->bsdf;
    ctx->normal = s->normal;
    ctx->wi = neg3(p->direction);
    ctx->cos_i = dot3(ctx->normal, ctx->wi);
#if HAS_BUMPS
    ctx->flipped = false;
    ctx->shadow = NO_BUMP;
#endif
#if HAS_FRAMES
    set_shading_frame(ctx, s);
#endif
#if FEATURE_ROUGH_PLASTIC
    ctx->rough_transmittances = scene->rough_transmittances;
#endif
#if FEATURE_TEXTURES
    ctx->textures = &scene->textures;
    ctx->point = texture_point(s);
#endif
#if HAS_NESTED_BSDFS
    const bool passes = resolve_nested_bsdf(ctx, s, path_random(scene, p, BLOCK_MATERIAL(dimension_of(p))).x);
#else
    const bool passes = FEATURE_NULL && (material(ctx).kind & BSDF_NULL);
#endif
#if FEATURE_TWOSIDED
    if ((material(ctx).flags & BSDF_TWOSIDED) && ctx->cos_i < 0.0f) flip_to_viewer(ctx);
#endif
    return passes;
}
