// Stage: the samples of a slice enter the per-pixel statistics. One work-item a pixel, which reads its samples in order.
// Blocks of BLOCK samples, by sample index, are summed about the mean of all before them and merged; the unfinished one waits
// in the state, so that the result depends on the samples alone and not on how they were cut into waves.
#include "compensated.h"
#include "vectors.h"

#define LUMINANCE_LIMIT 0x1p62f  // beyond it a square would leave float32; such a sample counts as not finite

#define MEAN_NOISE 0x1p-44f  // the same in host/isonoise/integrator/accumulator.py

#if FEATURE_MEDIAN
// The median of the CHUNK values that `pending` holds, by sorting them.
INLINE float chunk_median(float* values)
{
    for (int i = 1; i < CHUNK; ++i)
        for (int j = i; j > 0 && values[j] < values[j - 1]; --j) {
            const float swapped = values[j];
            values[j] = values[j - 1];
            values[j - 1] = swapped;
        }
    return values[CHUNK / 2];
}
#endif

// Merges a finished block into the n samples before it. Its sums are about `shift`: the mean of those, rounded to a float
// (so `rest` is what the rounding left), or the block's own first sample if it is the first.
// Chan, Golub, LeVeque, "Algorithms for Computing the Sample Variance", 1983.
INLINE void merge_block(uint n, float shift, float rest, float sum, float squares, Compensated* sum_x, Compensated* m2)
{
    const float block_mean = sum / BLOCK;
    *m2 = add(*m2, GREATER(squares - sum * block_mean, 0.0f));
    if (n > 0) {
        float difference = block_mean - rest;
        // a mean is known to 2^-48 of itself: equal samples must not seem to vary by its rounding
        if (abs1(difference) < MEAN_NOISE * abs1(shift)) difference = 0.0f;
        *m2 = add(*m2, difference * difference * (BLOCK / (1.0f + BLOCK / (float)n)));
    }
    *sum_x = add(add(*sum_x, shift * BLOCK), sum);
}

__kernel void reduce(__global const float* samples, uint first_pixel, uint pixels, uint slice_samples,
                     __global const uint* pixel_offset, uint total_pixels, __global uint* count, __global uint* rejected,
                     __global float* sums, __global float* block_sums, __global float* medians)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint begin = pixel_offset[pixel];
    const uint next = i + 1u < pixels ? pixel_offset[pixel + 1u] : slice_samples;
    const uint end = LESSER(next, slice_samples);  // a slice may have been cut short
    if (begin >= end) return;

    // state: one plane of total_pixels floats a member
    __global float* full = sums + pixel;
    Compensated sum[4], m2;  // red, green, blue, x
    for (uint c = 0; c < 4; ++c) {
        sum[c].high = full[(2 * c) * total_pixels];
        sum[c].low = full[(2 * c + 1) * total_pixels];
    }
    m2.high = full[8 * total_pixels];
    m2.low = full[9 * total_pixels];
    __global float* open = block_sums + pixel;
    float3 open_rgb = (float3)(open[0], open[total_pixels], open[2 * total_pixels]);
    float shift = open[3 * total_pixels], open_sum = open[4 * total_pixels], open_squares = open[5 * total_pixels];
#if FEATURE_MEDIAN
    __global float* median_state = medians + pixel;
    Compensated median_sum = {median_state[0], median_state[total_pixels]};
    float pending[CHUNK];
    for (uint k = 0; k + 1 < CHUNK; ++k) pending[k] = median_state[(2 + k) * total_pixels];
#endif
    uint n = count[pixel], dropped = 0;

    for (uint at = begin; at < end; ++at) {
        const float3 rgb = LOAD3(at, samples);
        const float x = luminance(rgb);
        if (!(is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && abs1(x) < LUMINANCE_LIMIT)) {
            ++dropped;
            continue;
        }
        const uint place = n % BLOCK;
        if (place == 0) {
            open_rgb = (float3)(0.0f);
            shift = n ? divide(sum[3], n).high : x;
            open_sum = open_squares = 0.0f;
        }
        const float d = x - shift;
        open_rgb += rgb;
        open_sum += d;
        open_squares += d * d;
        if (place == BLOCK - 1) {
            const uint before = n - place;
            merge_block(before, shift, before ? divide(sum[3], before).low : 0.0f, open_sum, open_squares, sum + 3, &m2);
            sum[0] = add(sum[0], open_rgb.x);
            sum[1] = add(sum[1], open_rgb.y);
            sum[2] = add(sum[2], open_rgb.z);
        }
#if FEATURE_MEDIAN
        pending[n % CHUNK] = x;
        if (n % CHUNK == CHUNK - 1) {
            float sorted[CHUNK];
            for (uint k = 0; k < CHUNK; ++k) sorted[k] = pending[k];
            median_sum = add(median_sum, chunk_median(sorted));
        }
#endif
        ++n;
    }

    for (uint c = 0; c < 4; ++c) {
        full[(2 * c) * total_pixels] = sum[c].high;
        full[(2 * c + 1) * total_pixels] = sum[c].low;
    }
    full[8 * total_pixels] = m2.high;
    full[9 * total_pixels] = m2.low;
    open[0] = open_rgb.x;
    open[total_pixels] = open_rgb.y;
    open[2 * total_pixels] = open_rgb.z;
    open[3 * total_pixels] = shift;
    open[4 * total_pixels] = open_sum;
    open[5 * total_pixels] = open_squares;
#if FEATURE_MEDIAN
    median_state[0] = median_sum.high;
    median_state[total_pixels] = median_sum.low;
    for (uint k = 0; k + 1 < CHUNK; ++k) median_state[(2 + k) * total_pixels] = pending[k];
#endif
    count[pixel] = n;
    rejected[pixel] += dropped;
}
