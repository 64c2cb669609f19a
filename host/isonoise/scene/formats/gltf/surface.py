"""What a glTF material becomes on a primitive, and how the modules that map it read the material's values.

Used by `materials.py` and the modules that it calls.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.textures import MaterialTexture, SurfaceTextures
from isonoise.scene.formats.report import ImportReport

_MAX_HUE_SPREAD = 2e-3  # half a step of 8-bit colours


class VertexColours(NamedTuple):
    """What the colours of a primitive's vertices have in common."""

    mean: tuple[float, float, float]
    is_constant: bool = False
    has_one_hue: bool = False  # each one is a multiple of the mean


def describe_vertex_colours(colours: np.ndarray) -> VertexColours:
    """Of (n, 3) linear colours."""
    mean = colours.mean(axis=0, dtype=np.float64)
    spread = np.abs(np.cross(colours, mean / max(mean.max(), 1e-9))).max(initial=0.0)  # 0 for multiples of the mean
    is_constant = not np.ptp(colours, axis=0).any() if len(colours) else True
    return VertexColours(tuple(mean.tolist()), bool(is_constant), bool(spread <= _MAX_HUE_SPREAD))


@dataclass(frozen=True)
class PrimitiveInfo:
    """What the surface of a primitive depends on besides its material."""

    uv_sets: int = 0  # TEXCOORD_0, ...
    vertex_colours: VertexColours | None = None  # of the attribute vertex_color, linear
    has_vertex_alpha: bool = False  # an attribute vertex_alpha
    has_mirrored_uvs: bool = False  # see `primitives.py`: t = n x s points down in the image
    has_tangents: bool = False  # in the file; they belong to its coordinates before texture transforms
    uv_bounds: tuple = ()  # of each set: ((u low, u high), (v low, v high))


@dataclass(frozen=True)
class Surface:
    """The surface of a primitive as parts of a shape's dict."""

    bsdf: dict
    emission: dict | None = None  # of an `area` emitter: {'type': 'area', ...}
    uv_set: int = 0
    needs_vertex_colours: bool = False  # attributes vertex_color times `vertex_colour_factor`, and vertex_alpha
    vertex_colour_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    interior_medium: dict | None = None
    uses_tangents: bool = False  # it depends on the directions of u and v: `has_mirrored_uvs` matters
    emits_from_both_sides: bool = False  # the file says so; an `area` emitter does not


@dataclass(frozen=True)
class Material:
    """A material of the file with its textures."""

    values: JsonObject
    textures: dict[str, MaterialTexture]  # by the name in the file, such as 'baseColorTexture'

    @property
    def place(self) -> str:
        """For warnings: index and name."""
        name = self.values.string("name", "")
        return f"{self.values.place} '{name}'" if name else self.values.place

    def part(self, name: str) -> JsonObject | None:
        """The material itself for '', its metallic-roughness model, or an extension; None if it has none."""
        if not name:
            return self.values
        return self.values.object(name) if name == "pbrMetallicRoughness" else self.values.extension(name)

    def factor(self, part: str, name: str, default: float) -> float:
        """A number of a part; `default` also if the part is missing."""
        owner = self.part(part)
        return owner.number(name, default) if owner else default

    def factors(self, part: str, name: str, count: int, default: float) -> tuple[float, ...]:
        """Numbers of a part, such as a colour."""
        owner = self.part(part)
        return owner.numbers(name, count, (default,) * count) if owner else (default,) * count


@dataclass(frozen=True)
class SurfaceContext:
    """A material on a primitive: the source of all parameters of its BSDFs."""

    material: Material
    primitive: PrimitiveInfo
    parameters: SurfaceTextures
    report: ImportReport

    def texture(self, name: str) -> MaterialTexture | None:
        """A texture of the material by its name in the file."""
        return self.material.textures.get(name)

    def number(self, part: str, name: str, default: float, texture: str = "", channel: int = 0) -> float | dict:
        """A number in [0, 1] or a texture of them: a factor times a channel of a texture."""
        return self.parameters.number(self.texture(texture), channel, self.material.factor(part, name, default))

    def colour(self, part: str, name: str, default: float, texture: str) -> dict:
        """A colour or a texture of them: factors times a texture."""
        return self.parameters.colour(self.texture(texture), self.material.factors(part, name, 3, default))

    def limit(self, feature: str, problem: str) -> None:
        """Report what is lost of this material."""
        self.report.limit(feature, problem, self.material.place)


def blend(weight: float | dict, first: dict, second: dict) -> dict:
    """The second BSDF with the share `weight`, the first one with the rest."""
    if weight == 0 or first is second:
        return first
    return second if weight == 1 else {"type": "blendbsdf", "weight": weight, "bsdf": first, "bsdf_1": second}


def two_sided(bsdf: dict) -> dict:
    """The same BSDF on both sides."""
    return {"type": "twosided", "bsdf": bsdf}
