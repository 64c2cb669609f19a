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

typedef struct {
    Compensated red, green, blue;
} CompensatedRgb;

INLINE CompensatedRgb load_rgb_sum(__global const float* planes, uint stride)
{
    CompensatedRgb sum;
    sum.red = load_sum(planes, stride);
    sum.green = load_sum(planes + 2 * stride, stride);
    sum.blue = load_sum(planes + 4 * stride, stride);
    return sum;
}

INLINE void store_rgb_sum(CompensatedRgb sum, __global float* planes, uint stride)
{
    store_sum(sum.red, planes, stride);
    store_sum(sum.green, planes + 2 * stride, stride);
    store_sum(sum.blue, planes + 4 * stride, stride);
}

#if FEATURE_HALF_BUFFER
INLINE CompensatedRgb add_rgb(CompensatedRgb sum, Vec3 rgb)
{
    sum.red = add_compensated(sum.red, rgb.x);
    sum.green = add_compensated(sum.green, rgb.y);
    sum.blue = add_compensated(sum.blue, rgb.z);
    return sum;
}
#endif

// The mean of n samples.
INLINE Vec3 divide_rgb_sum(CompensatedRgb sum, uint n)
{
    return vec3(divide_compensated(sum.red, n).high, divide_compensated(sum.green, n).high,
                divide_compensated(sum.blue, n).high);
}

typedef struct {
    CompensatedRgb rgb;              // sum over all samples of a pixel
    Compensated x, m2;               // over its full sample blocks; m2 of x
    float shift;                     // of the unfinished block: see merge_m2
    float block_sum, block_squares;  // sums of x - shift and of its square over it
} Moments;

// Loads the moments of n samples. `sums` has the sum of x, and before the first full block `shift` in its place; later
// `shift` follows from it.
INLINE Moments load_moments(uint n, __global const float* sums, __global const float* sample_block_sums, uint stride)
{
    Moments m;
    m.rgb = load_rgb_sum(sums, stride);
    m.x = load_sum(sums + 6 * stride, stride);
    m.m2 = load_sum(sums + 8 * stride, stride);
    m.shift = m.x.high;
    if (n < SAMPLE_BLOCK_SIZE)
        m.x.high = m.x.low = 0.0f;
    else
        m.shift = divide_compensated(m.x, n - n % SAMPLE_BLOCK_SIZE).high;
    m.block_sum = sample_block_sums[0];
    m.block_squares = sample_block_sums[stride];
    return m;
}

// The sum, and the k samples of a block more. k * shift is exact as product + fma.
INLINE Compensated add_block_sum(Compensated sum, float shift, uint k, float block_sum)
{
    const float product = shift * (float)k;
    sum = add_compensated(add_compensated(sum, product), FMA(shift, (float)k, -product));
    return add_compensated(sum, block_sum);
}

// Merges the block, of k samples after n others, into the sums.
INLINE void merge_block(Moments* m, uint n, uint k)
{
    const float shift_error = n ? divide_compensated(m->x, n).low : 0.0f;
    m->m2 = merge_m2(m->m2, n, k, m->shift, shift_error, m->block_sum, m->block_squares);
    m->x = add_block_sum(m->x, m->shift, k, m->block_sum);
    m->rgb.red = normalize_sum(m->rgb.red);
    m->rgb.green = normalize_sum(m->rgb.green);
    m->rgb.blue = normalize_sum(m->rgb.blue);
}

#if FEATURE_NET_MEANS
// s^2 / mean^2; 0 without noise beyond rounding.
INLINE float relative_variance_of(float mean, float s2)
{
    const float relative = mean > 0.0f ? s2 / mean / mean : 0.0f;
    return relative >= 0x1p-60f && relative < INFINITY ? relative : 0.0f;
}

// log2 of the samples of a net whose mean is kept: n samples hold from NET_COUNT / 2 to NET_COUNT - 1 full nets.
INLINE uint net_size_log2(uint n)
{
    return n < NET_COUNT ? 0u : 32u - NET_COUNT_LOG2 - leading_zeros(n);
}

// log2 of the size S of the nets that `net_variance` compares, an average.
INLINE float net_level(uint n)
{
    const uint size_log2 = net_size_log2(n), pairs = n >> size_log2 >> 1u;
    return (float)size_log2 + 1.0f + (pairs > 1u ? 1.0f / (float)(pairs + 1u) : 0.0f);
}

// S v(S) of n samples, v(S) the variance of half the difference between the halves of a net of S samples: the mean over
// all pairs of nets and, from four nets on, over the first two pairs. See stages/design_effect.cl. `means`: as in
// stages/reduce.cl.
INLINE float net_variance(uint n, __global const float* means, uint stride)
{
    const uint size_log2 = net_size_log2(n), size = 1u << size_log2, pairs = n >> size_log2 >> 1u;
    float sum = 0.0f;
#pragma unroll
    for (uint k = 0; k + 1u < NET_COUNT / 2u; ++k) {  // without branches, for vectorised loops over pixels
        const float half_difference = 0.5f * (means[2u * k * stride] - means[(2u * k + 1u) * stride]);
        sum += k < pairs ? half_difference * half_difference * (float)(2u * size) : 0.0f;
    }
    if (pairs < 2u) return sum;
    const float first = means[0] + means[stride], second = means[2u * stride] + means[3u * stride];
    const float half_difference = 0.25f * (first - second);
    return (sum + half_difference * half_difference * (float)(4u * size)) / (float)(pairs + 1u);
}
#endif

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
