// Stage: makes the sample list of a slice of a wave. One work-item per pixel of the slice.
// Reads pixel_offset, where the pixel's samples begin in the slice; writes sample_pixel, the pixel of every sample.

__kernel void list_samples(
#include "generated/list_samples_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint end = i + 1u < pixels ? pixel_offset[i + 1u] : slice_samples;
    for (uint sample = pixel_offset[i]; sample < end; ++sample) sample_pixel[sample] = pixel;
}
