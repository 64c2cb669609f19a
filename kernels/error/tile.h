// A tile of 64x64 pixels for the stage `relative_errors`: its statistics as pyramids. The levels of a pyramid are the
// pixels and their groups of 2x2, 4x4, 8x8 and 16x16. On every level the four children of a group are a quarter of the
// level apart, so loops over groups read and write consecutive elements.
#pragma once
#include "util/vec.h"

#define LEVELS 4
#define CELLS 4096
#define LEVEL_SIZE(level) (CELLS >> 2 * (level))
#define LEVEL_BEGIN(level) ((4 * CELLS - 4 * LEVEL_SIZE(level)) / 3)
#define PYRAMID_SIZE LEVEL_BEGIN(LEVELS + 1)

// Loops over elements of a tile, shared by the work-items of a group. SYNCHRONIZE stands between loops of which one
// reads what the other writes. On a CPU a group has one work-item, and the loops are vectorised. UNROLL_IF_VECTORIZED
// stands before an inner loop that would double the registers of a GPU if it were unrolled.
#if TILE_WORK_ITEMS > 1
#define FOR_EACH(i, size) for (int i = (int)get_local_id(0); i < (size); i += (int)TILE_WORK_ITEMS)
#define SYNCHRONIZE barrier(CLK_GLOBAL_MEM_FENCE)
#define UNROLL_IF_VECTORIZED NO_UNROLL
#else
#define FOR_EACH(i, size) VECTORIZE_PIXELS for (int i = 0; i < (size); ++i)
#define SYNCHRONIZE
#define UNROLL_IF_VECTORIZED _Pragma("unroll")
#endif

typedef __global float* Plane;

typedef struct {
    Plane n, x;          // samples and mean, of a group their sum and the weighted mean
    Plane dof, s2;       // degrees of freedom and the variance of a sample
    Plane known, zeros;  // pixels with n >= 2; those of which all samples are 0
    Plane smoothed;      // means smoothed by `_smoothed_mean`
    Plane kept_noise;    // the share of the noise that they still have
    Plane posterior;     // their variance by `_posterior_variance`, not divided by scale^2
    Plane relative;      // s2 / scale^2
    Plane shrunk;        // shrunk by `_shrunk_variance`
    Plane phi;           // noise of the variances by `_variance_noise`: of 16 windows, of 4 and of the tile
    Plane work[2];       // of the function
} Tile;

INLINE Tile tile_planes(Plane scratch)
{
    Tile t;
    t.n = scratch;
    t.x = t.n + PYRAMID_SIZE;
    t.dof = t.x + PYRAMID_SIZE;
    t.s2 = t.dof + PYRAMID_SIZE;
    t.known = t.s2 + PYRAMID_SIZE;
    t.zeros = t.known + PYRAMID_SIZE;
    t.smoothed = t.zeros + PYRAMID_SIZE;
    t.kept_noise = t.smoothed + PYRAMID_SIZE;
    t.posterior = t.kept_noise + PYRAMID_SIZE;
    t.relative = t.posterior + PYRAMID_SIZE;
    t.shrunk = t.relative + PYRAMID_SIZE;
    t.phi = t.shrunk + PYRAMID_SIZE;
    t.work[0] = t.phi + PYRAMID_SIZE;
    t.work[1] = t.work[0] + PYRAMID_SIZE;
    return t;
}

INLINE float ratio(float a, float b)
{
    return b > 0.0f ? a / b : 0.0f;
}

INLINE float limited(float value, float limit)
{
    return value < 1.0f / limit ? 0.0f : MIN(value, limit);
}

INLINE float child_dof(float children)
{
    return MAX(children - 1.0f, 0.0f);
}

// Weighted squared deviations of the four children of a group from its mean. The children are cells `first`, `first` +
// `stride`, ... of planes `weight` and `value`; `children` receives how many have weight.
INLINE float child_scatter(Plane weight, Plane value, float mean, int first, int stride, float* children)
{
    float sum = 0.0f;
    *children = 0.0f;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int c = first + k * stride;
        const float deviation = value[c] - mean;
        sum += weight[c] * deviation * deviation;
        *children += weight[c] > 0.0f ? 1.0f : 0.0f;
    }
    return sum;
}

// Total weights and weighted means of the groups above `level`.
NOINLINE void build_level(Plane weights, Plane values, int level)
{
    const int groups = LEVEL_SIZE(level + 1);
    const Plane weight = weights + LEVEL_BEGIN(level), value = values + LEVEL_BEGIN(level);
    const Plane group_weight = weights + LEVEL_BEGIN(level + 1), group_value = values + LEVEL_BEGIN(level + 1);
    FOR_EACH(g, groups) {
        float total = 0.0f, sum = 0.0f;
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            total += weight[g + k * groups];
            sum += weight[g + k * groups] * value[g + k * groups];
        }
        group_weight[g] = total;
        group_value[g] = ratio(sum, total);
    }
    SYNCHRONIZE;
}

// Sums of the groups above `level`.
NOINLINE void sum_level(Plane values, int level)
{
    const int groups = LEVEL_SIZE(level + 1);
    const Plane value = values + LEVEL_BEGIN(level), sum = values + LEVEL_BEGIN(level + 1);
    FOR_EACH(g, groups) sum[g] = value[g] + value[g + groups] + value[g + 2 * groups] + value[g + 3 * groups];
    SYNCHRONIZE;
}

NOINLINE void build_pyramids(Tile t)
{
    for (int level = 0; level < LEVELS; ++level) {
        build_level(t.n, t.x, level);
        build_level(t.dof, t.s2, level);
    }
}

// Loads the tile; means are in units of `1 / inverse_unit`. The bits of a cell's index are those of y and x in turn,
// the lowest bit of y first.
NOINLINE void load_tile(Tile t, uint left, uint top, uint width, uint height, float inverse_unit,
                        __global const uint* count, __global const float* luminance, uint total_pixels)
{
    FOR_EACH(c, CELLS) {
        uint x = left, y = top;
#pragma unroll
        for (uint bit = 0; bit < 6u; ++bit) {
            x += ((uint)c >> (10u - 2u * bit) & 1u) << bit;
            y += ((uint)c >> (11u - 2u * bit) & 1u) << bit;
        }
        const bool inside = x < width && y < height;
        const int pixel = inside ? (int)(y * width + x) : 0;
        const uint n = inside ? count[pixel] : 0u;
        const bool known = n > 1u;
        const float variance = luminance[(int)total_pixels + pixel] * inverse_unit * inverse_unit;
        const float mean = known ? limited(luminance[pixel] * inverse_unit, MAX_MEAN) : 0.0f;
        const float s2 = known ? limited(variance, MAX_MEAN * MAX_MEAN) : 0.0f;
        t.n[c] = known ? (float)n : 0.0f;
        t.dof[c] = known ? (float)n - 1.0f : 0.0f;
        t.x[c] = mean;
        t.s2[c] = s2;
        t.known[c] = known ? 1.0f : 0.0f;
        t.zeros[c] = known && mean == 0.0f && s2 == 0.0f ? 1.0f : 0.0f;
    }
    SYNCHRONIZE;
}
