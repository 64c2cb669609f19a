// Stage: what happens where the rays ended: emission, next-event estimation, the next direction, roulette.
// Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the path is alive.
#include "bsdf.h"
#include "light.h"
#include "material.h"
#include "medium.h"
#include "random.h"

// Veach and Guibas, "Optimally Combining Sampling Techniques", 1995: power heuristic with exponent 2; `pdf` made the sample.
// A negative pdf stands for a delta function, which no other technique can sample.
INLINE float mis_weight(float pdf, float other)
{
    const float ratio = other / pdf;
    return pdf < 0.0f ? 1.0f : 1.0f / (1.0f + ratio * ratio);
}

// Whether a ray's origin lies in the plane of the surface that it seems to have met, as far as rounding can tell: it grazes, from
// a neighbour in the same plane, and may be said to come from the wrong side of it. Such a path ends; it is one in millions,
// where the light of the other side would be seen to leak through. Both points carry an error, the origin was moved by its own.
INLINE bool in_plane(const Surface* s, float3 origin)
{
    const float distance = abs1(dot3(origin - s->position, s->geometric_normal));
    return distance <= 1.25f * dot3(abs3(s->geometric_normal), s->error + GAMMA(7) * abs3(origin));
}

#if FEATURE_NEXT_EVENT
// Leaves a shadow ray for one light; returns without one if nothing could arrive.
INLINE void next_event(const Geometry* g, __global const Light* lights, __global const Alias* light_alias,
                       uint light_count, const Surface* s, const Shading* at, float4 u, float3 weight, uint i,
                       __global float4* shadow_origin, __global float4* shadow_direction, __global float4* shadow_radiance)
{
    const LightSample light = sample_light(g, lights, light_alias, light_count, s->position, lit_side(at), u);
    if (!(light.pdf > 0.0f) || !(largest(light.radiance) > 0.0f)) return;
    float bsdf_pdf;
    const float3 scattered = bsdf_eval(at, light.direction, &bsdf_pdf);
    const float mis = light.is_delta ? 1.0f : mis_weight(light.pdf, bsdf_pdf);
    float3 radiance = weight * scattered * light.radiance * (mis / light.pdf);
#if HAS_BUMPS
    radiance *= bump_share(at, s, light.direction);
#endif
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    const float3 origin = leave(s, light.direction);
    // to a finite light the ray's length is 1, and both its ends are moved off their surfaces
    const float3 direction =
        light.is_infinite ? light.direction
                          : offset_origin(light.position, light.error, light.normal, -light.direction) - origin;
    shadow_origin[i] = (float4)(origin, as_float(light.primitive));
    shadow_direction[i] = (float4)(direction, light.is_infinite ? INFINITY : 1.0f);
    shadow_radiance[i] = (float4)(radiance, 0.0f);
}
#endif

__kernel void shade(uint paths, __global const uint* sample_pixel, uint2 seed, uint max_depth, uint rr_depth,
                    __global const float4* triangles, __global const uint* faces, __global const float* vertex_normals,
#if FEATURE_UVS
                    __global const float* uvs,
#endif
#if FEATURE_TEXTURES
                    __global const Texture* textures, __global const uchar4* texel_bytes,
                    __global const float4* texel_floats, __global const float* srgb, __global const float* attributes,
#endif
                    __global const Analytic* analytics, __global const Shape* shapes, __global const Bsdf* bsdfs,
#if FEATURE_ROUGH_PLASTIC
                    __global const float* boundaries,
#endif
                    __global const Light* lights, __global const Alias* light_alias, uint light_count,
#if FEATURE_ENVIRONMENT_MAP
                    __global const Environment* environment, __global const float* environment_texels,
                    __global const EnvironmentRow* environment_rows, __global const uint* environment_columns,
#endif
                    uint environment_light, __global float4* hit, __global float4* ray_origin,
                    __global float4* ray_direction, __global float4* throughput, __global uint4* path,
                    __global float4* shadow_origin, __global float4* shadow_direction, __global float4* shadow_radiance,
                    __global float* samples, __global uchar* alive
#if FEATURE_INSTANCES
                    , __global const Instance* instances, __global const uint* instance
#endif
#if FEATURE_VOLPATH
                    , __global uint2* crossing
#endif
#if FEATURE_MEDIA
                    , __global const Medium* media, __global uint* medium
#endif
#if FEATURE_LIGHT_TREE
                    , __global const float8* light_nodes, __global const uint* light_places, __global float4* lit
#endif
                    )
{
    const uint i = get_global_id(0);
    if (i >= paths) return;
    alive[i] = 0;
#if FEATURE_NEXT_EVENT
    shadow_direction[i] = (float4)(0.0f);
#endif
    Geometry geometry;
    geometry.triangles = triangles;
    geometry.faces = faces;
    geometry.vertex_normals = vertex_normals;
    geometry.analytics = analytics;
    geometry.shapes = shapes;
#if FEATURE_UVS
    geometry.uvs = uvs;
#endif
#if FEATURE_ENVIRONMENT_MAP
    geometry.environment.record = environment;
    geometry.environment.texels = environment_texels;
    geometry.environment.rows = environment_rows;
    geometry.environment.columns = environment_columns;
#endif
#if FEATURE_LIGHT_TREE
    const LightTree light_tree = {light_nodes, light_places, light_count};
    geometry.light_tree = light_tree;
#endif
#if FEATURE_TEXTURES
    const Textures all_textures = {textures, texel_bytes, texel_floats, srgb, attributes, faces};
    geometry.textures = all_textures;
#endif
    const float4 h = hit[i], origin = ray_origin[i], direction = ray_direction[i], carried = throughput[i];
    const uint4 state = path[i];
    const uint primitive = as_uint(h.w), pixel = sample_pixel[state.x], depth = state.w;
    float3 weight = carried.xyz;
#if FEATURE_VOLPATH
    // what lets a path through unturned is no vertex of it, but takes random numbers: the vertex before and these are kept
    const float travelled = as_float(crossing[i].x), since_vertex = travelled + h.x;
    const float3 last_vertex = origin.xyz - travelled * direction.xyz;
    const uint crossed = crossing[i].y, event = depth + crossed;
#else
    const float since_vertex = h.x;
    const float3 last_vertex = origin.xyz;
    const uint event = depth;
#endif
#if FEATURE_LIGHT_TREE
    const float4 was_lit = lit[i];  // at the last vertex
#else
    const float4 was_lit = (float4)(0.0f);
#endif
#if FEATURE_MEDIA
    const uint within = medium[i];
    float flown = h.x;
    const bool in_volume =
        within != MEDIUM_NONE && fly(media + within, random_block(seed, pixel, state.z, BLOCK_MEDIUM(event)), &flown, &weight);
    const bool from_volume = state.y == NONE;
#else
    const bool in_volume = false, from_volume = false;
#endif

    if (!in_volume && primitive == NONE) {
#if FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
#if FEATURE_HIDE_EMITTERS
        if (depth == 0u) return;
#endif
        float pdf;
        const float3 radiance = sky_radiance(&geometry, lights + environment_light, direction.xyz, &pdf);
        pdf *= pick_probability(&geometry, lights, environment_light, last_vertex, was_lit, direction.w);
        store3(LOAD3(state.x, samples) + weight * radiance * mis_weight(direction.w, pdf), state.x, samples);
#endif
        return;
    }
    Surface s;
    if (!FEATURE_MEDIA || primitive != NONE) {
#if FEATURE_INSTANCES
        s = instanced_surface_at(&geometry, instances, instance[i], primitive, origin.xyz, direction.xyz, h.x, h.y, h.z);
#else
        s = surface_at(&geometry, primitive, origin.xyz, direction.xyz, h.x, h.y, h.z);
#endif
    }
    if (!in_volume && dot3(s.geometric_normal, s.geometric_normal) == 0.0f) return;
#if FEATURE_TRIANGLES
    if (!(in_volume || from_volume) && !(primitive & ANALYTIC_BIT) && in_plane(&s, origin.xyz)) return;
#endif
#if FEATURE_MEDIA
    if (in_volume) {
        enter_volume(&s, primitive != NONE, origin.xyz, direction.xyz, flown, h.x, media[within].phase);
        hit[i].w = as_float(NONE);  // the shadow ray starts on no primitive
    }
#endif

#if FEATURE_AREA_LIGHTS
    if (s.light != NONE) {
#if FEATURE_HIDE_EMITTERS
        if (depth == 0u) {  // seen by the camera, the light is not there: the ray goes on behind it
            ray_origin[i] = (float4)(offset_origin(s.position, s.error, s.geometric_normal, direction.xyz), INFINITY);
            path[i].y = primitive;
#if FEATURE_VOLPATH
            throughput[i].xyz = weight;
            crossing[i].y = crossed + 1u;
#endif
            alive[i] = 1;
            return;
        }
#endif
        if (dot3(s.normal, direction.xyz) < 0.0f) {
            __global const Light* light = lights + s.light;
            const float pdf = pick_probability(&geometry, lights, s.light, last_vertex, was_lit, direction.w) *
                              light_pdf(&geometry, light, last_vertex, direction.xyz, since_vertex, s.normal);
            const float3 emitted = weight * emitted_radiance(&geometry, light, &s) * mis_weight(direction.w, pdf);
            store3(LOAD3(state.x, samples) + emitted, state.x, samples);
        }
    }
#endif

    const bool last = depth + 1u >= max_depth;
    if (!FEATURE_VOLPATH && last) return;
    Shading at;
    at.bsdf = bsdfs + s.bsdf;
    at.normal = s.normal;
    at.wi = -direction.xyz;
    at.cos_i = dot3(at.normal, at.wi);
#if HAS_BUMPS
    at.turned = false;
    at.shadow = NO_BUMP;
#endif
#if HAS_FRAMES
    set_frame(&at, &s);
#endif
#if FEATURE_ROUGH_PLASTIC
    at.tables = boundaries;
#endif
#if FEATURE_TEXTURES
    at.textures = &geometry.textures;
    at.point = texture_point(&s);
#endif
#if HAS_WRAPPERS
    const bool passes = unwrap(&at, bsdfs, &s, random_block(seed, pixel, state.z, BLOCK_MATERIAL(event)).x);
#else
    const bool passes = FEATURE_NULL && at.bsdf->kind == BSDF_NULL;
#endif
#if HAS_SEE_THROUGH && !FEATURE_VOLPATH
    if (passes) {  // next-event estimation did not see what is behind: it takes part in no weight
        ray_origin[i] = (float4)(offset_origin(s.position, s.error, s.geometric_normal, direction.xyz), INFINITY);
        ray_direction[i].w = -1.0f;
        path[i] = (uint4)(state.x, primitive, state.z, depth + 1u);
        alive[i] = 1;
        return;
    }
#endif
#if FEATURE_TWOSIDED
    if ((at.bsdf->flags & BSDF_TWOSIDED) && at.cos_i < 0.0f) turn_to_viewer(&at);
#endif
#if FEATURE_NEXT_EVENT
    if (!passes && !last && bsdf_is_smooth(&at)) {
        next_event(&geometry, lights, light_alias, light_count, &s, &at,
                   random_block(seed, pixel, state.z, BLOCK_LIGHT(event)), weight, i, shadow_origin, shadow_direction,
                   shadow_radiance);
#if FEATURE_MEDIA
        shadow_radiance[i].w = as_float(medium_behind(&s, shadow_direction[i].xyz, within));
#endif
    }
#endif
    const float4 u = random_block(seed, pixel, state.z, BLOCK_BSDF(event));
    const BsdfSample next = passes ? straight_on(direction.xyz) : bsdf_sample(&at, u.xyz);
    const bool straight = FEATURE_VOLPATH && next.pdf == STRAIGHT;
    if (last && !straight) return;
    weight *= next.weight;
#if HAS_BUMPS
    if (!straight) weight *= bump_share(&at, &s, next.direction);
#endif
    const float total = weight.x + weight.y + weight.z;
    if (total == 0.0f) return;
    if (!(total < INFINITY)) {  // the statistics count such a sample apart; it must not end as a black one
        store3((float3)(NAN), state.x, samples);
        return;
    }
    const float eta = carried.w * next.eta;
#if FEATURE_RUSSIAN_ROULETTE
    if (!straight && depth + 1u >= rr_depth) {  // Mitsuba 3's rule
        const float survival = LESSER(largest(weight) * eta * eta, 0.95f);
        if (u.w >= survival) return;
        weight /= survival;
    }
#endif
    ray_origin[i] = (float4)(leave(&s, next.direction), INFINITY);
    ray_direction[i] = (float4)(next.direction, straight ? direction.w : next.pdf);
    throughput[i] = (float4)(weight, eta);
    path[i] = (uint4)(state.x, in_volume ? NONE : primitive, state.z, depth + (straight ? 0u : 1u));
#if FEATURE_VOLPATH
    crossing[i] = straight ? (uint2)(as_uint(since_vertex), crossed + 1u) : (uint2)(as_uint(0.0f), crossed);
#endif
#if FEATURE_MEDIA
    medium[i] = medium_behind(&s, next.direction, within);
#endif
#if FEATURE_LIGHT_TREE
    if (!straight) lit[i] = lit_side(&at);
#endif
    alive[i] = 1;
}
