// Where the paths in flight are kept between the stages. Every buffer is a row of planes, one for each member of its records, of
// `pool` numbers: what paths side by side read or write together lies together.
#pragma once
#include "plain.h"

// Planes of `path`.
#define PATH_SAMPLE 0u  // of the slice
#define PATH_START 1u   // primitive that the ray starts on
#define PATH_INDEX 2u   // of the sample in its pixel
#define PATH_DEPTH 3u

// A work-item takes LANES paths, one after the other; `continue` goes on to the next. On devices with vector instructions, if
// their compiler doesn't do so with work-items, this is the loop that becomes some. Paths write to places of their own, so it may.
#if LANES > 1
#define EACH_PATH(i)                                                                          \
    _Pragma("clang loop vectorize(assume_safety) vectorize_width(16) interleave(disable)")    \
    for (size_t i = get_global_id(0) * LANES, end_ = i + LANES; i < end_; ++i)
#else
#define EACH_PATH(i) for (size_t i = get_global_id(0), end_ = i + 1; i < end_; ++i)
#endif

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
