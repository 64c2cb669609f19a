"""Luminance of linear Rec. 709 RGB: errors and allocation are computed from it."""

import numpy as np

REC709_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear R, G, B: ITU-R BT.709-6, and `luminance()` of kernels/util/math.h.

Statistics, errors and the density of environment maps use these weights. `isonoise.scene.spectra.MITSUBA_LUMINANCE`
holds the same weights with Mitsuba 3's digits, for what a scene file means: spectra, textures and light powers.
"""


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Luminance of linear RGB, shape (..., 3), in float64, shape (...)."""
    red, green, blue = REC709_LUMINANCE
    result = np.multiply(rgb[..., 0], red, dtype=np.float64)
    result += np.multiply(rgb[..., 1], green, dtype=np.float64)
    result += np.multiply(rgb[..., 2], blue, dtype=np.float64)
    return result
