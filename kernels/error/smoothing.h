// Means of the pixels without black ones, smoothed where neighbours differ by noise alone: `_find_black`,
// `_smoothed_mean` and `_posterior_variance` of host/isonoise/error/shrinkage.py.
#pragma once
#include "error/tile.h"

// Sets the weights of the black pixels of a level's groups to 0.
NOINLINE void remove_black(Tile t, int level)
{
    const int begin = LEVEL_BEGIN(level), groups = LEVEL_SIZE(level);
    FOR_EACH(g, groups) {
        const float mean = t.x[begin + g], seen = t.known[begin + g], zeros = t.zeros[begin + g];
        const float relative_variance = ratio(ratio(t.s2[begin + g], mean), mean);
        const float without_light = exp(-ratio(t.n[begin + g], seen * (1.0f + relative_variance)));
        const float unlucky = without_light * (seen - zeros);
        if (mean > 0.0f && unlucky < MAX_UNLUCKY_SHARE * (1.0f - without_light) * zeros)
            for (int c = g; c < CELLS; c += groups)
                if (t.zeros[c] > 0.0f) t.n[c] = t.dof[c] = 0.0f;
    }
    SYNCHRONIZE;
}

// Sets the weights of black pixels to 0: `_find_black`.
NOINLINE void find_black(Tile t)
{
    for (int level = 0; level < LEVELS; ++level) sum_level(t.zeros, level);
    float zeros = 0.0f;
    for (int g = 0; g < LEVEL_SIZE(LEVELS); ++g) zeros += t.zeros[LEVEL_BEGIN(LEVELS) + g];
    if (zeros == 0.0f) return;
    for (int level = 0; level < LEVELS; ++level) sum_level(t.known, level);
    for (int level = 2; level <= 3; ++level) remove_black(t, level);
    build_pyramids(t);
}

// One level of `_smoothed_mean`, and of `_posterior_variance` above the pixels.
NOINLINE void smooth_level(Tile t, int level)
{
    const int child = LEVEL_BEGIN(level), parent = LEVEL_BEGIN(level + 1);
    const int groups = LEVEL_SIZE(level + 1), windows = groups / 4;
    const Plane group_scatter = t.work[0];
    FOR_EACH(g, groups) {
        float children;
        const float sum = child_scatter(t.n, t.x, t.x[parent + g], child + g, groups, &children);
        group_scatter[g] = MIN(ratio(sum, child_dof(children)), MAX_SCATTER * t.s2[parent + g]);
    }
    SYNCHRONIZE;
    for (int q = 0; q < 4; ++q) {
        FOR_EACH(w, windows) {
            float scatter = 0.0f, noise = 0.0f;
            UNROLL_IF_VECTORIZED
            for (int k = 0; k < 4; ++k) {
                scatter += group_scatter[w + k * windows];
                noise += t.s2[parent + w + k * windows];
            }
            const float signal = ratio(scatter - noise, noise);
            const float inverse_signal = noise > 0.0f ? 1.0f / MAX(signal, 1e-9f) : 0.0f;
            const int g = w + q * windows, p = parent + g;
            const float mean = t.x[p], smoothed = t.smoothed[p];
            const float scaling = ratio(smoothed, mean), group_noise = ratio(t.s2[p], t.n[p]);
#pragma unroll
            for (int k = 0; k < 4; ++k) {
                const int c = child + g + k * groups;
                const float mean_ratio = ratio(t.x[c], mean);
                const float share = 1.0f / (1.0f + MAX(mean_ratio, MIN(inverse_signal, 1.0f)) * inverse_signal);
                const float kept = MAX(share, -signal);
                t.smoothed[c] = ((t.x[c] - mean) * share + mean) * scaling + (mean == 0.0f ? smoothed : 0.0f);
                t.kept_noise[c] = kept;
                if (level == 0) continue;  // `squared_errors` does it, with the shrunk variance
                const float own = ratio(t.s2[c], t.n[c]) - mean_ratio * mean_ratio * group_noise;
                t.posterior[c] = mean_ratio * mean_ratio * t.posterior[p] + MAX(own, 0.0f) * kept;
            }
        }
    }
    SYNCHRONIZE;
}
