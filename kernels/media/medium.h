// Media: how far a path flies before it scatters, what lies behind a surface, how much light gets through.
#pragma once
#include "geometry/surface.h"

#if FEATURE_MEDIA
// The medium that a ray is in once it leaves a surface. `medium`: where it came from; most surfaces separate none.
INLINE uint medium_towards(const Surface* s, Vec3 direction, uint medium)
{
    if (s->media == NONE) return medium;
    return dot3(direction, s->geometric_normal) > 0.0f ? s->media >> 16 : s->media & 0xFFFFu;
}

INLINE Vec3 medium_transmittance(__global const Medium* medium, float distance)
{
    const float finite = MIN(distance, FLT_MAX);  // where sigma_t is 0, infinity would make no number
    return vec3(exp(-medium->sigma_t[0] * finite), exp(-medium->sigma_t[1] * finite), exp(-medium->sigma_t[2] * finite));
}

// Whether a path scatters before the surface at `*distance`; then that gets the distance to where. The distance is drawn by one
// colour's density of collisions, the colour by its share of the path's weight, and the weight divided by the density of all
// three together: no colour gets more than the sum that they had (Wilkie et al., "Hero Wavelength Spectral Sampling", 2014).
// `u`: colour, distance, distance (low bits).
INLINE bool sample_medium(__global const Medium* medium, Vec4 u, float* distance, Vec3* weight)
{
    const Vec3 share = div3(*weight, splat3(weight->x + weight->y + weight->z)), sigma_t = LOAD3(0, medium->sigma_t);
    const float sigma = u.x < share.x ? sigma_t.x : u.x < share.x + share.y ? sigma_t.y : sigma_t.z;
    // 48 bits, so that both a thin medium and the light through a thick one are met as often as they should be
    const float low = 0x1p-24f * u.z;
    const float depth = u.y < 0.5f ? -log1p(-(u.y + low)) : -log((1.0f - u.y) - low);
    const float reached = depth / sigma;
    const bool scatters = sigma > 0.0f && reached < *distance;
    if (scatters) *distance = reached;
    const Vec3 transmitted = medium_transmittance(medium, *distance);
    const Vec3 density = scatters ? mul3(div3(sigma_t, splat3(sigma)), transmitted) : transmitted;
    const float all = dot3(share, density);
    const Vec3 albedo = scatters ? LOAD3(0, medium->albedo) : splat3(1.0f);
    *weight = all > 0.0f ? mul3(*weight, div3(mul3(albedo, density), splat3(all))) : splat3(0.0f);
    return scatters;
}

// Makes of the surface that a ray would meet at `ahead` the point of its medium at `distance`, which has no normal. It is
// reckoned from the nearer end and is not closer to the surface than the error of that, so that it is not beyond it.
INLINE void make_medium_vertex(Surface* s, bool has_end, Vec3 origin, Vec3 direction, float distance, float ahead, uint phase)
{
    Vec3 position = add3(origin, scale3(direction, distance));
    if (has_end && distance > 0.5f * ahead) {
        const Vec3 back = scale3(direction, distance - ahead), normal = s->geometric_normal;
        const float off = dot3(normal, back), least = dot3(abs3(normal), add3(s->error, scale3(abs3(s->position), 0x1p-23f)));
        position = add3(add3(s->position, back), scale3(normal, copy_sign(MAX(least - abs_float(off), 0.0f), off)));
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

// The nearest boundaries between media along a ray, in their order; those beyond are found by another search.
#define MAX_MEDIUM_INTERFACES 8u

typedef struct {
    float distance[MAX_MEDIUM_INTERFACES];
    uint behind[MAX_MEDIUM_INTERFACES];  // the medium there
    uint count;
} MediumInterfaces;

INLINE void insert_medium_interface(MediumInterfaces* b, float distance, uint behind)
{
    if (b->count == MAX_MEDIUM_INTERFACES && distance >= b->distance[MAX_MEDIUM_INTERFACES - 1u]) return;
    uint place = b->count < MAX_MEDIUM_INTERFACES ? b->count++ : MAX_MEDIUM_INTERFACES - 1u;
    for (; place > 0u && b->distance[place - 1u] > distance; --place) {
        b->distance[place] = b->distance[place - 1u];
        b->behind[place] = b->behind[place - 1u];
    }
    b->distance[place] = distance;
    b->behind[place] = behind;
}
#endif

// Where a ray that leaves a vertex towards `direction` may start: off the surface, or where it is in a volume.
INLINE Vec3 spawn_origin(const Surface* s, Vec3 direction)
{
#if FEATURE_MEDIA
    if (dot3(s->geometric_normal, s->geometric_normal) == 0.0f) return s->position;
#endif
    return offset_ray_origin(s->position, s->error, s->geometric_normal, direction);
}
