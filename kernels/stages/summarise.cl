// Stage: from the state that `reduce` keeps to the statistics that the host reads, in the device's units. One work-item a
// pixel; the pixels first_pixel... of a strip of at most `stride`, whose results lie in `summary` plane by plane:
// mean of x (high, low), variance, mean RGB (three floats a pixel), M_x, mean power (high, low), mean RGB of the half.
#include "util/statistics.h"
#include "util/vec.h"

__kernel void summarise(
#include "generated/summarise_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint n = count[pixel], opened = n % SAMPLES_PER_BLOCK, before = n - opened;
    const uint some = MAX(n, 1u);  // without samples every sum is 0

    __global const float* full = sums + pixel;
    Compensated sum[4];  // red, green, blue, x
    for (uint c = 0; c < 4; ++c) sum[c] = load_sum(full + 2 * c * total_pixels, total_pixels);
    Compensated m2 = load_sum(full + 8 * total_pixels, total_pixels);
    if (opened) {  // else the unfinished block holds the last full one
        __global const float* open = block_sums + pixel;
        const float shift = open[3 * total_pixels], open_sum = open[4 * total_pixels];
        const float rest = before ? divide_compensated(sum[3], before).low : 0.0f;
        m2 = merge_m2(m2, before, opened, shift, rest, open_sum, open[5 * total_pixels]);
        for (uint c = 0; c < 3; ++c) sum[c] = add_compensated(sum[c], open[c * total_pixels]);
        const float product = shift * (float)opened;
        sum[3] = add_compensated(add_compensated(add_compensated(sum[3], product), FMA(shift, (float)opened, -product)), open_sum);
    }
    __global float* to = summary;
    store_sum(divide_compensated(sum[3], some), to + i, stride);
    to += 2 * stride;
    to[i] = n > 1u ? m2.high / (float)(n - 1u) : 0.0f;
    to += stride;
    for (uint c = 0; c < 3; ++c) to[3 * i + c] = divide_compensated(sum[c], some).high;
    to += 3 * stride;

#if FEATURE_CHUNK_MEDIANS
    __global const float* median_state = medians + pixel;
#if FEATURE_BATCH_MEANS
    const uint entries = n / BATCH_SIZE;
#else
    const uint entries = n;
#endif
    float median = 0.0f;
    if (entries >= CHUNK_SIZE) {
        median = divide_compensated(load_sum(median_state, total_pixels), entries / CHUNK_SIZE).high;
    } else if (entries) {  // of what is there
        float pending[CHUNK_SIZE];
        for (uint k = 0; k < entries; ++k) pending[k] = median_state[(2 + k) * total_pixels];
        median = chunk_median(pending, entries);
    }
#if FEATURE_BATCH_MEANS
    else if (n) {
        median = divide_compensated(load_sum(median_state + (CHUNK_SIZE + 1) * total_pixels, total_pixels), n).high;
    }
#endif
    to[i] = median;
    to += stride;
#endif
#if FEATURE_POWER_MEAN
    store_sum(divide_compensated(load_sum(powers + pixel, total_pixels), some), to + i, stride);
    to += 2 * stride;
#endif
#if FEATURE_HALF_BUFFER
    for (uint c = 0; c < 3; ++c)
        to[3 * i + c] = n > 1u ? divide_compensated(load_sum(halves + pixel + 2 * c * total_pixels, total_pixels), n / 2u).high : 0.0f;
#endif
}
