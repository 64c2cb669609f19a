"""Maps the materials of a glTF file to Mitsuba 3's vocabulary. Called by `nodes.py` for every primitive."""

from dataclasses import dataclass

from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.report import ImportReport


@dataclass(frozen=True)
class PrimitiveInfo:
    """What the surface of a primitive depends on besides its material."""

    uv_sets: int = 0  # TEXCOORD_0, ...
    has_vertex_colours: bool = False
    has_vertex_alpha: bool = False  # and an attribute vertex_alpha
    has_mirrored_uvs: bool = False  # see `nodes.py`: t = n x s points down in the image


@dataclass(frozen=True)
class Surface:
    """The surface of a primitive as parts of a shape's dict."""

    bsdf: dict
    emission: dict | None = None  # of an `area` emitter: {'type': 'area', ...}
    uv_set: int = 0
    needs_vertex_colours: bool = False  # attributes vertex_color (linear) and vertex_alpha
    interior_medium: dict | None = None
    uses_tangents: bool = False  # it depends on the directions of u and v: `has_mirrored_uvs` matters


class Materials:
    """The surfaces of a file's materials. Equal surfaces are the same object."""

    def __init__(self, document: Document, report: ImportReport):
        self.document, self.report = document, report
        self._surfaces: dict[tuple[int | None, PrimitiveInfo], Surface] = {}

    def surface(self, index: int | None, primitive: PrimitiveInfo) -> Surface:
        """The surface of a primitive with the material of this index; None is the default material."""
        for image in self.document.all("images"):
            self.document.image_bytes(image)
        key = index, primitive
        if key not in self._surfaces:
            self._surfaces[key] = self._make_surface(index)
        return self._surfaces[key]

    def _make_surface(self, index: int | None) -> Surface:
        if index is None:
            return Surface({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 1.0}})
        material = self.document.all("materials")[index]
        pbr = material.object("pbrMetallicRoughness")
        base = pbr.numbers("baseColorFactor", 4, (1.0,) * 4)[:3] if pbr else (1.0,) * 3
        emissive = material.numbers("emissiveFactor", 3, (0.0,) * 3)
        reflectance = rgb(min(max(value, 0.0), 1.0) for value in base)
        emission = {"type": "area", "radiance": rgb(max(value, 0.0) for value in emissive)}
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
        return Surface(bsdf, emission if max(emissive) > 0 else None)
