// Stage: what happens where the rays ended: emission, next-event estimation, the next direction, roulette.
// Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the path is alive.
//
// On devices where a work-item takes several paths, they are shaded together, in steps: steps.h.
#undef LANES
#define LANES SHADE_LANES
#include "steps.h"

#if LANES == 1
INLINE void shade_path(const Scene* scene, const Paths* of, size_t i, uint max_depth, uint rr_depth)
{
    Path p = load_path(of, i);
    Surface s = meet_surface(scene, of, i, &p);
    bool shines;
    const bool scatters = arrive(scene, of, i, &p, &s, true, &shines);
#if FEATURE_AREA_LIGHTS
    if (shines) ADD3(arriving_emission(scene, &p, &s, pick_before(scene, &p, s.light)), p.sample, of->samples);
#endif
    const bool last = p.depth + 1u >= max_depth;
    if (!scatters) return;
    if (!FEATURE_VOLPATH && last) return;
    Shading at;
    const bool passes = meet_material(scene, &p, &s, &at);
#if HAS_SEE_THROUGH && !FEATURE_VOLPATH
    if (passes) {
        pass_unseen(of, i, &p, &s);
        return;
    }
#endif
#if FEATURE_NEXT_EVENT
    next_event(scene, of, i, &p, &s, &at, !passes && !last);
#endif
    const Vec4 u = path_random(scene, &p, BLOCK_BSDF(event_of(&p)));
    const BsdfSample next = passes ? straight_on(p.direction) : bsdf_sample(&at, xyz(u));
    go_on(of, i, &p, &s, &at, next, u.w, last, rr_depth);
}
#endif

__kernel void shade(uint paths, uint pool, __global const uint* sample_pixel, uint2 seed, uint max_depth, uint rr_depth,
                    __global const float* triangles, __global const uint* faces, __global const float* corner_normals,
#if FEATURE_UVS
                    __global const float* uvs,
#endif
#if FEATURE_TEXTURES
                    __global const Texture* textures, __global const uchar* texel_bytes,
                    __global const float* texel_floats, __global const float* srgb, __global const float* attributes,
                    uint textured_slots,
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
                    , __global const float8* light_nodes, __global const uint* light_places
#endif
#if FEATURE_LIGHT_LIST
                    , __global const LightBound* light_bounds
#endif
#if HAS_LIT
                    , __global float* lit
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
#if FEATURE_LIGHT_LIST
    const LightList light_list = {light_bounds, light_count};
    geometry->light_list = light_list;
#elif FEATURE_LIGHT_TREE
    const LightTree light_tree = {light_nodes, light_places, light_count};
    geometry->light_tree = light_tree;
#endif
#if FEATURE_TEXTURES
    const Textures all_textures = {textures, texel_bytes, texel_floats, srgb, attributes, faces};
    geometry->textures = all_textures;
    scene.textured_slots = textured_slots;
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
#if HAS_LIT
    of.lit = lit;
#endif
    const size_t begin = get_global_id(0) * LANES;
    if (begin >= paths) return;
#if LANES > 1
    shade_in_steps(&scene, &of, begin, (uint)LESSER(paths - begin, (size_t)LANES), max_depth, rr_depth);
#else
    alive[begin] = 0;
#if FEATURE_NEXT_EVENT
    PLANE(3, shadow_direction, pool)[begin] = 0.0f;
#endif
    shade_path(&scene, &of, begin, max_depth, rr_depth);
#endif
}
