// Participating media: free-flight sampling, transmittance, medium interfaces. Called by `shade` and
// `shadow_transmittance`. Reads the medium table and the surface at the end of the ray.
#pragma once
#include "geometry/surface.h"

#if FEATURE_MEDIA
// The medium of a ray that leaves a surface towards `direction`. `medium`: that of the incoming ray, which stays the
// same at surfaces that are not medium interfaces.
INLINE uint medium_towards(const Surface* s, Vec3 direction, uint medium)
{
    if (s->media == NONE) return medium;
    return dot3(direction, s->geometric_normal) > 0.0f ? s->media >> 16 : s->media & 0xFFFFu;
}

INLINE Vec3 medium_transmittance(__global const Medium* medium, float distance)
{
    const float d = MIN(distance, FLT_MAX);  // 0 * infinity would be NaN
    return vec3(exp(-medium->sigma_t[0] * d), exp(-medium->sigma_t[1] * d), exp(-medium->sigma_t[2] * d));
}

// Free-flight sampling. Returns whether the path scatters before the surface at `*distance`, which then receives the
// distance of the scattering event. A colour channel is selected in proportion to the throughput `*weight`, the
// distance is sampled by its extinction, and the weight is divided by the pdf of all three channels (balance
// heuristic), so that no channel exceeds the sum that they had before. Wilkie et al., "Hero Wavelength Spectral
// Sampling", 2014. `u`: channel, distance, distance (low bits).
INLINE bool sample_medium(__global const Medium* medium, Vec4 u, float* distance, Vec3* weight)
{
    const Vec3 channel_pmf = div3(*weight, splat3(weight->x + weight->y + weight->z));
    const Vec3 sigma_t = LOAD3(0, medium->sigma_t);
    const float sigma = u.x < channel_pmf.x ? sigma_t.x : u.x < channel_pmf.x + channel_pmf.y ? sigma_t.y : sigma_t.z;
    // 48 bits: scattering in a thin medium and transmission through a thick one keep their probabilities
    const float u_low = 0x1p-24f * u.z;
    const float optical_depth = u.y < 0.5f ? -log1p(-(u.y + u_low)) : -log((1.0f - u.y) - u_low);
    const float sampled_distance = optical_depth / sigma;
    const bool scatters = sigma > 0.0f && sampled_distance < *distance;
    if (scatters) *distance = sampled_distance;
    const Vec3 transmittance = medium_transmittance(medium, *distance);
    // collision density in units of sigma, or the probability to reach the surface
    const Vec3 density = scatters ? mul3(div3(sigma_t, splat3(sigma)), transmittance) : transmittance;
    const float pdf = dot3(channel_pmf, density);
    const Vec3 albedo = scatters ? LOAD3(0, medium->albedo) : splat3(1.0f);
    *weight = pdf > 0.0f ? mul3(*weight, div3(mul3(albedo, density), splat3(pdf))) : splat3(0.0f);
    return scatters;
}

// Replaces the surface that the ray hits at `hit_distance` by a vertex of the medium at `distance`, which has no
// normal. `has_hit`: whether there is such a surface. The position is computed from the nearer end of the ray and kept
// off the surface by the error bound of the hit, so that it is never on the wrong side.
INLINE void make_medium_vertex(Surface* s, bool has_hit, Vec3 origin, Vec3 direction, float distance,
                               float hit_distance, uint phase)
{
    Vec3 position = add3(origin, scale3(direction, distance));
    if (has_hit && distance > 0.5f * hit_distance) {
        const Vec3 back = scale3(direction, distance - hit_distance), normal = s->geometric_normal;
        const float height = dot3(normal, back);
        const float min_height = dot3(abs3(normal), add3(s->error, scale3(abs3(s->position), 0x1p-23f)));
        const float missing = MAX(min_height - abs_float(height), 0.0f);
        position = add3(add3(s->position, back), scale3(normal, copy_sign(missing, height)));
    }
    s->position = position;
    s->error = s->geometric_normal = splat3(0.0f);
    s->normal = vec3(0.0f, 0.0f, 1.0f);
    s->bsdf = phase;
    s->light = s->media = NONE;
#if FEATURE_UVS
    s->uv = s->barycentric = splat2(0.0f);
    s->dp_du = s->dp_dv = splat3(0.0f);
    s->triangle = NONE;
#endif
}

// The nearest medium interfaces along a ray, sorted by distance. Those beyond need another traversal.
#define MAX_MEDIUM_INTERFACES 8u

typedef struct {
    float distance[MAX_MEDIUM_INTERFACES];
    uint medium[MAX_MEDIUM_INTERFACES];  // behind the interface
    uint count;
} MediumInterfaces;

INLINE void insert_medium_interface(MediumInterfaces* list, float distance, uint medium)
{
    if (list->count == MAX_MEDIUM_INTERFACES && distance >= list->distance[MAX_MEDIUM_INTERFACES - 1u]) return;
    uint k = list->count < MAX_MEDIUM_INTERFACES ? list->count++ : MAX_MEDIUM_INTERFACES - 1u;
    for (; k > 0u && list->distance[k - 1u] > distance; --k) {
        list->distance[k] = list->distance[k - 1u];
        list->medium[k] = list->medium[k - 1u];
    }
    list->distance[k] = distance;
    list->medium[k] = medium;
}
#endif

// Origin of a ray that leaves a vertex towards `direction`: offset from a surface, unchanged in a medium.
INLINE Vec3 spawn_origin(const Surface* s, Vec3 direction)
{
#if FEATURE_MEDIA
    if (dot3(s->geometric_normal, s->geometric_normal) == 0.0f) return s->position;
#endif
    return offset_ray_origin(s->position, s->error, s->geometric_normal, direction);
}
