// Stage: the sample list of one slice of a wave: which pixel each of its samples belongs to.
// One work-item a pixel of the slice; pixel_offset is where the pixel's samples begin in the slice.

__kernel void list_samples(
#include "generated/list_samples_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i;
    const uint end = i + 1u < pixels ? pixel_offset[pixel + 1u] : slice_samples;
    for (uint sample = pixel_offset[pixel]; sample < end; ++sample) sample_pixel[sample] = pixel;
}
