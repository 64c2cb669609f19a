"""Bitmap textures made from images in memory. Called by the readers of formats whose textures have factors or alpha.

Operations on images return images. Bytes stay bytes where values only move (channels, alpha, a factor of 1); products
are linear 32-bit floats, which is exact but takes four times the memory on the device.
"""

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from isonoise.scene.image.image import Image, read_image

REPEAT, MIRROR, CLAMP = "repeat", "mirror", "clamp"
BILINEAR, NEAREST = "bilinear", "nearest"
UNIT_BOUNDS = ((0.0, 1.0), (0.0, 1.0))
_THRESHOLD_GAIN = 65536.0  # opacity per unit of alpha: one step of an 8-bit alpha is 257 times the ramp
_MAX_BEYOND = 1e6  # outside the image, in its size: keeps products with the size in the range of integers
_MAX_PADDING = 2.0  # columns or rows added for a mixed wrap mode, as a multiple of the image's


class Sampling(NamedTuple):
    """How a texture reads an image."""

    wrap_u: str = REPEAT
    wrap_v: str = REPEAT
    filter_type: str = BILINEAR
    to_uv: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    """Rows of the affine map from a mesh's texture coordinates to the image's, v = 0 is the top row."""

    def image_bounds(self, uv_bounds) -> np.ndarray:
        """((u low, u high), (v low, v high)) of the image's coordinates, of those of a mesh."""
        corners = np.array([(u, v, 1.0) for u in uv_bounds[0] for v in uv_bounds[1]])
        mapped = np.sum(np.asarray(self.to_uv)[:, None] * corners, axis=2)
        return np.stack([mapped.min(axis=1), mapped.max(axis=1)], axis=1)


DEFAULT_SAMPLING = Sampling()


class Bitmaps:
    """Operations on images and the textures that show them. Each is made once: equal calls return the same object."""

    def __init__(self):
        self._made: dict[Hashable, object] = {}  # keys hold the images, which are compared by identity

    def once(self, key: Hashable, make: Callable[[], object]):
        """What `make` returned when it was first called for a key."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def read(self, path: Path) -> Image:
        """The image of a file, with alpha, or SceneError. The caller checks whether the file may be read."""
        return self.once(("read", path.resolve()), lambda: read_image(path, with_alpha=True))

    def scaled(self, image: Image, factor, raw: bool = False) -> Image:
        """The image times a number or three numbers, without alpha: linear floats, unless every factor is 1."""
        factors = tuple(float(channel) for channel in np.atleast_1d(factor))
        if all(channel == 1 for channel in factors):
            return image
        return self.once(
            ("scaled", image, factors, raw), lambda: Image(image.linear(raw) * np.array(factors, np.float32))
        )

    def product(self, first: Image, second: Image, second_raw: bool = True) -> Image:
        """Two images of the same size, multiplied texel by texel; the first one is a colour."""
        return self.once(
            ("product", first, second, second_raw), lambda: Image(first.linear() * second.linear(second_raw))
        )

    def channel(self, image: Image, index: int) -> Image:
        """One channel as a number, to be read raw; grey images have the same value in all channels."""
        pixels = image.pixels
        if pixels.shape[2] == 1:
            return image
        return self.once(("channel", image, index), lambda: Image(np.ascontiguousarray(pixels[..., index, None])))

    def alpha(self, image: Image) -> Image | None:
        """The alpha as a number, to be read raw; None if the image is opaque."""
        return None if image.alpha is None else self.once(("alpha", image), lambda: Image(image.alpha))

    def threshold(self, number: Image, cutoff: float, factor: float = 1.0) -> Image:
        """An opacity that is 1 where `factor` times the interpolated number is at least `cutoff`, otherwise 0.

        The image holds a steep ramp that is not clamped: 1 at the cutoff, 0 at 1/65536 below it. Bilinear interpolation
        of a ramp is the ramp of the interpolated number, and Mitsuba 3 and isonoise clamp an opacity only after that;
        so the comparison is made after interpolation, as if by a rasteriser's alpha test.
        """

        def ramp() -> Image:
            number_minus_cutoff = factor * number.linear(raw=True).astype(np.float64) - cutoff
            return Image((1.0 + _THRESHOLD_GAIN * number_minus_cutoff).astype(np.float32))

        return self.once(("threshold", number, cutoff, factor), ramp)

    def normal_map(self, image: Image, matrix: tuple[tuple[float, float], tuple[float, float]]) -> Image:
        """A normal map whose first two components are multiplied by a 2 x 2 matrix.

        Bytes stay bytes if that only exchanges and negates components.
        """
        if matrix == ((1, 0), (0, 1)):
            return image

        def transformed() -> Image:
            pixels = np.broadcast_to(image.pixels, (*image.pixels.shape[:2], 3))
            factors = np.array(matrix)
            is_integer = pixels.dtype != np.float32 and sorted(map(abs, factors.ravel())) == [0, 0, 1, 1]
            if is_integer and np.linalg.det(factors):
                result, largest = pixels.copy(), np.iinfo(pixels.dtype).max
                for row, entries in enumerate(factors):
                    source = int(np.abs(entries).argmax())
                    result[..., row] = pixels[..., source] if entries[source] > 0 else largest - pixels[..., source]
                return Image(result)
            result = Image(pixels).linear(raw=True).copy()
            (a, b), (c, d) = factors.astype(np.float32)
            x, y = result[..., 0] - np.float32(0.5), result[..., 1] - np.float32(0.5)
            result[..., 0], result[..., 1] = 0.5 + (a * x + b * y), 0.5 + (c * x + d * y)
            return Image(result)

        return self.once(("normal map", image, matrix), transformed)

    def clipped(self, number: Image) -> Image:
        """A number, read raw, limited to [0, 1]: the opacity of `threshold` at the texels."""
        return self.once(("clipped", number), lambda: Image(np.clip(number.linear(raw=True), 0.0, 1.0)))

    def largest_channel(self, image: Image) -> Image:
        """The largest channel of each texel of a colour, as a number."""
        return self.once(
            ("largest channel", image), lambda: Image(np.ascontiguousarray(image.linear().max(axis=2, keepdims=True)))
        )

    def ratio(self, image: Image, divisor: Image, factor: float = 1.0) -> Image:
        """A colour over a number, times a factor; 0 where the number is 0."""

        def quotient() -> Image:
            below, above = divisor.linear(raw=True), image.linear() * np.float32(factor)
            return Image(np.divide(above, below, out=np.zeros_like(above), where=below > 0))

        return self.once(("ratio", image, divisor, factor), quotient)

    def constant(self, image: Image, raw: bool = False) -> np.ndarray | None:
        """The linear colour (3,) of an image all of whose texels are the same; otherwise None."""

        def colour() -> np.ndarray | None:
            first = image.pixels[:1, :1]
            is_constant = (image.pixels[0] == first).all() and (image.pixels == first).all()
            return np.broadcast_to(Image(first).linear(raw)[0, 0], 3).astype(np.float64) if is_constant else None

        return self.once(("constant", image, raw), colour)

    def mean(self, image: Image, raw: bool = False) -> np.ndarray:
        """The mean linear colour (3,) of an image."""
        return self.once(
            ("mean", image, raw),
            lambda: np.broadcast_to(image.linear(raw).mean(axis=(0, 1), dtype=np.float64), 3).copy(),
        )

    def texture(
        self, image: Image, raw: bool = False, sampling: Sampling = DEFAULT_SAMPLING, uv_bounds=UNIT_BOUNDS
    ) -> dict:
        """The texture that shows an image.

        Mitsuba 3 has one wrap mode for both axes. Where the axes differ, the image is extended by mirrored or repeated
        columns or rows, enough for a mesh whose texture coordinates are within `uv_bounds`: see `is_exact`.

        Parameters
        ----------
        image : the same object gives the same texture
        raw : integers are only scaled to [0, 1], not decoded from sRGB
        sampling : wrap modes, filter and the map from the mesh's coordinates
        uv_bounds : ((u low, u high), (v low, v high)) of the mesh's coordinates
        """
        if sampling.wrap_u == sampling.wrap_v:
            return self._texture(image, raw, sampling)
        bounds = sampling.image_bounds(uv_bounds)
        for axis, wrap in enumerate((sampling.wrap_u, sampling.wrap_v)):
            if wrap != REPEAT:
                image, sampling = self._extended(image, sampling, axis, wrap, bounds[axis])
        return self._texture(image, raw, sampling._replace(wrap_u=REPEAT, wrap_v=REPEAT))

    def is_exact(self, image: Image, sampling: Sampling, uv_bounds=UNIT_BOUNDS) -> bool:
        """Whether `texture` shows the image as the sampling says, inside `uv_bounds`."""
        if sampling.wrap_u == sampling.wrap_v:
            return True
        bounds = sampling.image_bounds(uv_bounds)
        sizes = image.pixels.shape[1::-1]
        return all(
            wrap != CLAMP or _padding(sizes[axis], bounds[axis]) <= _MAX_PADDING * sizes[axis] + 1
            for axis, wrap in enumerate((sampling.wrap_u, sampling.wrap_v))
        )

    def _texture(self, image: Image, raw: bool, sampling: Sampling) -> dict:
        def make() -> dict:
            texture = {
                "type": "bitmap",
                "bitmap": image,
                "raw": raw,
                "wrap_mode": sampling.wrap_u,
                "filter_type": sampling.filter_type,
            }
            if sampling.to_uv != DEFAULT_SAMPLING.to_uv:
                texture["to_uv"] = np.eye(4)
                texture["to_uv"][np.ix_([0, 1], [0, 1, 3])] = sampling.to_uv
            return texture

        return self.once(("texture", image, raw, sampling), make)

    def _extended(self, image: Image, sampling: Sampling, axis: int, wrap: str, bounds) -> tuple[Image, Sampling]:
        """An image, and how to read it, that repeats along an axis what the image mirrors or clamps there."""
        size = image.pixels.shape[1 - axis]
        if wrap == MIRROR:
            before, after = 0, size
        else:
            before = after = min(_padding(size, bounds), int(_MAX_PADDING * size) + 1)
        width = [(0, 0), (0, 0), (0, 0)]
        width[1 - axis] = (before, after)
        mode = "symmetric" if wrap == MIRROR else "edge"
        extended = self.once(("extended", image, axis, before, after, mode), lambda: _pad(image, width, mode))
        rows = [list(row) for row in sampling.to_uv]
        total = size + before + after
        rows[axis] = [entry * size / total for entry in rows[axis]]
        rows[axis][2] += before / total
        return extended, sampling._replace(to_uv=(tuple(rows[0]), tuple(rows[1])))


def _padding(size: int, bounds) -> int:
    """Texels to add at each end, so that clamped coordinates within `bounds` stay inside the image."""
    beyond = max(-bounds[0], bounds[1] - 1.0, 0.0)
    beyond = beyond if beyond < _MAX_BEYOND else _MAX_BEYOND  # also where huge transforms gave NaN
    return int(np.ceil(beyond * size)) + 1


def _pad(image: Image, width, mode: str) -> Image:
    return Image(np.pad(image.pixels, width, mode=mode))
