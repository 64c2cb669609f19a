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

// Sums over the pixels of a tile: one work-item per tile. `luminance`: planes of the mean and of s^2; `net_ratios`: S
// v(S) / s^2. `grid`: for every tile and bin the sums of the weight, of weight * S v(S) / s^2 and of weight * log2(S),
// and 0; the weight of a pixel is its relative variance.
__kernel void sum_tiles(
#include "generated/sum_tiles_parameters.h"
)
{
    const uint tile = get_global_id(0);
    const uint tiles_across = (image_width + TILE_SIZE - 1u) / TILE_SIZE;
    if (tile >= tile_count) return;
    __global float4* sums = (__global float4*)grid + tile * GRID_BINS;
    for (uint k = 0; k < GRID_BINS; ++k) sums[k] = (float4)(0.0f);
    const uint left = tile % tiles_across * TILE_SIZE, top = tile / tiles_across * TILE_SIZE;
    const uint width = MIN(TILE_SIZE, image_width - left), bottom = MIN(top + TILE_SIZE, total_pixels / image_width);
    float variance[TILE_SIZE], position[TILE_SIZE], level[TILE_SIZE];
    for (uint y = top; y < bottom; ++y) {
        const uint row = y * image_width + left;
        VECTORIZE_PIXELS
        for (uint x = 0; x < width; ++x) {
            variance[x] = relative_variance_of(luminance[row + x], luminance[total_pixels + row + x]);
            position[x] = bin_position(variance[x]);
            level[x] = net_level(count[row + x]);
        }
        for (uint x = 0; x < width; ++x) {
            const float relative_variance = variance[x];
            if (!(relative_variance > 0.0f)) continue;
            const uint bin = MIN((uint)position[x], GRID_BINS - 2u);
            const float fraction = position[x] - (float)bin;
            const float4 values = (float4)(1.0f, net_ratios[row + x], level[x], 0.0f);
            sums[bin] += relative_variance * (1.0f - fraction) * values;
            sums[bin + 1u] += relative_variance * fraction * values;
        }
    }
}

// The factor by which S v(S) changes from one size to the next, 2^-exponent, for every tile and bin, from the sums over
// 3x3 tiles with the weights 1, 2, 1 along both axes; 0 where no pixel is. One work-item per tile.
__kernel void fit_steps(
#include "generated/fit_steps_parameters.h"
)
{
    const uint tile = get_global_id(0);
    if (tile >= tile_count) return;
    const int across = (int)((image_width + TILE_SIZE - 1u) / TILE_SIZE), down = (int)tile_count / across;
    const int column = (int)tile % across, row = (int)tile / across;
    for (uint bin = 0; bin < GRID_BINS; ++bin) {
        float4 total = (float4)(0.0f);  // of weight, weight * ratio, weight * level
        for (int y = MAX(row - 1, 0); y <= MIN(row + 1, down - 1); ++y)
            for (int x = MAX(column - 1, 0); x <= MIN(column + 1, across - 1); ++x) {
                const float weight = (x == column ? 2.0f : 1.0f) * (y == row ? 2.0f : 1.0f);
                total += weight * ((__global const float4*)grid)[(uint)(y * across + x) * GRID_BINS + bin];
            }
        float step = 0.0f;
        if (total.x > 0.0f) step = MIN(MAX(exp2(log2(total.y / total.x) * (total.x / total.z)), MIN_STEP), 1.0f);
        steps[tile * GRID_BINS + bin] = step;
    }
}

// x^n, n < 32. Without branches: LLVM vectorises the loop over pixels that calls it.
INLINE float power(float x, uint n)
{
    float result = 1.0f;
#pragma unroll
    for (uint bit = 0; bit < 5u; ++bit) {
        result *= n >> bit & 1u ? x : 1.0f;
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
#pragma unroll
    for (uint k = 0; k < 3u; ++k) {  // nets of 1, 2 and 4 times `size`; smaller ones count for less than 0.01
        sum += net_term(n, size << k, ratio);
        ratio *= k < 2u ? step : extrapolated_step;
    }
    const float fill = (float)n / (float)size * 0.125f;  // n over 8 times `size`, from 1/2 to 1
    sum += (1.0f - fill) * (1.0f - fill) / fill * ratio;
    // all larger nets: fill / 2 * ratio * step + fill / 4 * ratio * step^2 + ...
    return sum + 0.5f * fill * ratio * extrapolated_step / (1.0f - 0.5f * extrapolated_step);
}

// The step, interpolated between tiles and bins, and the design effect. One work-item per run of at most TILE_SIZE
// pixels of a row, which lie between the centres of the same four tiles.
__kernel void compute_design_effect(
#include "generated/compute_design_effect_parameters.h"
)
{
    const uint height = total_pixels / image_width;
    const uint across = (image_width + TILE_SIZE - 1u) / TILE_SIZE, down = tile_count / across, runs = across + 1u;
    const uint column = get_global_id(0) % runs, y = get_global_id(0) / runs;  // column: of the tiles on the right
    if (y >= height) return;
    const uint begin = MAX(column * TILE_SIZE, TILE_SIZE / 2u) - TILE_SIZE / 2u;
    const uint end = MIN(column * TILE_SIZE + TILE_SIZE / 2u, image_width);
    const float row_position = ((float)y + 0.5f) * (1.0f / TILE_SIZE) + 0.5f;  // in tiles, of centres
    const uint row = (uint)row_position;
    const uint left = MAX(column, 1u) - 1u, right = MIN(column, across - 1u);
    const uint upper = (MAX(row, 1u) - 1u) * across, lower = MIN(row, down - 1u) * across;
    const uint tiles[4] = {upper + left, upper + right, lower + left, lower + right};
    const float lower_weight = row_position - (float)row;
    VECTORIZE_PIXELS
    for (uint x = begin; x < end; ++x) {
        const int pixel = (int)(y * image_width + x);
        const uint n = count[pixel];
        const float relative_variance = relative_variance_of(luminance[pixel], luminance[(int)total_pixels + pixel]);
        const float right_weight = ((float)x + 0.5f) * (1.0f / TILE_SIZE) + 0.5f - (float)column;
        const float position = bin_position(relative_variance);
        const int bin = MIN((int)position, (int)GRID_BINS - 2);
        const float upper_bin_weight = position - (float)bin;
        float total = 0.0f, sum = 0.0f;
#pragma unroll
        for (uint k = 0; k < 8u; ++k) {
            const float step = steps[(int)(tiles[k & 3u] * GRID_BINS + (k >> 2)) + bin];
            const float weight = (k & 1u ? right_weight : 1.0f - right_weight) *
                                 (k & 2u ? lower_weight : 1.0f - lower_weight) *
                                 (k & 4u ? upper_bin_weight : 1.0f - upper_bin_weight);
            total += step > 0.0f ? weight : 0.0f;
            sum += weight * step;
        }
        const float effect = design_effect_of(n, sum / total);
        // fewer samples than NET_COUNT tell nothing: their nets make up all of s^2
        const float d = n >= NET_COUNT && relative_variance > 0.0f && total > 0.0f ? effect : 1.0f;
        design_effect[pixel] = d;
        luminance[(int)total_pixels + pixel] *= d;
    }
}
