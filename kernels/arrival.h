// Where paths arrive: what shines there, and what there is to scatter them.
#pragma once
#include "bsdf.h"
#include "light.h"
#include "material.h"
#include "medium.h"
#include "paths.h"
#include "random.h"

#define HAS_SKY (FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP)

// What describes the scene; members that it does not need are not set.
typedef struct {
    Geometry geometry;
    __global const Bsdf* bsdfs;
    __global const float* boundaries;
    __global const Light* lights;
    __global const Alias* light_alias;
    uint light_count, environment_light;
    uint textured_slots;  // bits of the slots in which some material has a texture
    __global const Medium* media;
    __global const Instance* instances;
    uint world_triangles;  // those before are in no group
    uint2 seed;
} Scene;

// The buffers of the paths, and of what they bring.
typedef struct {
    uint pool;
    __global const uint* sample_pixel;
    __global float* hit;
    __global float* ray_origin;
    __global float* ray_direction;
    __global float* throughput;
    __global uint* path;
    __global uint* crossing;
    __global uint* medium;
    __global const uint* instance;
    __global float* lit;
    __global float* shadow_origin;
    __global float* shadow_direction;
    __global float* shadow_radiance;
    __global float* samples;
    __global uint* alive;
} Paths;

// A path at the end of its ray.
typedef struct {
    Vec3 origin, direction, weight;
    float direction_pdf, eta;  // the index of refraction that roulette reckons with
    float distance, u, v;      // of the hit
    uint primitive, start;     // that it met, that it started on
    uint sample, pixel, index, depth;
    uint crossed;        // surfaces that let it through since it began
    float since_vertex;  // distance from the last vertex
    Vec3 last_vertex;
    Vec4 was_lit;  // at the last vertex: `lit_side`
    uint within;   // the medium that it comes through
    bool in_volume;
} Path;

INLINE Path load_path(const Paths* of, size_t i)
{
    const uint pool = of->pool;
    const Vec4 hit = load_planes4(of->hit, i, pool), carried = load_planes4(of->throughput, i, pool);
    const Vec4 incoming = load_planes4(of->ray_direction, i, pool);
    Path p;
    p.origin = load_planes3(of->ray_origin, i, pool);
    p.direction = xyz(incoming);
    p.direction_pdf = incoming.w;
    p.weight = xyz(carried);
    p.eta = carried.w;
    p.distance = hit.x;
    p.u = hit.y;
    p.v = hit.z;
    p.primitive = as_uint(hit.w);
    p.start = PLANE(PATH_START, of->path, pool)[i];
    p.sample = PLANE(PATH_SAMPLE, of->path, pool)[i];
    p.pixel = of->sample_pixel[(int)p.sample];
    p.index = PLANE(PATH_INDEX, of->path, pool)[i];
    p.depth = PLANE(PATH_DEPTH, of->path, pool)[i];
    p.crossed = 0u;
    p.since_vertex = p.distance;
    p.last_vertex = p.origin;
#if FEATURE_VOLPATH
    // what lets a path through unturned is no vertex of it, but takes random numbers: the vertex before and these are kept
    const float travelled = as_float(of->crossing[i]);
    p.since_vertex = travelled + p.distance;
    p.last_vertex = sub3(p.origin, scale3(p.direction, travelled));
    p.crossed = PLANE(1, of->crossing, pool)[i];
#endif
    p.was_lit = vec4(0.0f, 0.0f, 0.0f, 0.0f);
#if HAS_LIT
    p.was_lit = load_planes4(of->lit, i, pool);
#endif
    p.within = 0u;
#if FEATURE_MEDIA
    p.within = of->medium[i];
#endif
    p.in_volume = false;
    return p;
}

INLINE Vec4 path_random(const Scene* scene, const Path* p, uint block)
{
    return random_block(scene->seed, p->pixel, p->index, block);
}

// Places in a path's order of events, by which its random numbers are counted.
INLINE uint event_of(const Path* p)
{
    return p->depth + p->crossed;
}

#if HAS_SKY || FEATURE_AREA_LIGHTS || FEATURE_NEXT_EVENT
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
INLINE bool meets_neighbour(const Scene* scene, const Paths* of, size_t i, const Path* p, const Surface* s)
{
#if FEATURE_INSTANCES
    const bool both_in_world = p->start < scene->world_triangles && of->instance[i] == NONE;
#else
    const bool both_in_world = !(p->start & ANALYTIC_BIT);
#endif
    if (both_in_world) {
        const Vec3 normal = FROM3((int)TRIANGLE_FLOATS * (int)p->start + 12, scene->geometry.triangles);
        return abs1(dot3(normal, s->geometric_normal)) > 0.999f;
    }
    return abs1(dot3(p->direction, s->geometric_normal)) < 0.5f;
}

// Whether a ray's origin lies in the plane of the surface that it seems to have met, as far as rounding can tell: it comes from a
// neighbour in the same plane, and may be said to come from the wrong side of it. Such a path ends; it is one in millions, where
// the light of the other side would be seen to leak through. Both points carry an error, the origin was moved by its own. Beside
// an edge with a wall at an angle origins lie in its plane too, far from the world's origin even most of them: those go on.
INLINE bool in_plane(const Scene* scene, const Paths* of, size_t i, const Path* p, const Surface* s)
{
    const float distance = abs1(dot3(sub3(p->origin, s->position), s->geometric_normal));
    const Vec3 error = add3(s->error, scale3(abs3(p->origin), GAMMA(7)));
    return distance <= 1.25f * dot3(abs3(s->geometric_normal), error) && meets_neighbour(scene, of, i, p, s);
}
#endif

#if (FEATURE_HIDE_EMITTERS && FEATURE_AREA_LIGHTS) || (HAS_SEE_THROUGH && !FEATURE_VOLPATH)
// Lets a path go on behind a surface as if there was none. Returns where it starts then.
INLINE void go_behind(const Paths* of, size_t i, const Path* p, const Surface* s)
{
    const Vec3 behind = offset_origin(s->position, s->error, s->geometric_normal, p->direction);
    store_planes4(with_w(behind, INFINITY), of->ray_origin, i, of->pool);
    PLANE(PATH_START, of->path, of->pool)[i] = p->primitive;
    of->alive[i] = 1;
}
#endif

#if HAS_SEE_THROUGH && !FEATURE_VOLPATH
// The same where a material lets a path through: next-event estimation did not see what is behind, it takes part in no weight.
INLINE void pass_unseen(const Paths* of, size_t i, const Path* p, const Surface* s)
{
    go_behind(of, i, p, s);
    PLANE(3, of->ray_direction, of->pool)[i] = -1.0f;
    PLANE(PATH_DEPTH, of->path, of->pool)[i] = p->depth + 1u;
}
#endif

#if HAS_SKY || FEATURE_AREA_LIGHTS
// Probability with which a light would have been picked at a path's last vertex.
INLINE float pick_before(const Scene* scene, const Path* p, uint light)
{
    return pick_probability(&scene->geometry, scene->lights, light, p->last_vertex, p->was_lit, p->direction_pdf);
}
#endif

#if HAS_SKY
// What a path brings that leaves the scene; `pick`: the probability with which the sky would have been picked at its last vertex.
INLINE Vec3 arriving_sky(const Scene* scene, const Path* p, float pick)
{
    const Geometry* g = &scene->geometry;
    float pdf = 0.0f;
    const Light sky = Light_at(scene->lights, scene->environment_light);
    const Vec3 radiance = sky_radiance(g, &sky, p->direction, &pdf);
    return scale3(mul3(p->weight, radiance), mis_weight(p->direction_pdf, pick * pdf));
}
#endif

#if FEATURE_AREA_LIGHTS
// What a path brings that meets a light; `pick`: the probability with which it would have been picked.
INLINE Vec3 arriving_emission(const Scene* scene, const Path* p, const Surface* s, float pick)
{
    const Geometry* g = &scene->geometry;
    const Light met = Light_at(scene->lights, FEATURE_MANY_LIGHTS ? s->light : 0u), *light = &met;
    const float pdf = pick * light_pdf(g, light, p->last_vertex, p->direction, p->since_vertex, s->normal);
    return scale3(mul3(p->weight, emitted_radiance(g, light, s)), mis_weight(p->direction_pdf, pdf));
}
#endif

// The surface that the path met, if it met one.
INLINE Surface meet_surface(const Scene* scene, const Paths* of, size_t i, const Path* p)
{
    if (p->primitive == NONE) return no_surface();
#if FEATURE_INSTANCES
    return instanced_surface_at(&scene->geometry, scene->instances, of->instance[i], p->primitive, p->origin, p->direction,
                                p->distance, p->u, p->v);
#else
    return surface_at(&scene->geometry, p->primitive, p->origin, p->direction, p->distance, p->u, p->v);
#endif
}

// Brings the path to the surface, or to a volume before it that takes its place. Returns whether it may be scattered there.
// `may_miss`: whether there may be none. `shines`: whether it met a light, whose emission is still to be added.
INLINE bool arrive(const Scene* scene, const Paths* of, size_t i, Path* p, Surface* s, bool may_miss, bool* shines)
{
    bool from_volume = false;
    *shines = false;
#if FEATURE_MEDIA
    float flown = p->distance;
    if (p->within != MEDIUM_NONE)
        p->in_volume = fly(scene->media + p->within, path_random(scene, p, BLOCK_MEDIUM(event_of(p))), &flown, &p->weight);
    from_volume = p->start == NONE;
#endif
    if (may_miss && !p->in_volume && p->primitive == NONE) {
#if HAS_SKY
        if (!FEATURE_HIDE_EMITTERS || p->depth > 0u) ADD3(arriving_sky(scene, p, pick_before(scene, p, scene->environment_light)), p->sample, of->samples);
#endif
        return false;
    }
    if (!p->in_volume && dot3(s->geometric_normal, s->geometric_normal) == 0.0f) return false;
#if FEATURE_TRIANGLES
    if (!(p->in_volume || from_volume) && !(p->primitive & ANALYTIC_BIT) && in_plane(scene, of, i, p, s)) return false;
#endif
#if FEATURE_MEDIA
    if (p->in_volume) {
        enter_volume(s, p->primitive != NONE, p->origin, p->direction, flown, p->distance, scene->media[p->within].phase);
        PLANE(3, of->hit, of->pool)[i] = as_float(NONE);  // the shadow ray starts on no primitive
    }
#endif
#if FEATURE_AREA_LIGHTS
    if (s->light != NONE) {
#if FEATURE_HIDE_EMITTERS
        if (p->depth == 0u) {  // seen by the camera, the light is not there
            go_behind(of, i, p, s);
#if FEATURE_VOLPATH
            store_planes3(p->weight, of->throughput, i, of->pool);
            PLANE(1, of->crossing, of->pool)[i] = p->crossed + 1u;
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
INLINE bool meet_material(const Scene* scene, const Path* p, const Surface* s, Shading* at)
{
    at->bsdfs = scene->bsdfs;
    at->bsdf = s->bsdf;
    at->normal = s->normal;
    at->wi = neg3(p->direction);
    at->cos_i = dot3(at->normal, at->wi);
#if HAS_BUMPS
    at->turned = false;
    at->shadow = NO_BUMP;
#endif
#if HAS_FRAMES
    set_frame(at, s);
#endif
#if FEATURE_ROUGH_PLASTIC
    at->tables = scene->boundaries;
#endif
#if FEATURE_TEXTURES
    at->textures = &scene->geometry.textures;
    at->point = texture_point(s);
#endif
#if HAS_WRAPPERS
    const bool passes = unwrap(at, s, path_random(scene, p, BLOCK_MATERIAL(event_of(p))).x);
#else
    const bool passes = FEATURE_NULL && (material(at).kind & BSDF_NULL);
#endif
#if FEATURE_TWOSIDED
    if ((material(at).flags & BSDF_TWOSIDED) && at->cos_i < 0.0f) turn_to_viewer(at);
#endif
    return passes;
}
