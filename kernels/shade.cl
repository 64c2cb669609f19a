// Stage: what happens where the rays ended: emission, next-event estimation, the next direction, roulette.
// Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the path is alive.
//
// On devices where a work-item takes several paths, what their loop cannot do as vector instructions is done before, path by
// path, and kept: kept.h.
#include "kept.h"

// Paths that left the scene are listed apart from those that met something: in one loop all lanes would do the work of both.
#define SPLITS (LANES > 1 && HAS_SKY)

// The light that next-event estimation looks at, if it looks at any.
INLINE LightPick light_for(const Scene* scene, const Path* p, const Surface* s, const Shading* at, bool looks)
{
    LightPick pick = {0u, 0.0f};
#if FEATURE_NEXT_EVENT
    if (looks && bsdf_is_smooth(at)) {
        const Vec4 u = path_random(scene, p, BLOCK_LIGHT(event_of(p)));
        pick = pick_light(&scene->geometry, scene->lights, scene->light_alias, scene->light_count, s->position, lit_side(at),
                          u.x, u.w);
    }
#endif
    return pick;
}

#if FEATURE_NEXT_EVENT
// Leaves a shadow ray for the light; none if nothing could arrive.
INLINE void next_event(const Scene* scene, const Paths* of, size_t i, const Path* p, const Surface* s, const Shading* at,
                       LightPick pick)
{
    if (!(pick.probability > 0.0f)) return;
    const Vec4 u = path_random(scene, p, BLOCK_LIGHT(event_of(p)));
    const LightSample sample = sample_light(&scene->geometry, scene->lights, pick, s->position, vec2(u.y, u.z));
    const LightSample* light = &sample;
    if (!(light->pdf > 0.0f) || !(largest(light->radiance) > 0.0f)) return;
    float bsdf_pdf = 0.0f;
    const Vec3 scattered = bsdf_eval(at, light->direction, &bsdf_pdf);
    const float mis = light->is_delta ? 1.0f : mis_weight(light->pdf, bsdf_pdf);
    Vec3 radiance = scale3(mul3(mul3(p->weight, scattered), light->radiance), mis / light->pdf);
#if HAS_BUMPS
    radiance = scale3(radiance, bump_share(at, s, light->direction));
#endif
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    const Vec3 origin = leave(s, light->direction);
    // to a finite light the ray's length is 1, and both its ends are moved off their surfaces
    const Vec3 end = offset_origin(light->position, light->error, light->normal, neg3(light->direction));
    const Vec3 direction = light->is_infinite ? light->direction : sub3(end, origin);
    store_planes4(with_w(origin, as_float(light->primitive)), of->shadow_origin, i, of->pool);
    store_planes4(with_w(direction, light->is_infinite ? INFINITY : 1.0f), of->shadow_direction, i, of->pool);
    store_planes3(radiance, of->shadow_radiance, i, of->pool);
#if FEATURE_MEDIA
    PLANE(3, of->shadow_radiance, of->pool)[i] = as_float(medium_behind(s, direction, p->within));
#endif
}
#endif

// Draws the direction in which the path goes on, if it does.
INLINE void scatter(const Scene* scene, const Paths* of, size_t i, Path* p, const Surface* s, const Shading* at, bool passes,
                    bool last, uint rr_depth)
{
    const Vec4 u = path_random(scene, p, BLOCK_BSDF(event_of(p)));
    const BsdfSample next = passes ? straight_on(p->direction) : bsdf_sample(at, xyz(u));
    const bool straight = FEATURE_VOLPATH && next.pdf == STRAIGHT;
    if (last && !straight) return;
    Vec3 weight = mul3(p->weight, next.weight);
#if HAS_BUMPS
    if (!straight) weight = scale3(weight, bump_share(at, s, next.direction));
#endif
    const float total = weight.x + weight.y + weight.z;
    if (total == 0.0f) return;
    if (!(total < INFINITY)) {  // the statistics count such a sample apart; it must not end as a black one
        STORE3(all3(NAN), p->sample, of->samples);
        return;
    }
    const float eta = p->eta * next.eta;
#if FEATURE_RUSSIAN_ROULETTE
    if (!straight && p->depth + 1u >= rr_depth) {  // Mitsuba 3's rule
        // not below the least number that u may be under, 2^-24
        const float survival = GREATER(LESSER(largest(weight) * eta * eta, 0.95f), 0x1p-24f);
        if (u.w >= survival) return;
        weight = over3(weight, survival);
    }
#endif
    const uint pool = of->pool;
    store_planes4(with_w(leave(s, next.direction), INFINITY), of->ray_origin, i, pool);
    store_planes4(with_w(next.direction, straight ? p->direction_pdf : next.pdf), of->ray_direction, i, pool);
    store_planes4(with_w(weight, eta), of->throughput, i, pool);
    PLANE(PATH_START, of->path, pool)[i] = p->in_volume ? NONE : p->primitive;
    PLANE(PATH_DEPTH, of->path, pool)[i] = p->depth + (straight ? 0u : 1u);
#if FEATURE_VOLPATH
    of->crossing[i] = as_uint(straight ? p->since_vertex : 0.0f);
    PLANE(1, of->crossing, pool)[i] = p->crossed + (straight ? 1u : 0u);
#endif
#if FEATURE_MEDIA
    of->medium[i] = medium_behind(s, next.direction, p->within);
#endif
#if FEATURE_LIGHT_TREE
    if (!straight) store_planes4(lit_side(at), of->lit, i, pool);
#endif
    of->alive[i] = 1;
}

// All up to the light that is looked at. Returns whether the path may go on from the surface.
INLINE bool begin_shading(const Scene* scene, const Paths* of, size_t i, uint max_depth, Path* p, Surface* s, Shading* at,
                          bool* passes, LightPick* pick)
{
    if (!arrive(scene, of, i, p, s, !SPLITS)) return false;
    const bool last = p->depth + 1u >= max_depth;
    if (!FEATURE_VOLPATH && last) return false;
    *passes = meet_material(scene, p, s, at);
#if HAS_SEE_THROUGH && !FEATURE_VOLPATH
    if (*passes) {  // next-event estimation did not see what is behind: it takes part in no weight
        go_behind(of, i, p, s);
        PLANE(3, of->ray_direction, of->pool)[i] = -1.0f;
        PLANE(PATH_DEPTH, of->path, of->pool)[i] = p->depth + 1u;
        return false;
    }
#endif
    *pick = light_for(scene, p, s, at, !*passes && !last);
    return true;
}

INLINE void end_shading(const Scene* scene, const Paths* of, size_t i, uint max_depth, uint rr_depth, Path* p, const Surface* s,
                        const Shading* at, bool passes, LightPick pick)
{
#if FEATURE_NEXT_EVENT
    next_event(scene, of, i, p, s, at, pick);
#endif
    scatter(scene, of, i, p, s, at, passes, p->depth + 1u >= max_depth, rr_depth);
}

__kernel void shade(uint paths, uint pool, __global const uint* sample_pixel, uint2 seed, uint max_depth, uint rr_depth,
                    __global const float* triangles, __global const uint* faces, __global const float* corner_normals,
#if FEATURE_UVS
                    __global const float* uvs,
#endif
#if FEATURE_TEXTURES
                    __global const Texture* textures, __global const uchar* texel_bytes,
                    __global const float* texel_floats, __global const float* srgb, __global const float* attributes,
#endif
                    __global const Analytic* analytics, __global const Shape* shapes, __global const Bsdf* bsdfs,
#if FEATURE_ROUGH_PLASTIC
                    __global const float* boundaries,
#endif
                    __global const Light* lights, __global const Alias* light_alias, uint light_count,
#if FEATURE_ENVIRONMENT_MAP
                    __global const Environment* environment, __global const float* environment_texels,
                    __global const float* environment_rows, __global const uint* environment_aliases,
#endif
                    uint environment_light, __global float* hit, __global float* ray_origin,
                    __global float* ray_direction, __global float* throughput, __global uint* path,
                    __global float* shadow_origin, __global float* shadow_direction, __global float* shadow_radiance,
                    __global float* samples, __global uint* alive
#if FEATURE_INSTANCES
                    , __global const Instance* instances, uint world_triangles, __global const uint* instance
#endif
#if FEATURE_VOLPATH
                    , __global uint* crossing
#endif
#if FEATURE_MEDIA
                    , __global const Medium* media, __global uint* medium
#endif
#if FEATURE_LIGHT_TREE
                    , __global const float8* light_nodes, __global const uint* light_places, __global float* lit
#endif
                    )
{
    Scene scene;
    Geometry* geometry = &scene.geometry;
    geometry->triangles = triangles;
    geometry->faces = faces;
    geometry->corner_normals = corner_normals;
    geometry->analytics = analytics;
    geometry->shapes = shapes;
#if FEATURE_UVS
    geometry->uvs = uvs;
#endif
#if FEATURE_ENVIRONMENT_MAP
    geometry->environment.record = environment;
    geometry->environment.texels = environment_texels;
    geometry->environment.rows = environment_rows;
    geometry->environment.aliases = environment_aliases;
#endif
#if FEATURE_LIGHT_TREE
    const LightTree light_tree = {light_nodes, light_places, light_count};
    geometry->light_tree = light_tree;
#endif
#if FEATURE_TEXTURES
    const Textures all_textures = {textures, texel_bytes, texel_floats, srgb, attributes, faces};
    geometry->textures = all_textures;
#endif
    scene.bsdfs = bsdfs;
#if FEATURE_ROUGH_PLASTIC
    scene.boundaries = boundaries;
#endif
    scene.lights = lights;
    scene.light_alias = light_alias;
    scene.light_count = light_count;
    scene.environment_light = FEATURE_MANY_LIGHTS ? environment_light : 0u;
    scene.seed = seed;
    Paths of;
    of.pool = pool;
    of.sample_pixel = sample_pixel;
    of.hit = hit;
    of.ray_origin = ray_origin;
    of.ray_direction = ray_direction;
    of.throughput = throughput;
    of.path = path;
    of.shadow_origin = shadow_origin;
    of.shadow_direction = shadow_direction;
    of.shadow_radiance = shadow_radiance;
    of.samples = samples;
    of.alive = alive;
#if FEATURE_INSTANCES
    scene.instances = instances;
    scene.world_triangles = world_triangles;
    of.instance = instance;
#endif
#if FEATURE_VOLPATH
    of.crossing = crossing;
#endif
#if FEATURE_MEDIA
    scene.media = media;
    of.medium = medium;
#endif
#if FEATURE_LIGHT_TREE
    of.lit = lit;
#endif
    const size_t begin = get_global_id(0) * LANES;
    if (begin >= paths) return;
    const uint count = (uint)LESSER(paths - begin, (size_t)LANES);
    for (uint k = 0u; k < count; ++k) alive[begin + k] = 0;
#if FEATURE_NEXT_EVENT
    for (uint k = 0u; k < count; ++k) PLANE(3, shadow_direction, pool)[begin + k] = 0.0f;
#endif
#if SPLITS
    int met[LANES + VECTOR], missed[LANES + VECTOR];
    uint count_met = 0u, count_missed = 0u;
    for (uint k = 0u; k < count; ++k) {
        const bool misses = as_uint(PLANE(3, hit, pool)[begin + k]) == NONE;
        met[count_met] = missed[count_missed] = (int)(begin + k);
        count_met += misses ? 0u : 1u;
        count_missed += misses ? 1u : 0u;
    }
    EACH_OF(k, count_missed) {
        if (k >= count_missed) continue;
        const Path p = load_path(&of, (size_t)missed[k]);
        if (!FEATURE_HIDE_EMITTERS || p.depth > 0u) ADD3(arriving_sky(&scene, &p), p.sample, samples);
    }
#define COUNT count_met
#define PATH(k) (size_t)met[k]
#else
#define COUNT count
#define PATH(k) (begin + (k))
#endif
#if KEEPS
    float kept[KEPT * LANES];
    EACH_OF(k, COUNT) {
        if (k >= COUNT) continue;
        const Path p = load_path(&of, PATH(k));
        const Surface s = meet_surface(&scene, &of, PATH(k), &p);
        keep_surface(&s, kept, k);
    }
    for (uint k = 0u; k < COUNT; ++k) {
        keep_mark(false, kept, k);
        Path p = load_path(&of, PATH(k));
        Surface s = kept_surface(kept, k);
        Shading at;
        LightPick pick;
        bool passes;
        if (!begin_shading(&scene, &of, PATH(k), max_depth, &p, &s, &at, &passes, &pick)) continue;
        keep_mark(true, kept, k);
        keep_shading(&scene, &at, pick, kept, k);
    }
    EACH_OF(k, COUNT) {
        if (k >= COUNT || !kept_mark(kept, k)) continue;
        Path p = load_path(&of, PATH(k));
        const Surface s = kept_surface(kept, k);
        const Shading at = kept_shading(&scene, &p, kept, k);
        end_shading(&scene, &of, PATH(k), max_depth, rr_depth, &p, &s, &at, false, kept_pick(kept, k));
    }
#else
    EACH_OF(k, COUNT) {
        if (k >= COUNT) continue;
        Path p = load_path(&of, PATH(k));
        Surface s = meet_surface(&scene, &of, PATH(k), &p);
        Shading at;
        LightPick pick;
        bool passes;
        if (begin_shading(&scene, &of, PATH(k), max_depth, &p, &s, &at, &passes, &pick))
            end_shading(&scene, &of, PATH(k), max_depth, rr_depth, &p, &s, &at, passes, pick);
    }
#endif
}
