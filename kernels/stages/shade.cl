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

__kernel void shade(uint path_count, uint plane_stride, __global const uint* sample_pixel, uint2 seed, uint max_depth, uint rr_depth,
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
                    __global const float* rough_transmittances,
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
                    , __global const float8* light_nodes, __global const uint* light_parents
#endif
#if FEATURE_LIGHT_LIST
                    , __global const LightBound* light_bounds
#endif
#if HAS_LIGHT_IMPORTANCE
                    , __global float* mis_normal
#endif
                    )
{
    SceneView scene;
    scene.triangles = triangles;
    scene.faces = faces;
    scene.corner_normals = corner_normals;
    scene.analytics = analytics;
    scene.shapes = shapes;
#if FEATURE_UVS
    scene.uvs = uvs;
#endif
#if FEATURE_ENVIRONMENT_MAP
    scene.envmap.record = environment;
    scene.envmap.texels = environment_texels;
    scene.envmap.rows = environment_rows;
    scene.envmap.aliases = environment_aliases;
#endif
#if FEATURE_LIGHT_LIST
    const LightList light_list = {light_bounds, light_count};
    scene.light_list = light_list;
#elif FEATURE_LIGHT_TREE
    const LightTree light_tree = {light_nodes, light_parents, light_count};
    scene.light_tree = light_tree;
#endif
#if FEATURE_TEXTURES
    const Textures all_textures = {textures, texel_bytes, texel_floats, srgb, attributes, faces};
    scene.textures = all_textures;
    scene.textured_slots = textured_slots;
#endif
    scene.bsdfs = bsdfs;
#if FEATURE_ROUGH_PLASTIC
    scene.rough_transmittances = rough_transmittances;
#endif
    scene.lights = lights;
    scene.light_alias = light_alias;
    scene.light_count = light_count;
    scene.environment_light = FEATURE_MANY_LIGHTS ? environment_light : 0u;
    scene.seed = seed;
    PathState paths;
    paths.plane_stride = plane_stride;
    paths.sample_pixel = sample_pixel;
    paths.hit = hit;
    paths.ray_origin = ray_origin;
    paths.ray_direction = ray_direction;
    paths.throughput = throughput;
    paths.path = path;
    paths.shadow_origin = shadow_origin;
    paths.shadow_direction = shadow_direction;
    paths.shadow_radiance = shadow_radiance;
    paths.samples = samples;
    paths.alive = alive;
#if FEATURE_INSTANCES
    scene.instances = instances;
    scene.world_triangles = world_triangles;
    paths.instance = instance;
#endif
#if FEATURE_VOLPATH
    paths.crossing = crossing;
#endif
#if FEATURE_MEDIA
    scene.media = media;
    paths.medium = medium;
#endif
#if HAS_LIGHT_IMPORTANCE
    paths.mis_normal = mis_normal;
#endif
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
