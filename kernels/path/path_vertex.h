// Where paths arrive: what shines there, and what there is to scatter them.
#pragma once
#include "bsdf/bsdf.h"
#include "light/light.h"
#include "bsdf/nested.h"
#include "media/medium.h"
#include "path/path_state.h"
#include "util/random.h"

#define HAS_ENVIRONMENT_LIGHT (FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP)

// The buffers of the paths, and of what they bring.
typedef struct {
    uint plane_stride;
    __global const uint* sample_pixel;
    __global float* hit;
    __global float* ray_origin;
    __global float* ray_direction;
    __global float* throughput;
    __global uint* path;
    __global uint* crossing;
    __global uint* medium;
    __global const uint* instance;
    __global float* mis_normal;
    __global float* shadow_origin;
    __global float* shadow_direction;
    __global float* shadow_radiance;
    __global float* samples;
    __global uint* alive;
} PathState;

// A path at the end of its ray.
typedef struct {
    Vec3 origin, direction, throughput;
    float direction_pdf, eta;  // the index of refraction that roulette reckons with
    float distance, u, v;      // of the hit
    uint primitive, start_primitive;     // that it met, that it started on
    uint sample, pixel, index, depth;
    uint null_bounces;        // surfaces that let it through since it began
    float mis_distance;  // distance from the last vertex
    Vec3 mis_origin;
    Vec4 mis_normal;  // at the last vertex: `light_sampling_normal`
    uint medium;   // the medium that it comes through
    bool in_volume;
} Path;

INLINE Path load_path(const PathState* paths, size_t i)
{
    const uint plane_stride = paths->plane_stride;
    const Vec4 hit = load_planes4(paths->hit, i, plane_stride), carried = load_planes4(paths->throughput, i, plane_stride);
    const Vec4 incoming = load_planes4(paths->ray_direction, i, plane_stride);
    Path p;
    p.origin = load_planes3(paths->ray_origin, i, plane_stride);
    p.direction = xyz(incoming);
    p.direction_pdf = incoming.w;
    p.throughput = xyz(carried);
    p.eta = carried.w;
    p.distance = hit.x;
    p.u = hit.y;
    p.v = hit.z;
    p.primitive = as_uint(hit.w);
    p.start_primitive = PLANE(PATH_START_PRIMITIVE, paths->path, plane_stride)[i];
    p.sample = PLANE(PATH_SAMPLE, paths->path, plane_stride)[i];
    p.pixel = paths->sample_pixel[(int)p.sample];
    p.index = PLANE(PATH_SAMPLE_INDEX, paths->path, plane_stride)[i];
    p.depth = PLANE(PATH_DEPTH, paths->path, plane_stride)[i];
    p.null_bounces = 0u;
    p.mis_distance = p.distance;
    p.mis_origin = p.origin;
#if FEATURE_VOLPATH
    // what lets a path through unturned is no vertex of it, but takes random numbers: the vertex before and these are kept
    const float travelled = as_float(paths->crossing[i]);
    p.mis_distance = travelled + p.distance;
    p.mis_origin = sub3(p.origin, scale3(p.direction, travelled));
    p.null_bounces = PLANE(1, paths->crossing, plane_stride)[i];
#endif
    p.mis_normal = vec4(0.0f, 0.0f, 0.0f, 0.0f);
#if HAS_LIGHT_IMPORTANCE
    p.mis_normal = load_planes4(paths->mis_normal, i, plane_stride);
#endif
    p.medium = 0u;
#if FEATURE_MEDIA
    p.medium = paths->medium[i];
#endif
    p.in_volume = false;
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
            PLANE(1, paths->crossing, paths->plane_stride)[i] = p->null_bounces + 1u;
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
