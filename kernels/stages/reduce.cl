// Stage: adds the samples of a slice to the per-pixel statistics. One work-item per pixel, which reads its samples in
// order. The luminance of sample blocks, SAMPLE_BLOCK_SIZE samples by sample index, is summed relative to the mean of
// all samples before them, then merged. The unfinished sample block stays in the state, so the result depends on the
// samples alone and not on how they were cut into waves. The same holds for chunks, of which medians are taken.
#include "util/statistics.h"
#include "util/math.h"

#define LUMINANCE_LIMIT 0x1p62f  // from here on a square would overflow; such samples are rejected like non-finite ones

INLINE bool is_rejected(Vec3 rgb, float x)
{
    const bool is_negative = rgb.x < 0.0f || rgb.y < 0.0f || rgb.z < 0.0f;
    return is_negative || !(is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && x < LUMINANCE_LIMIT);
}

INLINE void store_moments(const Moments* m, uint n, __global float* sums, __global float* sample_block_sums,
                          uint stride)
{
    const Compensated first = {m->shift, 0.0f};
    store_rgb_sum(m->rgb, sums, stride);
    store_sum(n < SAMPLE_BLOCK_SIZE ? first : m->x, sums + 6 * stride, stride);
    store_sum(m->m2, sums + 8 * stride, stride);
    sample_block_sums[0] = m->block_sum;
    sample_block_sums[stride] = m->block_squares;
}

// Adds the n-th sample, with luminance x.
INLINE void add_to_moments(Moments* m, uint n, Vec3 rgb, float x)
{
    const uint index = n % SAMPLE_BLOCK_SIZE;
    if (index == 0) {
        m->shift = n ? divide_compensated(m->x, n).high : x;
        m->block_sum = m->block_squares = 0.0f;
    }
    const float difference = x - m->shift;
    m->rgb.red = add_error_free(m->rgb.red, rgb.x);
    m->rgb.green = add_error_free(m->rgb.green, rgb.y);
    m->rgb.blue = add_error_free(m->rgb.blue, rgb.z);
    m->block_sum += difference;
    m->block_squares += difference * difference;
    if (index == SAMPLE_BLOCK_SIZE - 1) merge_block(m, n - index, SAMPLE_BLOCK_SIZE);
}

#if FEATURE_CHUNK_MEDIANS
INLINE void load_chunk(float* pending, __global const float* planes, uint stride)
{
    for (uint k = 0; k + 1 < CHUNK_SIZE; ++k) pending[k] = planes[k * stride];
}

INLINE void store_chunk(const float* pending, __global float* planes, uint stride)
{
    for (uint k = 0; k + 1 < CHUNK_SIZE; ++k) planes[k * stride] = pending[k];
}

// Stores an entry in its chunk. The median of a full chunk is added to the sum.
INLINE void add_to_chunk(uint entry_index, float entry, float* pending, Compensated* median_sum)
{
    pending[entry_index % CHUNK_SIZE] = entry;
    if (entry_index % CHUNK_SIZE != CHUNK_SIZE - 1) return;
    float sorted[CHUNK_SIZE];
    for (uint k = 0; k < CHUNK_SIZE; ++k) sorted[k] = pending[k];
    *median_sum = add_compensated(*median_sum, chunk_median(sorted, CHUNK_SIZE));
}
#endif

#if FEATURE_BATCH_MEANS
// Adds the n-th sample, with luminance x, to its batch. The mean of a full batch is an entry of a chunk.
INLINE void add_to_batch(uint n, float x, Compensated* batch_sum, float* pending, Compensated* median_sum)
{
    if (n % BATCH_SIZE == 0) batch_sum->high = batch_sum->low = 0.0f;
    *batch_sum = add_compensated(*batch_sum, x);
    if (n % BATCH_SIZE == BATCH_SIZE - 1)
        add_to_chunk(n / BATCH_SIZE, divide_compensated(*batch_sum, BATCH_SIZE).high, pending, median_sum);
}
#endif

#if FEATURE_POWER_MEAN
// x^q, or x ln x for q = 1; 0 where x is 0 or subnormal, which some devices flush to 0.
INLINE float power_of_sample(float x, float q)
{
    if (!(x >= 0x1p-126f)) return 0.0f;
    return q == 1.0f ? x * log(x) : powr(x, q);
}

INLINE void add_power(float x, float q, Compensated* power_sum)
{
    *power_sum = add_compensated(*power_sum, power_of_sample(x, q));
    if (!is_finite(power_sum->high)) power_sum->high = FLT_MAX;  // then low is 0
}
#endif

#if FEATURE_NET_MEANS
// Number of the sample that completes the net of the sample after the n-th.
INLINE uint net_end(uint n)
{
    return (n >> net_size_log2(n) << net_size_log2(n)) + (1u << net_size_log2(n));
}

// Ends the net that the n-th sample completes, and merges pairs of nets when there are NET_COUNT. `means`: planes of
// the means of the nets; the last net of NET_COUNT needs none. Returns the end of the next net.
INLINE uint end_net(const Moments* m, uint n, __global float* means, uint stride)
{
    const uint size_log2 = net_size_log2(n - 1u), k = (n >> size_log2) - 1u, pending_count = n % SAMPLE_BLOCK_SIZE;
    const float inverse_size = 1.0f / (float)(1u << size_log2);  // a power of two
    Compensated sum = m->x, before = {0.0f, 0.0f};
    if (pending_count) sum = add_block_sum(sum, m->shift, pending_count, m->block_sum);
    for (uint j = 0; j < k; ++j) before = add_compensated(before, means[j * stride]);
    const float mean = (sum.high * inverse_size - before.high) + (sum.low * inverse_size - before.low);
    if (k + 1u < NET_COUNT) {
        means[k * stride] = mean;
        return net_end(n);
    }
    for (uint j = 0; j < NET_COUNT / 2u; ++j) {
        const float second = 2u * j + 2u < NET_COUNT ? means[(2u * j + 1u) * stride] : mean;
        means[j * stride] = 0.5f * (means[2u * j * stride] + second);
    }
    return net_end(n);
}
#endif

__kernel void reduce(
#include "generated/reduce_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint begin = pixel_offset[i];
    // a slice may have been cut short
    const uint end = i + 1u < pixels ? MIN(pixel_offset[i + 1u], slice_samples) : slice_samples;
    if (begin >= end) return;
    uint n = count[pixel], new_rejected = 0;
    Moments moments = load_moments(n, sums + pixel, sample_block_sums + pixel, total_pixels);
#if FEATURE_CHUNK_MEDIANS
    Compensated median_sum = load_sum(medians + pixel, total_pixels);
    float pending[CHUNK_SIZE];
    load_chunk(pending, medians + pixel + 2 * total_pixels, total_pixels);
#endif
#if FEATURE_BATCH_MEANS
    Compensated batch_sum = load_sum(medians + pixel + (CHUNK_SIZE + 1) * total_pixels, total_pixels);
#endif
#if FEATURE_POWER_MEAN
    Compensated power_sum = load_sum(powers + pixel, total_pixels);
#endif
#if FEATURE_HALF_BUFFER
    CompensatedRgb half_sum = load_rgb_sum(halves + pixel, total_pixels);
#endif
#if FEATURE_NET_MEANS
    uint next_net_end = net_end(n);
#endif
    for (uint sample = begin; sample < end; ++sample) {
        const Vec3 rgb = LOAD3(sample, samples);
        const float x = luminance(rgb);
        if (is_rejected(rgb, x)) {
            ++new_rejected;
            continue;
        }
        add_to_moments(&moments, n, rgb, x);
#if FEATURE_BATCH_MEANS
        add_to_batch(n, x, &batch_sum, pending, &median_sum);
#elif FEATURE_CHUNK_MEDIANS
        add_to_chunk(n, x, pending, &median_sum);
#endif
#if FEATURE_POWER_MEAN
        add_power(x, power, &power_sum);
#endif
#if FEATURE_HALF_BUFFER
        if (n & 1u) half_sum = add_rgb(half_sum, rgb);
#endif
        ++n;
#if FEATURE_NET_MEANS
        if (n == next_net_end) next_net_end = end_net(&moments, n, net_means + pixel, total_pixels);
#endif
    }
    store_moments(&moments, n, sums + pixel, sample_block_sums + pixel, total_pixels);
#if FEATURE_CHUNK_MEDIANS
    store_sum(median_sum, medians + pixel, total_pixels);
    store_chunk(pending, medians + pixel + 2 * total_pixels, total_pixels);
#endif
#if FEATURE_BATCH_MEANS
    store_sum(batch_sum, medians + pixel + (CHUNK_SIZE + 1) * total_pixels, total_pixels);
#endif
#if FEATURE_POWER_MEAN
    store_sum(power_sum, powers + pixel, total_pixels);
#endif
#if FEATURE_HALF_BUFFER
    store_rgb_sum(half_sum, halves + pixel, total_pixels);
#endif
    count[pixel] = n;
    if (new_rejected) rejected[pixel] += new_rejected;  // memory that is never written takes no space on a CPU
}
