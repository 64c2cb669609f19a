"""Reads the layers that the stage `accumulate_layers` has summed up, as arrays of the image."""

from collections.abc import Mapping

import numpy as np

from isonoise.layers import FIRST_SAMPLE, HITS, LAYERS, NO_HIT_DEPTH, NO_HIT_INDEX, first_components
from isonoise.scene import structs


def layer_images(state: Mapping[str, np.ndarray], names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The layers by name, from the state of the stage `reduce`.

    Parameters
    ----------
    state : mapping of str to array
        Name -> (planes, height, width), as `Accumulator.state` returns it, also mapped from the device.
    names : tuple of str
        Layers of the state: `Needs.layers`.

    Returns
    -------
    dict of str to array
        (height, width) float32, or (height, width, channels) for a layer with more than one. Pixels without samples
        have the values of pixels without a hit.
    """
    if not names:
        return {}
    samples = state["count"][0].astype(np.float64) + state["rejected"][0]
    firsts, images = first_components(names), {}

    def mean(component: int, weight: np.ndarray) -> np.ndarray:
        high, low = state["layer_sums"][2 * component : 2 * component + 2]
        total = high.astype(np.float64) + low
        return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)

    for name in names:
        layer, first = LAYERS[name], firsts[name]
        if layer.made == FIRST_SAMPLE:
            index = state["layer_indices"][first]
            is_hit = (index != structs.NONE) & (samples > 0)
            images[name] = np.where(is_hit, index.astype(np.float32), np.float32(NO_HIT_INDEX))
            continue
        weight = np.rint(samples * mean(firsts["coverage"], samples)) if layer.made == HITS else samples
        planes = [mean(first + k, weight) for k in range(len(layer.channels))]
        if name == "depth":
            planes[0][weight == 0] = NO_HIT_DEPTH
        if name == "albedo":  # few samples of a rough surface may have a mean above 1
            planes = [np.minimum(plane, 1.0) for plane in planes]
        images[name] = (planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)).astype(np.float32)
    return images
