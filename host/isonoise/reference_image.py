"""The reference of a render, against which true errors are computed: from a file, arrays or an earlier render."""

import os
from typing import TypeAlias

import numpy as np

from isonoise.argument_checks import check_rgb
from isonoise.errors import UserError
from isonoise.film.exr import read_reference
from isonoise.outcome import Outcome
from isonoise.statistics import Statistics

Reference: TypeAlias = str | os.PathLike[str] | np.ndarray | tuple[np.ndarray, np.ndarray | None] | Outcome | Statistics
"""What `reference_image` accepts."""


def reference_image(reference: Reference) -> tuple[np.ndarray, np.ndarray | None]:
    """The linear RGB and its standard error of what a caller gives as reference.

    Parameters
    ----------
    reference : path, array, (array, array or None), Outcome or Statistics
        An .exr file with the channels R, G, B and, if it has them, stderr.R, stderr.G, stderr.B, as `isonoise compare`
        writes; linear RGB, (height, width, 3), alone or with its standard errors; or an earlier render, whose standard
        errors are those of the luminance.

    Returns
    -------
    rgb, standard_error : (height, width, 3) float32; the second one may be None, for an exact reference

    Raises
    ------
    UserError
        If it is something else, or not finite everywhere.
    """
    if isinstance(reference, (str, os.PathLike)):
        return read_reference(reference)
    if isinstance(reference, Outcome):
        reference = reference.statistics
    if isinstance(reference, Statistics):
        if reference.count.min() < 2:
            raise UserError("reference: the render has pixels with fewer than 2 samples, so their errors are unknown")
        error = np.sqrt(reference.variance_of_mean())
        reference = reference.rgb, np.repeat(error[..., None], 3, axis=2)
    if not isinstance(reference, (np.ndarray, tuple)):
        raise UserError(
            f"reference = {reference!r} is none: it has to be the path of an .exr file, an array (height, width, 3), "
            "a pair (RGB, standard error), or an outcome of isonoise.render"
        )
    rgb, error = reference if isinstance(reference, tuple) and len(reference) == 2 else (reference, None)
    pixels = _pixels("reference", rgb)
    if error is None:
        return pixels, None
    errors = _pixels("standard error of the reference", error)
    if errors.shape != pixels.shape or errors.min() < 0:
        raise UserError(
            f"standard error of the reference: it has the shape {errors.shape} and the least value {errors.min():g}; "
            f"the reference has the shape {pixels.shape}, and no standard error is below 0"
        )
    return pixels, errors


def check_reference_size(reference: tuple[np.ndarray, np.ndarray | None], shape: tuple[int, int]) -> None:
    """Raise UserError unless the reference has this shape, (height, width)."""
    if reference[0].shape[:2] != shape:
        height, width = reference[0].shape[:2]
        raise UserError(
            f"the reference is {width}x{height} and the image {shape[1]}x{shape[0]}: "
            f"render with size=({width}, {height}), or give another reference"
        )


def _pixels(name: str, value: object) -> np.ndarray:
    """The value as (height, width, 3) float32. Raises UserError if it is something else."""
    pixels = check_rgb(name, value)
    if not np.isfinite(pixels).all():
        raise UserError(f"{name}: {np.count_nonzero(~np.isfinite(pixels))} values are not finite")
    return pixels.astype(np.float32, copy=False)
