// Where the paths in flight are kept between the stages. Every buffer is a row of planes, one for each member of its records, of
// `pool` numbers: what paths side by side read or write together lies together.
#pragma once
#include "plain.h"

// Planes of `path`.
#define PATH_SAMPLE 0u  // of the slice
#define PATH_START 1u   // primitive that the ray starts on
#define PATH_INDEX 2u   // of the sample in its pixel
#define PATH_DEPTH 3u

// A work-item takes LANES paths. On devices with vector instructions, if their compiler doesn't do so with work-items, loops over
// them become some, VECTOR paths at a time; `continue` goes on to the next. Paths write to places of their own, so it may.
#if LANES > 1
#define VECTOR 16u
#define AS_VECTOR _Pragma("clang loop vectorize(assume_safety) vectorize_width(16) interleave(disable)")
#else
#define VECTOR 1u
#define AS_VECTOR
#endif
#ifdef __clang__
#pragma clang diagnostic ignored "-Wpass-failed"  // where it stays a loop, nothing is wrong
#endif
// The body has to leave out what is not below `count`.
#define EACH_OF(k, count)                                                \
    for (uint first_ = 0u; first_ < (count); first_ += VECTOR)           \
        AS_VECTOR for (uint k = first_; k < first_ + VECTOR; ++k)

#define PLANE(k, planes, pool) ((planes) + (size_t)(k) * (pool))

INLINE Vec3 load_planes3(__global const float* planes, size_t i, uint pool)
{
    return vec3(planes[i], PLANE(1, planes, pool)[i], PLANE(2, planes, pool)[i]);
}

INLINE Vec4 load_planes4(__global const float* planes, size_t i, uint pool)
{
    return vec4(planes[i], PLANE(1, planes, pool)[i], PLANE(2, planes, pool)[i], PLANE(3, planes, pool)[i]);
}

INLINE void store_planes3(Vec3 v, __global float* planes, size_t i, uint pool)
{
    planes[i] = v.x;
    PLANE(1, planes, pool)[i] = v.y;
    PLANE(2, planes, pool)[i] = v.z;
}

INLINE void store_planes4(Vec4 v, __global float* planes, size_t i, uint pool)
{
    store_planes3(xyz(v), planes, i, pool);
    PLANE(3, planes, pool)[i] = v.w;
}

#if LANES > 1
// Members of records that a work-item keeps from one loop over its paths to the next.
INLINE void keep1(float x, float* kept, uint member, size_t lane)
{
    (kept + member * LANES)[lane] = x;
}

INLINE float kept1(const float* kept, uint member, size_t lane)
{
    return (kept + member * LANES)[lane];
}

INLINE void keep3(Vec3 v, float* kept, uint member, size_t lane)
{
    keep1(v.x, kept, member, lane);
    keep1(v.y, kept, member + 1u, lane);
    keep1(v.z, kept, member + 2u, lane);
}

INLINE Vec3 kept3(const float* kept, uint member, size_t lane)
{
    return vec3(kept1(kept, member, lane), kept1(kept, member + 1u, lane), kept1(kept, member + 2u, lane));
}

INLINE void keep4(Vec4 v, float* kept, uint member, size_t lane)
{
    keep3(xyz(v), kept, member, lane);
    keep1(v.w, kept, member + 3u, lane);
}

INLINE Vec4 kept4(const float* kept, uint member, size_t lane)
{
    return with_w(kept3(kept, member, lane), kept1(kept, member + 3u, lane));
}
#endif
