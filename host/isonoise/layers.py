"""The layers of an image beside its colour: their names, channels, and what they are made from.

`--layers` and `layers=` name them. The device makes those of the first hit (kernels/stages/accumulate_layers.cl),
the host the others (`isonoise.film.layers`).
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from isonoise.errors import UserError
from isonoise.suggestions import suggestion

ALL_SAMPLES, HITS, FIRST_SAMPLE, HOST = range(4)
"""How a layer is made: the mean over all camera samples of the pixel, those without a hit as 0; the mean over those
with a hit; the value of the first camera sample; on the host."""

NO_HIT_DEPTH = 1e10
"""Depth of pixels in which no camera sample hits a surface, as in Cycles."""
NO_HIT_INDEX = -1
"""Index in pixels whose first camera sample hits nothing."""


class Layer(NamedTuple):
    """A layer: its channels, how it is made, and one line that says what it is."""

    channels: str
    made: int
    meaning: str


LAYERS: Mapping[str, Layer] = {
    "albedo": Layer("RGB", ALL_SAMPLES, "share of the light that the surface scatters, from 0 to 1"),
    "normal": Layer("XYZ", ALL_SAMPLES, "shading normal with bump and normal maps, in world space, to the camera"),
    "geometric_normal": Layer("XYZ", ALL_SAMPLES, "normal of the surface itself, in world space, to the camera"),
    "depth": Layer("Z", HITS, "distance along the optical axis, in scene units; 1e10 without a hit"),
    "position": Layer("XYZ", HITS, "position in world space"),
    "uv": Layer("UV", HITS, "texture coordinates"),
    "coverage": Layer("X", ALL_SAMPLES, "share of the camera samples that hit a surface"),
    "shape_index": Layer("X", FIRST_SAMPLE, "number of the shape; -1 without a hit"),
    "material_index": Layer("X", FIRST_SAMPLE, "number of the material; -1 without a hit"),
    "variance": Layer("X", HOST, "sample variance of the luminance"),
    "measure": Layer("X", HOST, "what the strategy acts on: see its table"),
    "denoised": Layer("RGB", HOST, "the image after Open Image Denoise"),
}
"""All layers by name, in the order in which they are kept."""

GUIDES = ("albedo", "normal")
"""Layers from which the denoiser learns where edges and textures are."""


def check_layers(names: object) -> tuple[str, ...]:
    """The names in the order of `LAYERS`, each once. Raises UserError for an unknown one."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise UserError(f"layers = {names!r} must be a list of names, such as ['albedo', 'depth']")
    names = tuple(names)
    for name in names:
        if name not in LAYERS:
            raise UserError(f"there is no layer '{name}'{suggestion(str(name), LAYERS)}; known are {', '.join(LAYERS)}")
    return tuple(name for name in LAYERS if name in names)


def device_layers(names: Iterable[str]) -> tuple[str, ...]:
    """The layers that the device makes for these: those named, and what others are made from."""
    wanted = set(names)
    if "denoised" in wanted:
        wanted.update(GUIDES)
    if any(LAYERS[name].made == HITS for name in wanted):
        wanted.add("coverage")
    return tuple(name for name, layer in LAYERS.items() if name in wanted and layer.made != HOST)


def first_components(names: Iterable[str]) -> dict[str, int]:
    """Name of a layer that the device makes -> number of its first channel among those that are made alike.

    Means and first values are counted separately. Layers that are not in `names` have -1.
    """
    numbers, means, values = {}, 0, 0
    for name, layer in LAYERS.items():
        if layer.made == HOST:
            continue
        numbers[name] = -1
        if name in names and layer.made == FIRST_SAMPLE:
            numbers[name], values = values, values + 1
        elif name in names:
            numbers[name], means = means, means + len(layer.channels)
    return numbers


def mean_components(names: Iterable[str]) -> int:
    """Channels of these layers that are means over samples."""
    return sum(len(LAYERS[name].channels) for name in names if LAYERS[name].made in (ALL_SAMPLES, HITS))


def first_values(names: Iterable[str]) -> int:
    """How many of these layers are values of the first sample."""
    return sum(LAYERS[name].made == FIRST_SAMPLE for name in names)
