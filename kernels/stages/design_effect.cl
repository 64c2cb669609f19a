// Stages after `summarise`, for well-distributed samples: the design effect d of every pixel, which is the variance of
// its mean over that of as many independent samples. It is pooled, because one pixel tells little about its own.
//
// A pixel's sequence is divided again and again into halves, nets of 1, 2, 4, ... samples. The random swaps of its
// scrambling make the differences between the halves of all nets uncorrelated, so the mean of the first n samples has
// the variance
//
//     sum over sizes S = 2, 4, 8, ... of (distance of n to the nearest multiple of S / n)^2 v(S),
//
// v(S) the variance of half the difference between the halves of a net of S samples. For independent samples S v(S) is
// s^2. `summarise` measures S v(S) / s^2 for the largest nets in the samples, and here it is modelled as S^-exponent.
// The exponent is an average over nearby pixels with a similar relative variance, taken by a bilateral grid: a pixel
// that has seen a rare bright sample converges slowly, its neighbours that have not may converge fast.
// Chen, Paris, Durand, "Real-time Edge-Aware Image Processing with the Bilateral Grid", SIGGRAPH 2007.
// Owen, "Scrambled Net Variance for Integrals of Smooth Functions", 1997, for the variance of nets.
#include "util/statistics.h"
#include "util/vec.h"

#define OCTAVES_PER_BIN 2.0f
#define FIRST_OCTAVE -24.0f
#define MIN_STEP 0.25f  // S v(S) falls at most as S^-2

// Position in the bins, from 0 to GRID_BINS - 1, by a piecewise linear log2.
INLINE float bin_position(float relative_variance)
{
    const float octave = (float)as_uint(relative_variance) * 0x1p-23f - 127.0f;
    return MIN(MAX((octave - FIRST_OCTAVE) / OCTAVES_PER_BIN, 0.0f), (float)(GRID_BINS - 1u));
}

// Sums over the pixels of a tile: one work-item per tile. `net_variances`: planes of the relative variance s^2 / mean^2
// and of S v(S) / s^2. `grid`: for every tile and bin the sums of the weight, of weight * S v(S) / s^2 and of weight *
// log2(S), the weight of a pixel being its relative variance.
__kernel void sum_tiles(
#include "generated/sum_tiles_parameters.h"
)
{
    const uint tile = get_global_id(0);
    const uint tiles_across = (image_width + TILE_SIZE - 1u) / TILE_SIZE;
    if (tile >= tile_count) return;
    __global float* sums = grid + tile * GRID_BINS * 3u;
    for (uint k = 0; k < GRID_BINS * 3u; ++k) sums[k] = 0.0f;
    const uint left = tile % tiles_across * TILE_SIZE, top = tile / tiles_across * TILE_SIZE;
    const uint right = MIN(left + TILE_SIZE, image_width), bottom = MIN(top + TILE_SIZE, total_pixels / image_width);
    for (uint y = top; y < bottom; ++y)
        for (uint x = left; x < right; ++x) {
            const uint pixel = y * image_width + x;
            const float relative_variance = net_variances[pixel], ratio = net_variances[total_pixels + pixel];
            if (!(relative_variance > 0.0f)) continue;
            const float position = bin_position(relative_variance);
            const uint bin = MIN((uint)position, GRID_BINS - 2u);
            const float fraction = position - (float)bin, level = net_level(count[pixel]);
            for (uint k = 0; k < 2u; ++k) {
                const float weight = relative_variance * (k ? fraction : 1.0f - fraction);
                __global float* sum = sums + 3u * (bin + k);
                sum[0] += weight;
                sum[1] += weight * ratio;
                sum[2] += weight * level;
            }
        }
}

// The factor by which S v(S) changes from one size to the next, 2^-exponent, for every tile and bin, from the sums over
// 3x3 tiles with the weights 1, 2, 1 along both axes; -1 where no pixel is. One work-item per tile.
__kernel void fit_steps(
#include "generated/fit_steps_parameters.h"
)
{
    const uint tile = get_global_id(0);
    if (tile >= tile_count) return;
    const int across = (int)((image_width + TILE_SIZE - 1u) / TILE_SIZE), down = (int)tile_count / across;
    const int column = (int)tile % across, row = (int)tile / across;
    for (uint bin = 0; bin < GRID_BINS; ++bin) {
        float total = 0.0f, ratio = 0.0f, level = 0.0f;
        for (int y = MAX(row - 1, 0); y <= MIN(row + 1, down - 1); ++y)
            for (int x = MAX(column - 1, 0); x <= MIN(column + 1, across - 1); ++x) {
                const float weight = (x == column ? 2.0f : 1.0f) * (y == row ? 2.0f : 1.0f);
                __global const float* sum = grid + ((uint)(y * across + x) * GRID_BINS + bin) * 3u;
                total += weight * sum[0];
                ratio += weight * sum[1];
                level += weight * sum[2];
            }
        float step = -1.0f;
        if (total > 0.0f) step = MIN(MAX(exp2(log2(ratio / total) * (total / level)), MIN_STEP), 1.0f);
        steps[tile * GRID_BINS + bin] = step;
    }
}

// x^n
INLINE float power(float x, uint n)
{
    float result = 1.0f;
    for (; n; n >>= 1u) {
        if (n & 1u) result *= x;
        x *= x;
    }
    return result;
}

// The term of nets of `size` samples in the formula above, times n / s^2.
INLINE float net_term(uint n, uint size, float ratio)
{
    const uint rest = n & (size - 1u), distance = MIN(rest, size - rest);
    return (float)distance / (float)n * ((float)distance / (float)size) * ratio;
}

// The design effect of the mean of n samples.
INLINE float design_effect_of(uint n, float step)
{
    const uint size_log2 = net_size_log2(n), size = 1u << size_log2;
    // beyond the nets measured the gain slows down: step^(3/4)
    const float root = SQRT(step), extrapolated_step = root * SQRT(root);
    float ratio = power(step, size_log2), sum = 0.0f;
    for (uint k = 0; k < 3u; ++k) {  // nets of 1, 2 and 4 times `size`; smaller ones count for less than 0.01
        sum += net_term(n, size << k, ratio);
        ratio *= k < 2u ? step : extrapolated_step;
    }
    const float fill = (float)n / (float)size * 0.125f;  // n over 8 times `size`, from 1/2 to 1
    sum += (1.0f - fill) * (1.0f - fill) / fill * ratio;
    // all larger nets: fill / 2 * ratio * step + fill / 4 * ratio * step^2 + ...
    return sum + 0.5f * fill * ratio * extrapolated_step / (1.0f - 0.5f * extrapolated_step);
}

// One work-item per pixel: the step, interpolated between tiles and bins, and the design effect.
__kernel void compute_design_effect(
#include "generated/compute_design_effect_parameters.h"
)
{
    const uint pixel = get_global_id(0);
    if (pixel >= total_pixels) return;
    const uint n = count[pixel];
    const float relative_variance = net_variances[pixel];
    float result = 1.0f;
    if (n >= NET_COUNT && relative_variance > 0.0f) {  // fewer samples tell nothing: their nets make up all of s^2
        const int across = (int)((image_width + TILE_SIZE - 1u) / TILE_SIZE), down = (int)tile_count / across;
        const float x = ((float)(pixel % image_width) + 0.5f) * (1.0f / TILE_SIZE) + 0.5f;  // in tiles, of centres
        const float y = ((float)(pixel / image_width) + 0.5f) * (1.0f / TILE_SIZE) + 0.5f;
        const float position = bin_position(relative_variance);
        const int column = (int)x, row = (int)y, bin = MIN((int)position, (int)GRID_BINS - 2);
        float total = 0.0f, sum = 0.0f;
        for (int k = 0; k < 8; ++k) {
            const int right = k & 1, lower = (k >> 1) & 1, upper_bin = k >> 2;
            const int tile_x = MIN(MAX(column - 1 + right, 0), across - 1);
            const int tile_y = MIN(MAX(row - 1 + lower, 0), down - 1);
            const float step = steps[(uint)(tile_y * across + tile_x) * GRID_BINS + (uint)(bin + upper_bin)];
            const float fraction_x = x - (float)column, fraction_y = y - (float)row, fraction = position - (float)bin;
            const float weight = (right ? fraction_x : 1.0f - fraction_x) * (lower ? fraction_y : 1.0f - fraction_y) *
                                 (upper_bin ? fraction : 1.0f - fraction);
            if (step < 0.0f) continue;
            total += weight;
            sum += weight * step;
        }
        result = total > 0.0f ? design_effect_of(n, sum / total) : 1.0f;
    }
    design_effect[pixel] = result;
}
