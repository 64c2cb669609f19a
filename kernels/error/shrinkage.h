// Variances of the pixels, shrunk towards those of their groups: `_shrunk_variance` of
// host/isonoise/error/shrinkage.py.
#pragma once
#include "error/tile.h"

// `_variance_noise`: 2 + 3/2 skewness^2 of windows of 16x16 pixels, of 2x2 of these, and of the tile.
NOINLINE void variance_noise(Tile t, float floor)
{
    const int groups = LEVEL_SIZE(1), windows = LEVEL_SIZE(LEVELS);
    const Plane third_moment = t.work[0], usable = t.work[1];
    FOR_EACH(g, groups) {
        const float parent = t.relative[CELLS + g];
        float x[4], sum = 0.0f, children = 0.0f;
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            const int c = g + k * groups;
            x[k] = t.x[c] / MAX(t.smoothed[c], floor);
            sum += t.n[c] * x[k];
            children += t.dof[c] > 0.0f ? 1.0f : 0.0f;
        }
        const float mean = ratio(sum, t.n[CELLS + g]);
        float scatter = 0.0f, product = 0.0f;
#pragma unroll
        for (int k = 0; k < 4; ++k) {
            const int c = g + k * groups;
            const float deviation = x[k] - mean;
            scatter += t.n[c] * deviation * deviation;
            product += t.n[c] * deviation * (t.relative[c] - parent);
        }
        const float norm = child_dof(children) * parent;
        const bool is_usable = scatter < MAX_SKEWNESS_SCATTER * norm;
        usable[g] = is_usable ? 1.0f : 0.0f;
        third_moment[g] = is_usable ? ratio(product, norm * SQRT(parent)) : 0.0f;
    }
    SYNCHRONIZE;
    FOR_EACH(w, windows) {
        float total = 0.0f, number = 0.0f;
        for (int g = w; g < groups; g += windows) {
            total += third_moment[g];
            number += usable[g];
        }
        const float skewness = MAX(ratio(total, number), 0.0f);
        t.phi[w] = 2.0f + 1.5f * skewness * skewness;
        t.shrunk[LEVEL_BEGIN(LEVELS) + w] = t.relative[LEVEL_BEGIN(LEVELS) + w];
    }
    SYNCHRONIZE;
    FOR_EACH(w, 4) t.phi[windows + w] = 0.25f * (t.phi[w] + t.phi[w + 4] + t.phi[w + 8] + t.phi[w + 12]);
    SYNCHRONIZE;
    FOR_EACH(w, 1)
        t.phi[windows + 4] = 0.25f * (t.phi[windows] + t.phi[windows + 1] + t.phi[windows + 2] + t.phi[windows + 3]);
    SYNCHRONIZE;
}

// The factor of shrinkage of every window of 4x4 groups: `_true_share`^(1/2).
NOINLINE void shrinkage_factors(Tile t, int level, Plane factor)
{
    const int child = LEVEL_BEGIN(level), parent = LEVEL_BEGIN(level + 1);
    const int groups = LEVEL_SIZE(level + 1), windows = groups / 16;
    const Plane scatters = t.work[0], all_children = t.work[0] + groups;
    FOR_EACH(g, groups) {
        const float mean = t.relative[parent + g];
        float children;
        const float sum = child_scatter(t.dof, t.relative, mean, child + g, groups, &children);
        const bool is_valid = children > 1.0f && mean > 0.0f;
        scatters[g] = is_valid ? sum / ((children - 1.0f) * mean * mean) : 0.0f;
        all_children[g] = is_valid ? children : 0.0f;
    }
    SYNCHRONIZE;
    FOR_EACH(w, windows) {
        float scatter = 0.0f, valid = 0.0f, total = 0.0f, children = 0.0f;
        for (int g = w; g < groups; g += windows) {
            scatter += scatters[g];
            children += all_children[g];
            valid += all_children[g] > 0.0f ? 1.0f : 0.0f;
            total += all_children[g] > 0.0f ? t.dof[parent + g] : 0.0f;
        }
        scatter = ratio(scatter, valid);
        const float phi = t.phi[level == 3 ? 20 : level == 2 ? 16 + w : w & 15];
        const float apparent_noise = ratio(scatter, MAX(1.0f - ratio(scatter, ratio(total, valid)), 1e-6f));
        const float share = apparent_noise > 0.0f ? MAX(1.0f - phi / apparent_noise, 0.0f) : 0.0f;
        const float dof = ratio(total, children);
        factor[w] = SQRT(share * ratio(dof, dof + phi));
    }
    SYNCHRONIZE;
}

// One level of `_shrunk_variance`.
NOINLINE void shrink_level(Tile t, int level)
{
    const int child = LEVEL_BEGIN(level), parent = LEVEL_BEGIN(level + 1);
    const int groups = LEVEL_SIZE(level + 1), windows = groups / 16;
    const Plane factors = t.work[1];
    shrinkage_factors(t, level, factors);
    for (int q = 0; q < 16; ++q) {
        FOR_EACH(w, windows) {
            const int g = w + q * windows, p = parent + g;
            const float factor = factors[w], mean = t.relative[p], shrunk = t.shrunk[p];
#pragma unroll
            for (int k = 0; k < 4; ++k) {
                const int c = child + g + k * groups;
                t.shrunk[c] = MAX((t.relative[c] - mean) * factor + shrunk, shrunk * (1.0f - factor));
            }
        }
    }
    SYNCHRONIZE;
}
