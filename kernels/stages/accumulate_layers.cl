// Stage: adds what the camera rays of a run of samples hit first (albedo, normal, depth, ...) to the sums of their
// pixels. Runs after `intersect`, before `shade` changes the rays. One work-item per pixel, which reads its samples in
// order, so that the sums depend on the samples alone. Reads path state and hits; writes layer_sums and layer_indices.
#undef LANES  // a work-item shades one path at a time
#define LANES 1
#include "path/path_vertex.h"
#include "util/statistics.h"

#if FEATURE_LAYERS
// LAYER_<NAME> is the number of the layer's first channel among the sums, or among the indices; -1 without the layer.

#if FEATURE_ALBEDO_LAYER
#define ALBEDO_SAMPLES 4u

// Coordinate of the n-th point of an additive recurrence from 1/2 on, in [0, 1); `step` is 2^32 times its step.
INLINE float recurrence(uint n, uint step)
{
    return (float)((n * step + 0x80000000u) >> 8) * 0x1p-24f;
}

// Share of the light that the surface scatters to any direction, for the direction of the path: the mean of the BSDF
// samples' weights, as pbrt-v4's GBufferFilm computes it. The samples of a pixel take consecutive points of the
// sequence R3 (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"), the same ones in every pixel,
// so that equal surfaces have equal albedos. For diffuse surfaces the first point is exact.
INLINE Vec3 albedo_of(const BsdfContext* ctx, uint sample_index)
{
    const bool is_diffuse = material(ctx).kind & BSDF_DIFFUSE;
    const uint count = is_diffuse ? 1u : ALBEDO_SAMPLES, first = is_diffuse ? 0u : sample_index * ALBEDO_SAMPLES;
    Vec3 sum = splat3(0.0f);
    for (uint k = 0u; k < count; ++k) {
        const uint n = first + k;
        const BsdfSample sample =
            bsdf_sample(ctx, vec3(recurrence(n, 3518319155u), recurrence(n, 2882110345u), recurrence(n, 2360945575u)));
        // transmitted radiance is that of a cone of another solid angle: eta^2 gives the light itself
        sum = add3(sum, scale3(sample.weight, sample.eta * sample.eta));
    }
    return scale3(sum, 1.0f / (float)count);
}
#endif

INLINE void add_layer1(int first, float value, Compensated* sums)
{
    if (first >= 0 && is_finite(value)) sums[first] = add_compensated(sums[first], value);
}

INLINE void add_layer3(int first, Vec3 value, Compensated* sums)
{
    if (first < 0) return;
    add_layer1(first, value.x, sums);
    add_layer1(first + 1, value.y, sums);
    add_layer1(first + 2, value.z, sums);
}

INLINE Vec3 facing(Vec3 normal, Vec3 direction)
{
    return dot3(normal, direction) > 0.0f ? neg3(normal) : normal;
}

// Distance from the camera along its optical axis.
INLINE float depth_of(__global const Camera* camera, Vec3 position)
{
    float m[12];
    load_matrix(camera->to_world, m);
    const Vec3 axis = normalize3(vec3(m[2], m[6], m[10]));
    return dot3(sub3(position, vec3(m[3], m[7], m[11])), axis);
}

INLINE uint shape_of(const SceneView* scene, __global const uint* triangle_shape, uint primitive)
{
#if FEATURE_ANALYTICS
    if (primitive & ANALYTIC_BIT) return scene->analytics[primitive & ~ANALYTIC_BIT].shape;
#endif
    return triangle_shape[primitive];
}

// Adds the layers of a surface to the sums.
INLINE void add_surface(const SceneView* scene, __global const Camera* camera, const Path* p, const Surface* s,
                        Compensated* sums)
{
    BsdfContext ctx;
    const bool passes = prepare_bsdf(scene, p, s, &ctx);
    add_layer1(LAYER_COVERAGE, 1.0f, sums);
    add_layer3(LAYER_NORMAL, facing(ctx.normal, p->direction), sums);
    add_layer3(LAYER_GEOMETRIC_NORMAL, facing(s->geometric_normal, p->direction), sums);
    add_layer3(LAYER_POSITION, s->position, sums);
    if (LAYER_DEPTH >= 0) add_layer1(LAYER_DEPTH, depth_of(camera, s->position), sums);
#if FEATURE_UVS
    if (LAYER_UV >= 0) {
        add_layer1(LAYER_UV, s->uv.x, sums);
        add_layer1(LAYER_UV + 1, s->uv.y, sums);
    }
#endif
#if FEATURE_ALBEDO_LAYER
    add_layer3(LAYER_ALBEDO, passes ? splat3(1.0f) : albedo_of(&ctx, p->index), sums);
#endif
}

__kernel void accumulate_layers(
#include "generated/accumulate_layers_parameters.h"
)
{
    const uint k = get_global_id(0);
    if (k >= layer_pixels) return;
    SceneView scene;
#include "generated/accumulate_layers_scene_view.h"
    PathBuffers paths;
#include "generated/accumulate_layers_path_buffers.h"
    const uint i = first_layer_pixel + k, pixel = first_pixel + i, run_end = first_sample + count_new;
    const uint begin = MAX(pixel_offset[i], first_sample);
    const uint end = i + 1u < pixels ? MIN(pixel_offset[i + 1u], run_end) : run_end;

    Compensated sums[LAYER_SUMS + 1];
    for (uint c = 0u; c < LAYER_SUMS; ++c) sums[c] = load_sum(layer_sums + pixel + 2u * c * total_pixels, total_pixels);
    for (uint sample = begin; sample < end; ++sample) {
        const size_t slot = first_slot + (sample - first_sample);
        const Path p = load_path(&paths, slot);
        const Surface s = hit_surface(&scene, &paths, slot, &p);
        if (p.primitive != NONE) add_surface(&scene, camera, &p, &s, sums);
        if (p.index != 0u) continue;
        const bool hits = p.primitive != NONE;
        if (LAYER_SHAPE_INDEX >= 0)
            layer_indices[pixel + (size_t)LAYER_SHAPE_INDEX * total_pixels] =
                hits ? shape_of(&scene, triangle_shape, p.primitive) : NONE;
        if (LAYER_MATERIAL_INDEX >= 0)
            layer_indices[pixel + (size_t)LAYER_MATERIAL_INDEX * total_pixels] = hits ? s.bsdf : NONE;
    }
    for (uint c = 0u; c < LAYER_SUMS; ++c) store_sum(sums[c], layer_sums + pixel + 2u * c * total_pixels, total_pixels);
}
#endif
