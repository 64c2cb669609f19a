"""Evaluates pbrt's textures while a scene is read, down to constants, images and checkerboards. Called by `read.py`.

Products, mixtures and inversions are computed texel by texel. v = 0 is the bottom row of an image in pbrt and the top
row in Mitsuba, so the maps of texture coordinates change.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isonoise.scene.formats.bitmaps import BILINEAR, CLAMP, NEAREST, REPEAT, Bitmaps, Sampling
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.pbrt.colours import Colours
from isonoise.scene.formats.pbrt.directives import Directive, find_file
from isonoise.scene.formats.pbrt.parameters import SPECTRUM_TYPES, Parameters
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.image.image import Image
from isonoise.scene.material.textures import SRGB

FLOAT, SPECTRUM = "float", "spectrum"
_PROCEDURAL = ("bilerp", "dots", "fbm", "marble", "windy", "wrinkled", "ptex", "directionmix", "uv")
_MAX_NESTING = 32  # textures in textures
_MAX_POINTWISE_TEXELS = 1 << 26


@dataclass(frozen=True, eq=False)
class ImageTexture:
    """An image and how it is read."""

    image: Image
    raw: bool
    sampling: Sampling


@dataclass(frozen=True, eq=False)
class Checkerboard:
    """Two textures in squares; `to_uv` as in Mitsuba 3."""

    first: "Texture"
    second: "Texture"
    to_uv: np.ndarray  # (4, 4)
    depth: int


Texture = np.ndarray | ImageTexture | Checkerboard
"""A texture; an array is a constant, linear RGB (3,)."""


class Textures:
    """The named textures of a scene. `base` and `folder` are those of `find_file`."""

    def __init__(self, base: Path, folder: Path | None, colours: Colours, report: ImportReport):
        self._base, self._folder, self._colours, self._report = base, folder, colours, report
        self._bitmaps = Bitmaps()
        self._by_name: dict[tuple[str, str], Texture] = {}  # (FLOAT or SPECTRUM, name)

    def define(self, directive: Directive) -> None:
        """Add the texture of a directive `Texture "name" "float|spectrum" "class"`."""
        name, type_, class_ = directive.arguments
        type_ = SPECTRUM if type_ == "color" else type_
        if type_ not in (FLOAT, SPECTRUM):
            directive.position.raise_error(f"a texture is of type 'float' or 'spectrum', got '{type_[:40]}'")
        self._by_name[type_, name] = self._evaluate(class_, directive.parameters, type_)

    def colour(self, parameters: Parameters, name: str, default: float) -> Texture:
        """A reflectance: a constant or a texture."""
        return self._read(parameters, name, SPECTRUM, np.full(3, default))

    def number(self, parameters: Parameters, name: str, default: float | None) -> Texture | None:
        """A number: a constant (three times the same) or a texture; None if it is absent and `default` is None."""
        return self._read(parameters, name, FLOAT, None if default is None else np.full(3, default))

    def mean(self, texture: Texture) -> np.ndarray:
        """Mean linear RGB (3,) over the texture."""
        if isinstance(texture, np.ndarray):
            return texture
        if isinstance(texture, Checkerboard):
            return 0.5 * (self.mean(texture.first) + self.mean(texture.second))
        linear = texture.image.linear(texture.raw)
        return np.broadcast_to(linear.mean(axis=(0, 1), dtype=np.float64), 3).copy()

    def map(self, name: str, function: Callable[..., np.ndarray], *textures: Texture, place: str = "") -> Texture:
        """Apply a function to the values of textures, channel by channel. `name` identifies the function.

        Images of different sizes or coordinates cannot be combined: all but the first are replaced by their means.
        """
        board = next((texture for texture in textures if isinstance(texture, Checkerboard)), None)
        if board is not None:
            branches = [
                self.map(name, function, *(side if t is board else t for t in textures), place=place)
                for side in (board.first, board.second)
            ]
            return Checkerboard(*branches, board.to_uv, 1 + max(map(_depth, branches)))
        images = [texture for texture in textures if isinstance(texture, ImageTexture)]
        if not images:
            return np.broadcast_to(function(*textures), 3).astype(np.float64)
        first = images[0]
        if any(not _fits(other, first) for other in images):
            self._report.limit("textures", "images of different size or coordinates are combined by their means", place)
            textures = [self.mean(t) if isinstance(t, ImageTexture) and not _fits(t, first) else t for t in textures]
        arrays = [self._values(texture) for texture in textures]
        key = ("pbrt", name, *((t.image, t.raw) if isinstance(t, ImageTexture) else tuple(t) for t in textures))
        with np.errstate(over="ignore", invalid="ignore"):  # pixels that are not finite are errors later
            image = self._bitmaps.once(key, lambda: Image(np.maximum(function(*arrays), 0).astype(np.float32)))
        return ImageTexture(image, False, first.sampling)

    def map_bytes(self, name: str, function: Callable[[np.ndarray], np.ndarray], texture: Texture) -> Texture:
        """Like `map`, for a function near the identity: images of bytes stay images of bytes, in sRGB."""
        is_bytes = isinstance(texture, ImageTexture) and texture.image.pixels.dtype == np.uint8 and not texture.raw
        if not is_bytes:
            return self.map(name, function, texture)
        midpoints = 0.5 * (SRGB[1:] + SRGB[:-1])
        table = np.searchsorted(midpoints, function(SRGB.astype(np.float64))).astype(np.uint8)
        image = self._bitmaps.once((name, texture.image), lambda: Image(table[texture.image.pixels]))
        return ImageTexture(image, False, texture.sampling)

    def to_colour(self, texture: Texture) -> dict:
        """The value of a colour parameter in a scene dict, at most 1."""
        if isinstance(texture, ImageTexture) and _exceeds_1(texture.image):
            texture = self.map("at most 1", lambda values: np.minimum(values, 1), texture)
        return self._to_dict(texture, lambda constant: rgb(np.clip(constant, 0, 1)))

    def to_unbounded(self, texture: Texture) -> dict:
        """The value of a colour parameter that may exceed 1, such as emission, in a scene dict."""
        return self._to_dict(texture, rgb)

    def to_number(self, texture: Texture) -> float | dict:
        """The value of a number parameter in a scene dict."""
        return self._to_dict(texture, lambda constant: float(constant.mean()))

    def _to_dict(self, texture: Texture, of_constant: Callable):
        if isinstance(texture, np.ndarray):
            return of_constant(texture)
        if isinstance(texture, ImageTexture):
            return self._bitmaps.texture(texture.image, texture.raw, texture.sampling)
        sides = [self._to_dict(side, of_constant) for side in (texture.first, texture.second)]
        key = ("checkerboard", texture, of_constant.__qualname__)
        return self._bitmaps.once(
            key, lambda: {"type": "checkerboard", "color0": sides[0], "color1": sides[1], "to_uv": texture.to_uv}
        )

    def read_image(self, parameters: Parameters, name: str) -> Image:
        """The image that a parameter names."""
        path = find_file(parameters.text(name), self._base, self._folder, parameters.position_of(name))
        return self._bitmaps.read(path)

    def normal_map(self, parameters: Parameters, name: str) -> dict:
        """The texture of normals that a parameter names."""
        return self._bitmaps.texture(self.read_image(parameters, name), raw=True)

    def scaled_image(self, image: Image, factor: np.ndarray, parameters: Parameters) -> Image:
        """The image of a light times a colour."""
        with np.errstate(over="ignore", invalid="ignore"):  # infinity times 0
            scaled = self._bitmaps.scaled(image, factor)
        if not np.isfinite(scaled.pixels).all():
            parameters.position.raise_error("the image of the light times its scale exceeds 32-bit floats")
        return scaled

    def _read(self, parameters: Parameters, name: str, type_: str, default: np.ndarray | None) -> Texture | None:
        if name not in parameters:
            return default
        value = parameters.find(name)
        if value.type in ("texture", "string") and value.is_texts:
            return self._find(value.values[0], type_, value.position)
        if type_ == FLOAT:
            return np.full(3, parameters.number(name, 0.0))
        value = parameters.find(name, "float", *SPECTRUM_TYPES)
        return self._colours.reflectance(value)

    def _find(self, name: str, type_: str, position) -> Texture:
        texture = self._by_name.get((type_, name))
        if texture is None:
            names = [other for kind, other in self._by_name if kind == type_]
            position.raise_unknown(f"there is no {type_} texture", name, names)
        return texture

    def _evaluate(self, class_: str, parameters: Parameters, type_: str) -> Texture:
        evaluate = {
            "constant": self._constant,
            "scale": self._scale,
            "mix": self._mix,
            "imagemap": self._image_map,
            "checkerboard": self._checkerboard,
        }.get(class_)
        if evaluate is not None:
            texture = evaluate(parameters, type_)
            if _depth(texture) > _MAX_NESTING:
                parameters.position.raise_error(f"checkerboards are nested more than {_MAX_NESTING} levels deep")
            return texture
        if class_ not in _PROCEDURAL:
            choices = ("constant", "scale", "mix", "imagemap", "checkerboard", *_PROCEDURAL)
            parameters.position.raise_unknown("unknown texture", class_, choices)
        self._report.limit("procedural_textures", f"'{class_}' is replaced by a constant", parameters.position.place)
        parameters.ignore(*(value.name for value in parameters.unused()))
        return self._substitute(class_, parameters, type_)

    def _substitute(self, class_: str, parameters: Parameters, type_: str) -> np.ndarray:
        """A constant in place of a procedural texture: the mean of its colours, otherwise 0.5."""
        names = {
            "bilerp": ("v00", "v01", "v10", "v11"),
            "dots": ("inside", "outside"),
            "directionmix": ("tex1", "tex2"),
        }
        given = [name for name in names.get(class_, ()) if name in parameters]
        means = [self.mean(self._read(parameters, name, type_, None)) for name in given]
        return np.mean(means, axis=0) if means else np.full(3, 0.5)

    def _constant(self, parameters: Parameters, type_: str) -> Texture:
        return self._read(parameters, "value", type_, np.ones(3))

    def _scale(self, parameters: Parameters, type_: str) -> Texture:
        """pbrt-v4: tex times scale, a number or a float texture. pbrt-v3: tex1 times tex2."""
        if "tex1" in parameters or "tex2" in parameters:
            factors = [self._read(parameters, name, type_, np.ones(3)) for name in ("tex1", "tex2")]
        else:
            factors = [self._read(parameters, "tex", type_, np.ones(3)), self.number(parameters, "scale", 1.0)]
        first, second = factors
        for factor, other in ((first, second), (second, first)):
            if isinstance(factor, np.ndarray) and (factor == 1).all():
                return other
        return self.map("product", lambda a, b: a * b, first, second, place=parameters.position.place)

    def _mix(self, parameters: Parameters, type_: str) -> Texture:
        first = self._read(parameters, "tex1", type_, np.zeros(3))
        second = self._read(parameters, "tex2", type_, np.ones(3))
        amount = self.number(parameters, "amount", 0.5)
        place = parameters.position.place
        return self.map("mix", lambda a, b, t: (1 - t) * a + t * b, first, second, amount, place=place)

    def _checkerboard(self, parameters: Parameters, type_: str) -> Texture:
        sides = [
            self._read(parameters, name, type_, np.full(3, default)) for name, default in (("tex1", 1.0), ("tex2", 0.0))
        ]
        parameters.ignore("aamode")
        if parameters.integer("dimension", 2) != 2:
            self._report.limit(
                "procedural_textures", "a checkerboard in space is replaced by its mean", parameters.position.place
            )
            self._uv_map(parameters)
            return 0.5 * (self.mean(sides[0]) + self.mean(sides[1]))
        self._report.use("procedural_textures")
        (u_scale, u_delta), (v_scale, v_delta) = self._uv_map(parameters)
        to_uv = np.eye(4)  # Mitsuba's squares have side 0.5, pbrt's 1
        to_uv[0, [0, 3]] = 0.5 * u_scale, 0.5 * u_delta
        to_uv[1, [1, 3]] = -0.5 * v_scale, 0.5 * (v_delta + v_scale)
        return Checkerboard(*sides, to_uv, 1 + max(map(_depth, sides)))

    def _uv_map(self, parameters: Parameters) -> tuple[tuple[float, float], tuple[float, float]]:
        """((u scale, u offset), (v scale, v offset)) of a texture."""
        if parameters.text("mapping", "uv") != "uv":
            parameters.ignore("v1", "v2")
            self._report.limit(
                "texture_transform",
                f"the mapping '{parameters.text('mapping')}' is replaced by the texture coordinates of the shape",
                parameters.position.place,
            )
        numbers = [parameters.number(name, default) for name, default in _UV_PARAMETERS]
        if numbers != [default for _, default in _UV_PARAMETERS]:
            self._report.use("texture_transform")
        return (numbers[0], numbers[1]), (numbers[2], numbers[3])

    def _image_map(self, parameters: Parameters, type_: str) -> Texture:
        if "filename" not in parameters:
            parameters.position.raise_error('an imagemap needs "string filename"')
        image = self.read_image(parameters, "filename")
        self._report.use("textures")
        encoding = parameters.text("encoding")
        if encoding is None:
            encoding = "sRGB" if parameters.boolean("gamma", True) else "linear"
        parameters.ignore("maxanisotropy", "trilinear")
        image, is_raw = self._decode(image, encoding, type_, parameters)
        texture = ImageTexture(image, is_raw, self._sampling(parameters))
        scale = parameters.number("scale", 1.0)
        if parameters.boolean("invert", False):
            return self.map(f"inverted {scale}", lambda values: 1 - scale * values, texture)
        return texture if scale == 1 else self.map(f"scaled {scale}", lambda values: scale * values, texture)

    def _decode(self, image: Image, encoding: str, type_: str, parameters: Parameters) -> tuple[Image, bool]:
        """The image of a texture, and whether it is read raw.

        A float texture reads alpha if the image has one, otherwise the mean of the channels (pbrt-v4, `MIPMap`).
        """
        alpha = self._bitmaps.alpha(image)
        if type_ == FLOAT and alpha is not None and _is_transparent(alpha):
            return alpha, True
        name, *numbers = encoding.split() or [""]
        raw = name == "linear"
        if name not in ("sRGB", "linear", "gamma") or len(numbers) != (name == "gamma"):
            parameters.position_of("encoding").raise_error(
                f"the encoding is 'sRGB', 'linear' or 'gamma' with a number, got '{encoding[:40]}'"
            )
        if name == "gamma" and image.pixels.dtype != np.float32:
            exponent = _to_exponent(numbers[0], parameters)
            key = ("gamma", image, exponent)
            image = self._bitmaps.once(key, lambda: Image(image.linear(raw=True) ** np.float32(exponent)))
        if type_ == FLOAT and image.pixels.shape[2] == 3:
            key = ("mean of channels", image, raw)
            image = self._bitmaps.once(key, lambda: Image(image.linear(raw).mean(axis=2, keepdims=True)))
        return image, raw

    def _sampling(self, parameters: Parameters) -> Sampling:
        wrap = parameters.text("wrap", "repeat")
        if wrap not in ("repeat", "clamp", "black", "octahedralsphere"):
            parameters.position_of("wrap").raise_error(f"unknown wrap mode '{wrap[:40]}': use repeat, clamp or black")
        if wrap in ("black", "octahedralsphere"):
            self._report.limit("texture_sampler", f"wrap '{wrap}' is replaced by 'clamp'", parameters.position.place)
        (u_scale, u_delta), (v_scale, v_delta) = self._uv_map(parameters)
        filter_type = NEAREST if parameters.text("filter", "bilinear") == "point" else BILINEAR
        wrap_mode = REPEAT if wrap == "repeat" else CLAMP
        to_uv = ((u_scale, 0.0, u_delta), (0.0, v_scale, 1.0 - v_scale - v_delta))
        return Sampling(wrap_mode, wrap_mode, filter_type, to_uv)

    def _values(self, texture: np.ndarray | ImageTexture) -> np.ndarray:
        """Linear values: (3,), or (height, width, 1 or 3)."""
        if isinstance(texture, np.ndarray):
            return texture.astype(np.float32)
        if texture.image.pixels.size > 3 * _MAX_POINTWISE_TEXELS:
            self._report.limit("textures", "a very large image is combined by its mean")
            return self.mean(texture).astype(np.float32)
        return texture.image.linear(texture.raw)


_UV_PARAMETERS = (("uscale", 1.0), ("udelta", 0.0), ("vscale", 1.0), ("vdelta", 0.0))


def _depth(texture: Texture) -> int:
    return texture.depth if isinstance(texture, Checkerboard) else 0


def _exceeds_1(image: Image) -> bool:
    return image.pixels.dtype == np.float32 and image.pixels.max(initial=0) > 1


def _fits(texture: ImageTexture, other: ImageTexture) -> bool:
    """Whether two images have the same texels at the same coordinates."""
    return texture.image.pixels.shape[:2] == other.image.pixels.shape[:2] and texture.sampling == other.sampling


def _is_transparent(alpha: Image) -> bool:
    full = 1.0 if alpha.pixels.dtype == np.float32 else np.iinfo(alpha.pixels.dtype).max
    return bool((alpha.pixels != full).any())


def _to_exponent(text: str, parameters: Parameters) -> float:
    try:
        exponent = float(text)
    except ValueError:
        exponent = 0.0
    if not 0.01 <= exponent <= 100:
        parameters.position_of("encoding").raise_error(f"gamma has to be 0.01 to 100, got '{text[:40]}'")
    return exponent
