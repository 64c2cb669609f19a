"""The data of the report's image viewer (`viewer.js`) as JSON; called by `scene_section`."""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from isonoise.comparison.report.map_grids import MapGrid, block_means, colour_stops
from isonoise.comparison.report.strategy_images import StrategyImages
from isonoise.film.png import automatic_exposure

MAX_SIDE = 512
"""Largest side of an image in the viewer; larger ones are reduced to the means of blocks of pixels."""
MAX_PIXELS = 3_000_000
"""Largest number of pixels in all images of a page. They take about 10 bytes each."""

_COLOURS = 64
_MAX_HALF = float(np.finfo(np.float16).max)


def viewer_factor(sizes: Sequence[tuple[int, int, int]]) -> int:
    """Side of the blocks of pixels that become one pixel of the viewers, such that all images fit into the page.

    `sizes` has the (width, height, number of images) of each viewer.
    """
    factor = 1
    while (
        max(max(width, height) for width, height, _ in sizes) // factor > MAX_SIDE
        or sum(width // factor * (height // factor) * count for width, height, count in sizes) > MAX_PIXELS
    ):
        factor += 1
    return min(factor, *(side for width, height, _ in sizes for side in (width, height)))


def viewer_json(
    reference: np.ndarray, images: Sequence[StrategyImages], scales: Mapping[str, MapGrid], factor: int
) -> str:
    """The data of a scene's viewer, as JSON that may stand in a `<script>` element.

    Fields: `width`, `height`, `factor` (of the reduction), `exposure` (factor for 0 EV), `signed` (whether errors have
    a sign), `scales` (`error` and `samples`: `low`, `high`, `colours`) and `images`. The first image is the reference.
    Each has a `title` and planes of float16: `rgb`, and but for the reference `error` and `samples`; the latter times
    `samples_factor` are the samples. Reduced errors are root mean squares, other values means.

    Parameters
    ----------
    reference : (height, width, 3)
        Linear RGB.
    scales : mapping
        Colour scales of the maps: "error" and "samples".
    factor : int
        From `viewer_factor`.
    """

    def reduce(values: np.ndarray) -> np.ndarray:
        return values if factor == 1 else block_means(values.astype(np.float64), factor)

    rgb = reduce(reference)
    entries = [{"title": "reference", "rgb": encode_half(np.moveaxis(rgb, 2, 0))}]
    for image in images:
        error = image.error if factor == 1 else np.sqrt(reduce(np.square(image.error, dtype=np.float64)))
        count = reduce(image.count)
        samples_factor = 2.0 ** max(0, int(np.ceil(np.log2(max(float(count.max()), 1) / _MAX_HALF))))
        entries.append(
            {
                "title": image.title,
                "rgb": encode_half(np.moveaxis(reduce(image.rgb), 2, 0)),
                "error": encode_half(error),
                "samples": encode_half(count / samples_factor),
                "samples_factor": samples_factor,
            }
        )
    data = {
        "width": rgb.shape[1],
        "height": rgb.shape[0],
        "factor": factor,
        "exposure": automatic_exposure(np.maximum(reference, 0)),
        "signed": factor == 1,
        "scales": {
            name: {"low": grid.low, "high": grid.high, "colours": colour_stops(grid, _COLOURS)}
            for name, grid in scales.items()
        },
        "images": entries,
    }
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


def encode_half(values: np.ndarray) -> str:
    """Values as base64 of deflated (RFC 1951) float16: first the low bytes of all, then the high bytes."""
    halves = np.clip(values, -_MAX_HALF, _MAX_HALF).astype("<f2").ravel()
    planes = np.ascontiguousarray(halves.view(np.uint8).reshape(-1, 2).T).tobytes()
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return base64.b64encode(deflate.compress(planes) + deflate.flush()).decode("ascii")
