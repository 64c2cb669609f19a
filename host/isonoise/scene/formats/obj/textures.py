"""Turns the texture statements of MTL files into textures. Called by `materials.py`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.formats.bitmaps import CLAMP, REPEAT, Bitmaps, Sampling
from isonoise.scene.formats.named_files import find_file
from isonoise.scene.formats.obj.mtl import TextureMap
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image
from isonoise.scene.spectra import MITSUBA_LUMINANCE

_CHANNELS = {"r": 0, "g": 1, "b": 2}
_NORMAL_MAP_MEAN = np.array([0.5, 0.5, 1.0])
_MAX_NORMAL_MAP_DEVIATION = np.array([0.12, 0.12, 0.35])


class Textures:
    """The textures of an OBJ file. Equal statements give one object."""

    def __init__(self, path: Path, folder: Path | None, report: ImportReport):
        self.path, self.folder, self.report = path, folder, report
        self.bitmaps = Bitmaps()
        self._images: dict[tuple[str, str], Image | None] = {}

    def image(self, texture: TextureMap) -> Image | None:
        """The image of a statement; None, and a warning, if it is missing or cannot be read."""
        key = texture.location.file, texture.file
        if key not in self._images:
            self._images[key] = self._read(texture)
        return self._images[key]

    def _read(self, texture: TextureMap) -> Image | None:
        sources = (Path(texture.location.file), self.path)
        file = next((file for source in sources if (file := find_file(source, texture.file, self.folder))), None)
        self.report.use("textures")
        if file is None:
            self.report.limit("textures", "there is no such file: its material is shown without it", texture.file)
            return None
        try:
            return self.bitmaps.read(file)
        except SceneError as error:
            reason = str(error).removeprefix(f"{file}: ")
            self.report.limit("textures", f"{reason}: its material is shown without it", texture.file)
            return None

    def colour(self, texture: TextureMap | None, factor) -> dict | None:
        """A colour times the image of a statement; None without an image."""
        if texture is None or (image := self.image(texture)) is None:
            return None
        image = self._with_gain(texture, image, raw=False)
        return self.bitmaps.texture(self.bitmaps.scaled(image, factor), sampling=self.sampling(texture))

    def number(
        self, texture: TextureMap | None, key: str = "", convert: Callable | None = None, use_alpha: bool = False
    ) -> dict | None:
        """The numbers of an image, changed by a function of arrays that `key` identifies; None without an image.

        `use_alpha`: take the alpha instead of the colour, where an image has one.
        """
        if texture is None or (image := self.image(texture)) is None:
            return None
        image = self._with_gain(texture, self._channel(texture, image, use_alpha), raw=True)
        if convert is not None:
            original = image
            image = self.bitmaps.once((key, original), lambda: _converted(original, convert))
        return self.bitmaps.texture(image, raw=True, sampling=self.sampling(texture))

    def _channel(self, texture: TextureMap, image: Image, use_alpha: bool) -> Image:
        channel = texture.options.get("imfchan", ["m" if use_alpha else "l"])[0].lower()
        if channel in _CHANNELS:
            return self.bitmaps.channel(image, _CHANNELS[channel])
        alpha = self.bitmaps.alpha(image) if channel == "m" else None
        return image if alpha is None else alpha

    def _with_gain(self, texture: TextureMap, image: Image, raw: bool) -> Image:
        """The image after the option -mm: base + gain * value."""
        base, gain = texture.numbers("mm", (0.0, 1.0))
        if (base, gain) == (0.0, 1.0):
            return image
        return self.bitmaps.once(
            ("mm", image, base, gain, raw),
            lambda: Image(np.maximum(base + gain * image.linear(raw), 0.0).astype(np.float32)),
        )

    def sampling(self, texture: TextureMap) -> Sampling:
        """How a statement's image is repeated, scaled (-s) and shifted (-o)."""
        scale, offset = texture.numbers("s", (1.0, 1.0, 1.0)), texture.numbers("o", (0.0, 0.0, 0.0))
        if texture.numbers("t", (0.0, 0.0, 0.0)).any():
            self.report.limit("texture_transform", "turbulence (-t) is left out", texture.file)
        if (scale[:2] != 1).any() or offset[:2].any():
            self.report.use("texture_transform")
        wrap = CLAMP if texture.options.get("clamp") == ["on"] else REPEAT
        if wrap == CLAMP:
            self.report.use("texture_sampler")
        # v is 1 - v of the file: 1 - (scale v + offset) = scale (1 - v) + 1 - scale - offset
        rows = ((scale[0], 0.0, offset[0]), (0.0, scale[1], 1.0 - scale[1] - offset[1]))
        return Sampling(wrap, wrap, to_uv=tuple(tuple(map(float, row)) for row in rows))

    def is_normal_map(self, texture: TextureMap) -> bool:
        """Whether an image, given as a bump map, contains normals instead of heights: exporters write both so."""
        image = self.image(texture)
        if image is None or image.pixels.shape[2] != 3:
            return False
        mean = self.bitmaps.mean(image, raw=True)
        return bool((np.abs(mean - _NORMAL_MAP_MEAN) < _MAX_NORMAL_MAP_DEVIATION).all())


def _converted(image: Image, convert: Callable) -> Image:
    values = image.linear(raw=True)
    if values.shape[2] == 3:
        values = (values @ MITSUBA_LUMINANCE)[..., None]
    return Image(np.asarray(convert(values), np.float32))
