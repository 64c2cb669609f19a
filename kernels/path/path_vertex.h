// A path at the end of its ray: the vertex it reaches, the emission found there, and the BSDF context for scattering
// it. Both forms of stages/shade.cl call it.
#pragma once
#include "bsdf/bsdf.h"
#include "bsdf/nested.h"
#include "light/light.h"
#include "media/heterogeneous.h"
#include "media/medium.h"
#include "path/path_state.h"
#include "util/random.h"

// Buffers of the paths in flight, one plane a member: host/isonoise/integrator/kernel_table.py.
typedef struct {
#include "generated/path_buffers_members.h"
} PathBuffers;

// A path at the end of its ray.
typedef struct {
    Vec3 origin, direction, throughput;
    float direction_pdf;   // PDF_WITHOUT_MIS (negative) where next-event estimation could not have found this direction
    float eta;             // relative index of refraction so far, for Russian roulette
    float distance, u, v;  // of the hit
    uint primitive;        // that was hit, NONE if the ray escaped
    uint start_primitive;  // that the ray starts on
    uint sample, pixel, index, depth;
    Vec3 mis_origin;  // the vertex that the direction was sampled at
    bool in_volume;   // scattered in the medium before the hit
    // null_bounces: pass-through surfaces so far; mis_distance: distance from mis_origin to the hit;
    // medium: that the ray runs through; mis_normal: `light_sampling_normal` at mis_origin
#include "generated/path_members.h"
} Path;

INLINE Path load_path(const PathBuffers* paths, size_t i)
{
    const uint plane_stride = paths->plane_stride;
    const Vec4 hit = load_planes4(paths->hit, i, plane_stride),
               throughput = load_planes4(paths->throughput, i, plane_stride);
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
    p.start_primitive = PLANE(PATH_START_PRIMITIVE, paths->path_ids, plane_stride)[i];
    p.sample = PLANE(PATH_SAMPLE, paths->path_ids, plane_stride)[i];
    p.pixel = paths->sample_pixel[(int)p.sample];
    p.index = PLANE(PATH_SAMPLE_INDEX, paths->path_ids, plane_stride)[i];
    p.depth = PLANE(PATH_DEPTH, paths->path_ids, plane_stride)[i];
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

// Index of the vertex among all that consume random numbers: with FEATURE_VOLPATH, pass-through surfaces do, although
// they do not add to the depth.
INLINE uint random_vertex_index(const Path* p)
{
    return p->depth + p->null_bounces;
}

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS || FEATURE_NEXT_EVENT
// MIS weight of a sample that was taken with `pdf`: power heuristic with exponent 2. Veach and Guibas, "Optimally
// Combining Sampling Techniques for Monte Carlo Rendering", 1995.
INLINE float mis_weight(float pdf, float other_pdf)
{
    const float ratio = other_pdf / pdf;
    return is_mis_weighted(pdf) ? 1.0f / (1.0f + ratio * ratio) : 1.0f;
}
#endif

#if FEATURE_TRIANGLES
// Whether the triangle that was hit lies in the plane of the triangle that the ray starts on. If one of them is in an
// instance, or the ray starts on no triangle, a grazing hit counts as one.
INLINE bool hits_coplanar_neighbour(const SceneView* scene, const PathBuffers* paths, size_t i, const Path* p,
                                    const Surface* s)
{
#if FEATURE_INSTANCES
    const bool both_in_world = p->start_primitive < scene->world_triangle_count && paths->instance[i] == NONE;
#else
    const bool both_in_world = !(p->start_primitive & ANALYTIC_BIT);
#endif
    if (both_in_world) {
        const Triangle start = Triangle_at(scene->triangles, p->start_primitive);
        const Vec3 normal = LOAD3(0, start.normal);
        return abs_float(dot3(normal, s->geometric_normal)) > 0.999f;
    }
    return abs_float(dot3(p->direction, s->geometric_normal)) < 0.5f;
}

// Whether the hit is a false one on a coplanar neighbour: the ray's origin lies in the plane of the triangle that was
// hit, within rounding. Rounding may then put the origin on the wrong side, and light from behind would leak through,
// so such a path ends; it is one in millions. Both points carry an error bound; the origin was also moved by its own.
// Beside an edge with a wall at an angle, origins lie in the wall's plane too (far from the world's origin most of them
// do): these paths continue.
INLINE bool is_false_coplanar_hit(const SceneView* scene, const PathBuffers* paths, size_t i, const Path* p,
                                  const Surface* s)
{
    const float distance = abs_float(dot3(sub3(p->origin, s->position), s->geometric_normal));
    const Vec3 error = add3(s->error, scale3(abs3(p->origin), GAMMA(7)));
    return distance <= 1.25f * dot3(abs3(s->geometric_normal), error) && hits_coplanar_neighbour(scene, paths, i, p, s);
}
#endif

#if (FEATURE_HIDE_EMITTERS && FEATURE_AREA_LIGHTS) || (HAS_NULL_BSDFS && !FEATURE_VOLPATH)
// Continues the path behind a surface in the same direction, as if the surface was not there.
INLINE void continue_behind(const PathBuffers* paths, size_t i, const Path* p, const Surface* s)
{
    const Vec3 origin = offset_ray_origin(s->position, s->error, s->geometric_normal, p->direction);
    store_planes4(vec4_from(origin, INFINITY), paths->ray_origin, i, paths->plane_stride);
    PLANE(PATH_START_PRIMITIVE, paths->path_ids, paths->plane_stride)[i] = p->primitive;
    paths->alive[i] = 1;
}
#endif

#if HAS_NULL_BSDFS && !FEATURE_VOLPATH
// The same at a pass-through BSDF. In the integrator `path`, shadow rays stop at this surface, so emission found behind
// it gets no MIS weight.
INLINE void continue_behind_unweighted(const PathBuffers* paths, size_t i, const Path* p, const Surface* s)
{
    continue_behind(paths, i, p, s);
    PLANE(3, paths->ray_direction, paths->plane_stride)[i] = PDF_WITHOUT_MIS;
    PLANE(PATH_DEPTH, paths->path_ids, paths->plane_stride)[i] = p->depth + 1u;
}
#endif

#if HAS_ENVIRONMENT_LIGHT || FEATURE_AREA_LIGHTS
// Probability that next-event estimation at the previous vertex would have selected the light.
INLINE float previous_light_pmf(const SceneView* scene, const Path* p, uint light)
{
    return light_pmf(scene, light, p->mis_origin, p->mis_normal, p->direction_pdf);
}
#endif

#if HAS_ENVIRONMENT_LIGHT
// Weighted radiance of the environment for an escaped ray. `pmf`: of selecting the environment at the previous vertex.
INLINE Vec3 environment_contribution(const SceneView* scene, const Path* p, float pmf)
{
    float pdf = 0.0f;
    const Light light = Light_at(scene->lights, scene->environment_light);
    const Vec3 radiance = environment_radiance(scene, &light, p->direction, &pdf);
    return scale3(mul3(p->throughput, radiance), mis_weight(p->direction_pdf, pmf * pdf));
}
#endif

#if FEATURE_AREA_LIGHTS
// Weighted radiance of an emitter that the ray hit. `pmf`: of selecting it at the previous vertex.
INLINE Vec3 emission_contribution(const SceneView* scene, const Path* p, const Surface* s, float pmf)
{
    const Light light = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? s->light : 0u);
    const float pdf = pmf * light_pdf(scene, &light, p->mis_origin, p->direction, p->mis_distance, s->normal);
    return scale3(mul3(p->throughput, emitted_radiance(scene, &light, s)), mis_weight(p->direction_pdf, pdf));
}
#endif

INLINE Surface hit_surface(const SceneView* scene, const PathBuffers* paths, size_t i, const Path* p)
{
    if (p->primitive == NONE) return empty_surface();
#if FEATURE_INSTANCES
    return instanced_surface_of_hit(scene, paths->instance[i], p->primitive, p->origin, p->direction, p->distance, p->u,
                                    p->v);
#else
    return surface_of_hit(scene, p->primitive, p->origin, p->direction, p->distance, p->u, p->v);
#endif
}

#if FEATURE_MEDIA
// Samples the distance to a scattering event in the medium that the ray runs through. Returns the distance, that of the
// hit if there is no event before it; sets p->in_volume.
INLINE float sample_scatter_distance(const SceneView* scene, Path* p)
{
    float distance = p->distance;
    if (p->medium != MEDIUM_NONE) {
        const uint block = BLOCK_MEDIUM(random_vertex_index(p));
        const Vec4 u = path_random(scene, p, block);
#if FEATURE_HETEROGENEOUS
        if (scene->heterogeneous.media[p->medium].sigma_t != NONE) {
            RandomStream stream = random_stream(scene->seed, p->pixel, p->index, block);
            p->in_volume = sample_heterogeneous_medium(&scene->heterogeneous, scene->media, p->medium, p->origin,
                                                       p->direction, u, &stream, &distance, &p->throughput);
            return distance;
        }
#endif
        p->in_volume = sample_medium(scene->media + p->medium, u, &distance, &p->throughput);
    }
    return distance;
}
#endif

#if HAS_ENVIRONMENT_LIGHT
INLINE void add_escaped_radiance(const SceneView* scene, const PathBuffers* paths, const Path* p)
{
    if (FEATURE_HIDE_EMITTERS && p->depth == 0u) return;
    const float pmf = previous_light_pmf(scene, p, scene->environment_light);
    ADD3(environment_contribution(scene, p, pmf), p->sample, paths->samples);
}
#endif

#if FEATURE_HIDE_EMITTERS && FEATURE_AREA_LIGHTS
// Continues a camera ray behind an emitter, which the camera does not see.
INLINE void skip_hidden_emitter(const PathBuffers* paths, size_t i, const Path* p, const Surface* s)
{
    continue_behind(paths, i, p, s);
#if FEATURE_VOLPATH
    store_planes3(p->throughput, paths->throughput, i, paths->plane_stride);
    paths->null_bounces[i] = p->null_bounces + 1u;
#endif
}
#endif

// Moves the path to its next vertex: the surface that was hit, or a scattering event in the medium before it. Returns
// whether the vertex may scatter the path.
// `may_escape`: the ray may have hit nothing; then the radiance of the environment is added. `hits_emitter`: set if the
// emission of the surface is still to be added.
INLINE bool advance_to_vertex(const SceneView* scene, const PathBuffers* paths, size_t i, Path* p, Surface* s,
                              bool may_escape, bool* hits_emitter)
{
    bool starts_in_volume = false;
    *hits_emitter = false;
#if FEATURE_MEDIA
    const float scatter_distance = sample_scatter_distance(scene, p);
    starts_in_volume = p->start_primitive == NONE;
#endif
    if (may_escape && !p->in_volume && p->primitive == NONE) {
#if HAS_ENVIRONMENT_LIGHT
        add_escaped_radiance(scene, paths, p);
#endif
        return false;
    }
    if (!p->in_volume && dot3(s->geometric_normal, s->geometric_normal) == 0.0f) return false;
#if FEATURE_TRIANGLES
    const bool is_between_surfaces = !(p->in_volume || starts_in_volume);
    if (is_between_surfaces && !(p->primitive & ANALYTIC_BIT) && is_false_coplanar_hit(scene, paths, i, p, s))
        return false;
#endif
#if FEATURE_MEDIA
    if (p->in_volume) {
        make_medium_vertex(s, p->primitive != NONE, p->origin, p->direction, scatter_distance, p->distance,
                           scene->media[p->medium].phase);
        PLANE(3, paths->hit, paths->plane_stride)[i] = as_float(NONE);  // the shadow ray starts on no primitive
    }
#endif
#if FEATURE_AREA_LIGHTS
    if (s->light != NONE) {
#if FEATURE_HIDE_EMITTERS
        if (p->depth == 0u) {
            skip_hidden_emitter(paths, i, p, s);
            return false;
        }
#endif
        *hits_emitter = dot3(s->normal, p->direction) < 0.0f;
    }
#endif
    return true;
}

// The BSDF at the vertex, in its shading frame; nested BSDFs are resolved. Returns whether the path passes through
// unscattered.
INLINE bool prepare_bsdf(const SceneView* scene, const Path* p, const Surface* s, BsdfContext* ctx)
{
    ctx->bsdfs = scene->bsdfs;
    ctx->bsdf = s->bsdf;
    ctx->normal = s->normal;
    ctx->wi = neg3(p->direction);
    ctx->cos_i = dot3(ctx->normal, ctx->wi);
#if HAS_BUMPS
    ctx->flipped = false;
    ctx->bump_alpha2 = NO_BUMP;
#endif
#if HAS_SHADING_FRAME
    set_shading_frame(ctx, s);
#endif
#if HAS_ROUGH_TRANSMITTANCE
    ctx->rough_transmittances = scene->rough_transmittances;
#endif
#if FEATURE_TEXTURES
    ctx->textures = &scene->textures;
    ctx->point = texture_point(s);
#endif
#if HAS_NESTED_BSDFS
    const bool passes = resolve_nested_bsdf(ctx, s, path_random(scene, p, BLOCK_MATERIAL(random_vertex_index(p))).x);
#else
    const bool passes = FEATURE_NULL && (material(ctx).kind & BSDF_NULL);
#endif
#if FEATURE_TWOSIDED
    if ((material(ctx).flags & BSDF_TWOSIDED) && ctx->cos_i < 0.0f) flip_to_viewer(ctx);
#endif
    return passes;
}
