// Where the paths in flight are kept between the stages. Every buffer is a row of planes, one for each member of its records, of
// `plane_stride` numbers: what paths side by side read or write together lies together.
#pragma once
#include "util/vec.h"

// Planes of `path`.
#define PATH_SAMPLE 0u  // of the slice
#define PATH_START_PRIMITIVE 1u   // primitive that the ray starts on
#define PATH_SAMPLE_INDEX 2u   // of the sample in its pixel
#define PATH_DEPTH 3u

// A work-item takes LANES paths. On devices with vector instructions, if their compiler doesn't do so with work-items, loops over
// them become some, VECTOR_WIDTH paths at a time; `continue` goes on to the next. Paths write to places of their own, so it may.
#if LANES > 1
#define VECTOR_WIDTH 16u
#define VECTORIZE _Pragma("clang loop vectorize(assume_safety) vectorize_width(16) interleave(disable)")
#else
#define VECTOR_WIDTH 1u
#define VECTORIZE
#endif
#ifdef __clang__
#pragma clang diagnostic ignored "-Wpass-failed"  // where it stays a loop, nothing is wrong
#endif
// The body has to leave out what is not below `count`.
#define FOR_LANES(k, count)                                                \
    for (uint first_ = 0u; first_ < (count); first_ += VECTOR_WIDTH)           \
        VECTORIZE for (uint k = first_; k < first_ + VECTOR_WIDTH; ++k)

#define PLANE(k, planes, plane_stride) ((planes) + (size_t)(k) * (plane_stride))

INLINE Vec3 load_planes3(__global const float* planes, size_t i, uint plane_stride)
{
    return vec3(planes[i], PLANE(1, planes, plane_stride)[i], PLANE(2, planes, plane_stride)[i]);
}

INLINE Vec4 load_planes4(__global const float* planes, size_t i, uint plane_stride)
{
    return vec4(planes[i], PLANE(1, planes, plane_stride)[i], PLANE(2, planes, plane_stride)[i], PLANE(3, planes, plane_stride)[i]);
}

INLINE void store_planes3(Vec3 v, __global float* planes, size_t i, uint plane_stride)
{
    planes[i] = v.x;
    PLANE(1, planes, plane_stride)[i] = v.y;
    PLANE(2, planes, plane_stride)[i] = v.z;
}

INLINE void store_planes4(Vec4 v, __global float* planes, size_t i, uint plane_stride)
{
    store_planes3(xyz(v), planes, i, plane_stride);
    PLANE(3, planes, plane_stride)[i] = v.w;
}

#if LANES > 1
// Members of records that a work-item keeps from one loop over its paths to the next.
INLINE void store_lane(float x, float* lane_state, uint member, size_t lane)
{
    (lane_state + member * LANES)[lane] = x;
}

INLINE float load_lane(const float* lane_state, uint member, size_t lane)
{
    return (lane_state + member * LANES)[lane];
}

INLINE void store_lane3(Vec3 v, float* lane_state, uint member, size_t lane)
{
    store_lane(v.x, lane_state, member, lane);
    store_lane(v.y, lane_state, member + 1u, lane);
    store_lane(v.z, lane_state, member + 2u, lane);
}

INLINE Vec3 load_lane3(const float* lane_state, uint member, size_t lane)
{
    return vec3(load_lane(lane_state, member, lane), load_lane(lane_state, member + 1u, lane), load_lane(lane_state, member + 2u, lane));
}

INLINE void store_lane4(Vec4 v, float* lane_state, uint member, size_t lane)
{
    store_lane3(xyz(v), lane_state, member, lane);
    store_lane(v.w, lane_state, member + 3u, lane);
}

INLINE Vec4 load_lane4(const float* lane_state, uint member, size_t lane)
{
    return vec4_from(load_lane3(lane_state, member, lane), load_lane(lane_state, member + 3u, lane));
}
#endif
