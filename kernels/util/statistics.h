// Per-pixel statistics, used by `reduce` and `summarise`: access to the state, merging of sample blocks, medians. A
// block is a sample block: SAMPLE_BLOCK_SIZE consecutive samples of a pixel, or the unfinished rest. The state consists
// of planes with one float per pixel, `stride` floats apart; a Compensated sum takes two planes.
#pragma once
#include "util/compensated.h"

#define MEAN_ROUNDING 0x1p-44f  // relative; a mean is exact to 2^-48, and its rounding must not look like variance

INLINE Compensated load_sum(__global const float* plane, uint stride)
{
    const Compensated sum = {plane[0], plane[stride]};
    return sum;
}

INLINE void store_sum(Compensated sum, __global float* plane, uint stride)
{
    plane[0] = sum.high;
    plane[stride] = sum.low;
}

// Merges M2, the sum of squared differences from the mean, of n samples with a sample block of k more.
// Chan, Golub, LeVeque, "Algorithms for Computing the Sample Variance", 1983.
// `block_sum`, `block_squares`: sums of x - shift and of its square over the block.
// The mean of the n samples is shift + shift_error, `shift` being a float; for n = 0 `shift` is the block's first
// sample. A result beyond float32 becomes FLT_MAX.
INLINE Compensated merge_m2(Compensated m2, uint n, uint k, float shift, float shift_error, float block_sum,
                            float block_squares)
{
    const float block_mean = block_sum / (float)k;
    m2 = add_compensated(m2, is_finite(block_squares) ? MAX(block_squares - block_sum * block_mean, 0.0f) : FLT_MAX);
    const float difference = block_mean - shift_error;
    if (n != 0 && abs_float(difference) >= MEAN_ROUNDING * abs_float(shift))
        m2 = add_compensated(m2, difference * difference * ((float)k / (1.0f + (float)k / (float)n)));
    const Compensated maximum = {FLT_MAX, 0.0f};
    return is_finite(m2.high) ? m2 : maximum;
}

INLINE void load_sums(Compensated* sums, uint sum_count, __global const float* planes, uint stride)
{
    for (uint c = 0; c < sum_count; ++c) sums[c] = load_sum(planes + 2 * c * stride, stride);
}

INLINE void add_rgb(Compensated* sums, Vec3 rgb)
{
    sums[0] = add_compensated(sums[0], rgb.x);
    sums[1] = add_compensated(sums[1], rgb.y);
    sums[2] = add_compensated(sums[2], rgb.z);
}

// Sums over the full sample blocks of a pixel, and over its unfinished one.
typedef struct {
    Compensated sum[4];              // red, green, blue, x
    Compensated m2;                  // of x
    Vec3 block_rgb;                  // sum of RGB
    float shift;                     // see merge_m2
    float block_sum, block_squares;  // sums of x - shift and of its square
} Moments;

INLINE Moments load_moments(__global const float* sums, __global const float* sample_block_sums, uint stride)
{
    Moments m;
    load_sums(m.sum, 4, sums, stride);
    m.m2 = load_sum(sums + 8 * stride, stride);
    m.block_rgb = vec3(sample_block_sums[0], sample_block_sums[stride], sample_block_sums[2 * stride]);
    m.shift = sample_block_sums[3 * stride];
    m.block_sum = sample_block_sums[4 * stride];
    m.block_squares = sample_block_sums[5 * stride];
    return m;
}

// Merges the block, of k samples after n others, into the sums. k * shift is exact as product + fma.
INLINE void merge_block(Moments* m, uint n, uint k)
{
    const float shift_error = n ? divide_compensated(m->sum[3], n).low : 0.0f;
    m->m2 = merge_m2(m->m2, n, k, m->shift, shift_error, m->block_sum, m->block_squares);
    add_rgb(m->sum, m->block_rgb);
    const float product = m->shift * (float)k;
    const Compensated shifted = add_compensated(add_compensated(m->sum[3], product), FMA(m->shift, (float)k, -product));
    m->sum[3] = add_compensated(shifted, m->block_sum);
}

#if FEATURE_CHUNK_MEDIANS
// Median of `count` values, which are sorted in place; for an even count the mean of the middle two.
INLINE float chunk_median(float* values, int count)
{
    for (int i = 1; i < count; ++i)
        for (int j = i; j > 0 && values[j] < values[j - 1]; --j) {
            const float swapped = values[j];
            values[j] = values[j - 1];
            values[j - 1] = swapped;
        }
    return 0.5f * (values[(count - 1) / 2] + values[count / 2]);
}
#endif
