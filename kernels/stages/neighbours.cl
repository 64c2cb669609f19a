// Stage after `design_effect`, for strategies that read the neighbours: mean and variance of the pixels around each
// pixel. A work-item processes a run of at most NEIGHBOUR_RUN pixels of a row.
#include "util/vec.h"

#define MAX_RADIUS 15
#define SPAN (NEIGHBOUR_RUN + 2 * MAX_RADIUS)  // the pixels of a run, and those around them in its row

// Averages over the square with `neighbour_radius` pixels to each side, as far as it is inside the image, without the
// pixel itself and without pixels of fewer than two samples. Nothing is subtracted, so that a large value leaves no
// rounding error behind. `luminance`: planes of the mean and of the variance of a sample; so is `neighbours`, with the
// variance infinite where no neighbour counts.
__kernel void average_neighbours(
#include "generated/average_neighbours_parameters.h"
)
{
    const int width = (int)image_width, height = (int)(total_pixels / image_width), radius = (int)neighbour_radius;
    const int runs = (width + NEIGHBOUR_RUN - 1) / NEIGHBOUR_RUN;
    const int y = (int)get_global_id(0) / runs, left = (int)get_global_id(0) % runs * NEIGHBOUR_RUN - radius;
    if (y >= height || radius == 0) return;
    const int begin = MAX(left, 0), end = MIN(left + NEIGHBOUR_RUN + 2 * radius, width);
    // Of every column of the span: the pixels above and below, and those of the row too.
    float others[3][SPAN], all[3][SPAN];
    for (int i = 0; i < SPAN; ++i)
        for (int k = 0; k < 3; ++k) others[k][i] = all[k][i] = 0.0f;
    for (int row = MAX(y - radius, 0); row <= MIN(y + radius, height - 1); ++row) {
        const float other = row == y ? 0.0f : 1.0f;
        VECTORIZE_PIXELS
        for (int x = begin; x < end; ++x) {
            const int pixel = row * width + x, i = x - left;
            const float known = count[pixel] > 1u ? 1.0f : 0.0f;
            const float mean = known * luminance[pixel], variance = known * luminance[(int)total_pixels + pixel];
            all[0][i] += known;
            all[1][i] += mean;
            all[2][i] += variance;
            others[0][i] += other * known;
            others[1][i] += other * mean;
            others[2][i] += other * variance;
        }
    }
    const int run_end = MIN(NEIGHBOUR_RUN, width - left - radius);
    for (int step = 1; step <= radius; ++step) {
        VECTORIZE_PIXELS
        for (int i = radius; i < radius + run_end; ++i) {
            others[0][i] += all[0][i - step] + all[0][i + step];
            others[1][i] += all[1][i - step] + all[1][i + step];
            others[2][i] += all[2][i - step] + all[2][i + step];
        }
    }
    VECTORIZE_PIXELS
    for (int i = radius; i < radius + run_end; ++i) {
        const int pixel = y * width + left + i;
        const float number = MAX(others[0][i], 1.0f);
        neighbours[pixel] = others[1][i] / number;
        neighbours[(int)total_pixels + pixel] = others[0][i] > 0.0f ? others[2][i] / number : INFINITY;
    }
}
