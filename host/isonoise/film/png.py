"""8-bit sRGB previews: automatic exposure, and a soft shoulder for the highlights."""

import math
import os

import numpy as np

from isonoise.argument_checks import check_number, check_path, check_rgb
from isonoise.film.files import write_atomically
from isonoise.luminance import luminance
from isonoise.strategies.measures import image_floor

MIDDLE_GREY = 0.18
"""Display value of the image's log-average luminance: the key value of Reinhard et al. 2002, section 2.1."""

MAX_BRIGHT = 1.0
"""Value before the curve that at most a share `_BRIGHT_SHARE` of the lit pixels may exceed."""
_BRIGHT_SHARE = 0.1

SHOULDER = 0.6
"""Display value up to which the curve is linear, so that only highlights are compressed."""


def tone_map(rgb: np.ndarray, exposure: float | None = None, stops: float = 0.0) -> np.ndarray:
    """Tone-map linear RGB of any scale to 8-bit sRGB.

    Exposure, unless given: the log-average luminance becomes `MIDDLE_GREY` (Reinhard, Stark, Shirley, Ferwerda 2002,
    equations 1 and 2). The average is over pixels with light, none counted darker than 1e-4 of the mean, so that a
    black background or a few nearly black pixels do not brighten the rest. It is less if a tenth of these pixels would
    exceed `MAX_BRIGHT`. Curve, per channel: linear to `SHOULDER` s, then s + (1 - s)(1 - exp(-(v - s)/(1 - s))), which
    continues value and slope and reaches 1 only at infinity. Encoding: IEC 61966-2-1. The result depends only on the
    pixels, so equal images give equal bytes.

    Parameters
    ----------
    rgb : (height, width, 3)
        Linear, Rec. 709 primaries; negative and non-finite values count as 0.
    exposure : float or None
        Factor on `rgb`, in place of that by the image's brightness.
    stops : float
        Correction of the exposure: a factor of 2 to this power.

    Returns
    -------
    (height, width, 3) uint8
    """
    value = np.where(np.isfinite(rgb), rgb, 0).astype(np.float32).clip(min=0)
    with np.errstate(over="ignore"):  # infinity is white as well
        value *= np.float32((automatic_exposure(value) if exposure is None else exposure) * 2.0**stops)
    above = np.maximum(value - SHOULDER, 0) / (1 - SHOULDER)
    value = np.where(value <= SHOULDER, value, SHOULDER + (1 - SHOULDER) * -np.expm1(-above))
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(encoded * 255).astype(np.uint8)


def write_png(path: str | os.PathLike, rgb: np.ndarray, exposure: float | None = None, stops: float = 0.0) -> None:
    """Tone-map linear RGB as `tone_map` does and write it as a PNG, atomically.

    Parameters
    ----------
    path : path
        The file.
    rgb : (height, width, 3)
        Linear, Rec. 709 primaries.
    exposure : float or None
        Factor on `rgb`; None: by the image's brightness.
    stops : float
        As for `tone_map`.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    from PIL import Image

    check_path("path", path)
    rgb = check_rgb("rgb", rgb)
    for name, value in (("exposure", exposure), ("stops", stops)):
        if value is not None:
            check_number(name, value, math.isfinite, "a finite number")
    picture = Image.fromarray(tone_map(rgb, exposure, stops))
    write_atomically(path, lambda temporary: picture.save(temporary, format="PNG"))


def automatic_exposure(rgb: np.ndarray) -> float:
    """The factor on `rgb` that `tone_map` takes unless one is given; (height, width, 3), finite and not negative."""
    brightness = luminance(rgb)
    average = 100 * image_floor(brightness)  # the floor is 1 % of the log-average
    if not average > 0:
        return 1.0
    lit = brightness[brightness > 0]
    rank = int((1 - _BRIGHT_SHARE) * (len(lit) - 1))
    bright = float(np.partition(lit, rank)[rank])
    return min(MIDDLE_GREY / average, MAX_BRIGHT / bright)
