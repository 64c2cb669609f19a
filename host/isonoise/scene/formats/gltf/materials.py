"""Maps the materials of a glTF file to Mitsuba 3's vocabulary. Called by `shapes.py` for every primitive.

Formats: glTF 2.0 section 3.9 and appendix B, and the extensions KHR_materials_*.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from isonoise.scene.formats.bitmaps import UNIT_BOUNDS
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.layers import add_clearcoat, add_normal_map, add_sheen
from isonoise.scene.formats.gltf.opacity import add_opacity, emission, emitter
from isonoise.scene.formats.gltf.specular_glossiness import as_metallic_roughness
from isonoise.scene.formats.gltf.surface import (
    Material,
    PrimitiveInfo,
    Surface,
    SurfaceContext,
    blend,
)
from isonoise.scene.formats.gltf.textures import MaterialTextures, SurfaceTextures
from isonoise.scene.formats.gltf.transmission import (
    base_layer,
    interior_medium,
    is_solid_glass,
    is_transmissive,
)
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.spectra import MITSUBA_LUMINANCE

_PBR = "pbrMetallicRoughness"
_TEXTURES = {
    _PBR: ("baseColorTexture", "metallicRoughnessTexture"),
    "": ("normalTexture", "emissiveTexture"),
    "KHR_materials_transmission": ("transmissionTexture",),
    "KHR_materials_diffuse_transmission": ("diffuseTransmissionTexture", "diffuseTransmissionColorTexture"),
    "KHR_materials_clearcoat": ("clearcoatTexture", "clearcoatRoughnessTexture", "clearcoatNormalTexture"),
    "KHR_materials_specular": ("specularTexture", "specularColorTexture"),
    "KHR_materials_sheen": ("sheenColorTexture", "sheenRoughnessTexture"),
    "KHR_materials_anisotropy": ("anisotropyTexture",),
}
"""By the object that holds them. The first one that a primitive can show decides which set of coordinates it keeps."""

_EXTENSIONS = {
    "KHR_materials_ior": ("specular", ""),
    "KHR_materials_specular": ("specular", ""),
    "KHR_materials_emissive_strength": ("emission", ""),
    "KHR_materials_unlit": ("unlit", ""),
    "KHR_materials_transmission": ("transmission", "transmissionFactor"),
    "KHR_materials_diffuse_transmission": ("transmission", "diffuseTransmissionFactor"),
    "KHR_materials_volume": ("volume", "thicknessFactor"),
    "KHR_materials_clearcoat": ("clearcoat", "clearcoatFactor"),
    "KHR_materials_sheen": ("sheen", "sheenColorFactor"),
    "KHR_materials_anisotropy": ("anisotropy", "anisotropyStrength"),
    "KHR_materials_iridescence": ("iridescence", "iridescenceFactor"),
    "KHR_materials_dispersion": ("dispersion", "dispersion"),
}
"""Extension -> (feature, the value that has to be above 0 for it to have an effect)."""

_BLACK = {"type": "rgb", "value": [0.0, 0.0, 0.0]}


class Materials:
    """The surfaces of a file's materials. Equal surfaces are the same object."""

    def __init__(self, document: Document, report: ImportReport):
        self.document, self.report = document, report
        self._textures = MaterialTextures(document, report)
        for kind in ("materials", "images"):
            if document.all(kind):
                report.count(kind, len(document.all(kind)))
        self._materials: dict[int | None, Material] = {}
        self._surfaces: dict[tuple[int | None, PrimitiveInfo], Surface] = {}
        self._surface_counts: Counter[int | None] = Counter()  # of each material

    def surface(self, index: int | None, primitive: PrimitiveInfo) -> Surface:
        """The surface of a primitive with the material of this index; None is the default material."""
        if index not in self._materials:
            self._materials[index] = self._read(index)
        material = self._materials[index]
        if not _uses_tangents(material):
            primitive = replace(primitive, has_mirrored_uvs=False, has_tangents=False)
        if all(texture.sampling.wrap_u == texture.sampling.wrap_v for texture in material.textures.values()):
            primitive = replace(primitive, uv_bounds=())
        key = index, primitive
        if key not in self._surfaces:
            surface = self._make_surface(material, primitive)
            if name := material.values.string("name", ""):  # another surface of this material gets another id
                number = self._surface_counts[index]
                variant = f"#{number}" if number else ""
                surface = replace(surface, bsdf={**surface.bsdf, "id": f"material_{index}{variant}: {name}"})
            self._surfaces[key] = surface
            self._surface_counts[index] += 1
        return self._surfaces[key]

    def _read(self, index: int | None) -> Material:
        if index is None:
            values = JsonObject(self.document.root.file, "the default material", {})
        else:
            values = self.document.all("materials")[index]
        material = Material(values, {})
        for holder, names in _TEXTURES.items():
            found = {name: self._textures.read(material.part(holder), name) for name in names}
            material.textures.update({name: texture for name, texture in found.items() if texture})
        material = as_metallic_roughness(material, self._textures, self.report)
        _report_features(material, self.report)
        return material

    def _make_surface(self, material: Material, primitive: PrimitiveInfo) -> Surface:
        sets = [texture.uv_set for texture in material.textures.values()]
        uv_set = next((number for number in sets if number < primitive.uv_sets), 0)
        bounds = primitive.uv_bounds[uv_set] if primitive.uv_bounds else UNIT_BOUNDS
        parameters = SurfaceTextures(self._textures.bitmaps, self.report, uv_set, primitive.uv_sets, bounds)
        context = SurfaceContext(material, primitive, parameters, self.report)
        colour, weight, factor = _base_colour(context)
        surface = _unlit(context, colour, weight) if _is_unlit(material) else _lit(context, colour, weight)
        return replace(
            surface,
            bsdf=add_opacity(context, surface.bsdf),
            uv_set=uv_set,
            needs_vertex_colours=factor is not None or primitive.has_vertex_alpha,
            vertex_colour_factor=factor or (1.0, 1.0, 1.0),
            uses_tangents=_uses_tangents(material),
            emits_from_both_sides=surface.emission is not None and material.values.boolean("doubleSided", False),
        )


def _lit(context: SurfaceContext, colour: dict, weight: dict | None) -> Surface:
    def build(factor: float = 1.0, **changes) -> dict:
        base = base_layer(context, context.parameters.times(colour, factor), **changes)
        if weight is not None:  # every lobe is an affine function of the base colour
            base = blend(weight, base_layer(context, _BLACK, **changes), base)
        return add_normal_map(context, add_sheen(context, base))

    if is_solid_glass(context):
        bsdf = build()
        if context.material.factor("KHR_materials_clearcoat", "clearcoatFactor", 0.0) > 0:
            context.limit("clearcoat", "on glass with a volume it is left out")
    else:
        bsdf = add_clearcoat(context, build, is_transmissive(context))
    return Surface(bsdf, emission(context), interior_medium=interior_medium(context))


def _unlit(context: SurfaceContext, colour: dict, weight: dict | None) -> Surface:
    """A black surface that emits the base colour."""
    context.limit("unlit", "they emit their colour, so they also light what is around them")
    if weight is not None:
        context.limit("vertex_colours", "over the texture of an unlit material they are left out")
    return Surface({"type": "diffuse", "reflectance": _BLACK}, emitter(context, "baseColorTexture", colour))


def _base_colour(context: SurfaceContext) -> tuple[dict, dict | None, tuple[float, float, float] | None]:
    """(base colour, weight of it against black or None, factor on the attribute vertex_color or None if unused).

    A texture and vertex colours cannot be multiplied. A blend with black by the luminance of the vertex colours is the
    same as far as these are multiples of one colour.
    """
    texture, colours = context.texture("baseColorTexture"), context.primitive.vertex_colours
    factors = np.array(context.material.factors(_PBR, "baseColorFactor", 4, 1.0)[:3])
    if colours is None or colours.is_constant:
        return context.parameters.colour(texture, factors * (colours.mean if colours else 1.0)), None, None
    colour = context.parameters.colour(texture, factors)
    if colour["type"] == "rgb":
        attribute = {"type": "mesh_attribute", "name": "vertex_color"}
        return attribute, None, tuple(colour["value"])
    if not colours.has_one_hue:
        context.limit("vertex_colours", "over a texture, only their luminance varies: the mean of their hue is used")
    hue = np.array(colours.mean) / max(colours.mean) if max(colours.mean) > 0 else np.ones(3)
    weight = {"type": "mesh_attribute", "name": "vertex_color", "scale": 1.0 / float(hue @ MITSUBA_LUMINANCE)}
    return context.parameters.colour(texture, factors * hue), weight, (1.0, 1.0, 1.0)


def _is_unlit(material: Material) -> bool:
    return material.part("KHR_materials_unlit") is not None


def _uses_tangents(material: Material) -> bool:
    is_bumped = not material.textures.keys().isdisjoint({"normalTexture", "clearcoatNormalTexture"})
    return is_bumped and not _is_unlit(material)


def _report_features(material: Material, report: ImportReport) -> None:
    used = {
        "diffuse": material.factor(_PBR, "metallicFactor", 1.0) < 1 or "metallicRoughnessTexture" in material.textures,
        "metal": material.factor(_PBR, "metallicFactor", 1.0) > 0,
        "roughness": True,
        "one_sided": not material.values.boolean("doubleSided", False),
        "normal_map": "normalTexture" in material.textures,
        "occlusion_map": "occlusionTexture" in material.values,
        "emission": max(material.factors("", "emissiveFactor", 3, 0.0)) > 0,
        "opacity": material.values.string("alphaMode", "OPAQUE") != "OPAQUE",
    }
    for extension, (feature, factor) in _EXTENSIONS.items():
        part = material.part(extension)
        used[feature] = used.get(feature, False) or (part is not None and _is_positive(part, factor))
    for feature, is_used in used.items():
        if is_used:
            report.use(feature, material.place)


def _is_positive(part: JsonObject, factor: str) -> bool:
    value = part.values.get(factor, 0.0) if factor else 1.0
    values = value if isinstance(value, list) else [value]
    return any(isinstance(number, (int, float)) and number > 0 for number in values)
