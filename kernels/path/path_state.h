// Path state in memory, and loops over the paths of a work-item. Every buffer is a row of planes, one for each 4-byte
// member, of `plane_stride` numbers: members that neighbouring paths access together lie together. All stages over
// paths include this.
#pragma once
#include "util/vec.h"

// Planes of the buffer `path_ids`.
#define PATH_SAMPLE 0u           // sample within the slice
#define PATH_START_PRIMITIVE 1u  // primitive that the ray starts on, or NONE
#define PATH_SAMPLE_INDEX 2u     // index of the sample within its pixel
#define PATH_DEPTH 3u

// A work-item processes LANES paths. PoCL's CPU devices do not vectorise across work-items, but vectorise these loops
// over lanes, VECTOR_WIDTH lanes at a time. On all other devices LANES is 1. Every lane writes to memory of its own, so
// `assume_safety` holds.
#if LANES > 1
#define VECTOR_WIDTH 16u
#define VECTORIZE _Pragma("clang loop vectorize(assume_safety) vectorize_width(16) interleave(disable)")
#else
#define VECTOR_WIDTH 1u
#define VECTORIZE
#endif
#ifdef __clang__
#pragma clang diagnostic ignored "-Wpass-failed"  // a loop that is not vectorised is slow, not wrong
#endif
// Runs over whole vectors: the body has to skip lanes k >= count, where it has effects.
#define FOR_LANES(k, count)                                                    \
    for (uint first_ = 0u; first_ < (count); first_ += VECTOR_WIDTH) VECTORIZE \
    for (uint k = first_; k < first_ + VECTOR_WIDTH; ++k)

// In place of the pdf of a direction that next-event estimation could not have found: of a camera ray, of a delta lobe,
// of a phase function from which no lights are sampled, or behind a surface at which shadow rays stop.
#define PDF_WITHOUT_MIS (-1.0f)

INLINE bool is_mis_weighted(float pdf)
{
    return !(pdf < 0.0f);
}

#define PLANE(k, planes, plane_stride) ((planes) + (size_t)(k) * (plane_stride))

INLINE Vec3 load_planes3(__global const float* planes, size_t i, uint plane_stride)
{
    return vec3(planes[i], PLANE(1, planes, plane_stride)[i], PLANE(2, planes, plane_stride)[i]);
}

INLINE Vec4 load_planes4(__global const float* planes, size_t i, uint plane_stride)
{
    return vec4(planes[i], PLANE(1, planes, plane_stride)[i], PLANE(2, planes, plane_stride)[i],
                PLANE(3, planes, plane_stride)[i]);
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
// Access to lane state (path/lane_state.h): private planes of LANES numbers.
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
    return vec3(load_lane(lane_state, member, lane), load_lane(lane_state, member + 1u, lane),
                load_lane(lane_state, member + 2u, lane));
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
