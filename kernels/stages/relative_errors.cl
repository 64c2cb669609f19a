// Stage after `design_effect`: the relative error of every pixel, for the stated error. It computes `relative_errors`
// of host/isonoise/error/shrinkage.py, where the method and its sources are explained; functions have the same names.
// A work-group takes one tile after another.
#include "error/tile.h"
#include "error/smoothing.h"
#include "error/shrinkage.h"

// The index in the histogram: of errors without noise ERROR_BINS, of unknown ones ERROR_BINS + 1. Bins are intervals
// of equal length of the piecewise linear log2 of the mean square, for each bin of the root of the normal share.
INLINE uint error_bin(float square, float normal)
{
    if (!(square > 0.0f)) return ERROR_BINS;
    const uint normal_bin = (uint)(SQRT(ratio(normal, square)) * (float)NORMAL_BINS + 0.5f);
    const float limit = MIN(MAX(square, FIRST_ERROR_SQUARE), LAST_ERROR_SQUARE);
    return normal_bin * (ERROR_BINS / (NORMAL_BINS + 1u)) +
           ((as_uint(limit) - as_uint(FIRST_ERROR_SQUARE)) >> ERROR_BIN_SHIFT);
}

// The mean squares of the errors over scale^2, and the part of them that is normal.
NOINLINE void squared_errors(Tile t, float floor, Plane squares, Plane normals, Plane noises)
{
    const int groups = LEVEL_SIZE(1);
    FOR_EACH(g, groups) {
        const float parent = t.x[CELLS + g], group_noise = ratio(t.s2[CELLS + g], t.n[CELLS + g]);
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            const int c = g + k * groups;
            const float scale = MAX(t.smoothed[c], floor), inverse_scale = 1.0f / scale;
            const float noise = ratio(t.shrunk[c], t.n[c]);
            const float mean_ratio = ratio(t.x[c], parent);
            const float own = noise * scale * scale - mean_ratio * mean_ratio * group_noise;
            const float variance = mean_ratio * mean_ratio * t.posterior[CELLS + g] + MAX(own, 0.0f) * t.kept_noise[c];
            const float normal = variance * inverse_scale * inverse_scale;
            const float deviation = t.n[c] > 0.0f ? (t.x[c] - t.smoothed[c]) * inverse_scale : 0.0f;
            squares[c] = deviation * deviation + normal;
            normals[c] = normal;
            noises[c] = noise;
        }
    }
    SYNCHRONIZE;
}

// Writes the bins, of squares that add up to the noise over 8x8 pixels.
NOINLINE void write_bins(Tile t, Plane squares, Plane normals, Plane noises, __global uint* bins)
{
    const int windows = 64;
    const Plane corrections = t.work[0];
    FOR_EACH(w, windows) {
        float square = 0.0f, noise = 0.0f;
        for (int c = w; c < CELLS; c += windows) {
            square += squares[c];
            noise += noises[c];
        }
        corrections[w] = ratio(noise, square);
    }
    SYNCHRONIZE;
    for (int row = 0; row < CELLS; row += windows) {
        FOR_EACH(w, windows) {
            const int c = row + w;
            const float correction = corrections[w];
            const uint bin = error_bin(squares[c] * correction, normals[c] * correction);
            bins[c] = t.known[c] > 0.0f ? bin : ERROR_BINS + 1u;
        }
    }
    SYNCHRONIZE;
}

__kernel void relative_errors(
#include "generated/relative_errors_parameters.h"
)
{
    if (get_group_id(0) >= error_groups) return;
    const uint height = total_pixels / image_width, across = (image_width + 63u) / 64u, down = (height + 63u) / 64u;
    const Tile t = tile_planes(error_scratch + get_group_id(0) * ERROR_SCRATCH);
    for (uint tile = get_group_id(0); tile < across * down; tile += error_groups) {
        const uint left = tile % across * 64u, top = tile / across * 64u;
        load_tile(t, left, top, image_width, height, inverse_unit, count, luminance, total_pixels);
        build_pyramids(t);
        find_black(t);
        const int top_level = LEVEL_BEGIN(LEVELS), top_size = LEVEL_SIZE(LEVELS);
        FOR_EACH(g, top_size) {
            t.smoothed[top_level + g] = t.x[top_level + g];
            t.posterior[top_level + g] = ratio(t.s2[top_level + g], t.n[top_level + g]);
        }
        SYNCHRONIZE;
        for (int level = LEVELS - 1; level >= 0; --level) smooth_level(t, level);
        FOR_EACH(c, CELLS) {
            const float scale = MAX(t.smoothed[c], error_floor);
            t.relative[c] = MIN(t.s2[c] / scale / scale, MAX_MEAN);
        }
        SYNCHRONIZE;
        for (int level = 0; level < LEVELS; ++level) build_level(t.dof, t.relative, level);
        variance_noise(t, error_floor);
        for (int level = LEVELS - 1; level >= 0; --level) shrink_level(t, level);
        squared_errors(t, error_floor, t.zeros, t.relative, t.dof);
        write_bins(t, t.zeros, t.relative, t.dof, error_bins + tile * CELLS);
    }
}
