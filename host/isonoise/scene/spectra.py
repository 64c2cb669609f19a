"""Converts spectra to linear RGB (Rec. 709 primaries) as the rgb variants of Mitsuba 3 do.

A spectrum is integrated against the CIE 1931 2-degree observer at 1000 points over 360..830 nm, made linear sRGB
and clamped to the gamut. Reflectances and other quantities that do not emit are lit by D65: a spectrum of 1 becomes RGB
(1, 1, 1). Emission is not multiplied by D65: a constant spectrum (equal energy) of 1 becomes (1.2048, 0.9483, 0.9089).
The normalisations are Mitsuba's: the integral of y, and the luminance of its D65 table relative to it.
"""

from functools import lru_cache
from importlib.resources import files

import numpy as np

_SAMPLES, _MIN_NM, _MAX_NM = 1000, 360.0, 830.0
_Y_INTEGRAL = 106.7502593994140625  # of the observer's y over wavelength (Mitsuba 3, MI_CIE_Y_NORMALIZATION)
_D65_SCALE = 98.99741751876255  # mean of D65 weighted with y (Mitsuba 3, MI_CIE_D65_NORMALIZATION)
_XYZ_TO_RGB = np.array(  # ITU-R Rec. BT.709
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
MITSUBA_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Weights of linear R, G, B in Mitsuba 3 (`luminance()` of its color.h), for spectra, textures and light powers.

Statistics and errors use the digits of the standard: `isonoise.luminance.REC709_LUMINANCE`.
"""


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Decode sRGB values (IEC 61966-2-1); values outside [0, 1] are allowed."""
    curve = ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve)


@lru_cache(maxsize=1)
def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavelengths (1000,), RGB weights of emission (1000, 3), RGB weights of reflectance under D65 (1000, 3)."""
    with files("isonoise.scene").joinpath("data/cie1931.csv").open() as file:
        table = np.loadtxt(file, delimiter=",")
    wavelengths = np.linspace(_MIN_NM, _MAX_NM, _SAMPLES)
    x, y, z, d65 = (np.interp(wavelengths, table[:, 0], table[:, i]) for i in range(1, 5))
    weights = np.stack([x, y, z], axis=1) @ _XYZ_TO_RGB.T * ((_MAX_NM - _MIN_NM) / _SAMPLES / _Y_INTEGRAL)
    return wavelengths, weights, weights * (d65 / _D65_SCALE)[:, None]


def spectrum_to_rgb(wavelengths, values, kind: str) -> np.ndarray:
    """Linear RGB (3,) float64 of a piecewise linear spectrum, zero outside its range.

    `kind` is 'reflectance' (result within [0, 1]), 'unbounded' (eta, k; result >= 0) or 'radiance' (result >= 0).
    """
    grid, emission_weights, d65_weights = _tables()
    wavelengths = np.asarray(wavelengths, float)
    sampled = np.interp(grid, wavelengths, values)
    sampled[(grid < wavelengths[0]) | (grid > wavelengths[-1])] = 0.0
    rgb = sampled @ (emission_weights if kind == "radiance" else d65_weights)
    return np.clip(rgb, 0.0, 1.0 if kind == "reflectance" else np.inf)


def xyz_to_rgb(xyz) -> np.ndarray:
    """Linear RGB (3,) float64 of CIE XYZ; outside the gamut some are negative."""
    return _XYZ_TO_RGB @ np.asarray(xyz, float)


def constant_to_rgb(value: float, kind: str) -> np.ndarray:
    """Linear RGB (3,) of a constant spectrum; as emission it is equal energy, X = Y = Z."""
    return value * (_XYZ_TO_RGB.sum(axis=1) if kind == "radiance" else np.ones(3))


def colour_to_rgb(colour, kind: str) -> np.ndarray:
    """Linear RGB (3,) float64 of a colour of the description: a float, or a dict of type 'rgb' or 'spectrum'."""
    if not isinstance(colour, dict):
        return np.full(3, float(colour))
    value = colour["value"]
    if colour["type"] == "rgb":
        return np.broadcast_to(np.asarray(value, float), 3).copy()
    if isinstance(value, float):
        return constant_to_rgb(value, kind)
    wavelengths, values = np.asarray(value, float).T
    return spectrum_to_rgb(wavelengths, values, kind)
