"""Luminance: the one number per pixel that errors are measured on."""

import numpy as np

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear RGB with Rec. 709 primaries and white point D65 (ITU-R BT.709-6)."""


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Luminance of linear RGB, shape (..., 3), in float64, shape (...)."""
    red, green, blue = LUMINANCE
    result = np.multiply(rgb[..., 0], red, dtype=np.float64)
    result += np.multiply(rgb[..., 1], green, dtype=np.float64)
    result += np.multiply(rgb[..., 2], blue, dtype=np.float64)
    return result
