// Stage: what happens where the rays ended: emission, next-event estimation, the next direction, roulette.
// Reads hit and the path state; adds emission to samples; writes the next ray, the shadow ray and whether the path is alive.
#include "bsdf.h"
#include "light.h"
#include "material.h"
#include "medium.h"
#include "paths.h"
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
INLINE bool in_plane(const Surface* s, Vec3 origin)
{
    const float distance = abs1(dot3(sub3(origin, s->position), s->geometric_normal));
    return distance <= 1.25f * dot3(abs3(s->geometric_normal), add3(s->error, scale3(abs3(origin), GAMMA(7))));
}

#if FEATURE_NEXT_EVENT
// Leaves a shadow ray for one light; returns without one if nothing could arrive.
INLINE void next_event(const Geometry* g, __global const Light* lights, __global const Alias* light_alias,
                       uint light_count, const Surface* s, const Shading* at, Vec4 u, Vec3 weight, uint medium, size_t i,
                       uint pool, __global float* shadow_origin, __global float* shadow_direction, __global float* shadow_radiance)
{
    const LightSample light = sample_light(g, lights, light_alias, light_count, s->position, lit_side(at), u);
    if (!(light.pdf > 0.0f) || !(largest(light.radiance) > 0.0f)) return;
    float bsdf_pdf = 0.0f;
    const Vec3 scattered = bsdf_eval(at, light.direction, &bsdf_pdf);
    const float mis = light.is_delta ? 1.0f : mis_weight(light.pdf, bsdf_pdf);
    Vec3 radiance = scale3(mul3(mul3(weight, scattered), light.radiance), mis / light.pdf);
#if HAS_BUMPS
    radiance = scale3(radiance, bump_share(at, s, light.direction));
#endif
    if (radiance.x + radiance.y + radiance.z == 0.0f) return;
    const Vec3 origin = leave(s, light.direction);
    // to a finite light the ray's length is 1, and both its ends are moved off their surfaces
    const Vec3 direction =
        light.is_infinite ? light.direction
                          : sub3(offset_origin(light.position, light.error, light.normal, neg3(light.direction)), origin);
    store_planes4(with_w(origin, as_float(light.primitive)), shadow_origin, i, pool);
    store_planes4(with_w(direction, light.is_infinite ? INFINITY : 1.0f), shadow_direction, i, pool);
    store_planes3(radiance, shadow_radiance, i, pool);
#if FEATURE_MEDIA
    PLANE(3, shadow_radiance, pool)[i] = as_float(medium_behind(s, direction, medium));
#endif
}
#endif

__kernel void shade(uint paths, uint pool, __global const uint* restrict sample_pixel, uint2 seed, uint max_depth, uint rr_depth,
                    __global const float* restrict triangles, __global const uint* restrict faces, __global const float* restrict vertex_normals,
#if FEATURE_UVS
                    __global const float* restrict uvs,
#endif
#if FEATURE_TEXTURES
                    __global const Texture* restrict textures, __global const uchar* restrict texel_bytes,
                    __global const float* restrict texel_floats, __global const float* restrict srgb, __global const float* restrict attributes,
#endif
                    __global const Analytic* restrict analytics, __global const Shape* restrict shapes, __global const Bsdf* restrict bsdfs,
#if FEATURE_ROUGH_PLASTIC
                    __global const float* restrict boundaries,
#endif
                    __global const Light* restrict lights, __global const Alias* restrict light_alias, uint light_count,
#if FEATURE_ENVIRONMENT_MAP
                    __global const Environment* restrict environment, __global const float* restrict environment_texels,
                    __global const EnvironmentRow* restrict environment_rows, __global const uint* restrict environment_columns,
#endif
                    uint environment_light, __global float* restrict hit, __global float* restrict ray_origin,
                    __global float* restrict ray_direction, __global float* restrict throughput, __global uint* restrict path,
                    __global float* restrict shadow_origin, __global float* restrict shadow_direction, __global float* restrict shadow_radiance,
                    __global float* restrict samples, __global uchar* restrict alive
#if FEATURE_INSTANCES
                    , __global const Instance* restrict instances, __global const uint* restrict instance
#endif
#if FEATURE_VOLPATH
                    , __global uint* restrict crossing
#endif
#if FEATURE_MEDIA
                    , __global const Medium* restrict media, __global uint* restrict medium
#endif
#if FEATURE_LIGHT_TREE
                    , __global const float8* restrict light_nodes, __global const uint* restrict light_places, __global float* restrict lit
#endif
                    )
{
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
    EACH_PATH(i) {
        if (i >= paths) continue;
        alive[i] = 0;
#if FEATURE_NEXT_EVENT
        PLANE(3, shadow_direction, pool)[i] = 0.0f;
#endif
        const Vec4 h = load_planes4(hit, i, pool), carried = load_planes4(throughput, i, pool);
        const Vec4 incoming = load_planes4(ray_direction, i, pool);
        const Vec3 origin = load_planes3(ray_origin, i, pool), direction = xyz(incoming);
        const float direction_pdf = incoming.w;
        const uint primitive = as_uint(h.w), start = PLANE(PATH_START, path, pool)[i];
        const uint sample = PLANE(PATH_SAMPLE, path, pool)[i], index = PLANE(PATH_INDEX, path, pool)[i];
        const uint pixel = sample_pixel[sample], depth = PLANE(PATH_DEPTH, path, pool)[i];
        Vec3 weight = xyz(carried);
#if FEATURE_VOLPATH
        // what lets a path through unturned is no vertex of it, but takes random numbers: the vertex before and these are kept
        const float travelled = as_float(crossing[i]), since_vertex = travelled + h.x;
        const Vec3 last_vertex = sub3(origin, scale3(direction, travelled));
        const uint crossed = PLANE(1, crossing, pool)[i], event = depth + crossed;
#else
        const float since_vertex = h.x;
        const Vec3 last_vertex = origin;
        const uint event = depth;
#endif
#if FEATURE_LIGHT_TREE
        const Vec4 was_lit = load_planes4(lit, i, pool);  // at the last vertex
#else
        const Vec4 was_lit = vec4(0.0f, 0.0f, 0.0f, 0.0f);
#endif
#if FEATURE_MEDIA
        const uint within = medium[i];
        float flown = h.x;
        const bool in_volume =
            within != MEDIUM_NONE && fly(media + within, random_block(seed, pixel, index, BLOCK_MEDIUM(event)), &flown, &weight);
        const bool from_volume = start == NONE;
#else
        const uint within = 0u;
        const bool in_volume = false, from_volume = false;
#endif

        if (!in_volume && primitive == NONE) {
#if FEATURE_CONSTANT_LIGHT || FEATURE_ENVIRONMENT_MAP
#if FEATURE_HIDE_EMITTERS
            if (depth == 0u) continue;
#endif
            float pdf;
            const Vec3 radiance = sky_radiance(&geometry, lights + environment_light, direction, &pdf);
            pdf *= pick_probability(&geometry, lights, environment_light, last_vertex, was_lit, direction_pdf);
            ADD3(scale3(mul3(weight, radiance), mis_weight(direction_pdf, pdf)), sample, samples);
#endif
            continue;
        }
        Surface s = no_surface();
        if (!FEATURE_MEDIA || primitive != NONE) {
#if FEATURE_INSTANCES
            s = instanced_surface_at(&geometry, instances, instance[i], primitive, origin, direction, h.x, h.y, h.z);
#else
            s = surface_at(&geometry, primitive, origin, direction, h.x, h.y, h.z);
#endif
        }
        if (!in_volume && dot3(s.geometric_normal, s.geometric_normal) == 0.0f) continue;
#if FEATURE_TRIANGLES
        if (!(in_volume || from_volume) && !(primitive & ANALYTIC_BIT) && in_plane(&s, origin)) continue;
#endif
#if FEATURE_MEDIA
        if (in_volume) {
            enter_volume(&s, primitive != NONE, origin, direction, flown, h.x, media[within].phase);
            PLANE(3, hit, pool)[i] = as_float(NONE);  // the shadow ray starts on no primitive
        }
#endif

#if FEATURE_AREA_LIGHTS
        if (s.light != NONE) {
#if FEATURE_HIDE_EMITTERS
            if (depth == 0u) {  // seen by the camera, the light is not there: the ray goes on behind it
                const Vec3 behind = offset_origin(s.position, s.error, s.geometric_normal, direction);
                store_planes4(with_w(behind, INFINITY), ray_origin, i, pool);
                PLANE(PATH_START, path, pool)[i] = primitive;
#if FEATURE_VOLPATH
                store_planes3(weight, throughput, i, pool);
                PLANE(1, crossing, pool)[i] = crossed + 1u;
#endif
                alive[i] = 1;
                continue;
            }
#endif
            if (dot3(s.normal, direction) < 0.0f) {
                __global const Light* light = lights + s.light;
                const float pdf = pick_probability(&geometry, lights, s.light, last_vertex, was_lit, direction_pdf) *
                                  light_pdf(&geometry, light, last_vertex, direction, since_vertex, s.normal);
                const Vec3 emitted = scale3(mul3(weight, emitted_radiance(&geometry, light, &s)), mis_weight(direction_pdf, pdf));
                ADD3(emitted, sample, samples);
            }
        }
#endif

        const bool last = depth + 1u >= max_depth;
        if (!FEATURE_VOLPATH && last) continue;
        Shading at;
        at.bsdf = bsdfs + s.bsdf;
        at.normal = s.normal;
        at.wi = neg3(direction);
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
        const bool passes = unwrap(&at, bsdfs, &s, random_block(seed, pixel, index, BLOCK_MATERIAL(event)).x);
#else
        const bool passes = FEATURE_NULL && (at.bsdf->kind & BSDF_NULL);
#endif
#if HAS_SEE_THROUGH && !FEATURE_VOLPATH
        if (passes) {  // next-event estimation did not see what is behind: it takes part in no weight
            const Vec3 behind = offset_origin(s.position, s.error, s.geometric_normal, direction);
            store_planes4(with_w(behind, INFINITY), ray_origin, i, pool);
            PLANE(3, ray_direction, pool)[i] = -1.0f;
            PLANE(PATH_START, path, pool)[i] = primitive;
            PLANE(PATH_DEPTH, path, pool)[i] = depth + 1u;
            alive[i] = 1;
            continue;
        }
#endif
#if FEATURE_TWOSIDED
        if ((at.bsdf->flags & BSDF_TWOSIDED) && at.cos_i < 0.0f) turn_to_viewer(&at);
#endif
#if FEATURE_NEXT_EVENT
        if (!passes && !last && bsdf_is_smooth(&at)) {
            next_event(&geometry, lights, light_alias, light_count, &s, &at,
                       random_block(seed, pixel, index, BLOCK_LIGHT(event)), weight, within, i, pool, shadow_origin,
                       shadow_direction, shadow_radiance);
        }
#endif
        const Vec4 u = random_block(seed, pixel, index, BLOCK_BSDF(event));
        const BsdfSample next = passes ? straight_on(direction) : bsdf_sample(&at, xyz(u));
        const bool straight = FEATURE_VOLPATH && next.pdf == STRAIGHT;
        if (last && !straight) continue;
        weight = mul3(weight, next.weight);
#if HAS_BUMPS
        if (!straight) weight = scale3(weight, bump_share(&at, &s, next.direction));
#endif
        const float total = weight.x + weight.y + weight.z;
        if (total == 0.0f) continue;
        if (!(total < INFINITY)) {  // the statistics count such a sample apart; it must not end as a black one
            STORE3(all3(NAN), sample, samples);
            continue;
        }
        const float eta = carried.w * next.eta;
#if FEATURE_RUSSIAN_ROULETTE
        if (!straight && depth + 1u >= rr_depth) {  // Mitsuba 3's rule
            const float survival = LESSER(largest(weight) * eta * eta, 0.95f);
            if (u.w >= survival) continue;
            weight = over3(weight, survival);
        }
#endif
        store_planes4(with_w(leave(&s, next.direction), INFINITY), ray_origin, i, pool);
        store_planes4(with_w(next.direction, straight ? direction_pdf : next.pdf), ray_direction, i, pool);
        store_planes4(with_w(weight, eta), throughput, i, pool);
        PLANE(PATH_START, path, pool)[i] = in_volume ? NONE : primitive;
        PLANE(PATH_DEPTH, path, pool)[i] = depth + (straight ? 0u : 1u);
#if FEATURE_VOLPATH
        crossing[i] = as_uint(straight ? since_vertex : 0.0f);
        PLANE(1, crossing, pool)[i] = crossed + (straight ? 1u : 0u);
#endif
#if FEATURE_MEDIA
        medium[i] = medium_behind(&s, next.direction, within);
#endif
#if FEATURE_LIGHT_TREE
        if (!straight) store_planes4(lit_side(&at), lit, i, pool);
#endif
        alive[i] = 1;
    }
}
