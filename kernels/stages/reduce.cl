// Stage: the samples of a slice enter the per-pixel statistics. One work-item a pixel, which reads its samples in order.
// Blocks of SAMPLES_PER_BLOCK samples, by sample index, are summed about the mean of all before them and merged; the unfinished one waits
// in the state, so that the result depends on the samples alone and not on how they were cut into waves. So do chunks.
#include "util/statistics.h"
#include "util/math.h"

#define LUMINANCE_LIMIT 0x1p62f  // from here on a square would leave float32; such a sample counts as not finite

#if FEATURE_CHUNK_MEDIANS
// An entry takes its place in its chunk; the median of a full chunk enters the sum.
INLINE void add_to_chunk(uint number, float entry, float* pending, Compensated* median_sum)
{
    pending[number % CHUNK_SIZE] = entry;
    if (number % CHUNK_SIZE != CHUNK_SIZE - 1) return;
    float sorted[CHUNK_SIZE];
    for (uint k = 0; k < CHUNK_SIZE; ++k) sorted[k] = pending[k];
    *median_sum = add_compensated(*median_sum, chunk_median(sorted, CHUNK_SIZE));
}
#endif

#if FEATURE_POWER_MEAN
// x^q, for q = 1 x ln x; 0 where x is none or so small that some devices take it for 0.
INLINE float power_of_sample(float x, float q)
{
    if (!(x >= 0x1p-126f)) return 0.0f;
    return q == 1.0f ? x * log(x) : powr(x, q);
}
#endif

__kernel void reduce(
#include "generated/reduce_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint begin = pixel_offset[pixel];
    const uint next = i + 1u < pixels ? pixel_offset[pixel + 1u] : slice_samples;
    const uint end = MIN(next, slice_samples);  // a slice may have been cut short
    if (begin >= end) return;

    __global float* full = sums + pixel;
    Compensated sum[4];  // red, green, blue, x
    for (uint c = 0; c < 4; ++c) sum[c] = load_sum(full + 2 * c * total_pixels, total_pixels);
    Compensated m2 = load_sum(full + 8 * total_pixels, total_pixels);
    __global float* open = block_sums + pixel;
    Vec3 open_rgb = vec3(open[0], open[total_pixels], open[2 * total_pixels]);
    float shift = open[3 * total_pixels], open_sum = open[4 * total_pixels], open_squares = open[5 * total_pixels];
#if FEATURE_CHUNK_MEDIANS
    __global float* median_state = medians + pixel;
    Compensated median_sum = load_sum(median_state, total_pixels);
    float pending[CHUNK_SIZE];
    for (uint k = 0; k + 1 < CHUNK_SIZE; ++k) pending[k] = median_state[(2 + k) * total_pixels];
#endif
#if FEATURE_BATCH_MEANS
    Compensated batch_sum = load_sum(median_state + (CHUNK_SIZE + 1) * total_pixels, total_pixels);
#endif
#if FEATURE_POWER_MEAN
    Compensated power_sum = load_sum(powers + pixel, total_pixels);
#endif
#if FEATURE_HALF_BUFFER
    Compensated half_sum[3];
    for (uint c = 0; c < 3; ++c) half_sum[c] = load_sum(halves + pixel + 2 * c * total_pixels, total_pixels);
#endif
    uint n = count[pixel], dropped = 0;

    for (uint at = begin; at < end; ++at) {
        const Vec3 rgb = LOAD3(at, samples);
        const float x = luminance(rgb);
        const bool negative = rgb.x < 0.0f || rgb.y < 0.0f || rgb.z < 0.0f;
        if (negative || !(is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && x < LUMINANCE_LIMIT)) {
            ++dropped;
            continue;
        }
        const uint place = n % SAMPLES_PER_BLOCK;
        if (place == 0) {
            open_rgb = splat3(0.0f);
            shift = n ? divide_compensated(sum[3], n).high : x;
            open_sum = open_squares = 0.0f;
        }
        const float d = x - shift;
        open_rgb = add3(open_rgb, rgb);
        open_sum += d;
        open_squares += d * d;
        if (place == SAMPLES_PER_BLOCK - 1) {
            const uint before = n - place;
            const float rest = before ? divide_compensated(sum[3], before).low : 0.0f;
            m2 = merge_m2(m2, before, SAMPLES_PER_BLOCK, shift, rest, open_sum, open_squares);
            sum[0] = add_compensated(sum[0], open_rgb.x);
            sum[1] = add_compensated(sum[1], open_rgb.y);
            sum[2] = add_compensated(sum[2], open_rgb.z);
            sum[3] = add_compensated(add_compensated(sum[3], shift * SAMPLES_PER_BLOCK), open_sum);  // SAMPLES_PER_BLOCK is a power of two: the product is exact
        }
#if FEATURE_BATCH_MEANS
        if (n % BATCH_SIZE == 0) batch_sum.high = batch_sum.low = 0.0f;
        batch_sum = add_compensated(batch_sum, x);
        if (n % BATCH_SIZE == BATCH_SIZE - 1) add_to_chunk(n / BATCH_SIZE, divide_compensated(batch_sum, BATCH_SIZE).high, pending, &median_sum);
#elif FEATURE_CHUNK_MEDIANS
        add_to_chunk(n, x, pending, &median_sum);
#endif
#if FEATURE_POWER_MEAN
        power_sum = add_compensated(power_sum, power_of_sample(x, power));
        if (!is_finite(power_sum.high)) power_sum.high = FLT_MAX;  // low is 0 then; the sum stays as large as it can be
#endif
#if FEATURE_HALF_BUFFER
        if (n & 1u) {
            half_sum[0] = add_compensated(half_sum[0], rgb.x);
            half_sum[1] = add_compensated(half_sum[1], rgb.y);
            half_sum[2] = add_compensated(half_sum[2], rgb.z);
        }
#endif
        ++n;
    }

    for (uint c = 0; c < 4; ++c) store_sum(sum[c], full + 2 * c * total_pixels, total_pixels);
    store_sum(m2, full + 8 * total_pixels, total_pixels);
    open[0] = open_rgb.x;
    open[total_pixels] = open_rgb.y;
    open[2 * total_pixels] = open_rgb.z;
    open[3 * total_pixels] = shift;
    open[4 * total_pixels] = open_sum;
    open[5 * total_pixels] = open_squares;
#if FEATURE_CHUNK_MEDIANS
    store_sum(median_sum, median_state, total_pixels);
    for (uint k = 0; k + 1 < CHUNK_SIZE; ++k) median_state[(2 + k) * total_pixels] = pending[k];
#endif
#if FEATURE_BATCH_MEANS
    store_sum(batch_sum, median_state + (CHUNK_SIZE + 1) * total_pixels, total_pixels);
#endif
#if FEATURE_POWER_MEAN
    store_sum(power_sum, powers + pixel, total_pixels);
#endif
#if FEATURE_HALF_BUFFER
    for (uint c = 0; c < 3; ++c) store_sum(half_sum[c], halves + pixel + 2 * c * total_pixels, total_pixels);
#endif
    count[pixel] = n;
    rejected[pixel] += dropped;
}
