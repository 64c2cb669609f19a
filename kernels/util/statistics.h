// What the stages of the per-pixel statistics share: how the state lies in memory, merging of blocks, medians.
// The state is planes of one float a pixel, `stride` apart; a sum of two floats has two of them, high and low.
#pragma once
#include "util/compensated.h"

#define MEAN_ROUNDING 0x1p-44f  // a mean is known to 2^-48 of itself: equal samples must not seem to vary by its rounding

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

// M2 of n samples and a block of k more. The block's sums are about `shift`: the mean of the n, rounded to a float (so `rest`
// is what the rounding left), or, for n = 0, the block's own first sample.
// Chan, Golub, LeVeque, "Algorithms for Computing the Sample Variance", 1983. What leaves float32 stays as large as it can be.
INLINE Compensated merge_m2(Compensated m2, uint n, uint k, float shift, float rest, float sum, float squares)
{
    const float block_mean = sum / (float)k;
    m2 = add_compensated(m2, is_finite(squares) ? MAX(squares - sum * block_mean, 0.0f) : FLT_MAX);
    const float difference = block_mean - rest;
    if (n != 0 && abs_float(difference) >= MEAN_ROUNDING * abs_float(shift))
        m2 = add_compensated(m2, difference * difference * ((float)k / (1.0f + (float)k / (float)n)));
    const Compensated most = {FLT_MAX, 0.0f};
    return is_finite(m2.high) ? m2 : most;
}

#if FEATURE_CHUNK_MEDIANS
// The median of `count` values, by sorting them; of an even number the mean of the middle two.
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
