"""Maps of sample counts and errors with a common colour scale: for the page, plots/ and the poster's figures."""

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.metric_columns import format_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Map:
    """One map: positive `values` (height, width)."""

    title: str
    values: np.ndarray


@dataclass(frozen=True)
class MapGrid:
    """Maps with a common logarithmic colour scale from `low` to `high`; `colours` is a colour map of matplotlib."""

    maps: Sequence[Map]
    low: float
    high: float
    colours: str


MAX_DECADES = 2.5
"""Range of an error map's scale: pixels without noise would extend it without limit."""


def sample_maps(counts: Mapping[str, np.ndarray]) -> MapGrid:
    """Maps of sample counts (title -> counts). The scale clips the extreme 0.1 % of a map's pixels at either end."""
    maps = [Map(title, np.maximum(count, 1).astype(np.float64)) for title, count in counts.items()]
    ends = np.array([np.quantile(m.values, (0.001, 0.999)) for m in maps])
    return MapGrid(maps, *_widen(ends[:, 0].min(), ends[:, 1].max()), "viridis")


def error_maps(errors: Mapping[str, np.ndarray]) -> MapGrid:
    """Maps of RMS relative errors (title -> errors). The scale clips the extreme 1 % of all pixels at either end."""
    all_errors = np.concatenate([image.ravel() for image in errors.values()])
    noisy = all_errors[all_errors > 0]
    low, high = np.quantile(noisy, (0.01, 0.99)) if noisy.size else (1.0, 1.0)
    low = max(low, high / 10**MAX_DECADES)
    return MapGrid([Map(title, image) for title, image in errors.items()], *_widen(low, high), "magma")


def grid_figure(grid: MapGrid, caption: str, form=format_number) -> "Figure":
    """The maps side by side with a common colour bar."""
    from matplotlib.figure import Figure

    column_count = min(5, len(grid.maps))
    row_count = -(-len(grid.maps) // column_count)
    height, width = grid.maps[0].values.shape
    figure = Figure(
        figsize=(2.1 * column_count, (2.1 * height / width + 0.25) * row_count + 0.6), dpi=130, layout="compressed"
    )
    axes = figure.subplots(row_count, column_count, squeeze=False)
    for panel in axes.flat:
        panel.axis("off")
    for panel, map_ in zip(axes.flat, grid.maps, strict=False):
        draw_map(panel, map_, grid)
    draw_colour_bar(figure, axes, grid, caption, form, location="bottom", aspect=60, shrink=0.6)
    return figure


def draw_map(axes, map_: Map, grid: MapGrid) -> None:
    """Draw one map of a grid and its title into `axes` of matplotlib."""
    from matplotlib.colors import LogNorm

    norm = LogNorm(grid.low, grid.high)
    axes.imshow(np.maximum(map_.values, grid.low), norm=norm, cmap=grid.colours, interpolation="nearest")
    axes.set_title(map_.title, fontsize=8)
    axes.set(xticks=[], yticks=[])


def draw_colour_bar(figure: "Figure", axes, grid: MapGrid, caption: str, form=format_number, **options) -> None:
    """Draw the colour bar of a grid beside `axes`; `options` are passed to matplotlib's `colorbar`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(ScalarMappable(LogNorm(grid.low, grid.high), grid.colours), ax=axes, **options)
    bar.set_label(caption)
    bar.ax.minorticks_off()
    ticks = nice_ticks(grid.low, grid.high)
    bar.set_ticks(ticks, labels=[form(value, 1) for value in ticks])


def map_png(map_: Map, grid: MapGrid, max_side: int = 256) -> bytes:
    """One map as a small PNG; larger maps than `max_side` pixels are reduced by means of blocks."""
    from matplotlib import colormaps
    from PIL import Image

    levels = 64  # looks the same on noise, with half the file size of 256
    values = np.maximum(shrink(map_.values, max_side), grid.low)
    position = np.log(values / grid.low) / np.log(grid.high / grid.low)
    picture = Image.fromarray(np.clip(position * (levels - 1) + 0.5, 0, levels - 1).astype(np.uint8), mode="P")
    picture.putpalette(
        (colormaps[grid.colours](np.linspace(0, 1, levels))[:, :3] * 255).round().astype(np.uint8).tobytes()
    )
    return png_bytes(picture)


def shrink(values: np.ndarray, max_side: int) -> np.ndarray:
    """Means of k by k blocks, with the least k that makes both sides at most `max_side`; incomplete blocks are cut."""
    return block_means(values, -(-max(values.shape[:2]) // max_side))


def block_means(values: np.ndarray, k: int) -> np.ndarray:
    """Means of k by k blocks of the first two axes; incomplete blocks are cut."""
    height, width = (side // k * k for side in values.shape[:2])
    blocks = values[:height, :width].reshape(height // k, k, width // k, k, *values.shape[2:])
    return blocks.mean(axis=(1, 3))


def png_bytes(picture) -> bytes:
    """A PIL image as the bytes of a PNG file."""
    stream = io.BytesIO()
    picture.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def data_uri(png: bytes) -> str:
    """A PNG as the address of an image in the page."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def grid_values(grid: MapGrid, title: str, form: Callable[..., str], max_side: int) -> dict:
    """A grid of maps for the template; `form` formats the numbers of its scale."""
    span = np.log(grid.high / grid.low)
    return {
        "title": title,
        "maps": [(m.title, data_uri(map_png(m, grid, max_side))) for m in grid.maps],
        "colours": colour_stops(grid),
        "ticks": [(form(t, 1), 100 * float(np.log(t / grid.low) / span)) for t in nice_ticks(grid.low, grid.high)],
    }


def nice_ticks(low: float, high: float) -> list[float]:
    """Ticks 1, 2, 5 times powers of ten from `low` to `high`; powers of ten alone if there are more than eight."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for digits in ((1, 2, 5), (1,)):
        ticks = [digit * 10.0**power for power in powers for digit in digits if low <= digit * 10.0**power <= high]
        if len(ticks) <= 8:
            break
    return ticks


def colour_stops(grid: MapGrid, count: int = 12) -> list[str]:
    """Evenly spaced colours of the grid's colour map, for CSS."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps[grid.colours](position)) for position in np.linspace(0, 1, count)]


def _widen(low: float, high: float) -> tuple[float, float]:
    """Widens an empty range, which no logarithmic scale can show."""
    return (float(low), float(high)) if high > low * 1.001 else (float(low) / 1.1, float(high) * 1.1)
