// Stage: turns the state of `reduce` into the statistics that the host reads. Radiance is radiance_scale times that of
// the scene (host/isonoise/scene/compiled_scene.py). A strip has at most `stride` pixels, a work-item
// PIXELS_PER_ITEM of them.
// Reads the state; writes `summary`, one plane after another:
// mean of x (high, low), variance, M_x, mean power (high, low), mean RGB of the half (three floats a pixel).
#include "util/statistics.h"
#include "util/vec.h"

__kernel void summarise(
#include "generated/summarise_parameters.h"
)
{
    const uint begin = get_global_id(0) * PIXELS_PER_ITEM, end = MIN(begin + PIXELS_PER_ITEM, pixels);
    VECTORIZE_PIXELS
    for (int i = (int)begin; i < (int)end; ++i) {
        const int pixel = (int)first_pixel + i;
        const uint n = count[pixel], pending_count = n % SAMPLE_BLOCK_SIZE;
        const uint divisor = MAX(n, 1u);  // without samples every sum is 0

        Moments moments = load_moments(n, sums + pixel, sample_block_sums + pixel, total_pixels);
        if (pending_count) merge_block(&moments, n - pending_count, pending_count);
        __global float* out = summary;
        const Compensated mean = divide_compensated(moments.x, divisor);
        store_sum(mean, out + i, stride);
        out += 2 * stride;
        const float s2 = n > 1u ? moments.m2.high / (float)(n - 1u) : 0.0f;
        out[i] = s2;
        out += stride;
        luminance[pixel] = mean.high;
        luminance[total_pixels + pixel] = s2;

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
        } else if (entries) {  // no full chunk yet: the median of its entries
            float pending[CHUNK_SIZE];
            for (uint k = 0; k < entries; ++k) pending[k] = median_state[(2 + k) * total_pixels];
            median = chunk_median(pending, entries);
        }
#if FEATURE_BATCH_MEANS
        else if (n) {  // no full batch yet: the mean of its samples
            median = divide_compensated(load_sum(median_state + (CHUNK_SIZE + 1) * total_pixels, total_pixels), n).high;
        }
#endif
        out[i] = median;
        out += stride;
#endif
#if FEATURE_POWER_MEAN
        store_sum(divide_compensated(load_sum(powers + pixel, total_pixels), divisor), out + i, stride);
        out += 2 * stride;
#endif
#if FEATURE_NET_MEANS
        const bool has_noise = relative_variance_of(mean.high, s2) > 0.0f;
        net_ratios[pixel] = has_noise ? net_variance(n, net_means + pixel, total_pixels) / s2 : 0.0f;
#endif
#if FEATURE_HALF_BUFFER
        const Vec3 half_rgb = divide_rgb_sum(load_rgb_sum(halves + pixel, total_pixels), MAX(n / 2u, 1u));
        STORE3(half_rgb, i, out);
#endif
    }
}

// Writes the mean RGB to planes of `summary`.
__kernel void summarise_rgb(
#include "generated/summarise_rgb_parameters.h"
)
{
    const uint begin = get_global_id(0) * PIXELS_PER_ITEM, end = MIN(begin + PIXELS_PER_ITEM, pixels);
    VECTORIZE_PIXELS
    for (int i = (int)begin; i < (int)end; ++i) {
        const int pixel = (int)first_pixel + i;
        const Vec3 rgb = divide_rgb_sum(load_rgb_sum(sums + pixel, total_pixels), MAX(count[pixel], 1u));
        summary[i] = rgb.x;
        summary[stride + (uint)i] = rgb.y;
        summary[2u * stride + (uint)i] = rgb.z;
    }
}
