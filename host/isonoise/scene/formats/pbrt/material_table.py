"""The named and unnamed materials of a scene; each becomes one BSDF. Called by `scene_builder.py`."""

import numpy as np

from isonoise.scene.formats.pbrt.legacy_materials import LEGACY_MATERIALS
from isonoise.scene.formats.pbrt.materials import MATERIALS, NULL, MaterialContext, two_sided
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.pbrt.tokens import Position

_INTERFACES = ("", "none", "interface")
_MAX_MIX_DEPTH = 16


class MaterialTable:
    """Maps materials when they are defined, and finds them by name."""

    def __init__(self, context: MaterialContext):
        self._context = context
        self._by_name: dict[str, dict] = {}
        self._mix_depth: dict[int, int] = {}  # by id() of the BSDF, which `_by_name` or a shape keeps alive
        self.default = two_sided({"type": "diffuse", "reflectance": 0.5})

    def define(self, name: str, parameters: Parameters) -> None:
        """Add a named material, whose type is a parameter."""
        self._by_name[name] = self.make(parameters.text("type", "diffuse"), parameters)

    def find(self, name: str, position: Position) -> dict:
        """The BSDF of a named material."""
        if name in self._by_name:
            return self._by_name[name]
        position.raise_unknown("there is no material named", name, self._by_name)

    def make(self, type_: str, parameters: Parameters) -> dict:
        """The BSDF of a material."""
        if type_ in _INTERFACES:
            return NULL
        if type_ == "mix":
            return self._mix(parameters)
        function = MATERIALS.get(type_) or LEGACY_MATERIALS.get(type_)
        if function is None:
            choices = (*MATERIALS, *LEGACY_MATERIALS, "mix", "interface")
            parameters.position.raise_unknown("unknown material", type_, choices)
        return self._with_bump_or_normal_map(function(parameters, self._context), parameters)

    def _mix(self, parameters: Parameters) -> dict:
        """pbrt-v4: `amount` is the share of the second of `materials`; pbrt-v3: of `namedmaterial1`."""
        textures = self._context.textures
        self._context.report.use("mixed_materials")
        is_legacy = "namedmaterial1" in parameters
        if is_legacy:
            names = [parameters.text(name, "") for name in ("namedmaterial1", "namedmaterial2")]
            amount = textures.colour(parameters, "amount", 0.5)
            amount = textures.map("1 - amount", lambda values: 1 - values, amount)
        else:
            names = parameters.texts("materials")
            amount = textures.number(parameters, "amount", 0.5)
        if len(names) != 2:
            parameters.position_of("materials").raise_error("a mix needs the names of two materials")
        first, second = (self.find(name, parameters.position) for name in names)
        depth = 1 + max(self._mix_depth.get(id(bsdf), 0) for bsdf in (first, second))
        if depth > _MAX_MIX_DEPTH:
            parameters.position.raise_error(f"mixes are nested more than {_MAX_MIX_DEPTH} levels deep")
        weight = textures.to_number(amount)
        weight = min(max(weight, 0.0), 1.0) if isinstance(weight, float) else weight
        mix = {"type": "blendbsdf", "weight": weight, "first": first, "second": second}
        self._mix_depth[id(mix)] = depth
        return mix

    def _with_bump_or_normal_map(self, bsdf: dict, parameters: Parameters) -> dict:
        """The BSDF with the material's bump or normal map; it is put inside a two-sided one."""
        textures, report = self._context.textures, self._context.report
        place = parameters.position.place
        wrapper = None
        if "normalmap" in parameters:
            report.use("normal_map")
            wrapper = {"type": "normalmap", "normalmap": textures.normal_map(parameters, "normalmap")}
        name = "displacement" if "displacement" in parameters else "bumpmap"
        height = textures.number(parameters, name, None)
        if height is not None and not isinstance(height, np.ndarray):  # a constant height changes nothing
            texture = textures.to_number(height)
            if wrapper is not None:
                report.limit("bump_map", "a material has a normal map too, which is used", place)
            elif texture["type"] != "bitmap":
                report.limit("bump_map", "only images are bump maps", place)
            else:
                report.use("bump_map")
                wrapper = {"type": "bumpmap", "texture": texture}
        if wrapper is None:
            return bsdf
        if bsdf["type"] == "twosided":
            return two_sided({**wrapper, "bsdf": bsdf["bsdf"]})
        return {**wrapper, "bsdf": bsdf}
