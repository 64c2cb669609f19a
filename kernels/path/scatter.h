// Scattering at a path vertex: next-event estimation and the path's next ray. Both forms of stages/shade.cl call it.
#pragma once
#include "path/path_vertex.h"

#if FEATURE_NEXT_EVENT
INLINE bool can_contribute(const LightSample* light)
{
    return light->pdf > 0.0f && max_component3(light->radiance) > 0.0f;
}

#if HAS_BLEND_LIGHTING
// Value of a blend for a light sample, MIS-weighted, and 0 in place of a pdf. Each part has a MIS weight of its own, as
// it has where its sample finds the light: the path follows one of the two, with the probability of its weight.
INLINE Vec4 blend_value(const LightSample* light, Vec4 value_and_pdf, Vec4 other_value_and_pdf, float other_weight)
{
    const float mis = light->is_delta ? 1.0f : mis_weight(light->pdf, value_and_pdf.w);
    const float other_mis = light->is_delta ? 1.0f : mis_weight(light->pdf, other_value_and_pdf.w);
    return vec4_from(add3(scale3(xyz(value_and_pdf), (1.0f - other_weight) * mis),
                          scale3(xyz(other_value_and_pdf), other_weight * other_mis)),
                     0.0f);
}
#endif

// Contribution of a light sample if it is not occluded. `bsdf_value`: bsdf * |cos|; `bsdf_pdf`: of the light's
// direction.
INLINE Vec3 direct_lighting(const Path* p, const Surface* s, const BsdfContext* ctx, const LightSample* light,
                            Vec3 bsdf_value, float bsdf_pdf)
{
    const float mis = light->is_delta ? 1.0f : mis_weight(light->pdf, bsdf_pdf);
    Vec3 radiance = scale3(mul3(mul3(p->throughput, bsdf_value), light->radiance), mis / light->pdf);
#if HAS_BUMPS
    radiance = scale3(radiance, bump_shadowing(ctx, s, light->direction));
#endif
    return radiance;
}

// Writes the shadow ray that leads to the light sample; the caller writes its radiance.
INLINE void write_shadow_ray(const PathBuffers* paths, size_t i, const Path* p, const Surface* s,
                             const LightSample* light)
{
    const Vec3 origin = spawn_origin(s, light->direction);
    // the ray to a finite light has length 1, and both its ends are moved off their surfaces
    const Vec3 end = offset_ray_origin(light->position, light->error, light->normal, neg3(light->direction));
    const Vec3 direction = light->is_infinite ? light->direction : sub3(end, origin);
    const float t_max = light->is_infinite ? INFINITY : 1.0f;
    store_planes4(vec4_from(origin, as_float(light->primitive)), paths->shadow_origin, i, paths->plane_stride);
    store_planes4(vec4_from(direction, t_max), paths->shadow_direction, i, paths->plane_stride);
#if FEATURE_MEDIA
    PLANE(3, paths->shadow_radiance, paths->plane_stride)[i] = as_float(medium_towards(s, direction, p->medium));
#endif
}

#if LANES == 1
// Next-event estimation at the vertex: selects a light, samples it, and writes a shadow ray unless the contribution is
// zero.
INLINE void sample_direct(const SceneView* scene, const PathBuffers* paths, size_t i, const Path* p, const Surface* s,
                          const BsdfContext* ctx)
{
    if (!has_non_delta_lobes(ctx)) return;
    const Vec4 u = path_random(scene, p, BLOCK_LIGHT(random_vertex_index(p)));
    const LightSelection selection = select_light(scene, s->position, light_sampling_normal(ctx), u.x, u.z);
    if (!(selection.probability > 0.0f)) return;
    const LightSample light = sample_light(scene, selection, s->position, u.y);
    if (!can_contribute(&light)) return;
    float bsdf_pdf = 0.0f;
    Vec3 bsdf_value = bsdf_eval(ctx, light.direction, &bsdf_pdf);
#if HAS_BLEND_LIGHTING
    if (ctx->other_weight > 0.0f) {
        BsdfContext other = *ctx;
        float other_pdf = 0.0f;
        other.bsdf = ctx->other_bsdf;
        const Vec3 other_value = bsdf_eval(&other, light.direction, &other_pdf);
        bsdf_value = xyz(
            blend_value(&light, vec4_from(bsdf_value, bsdf_pdf), vec4_from(other_value, other_pdf), ctx->other_weight));
        bsdf_pdf = 0.0f;
    }
#endif
    const Vec3 radiance = direct_lighting(p, s, ctx, &light, bsdf_value, bsdf_pdf);
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    write_shadow_ray(paths, i, p, s, &light);
    store_planes3(radiance, paths->shadow_radiance, i, paths->plane_stride);
#if FEATURE_HETEROGENEOUS
    const uint block = BLOCK_SHADOW(random_vertex_index(p));
    const Vec4 seed = philox_block(scene->seed, p->pixel, p->index, block, 0u);
    paths->shadow_stream[i] = as_uint(seed.x);
    PLANE(1, paths->shadow_stream, paths->plane_stride)[i] = as_uint(seed.y);
#endif
}
#endif
#endif

// Continues the path in the sampled direction, unless the path ends here. `is_last`: the maximum depth is reached.
INLINE void continue_path(const PathBuffers* paths, size_t i, const Path* p, const Surface* s, const BsdfContext* ctx,
                          BsdfSample sample, float u_roulette, bool is_last, uint rr_depth)
{
    // a null bounce keeps the direction and its pdf, and does not add to the depth
    const bool is_null = FEATURE_VOLPATH && sample.is_null;
    if (is_last && !is_null) return;
    Vec3 throughput = mul3(p->throughput, sample.weight);
#if HAS_BUMPS
    if (!is_null) throughput = scale3(throughput, bump_shadowing(ctx, s, sample.direction));
#endif
    const float total = throughput.x + throughput.y + throughput.z;
    if (total == 0.0f) return;
    if (!(total < INFINITY)) {  // the statistics count such a sample as rejected; it must not end up black
        STORE3(splat3(NAN), p->sample, paths->samples);
        return;
    }
    const float eta = p->eta * sample.eta;
#if FEATURE_RUSSIAN_ROULETTE
    if (!is_null && p->depth + 1u >= rr_depth) {  // the rule of Mitsuba 3
        // 2^-24 is the smallest probability that a random number can fall below
        const float survival = MAX(MIN(max_component3(throughput) * eta * eta, 0.95f), 0x1p-24f);
        if (u_roulette >= survival) return;
        throughput = div_scalar3(throughput, survival);
    }
#endif
    const uint plane_stride = paths->plane_stride;
    store_planes4(vec4_from(spawn_origin(s, sample.direction), INFINITY), paths->ray_origin, i, plane_stride);
    store_planes4(vec4_from(sample.direction, is_null ? p->direction_pdf : sample.pdf), paths->ray_direction, i,
                  plane_stride);
    store_planes4(vec4_from(throughput, eta), paths->throughput, i, plane_stride);
    PLANE(PATH_START_PRIMITIVE, paths->path_ids, plane_stride)[i] = p->in_volume ? NONE : p->primitive;
    PLANE(PATH_DEPTH, paths->path_ids, plane_stride)[i] = p->depth + (is_null ? 0u : 1u);
#if FEATURE_VOLPATH
    paths->mis_distance[i] = is_null ? p->mis_distance : 0.0f;
    paths->null_bounces[i] = p->null_bounces + (is_null ? 1u : 0u);
#endif
#if FEATURE_MEDIA
    paths->medium[i] = medium_towards(s, sample.direction, p->medium);
#endif
#if HAS_LIGHT_IMPORTANCE
    if (!is_null) store_planes4(light_sampling_normal(ctx), paths->mis_normal, i, plane_stride);
#endif
    paths->alive[i] = 1;
}
