"""Reads the textures of glTF materials: images, samplers and texture transforms. Called by `materials.py`.

Formats: glTF 2.0 sections 3.8 and 5.26 to 5.30; KHR_texture_transform.
"""

import math
from dataclasses import dataclass

import numpy as np

from isonoise.scene.formats.bitmaps import (
    BILINEAR,
    CLAMP,
    DEFAULT_SAMPLING,
    MIRROR,
    NEAREST,
    REPEAT,
    Bitmaps,
    Sampling,
)
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image, decode_image

_WRAP_MODES = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}
_NEAREST_FILTER = 9728
_SOURCES = ("EXT_texture_webp",)  # extensions that name images which can be decoded
_UNSUPPORTED_SOURCES = {"KHR_texture_basisu": "KTX2", "MSFT_texture_dds": "DDS", "EXT_texture_avif": "AVIF"}
_MAX_UV_SETS = 8
_MAX_NORMAL_SCALE = 1e6  # normals are horizontal long before; products stay within 32-bit floats


@dataclass(frozen=True, eq=False)
class MaterialTexture:
    """A texture as a material uses it."""

    image: Image
    sampling: Sampling
    uv_set: int
    place: str
    scale: float  # of normal maps


class MaterialTextures:
    """Reads the textures of materials; an image is decoded once."""

    def __init__(self, document: Document, report: ImportReport):
        self.bitmaps = Bitmaps()
        self._document, self._report = document, report

    def read(self, owner: JsonObject | None, name: str) -> MaterialTexture | None:
        """The texture that an object of a material names; None if there is none or it cannot be decoded."""
        info = owner.object(name) if owner else None
        if info is None:
            return None
        texture = self._document.get("textures", info.integer("index"), info, "index")
        image = self._image(texture)
        if image is None:
            return None
        self._report.use("textures", info.place)
        transform = info.extension("KHR_texture_transform")
        uv_set = info.integer("texCoord", 0, high=_MAX_UV_SETS)
        sampling = self._sampling(texture)
        if transform:
            self._report.use("texture_transform", info.place)
            uv_set = transform.integer("texCoord", uv_set, high=_MAX_UV_SETS)
            sampling = sampling._replace(to_uv=_transform_rows(transform))
        scale = min(max(info.number("scale", 1.0), -_MAX_NORMAL_SCALE), _MAX_NORMAL_SCALE)
        return MaterialTexture(image, sampling, uv_set, info.place, scale)

    def _image(self, texture: JsonObject) -> Image | None:
        for extension in map(texture.extension, _SOURCES):
            if extension:
                return self._decode(self._document.referenced(extension, "source", "images"))
        source = self._document.referenced(texture, "source", "images")
        if source:
            return self._decode(source)
        title = next((title for name, title in _UNSUPPORTED_SOURCES.items() if texture.extension(name)), "")
        problem = f"its image is {title}, which is not supported: convert it to PNG" if title else "it has no image"
        self._report.limit("textures", problem, texture.place)
        return None

    def _decode(self, image: JsonObject) -> Image:
        name = f"{image.file}: {image.place}"
        return self.bitmaps.once(
            ("image", image.place), lambda: decode_image(self._document.image_bytes(image), name, with_alpha=True)
        )

    def _sampling(self, texture: JsonObject) -> Sampling:
        sampler = self._document.referenced(texture, "sampler", "samplers")
        if sampler is None:
            return DEFAULT_SAMPLING
        wraps = []
        for name in ("wrapS", "wrapT"):
            mode = sampler.integer(name, 10497)
            if mode not in _WRAP_MODES:
                sampler.fail(name, f"it has to be 33071, 33648 or 10497, got {mode}")
            wraps.append(_WRAP_MODES[mode])
        filter_type = NEAREST if sampler.integer("magFilter", 0) == _NEAREST_FILTER else BILINEAR
        sampling = Sampling(*wraps, filter_type)
        if sampling != DEFAULT_SAMPLING:
            self._report.use("texture_sampler", sampler.place)
        return sampling


def _transform_rows(transform: JsonObject) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The affine map of KHR_texture_transform: scale, then rotate counter-clockwise as seen in the image, then move."""
    angle = transform.number("rotation", 0.0)
    (scale_u, scale_v), (offset_u, offset_v) = (
        transform.numbers(name, 2, default) for name, default in (("scale", (1.0, 1.0)), ("offset", (0.0, 0.0)))
    )
    cos, sin = math.cos(angle), math.sin(angle)
    return (cos * scale_u, sin * scale_v, offset_u), (-sin * scale_u, cos * scale_v, offset_v)


class SurfaceTextures:
    """Makes parameters of BSDFs from factors and textures, for a primitive that shows one set of coordinates."""

    def __init__(self, bitmaps: Bitmaps, report: ImportReport, uv_set: int, uv_set_count: int, uv_bounds):
        self.bitmaps, self._report = bitmaps, report
        self._uv_set, self._uv_set_count, self._uv_bounds = uv_set, uv_set_count, uv_bounds

    def colour(self, texture: MaterialTexture | None, factor, maximum: float = 1.0) -> dict:
        """A colour: linear factors (3,), limited to [0, maximum], times a texture in sRGB, if there is one."""
        factor = np.clip(factor, 0.0, maximum)
        if texture is None:
            return rgb(factor)
        constant = self._constant(texture, texture.image, raw=False)
        if constant is not None:
            return rgb(np.minimum(constant * factor, maximum))
        return self.show(texture, self.bitmaps.scaled(texture.image, factor), raw=False)

    def times(self, colour: dict, factor: float) -> dict:
        """A colour of `colour`, or vertex colours, times a factor in [0, 1]."""
        if factor == 1:
            return colour
        if colour["type"] == "rgb":
            return rgb(np.multiply(colour["value"], factor))
        if colour["type"] == "mesh_attribute":
            return colour | {"scale": factor}
        return colour | {"bitmap": self.bitmaps.scaled(colour["bitmap"], factor)}

    def number(self, texture: MaterialTexture | None, channel: int, factor: float) -> float | dict:
        """A number in [0, 1]: a factor times a channel of a linear texture, 3 for alpha, if there is one."""
        factor = min(max(factor, 0.0), 1.0)
        image = self.channel(texture, channel)
        if image is None or factor == 0:
            return factor
        constant = self._constant(texture, image, raw=True)
        if constant is not None:
            return min(max(float(constant[0]) * factor, 0.0), 1.0)
        return self.show(texture, self.bitmaps.scaled(image, factor, raw=True), raw=True)

    def channel(self, texture: MaterialTexture | None, channel: int) -> Image | None:
        """A channel of a texture, 3 for alpha, as an image to be read raw; None stands for 1."""
        if texture is None:
            return None
        return self.bitmaps.alpha(texture.image) if channel == 3 else self.bitmaps.channel(texture.image, channel)

    def show(self, texture: MaterialTexture, image: Image, raw: bool) -> dict:
        """The `bitmap` that shows an image with the sampling of a texture."""
        if not self.bitmaps.is_exact(image, texture.sampling, self._uv_bounds):
            self._report.limit("texture_sampler", "clamping along one axis ends far from the image", texture.place)
        return self.bitmaps.texture(image, raw, texture.sampling, self._uv_bounds)

    def is_shown(self, texture: MaterialTexture) -> bool:
        """Whether the primitive shows the texture: it has the texture's coordinates, and no other set goes first."""
        return texture.uv_set == self._uv_set and self._uv_set < self._uv_set_count

    def _constant(self, texture: MaterialTexture, image: Image, raw: bool) -> np.ndarray | None:
        """The colour of an image that has only one, or its mean if the primitive cannot show it; otherwise None."""
        constant = self.bitmaps.constant(image, raw)
        if constant is not None or self.is_shown(texture):
            return constant
        if texture.uv_set >= self._uv_set_count:
            self._report.limit("uvs", f"TEXCOORD_{texture.uv_set} is missing: the image's mean is used", texture.place)
        else:
            problem = f"a mesh keeps one set, TEXCOORD_{self._uv_set}: of the others, the image's mean is used"
            self._report.limit("uv_sets", problem, texture.place)
        return self.bitmaps.mean(image, raw)
