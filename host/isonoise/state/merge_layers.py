"""The layers of a state, and of renders that are merged. Called by `merge`."""

from collections.abc import Mapping

import numpy as np

from isonoise.integrator.layer_planes import layer_images
from isonoise.layers import FIRST_SAMPLE, HITS, LAYERS, NO_HIT_DEPTH
from isonoise.state.state import State
from isonoise.statistics import Statistics


def state_layers(state: State) -> dict[str, np.ndarray]:
    """The layers that the device has made for a state, or for merged renders, by name."""
    if "merged" in state.values:
        return state.group("layers")
    return layer_images(state.group("reduction"), tuple(state.settings["needs"]["layers"]))


def merge_layers(
    a: Mapping[str, np.ndarray], a_statistics: Statistics, b: Mapping[str, np.ndarray], b_statistics: Statistics
) -> dict[str, np.ndarray]:
    """The layers that both have, of the samples of both. An index is that of `a`, where it has samples."""
    samples_a, samples_b = (
        statistics.count.astype(np.float64) + statistics.rejected for statistics in (a_statistics, b_statistics)
    )
    merged = {}
    for name in a:
        if name not in b:
            continue
        made = LAYERS[name].made
        if made == FIRST_SAMPLE:
            merged[name] = np.where(samples_a > 0, a[name], b[name])
            continue
        weight_a, weight_b = samples_a, samples_b
        if made == HITS:
            weight_a, weight_b = samples_a * a["coverage"], samples_b * b["coverage"]
        total = weight_a + weight_b
        share = np.divide(weight_b, total, out=np.zeros_like(total), where=total > 0)
        share = share[..., None] if a[name].ndim == 3 else share
        image = a[name] + share * (b[name].astype(np.float64) - a[name])
        if name == "depth":
            image[total == 0] = NO_HIT_DEPTH
        merged[name] = image.astype(np.float32)
    return merged
