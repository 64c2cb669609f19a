// Stage: makes the sample list of a slice of a wave. One work-item per pixel of the slice.
// Reads pixel_offset, where the pixel's samples begin in the slice, and the per-pixel counts. Writes sample_pixel, the
// pixel of every sample in the film, and sample_index, its index among the samples of the pixel. pixel_list has the
// pixels of the image whose statistics are on the device; it is null if these are all pixels. The image is a window of
// the film, which begins at film_offset: so a pixel has the same samples in every window.

__kernel void list_samples(
#include "generated/list_samples_parameters.h"
)
{
    const uint i = get_global_id(0);
    if (i >= pixels) return;
    const uint pixel = first_pixel + i, begin = pixel_offset[i];
    const uint end = i + 1u < pixels ? pixel_offset[i + 1u] : slice_samples;
    const uint image_pixel = pixel_list ? pixel_list[pixel] : pixel, first_index = count[pixel] + rejected[pixel];
    const uint film_pixel = film_offset + image_pixel + image_pixel / crop_width * (film_width - crop_width);
    for (uint sample = begin; sample < end; ++sample) {
        sample_pixel[sample] = film_pixel;
        sample_index[sample] = first_index + (sample - begin);
    }
}
