"""The regions of an image where the strategies err most; called by `scene_section`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MAX_REGIONS = 3
MIN_SIDE = 16
"""Smallest side of a region in pixels, if the image is as large."""
SHARE = 6
"""The side of a region is the smaller side of the image over this number."""


@dataclass(frozen=True)
class Region:
    """A square of pixels, `x` and `y` its upper left corner."""

    x: int
    y: int
    side: int

    def crop(self, image: np.ndarray) -> np.ndarray:
        return image[self.y : self.y + self.side, self.x : self.x + self.side]


def worst_regions(errors: Sequence[np.ndarray]) -> list[Region]:
    """At most `MAX_REGIONS` squares that do not overlap, with the largest mean of the errors over pixels and images.

    Parameters
    ----------
    errors : sequence of (height, width)
        Not negative. Each image counts relative to its own mean, so that all strategies have the same weight.

    Returns
    -------
    list of Region
        The worst first.
    """
    height, width = errors[0].shape
    side = min(max(MIN_SIDE, min(height, width) // SHARE), height, width)
    relative = sum(image / mean for image in errors if (mean := float(np.mean(image, dtype=np.float64))) > 0)
    if np.ndim(relative) == 0:  # no errors at all
        return []
    sums = np.zeros((height + 1, width + 1))
    sums[1:, 1:] = relative.cumsum(axis=0).cumsum(axis=1)
    means = (sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]) / side**2
    regions = []
    while len(regions) < MAX_REGIONS and np.isfinite(means).any():
        y, x = (int(index) for index in np.unravel_index(np.argmax(means), means.shape))
        regions.append(Region(x, y, side))
        means[max(y - side + 1, 0) : y + side, max(x - side + 1, 0) : x + side] = -np.inf
    return regions
