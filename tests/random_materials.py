"""Random materials and media. Used by scene_generator.py."""

import numpy as np
from random_textures import RandomTextures

from isonoise.scene.material.bsdf_kinds import KINDS
from isonoise.scene.vocabulary import plugins_of
from isonoise.scene.vocabulary.plugin import SUPPORTED

METALS = ("Au", "Cu", "Al", "Ag", "W", "Cr", "none")
INDICES = ("air", "water", "bk7", "diamond", "acetone", "pet", "vacuum")
OPAQUE = ["diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "principled"]
CLEAR = ["dielectric", "thindielectric", "roughdielectric"]
for _kind in KINDS.values():  # BSDFs without a method of their own are written by `any_parameters`
    if _kind.scatters and _kind.plugin and _kind.plugin not in OPAQUE + CLEAR:
        (CLEAR if _kind.transmits else OPAQUE).append(_kind.plugin)
BUMPY = ("bumpmap", "normalmap")


class RandomMaterials(RandomTextures):
    """Materials and media; the method of a BSDF is its name after an underscore."""

    def material(self, parent, depth: int, opaque=False, attribute: str = "", bumpy=True, **attributes):
        """A material nested up to `depth` times; `opaque`: no light passes through; `bumpy`: bump maps are allowed."""
        kinds = [*OPAQUE, *OPAQUE, *(() if opaque else CLEAR)]
        if depth > 0:
            wrappers = [
                "twosided",
                *(("blendbsdf",) if self.point_like_lights else ()),
                *(() if opaque else ("mask",)),
                *(BUMPY if bumpy else ()),
            ]
            kinds = kinds if self.chance(0.6) else wrappers
        kind = self.r.choice(kinds)
        bsdf = self.tag(parent, "bsdf", kind, **attributes)

        def nested():
            self.material(bsdf, depth - 1, opaque or kind == "twosided", attribute, bumpy and kind not in BUMPY)

        if kind == "twosided":
            for _ in range(self.r.randint(1, 2)):
                nested()
        elif kind == "mask":
            self.number(bsdf, "opacity", 0.2, 0.9, attribute)
            nested()
        elif kind == "blendbsdf":
            self.number(bsdf, "weight", 0.1, 0.9, attribute)
            nested()
            nested()
        elif kind == "bumpmap":
            self.texture(bsdf, "", 0.0, 1.0, number=True, kinds=("bitmap",))  # Mitsuba has the slope of no other
            self.float(bsdf, "scale", self.uniform(-0.08, 0.08))
            nested()
        elif kind == "normalmap":
            texture = self.tag(bsdf, "texture", "bitmap", name="normalmap")
            slopes = self.arrays.uniform(-0.25, 0.25, (6, 6, 2))
            normals = np.concatenate([slopes, np.ones((6, 6, 1))], axis=2)
            normals /= np.linalg.norm(normals, axis=2, keepdims=True)
            self.bitmap(texture, 0.5 + 0.5 * normals, "png")
            self.tag(texture, "boolean", name="raw", value="true")
            nested()
        else:
            getattr(self, f"_{kind}", self.any_parameters)(bsdf, attribute, opaque)

    def any_parameters(self, tag, attribute: str = "", opaque: bool = True):
        """Some of the colours, numbers and flags that the vocabulary has for a plugin."""
        for parameter in plugins_of(tag.tag)[tag.get("type")].parameters:
            if parameter.status != SUPPORTED or not self.chance(0.6):
                continue
            if parameter.type == "reflectance":
                self.colour(tag, parameter.name, 0.1, 0.85, attribute)
            elif parameter.type == "float" and parameter.texture:
                self.number(tag, parameter.name, 0.05, 0.95, attribute)
            elif parameter.type == "float":
                self.float(tag, parameter.name, self.uniform(0.05, 0.95))
            elif parameter.type == "boolean":
                self.flag(tag, parameter.name, 0.5)

    def _diffuse(self, bsdf, attribute, opaque):
        if self.chance(0.9):
            self.colour(bsdf, "reflectance", 0.1, 0.85, attribute)

    def _conductor(self, bsdf, attribute, opaque):
        choice = self.r.randint(0, 2)
        if choice == 0:
            self.tag(bsdf, "string", name="material", value=self.r.choice(METALS))
        elif choice == 1:
            for name, low, high in (("eta", 0.2, 2.0), ("k", 1.5, 5.0)):
                self.colour(bsdf, name, low, high, plain=True)
        self.colour(bsdf, "specular_reflectance", 0.4, 0.9, attribute)

    def _roughconductor(self, bsdf, attribute, opaque):
        self._conductor(bsdf, attribute, opaque)
        self.roughness(bsdf, attribute)

    def _dielectric(self, bsdf, attribute, opaque):
        self.indices(bsdf)
        for name in ("specular_reflectance", "specular_transmittance"):
            if self.chance(0.3):
                self.colour(bsdf, name, 0.4, 0.9, attribute)

    _thindielectric = _dielectric

    def _roughdielectric(self, bsdf, attribute, opaque):
        self._dielectric(bsdf, attribute, opaque)
        self.roughness(bsdf, attribute)

    def _plastic(self, bsdf, attribute, opaque):
        self.indices(bsdf)  # no mesh attributes: Mitsuba needs the mean of these colours, which they lack
        self.colour(bsdf, "diffuse_reflectance", 0.1, 0.85)
        if self.chance(0.3):
            self.colour(bsdf, "specular_reflectance", 0.3, 0.9)
        self.maybe_boolean(bsdf, "nonlinear", 0.5)

    def _roughplastic(self, bsdf, attribute, opaque):
        self._plastic(bsdf, attribute, opaque)
        self.tag(bsdf, "string", name="distribution", value=self.r.choice(("beckmann", "ggx")))
        self.float(bsdf, "alpha", self.uniform(0.05, 0.6))
        self.maybe_boolean(bsdf, "sample_visible", 0.2)

    def _principled(self, bsdf, attribute, opaque):
        self.colour(bsdf, "base_color", 0.1, 0.85, attribute)
        self.number(bsdf, "roughness", 0.25, 0.9, attribute)
        names = ["anisotropic", "metallic", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat"]
        names += ["clearcoat_gloss", *(() if opaque else ("spec_trans",))]
        for name in names:
            if self.chance(0.35):
                self.number(bsdf, name, 0.05, 0.95, attribute)
        if self.chance(0.5):
            self.float(bsdf, "eta", self.uniform(1.2, 1.8))
        elif self.chance(0.5):
            self.float(bsdf, "specular", self.uniform(0.1, 0.9))

    def indices(self, bsdf):
        """Indices of refraction of both sides, never equal: Mitsuba and isonoise refuse that for rough materials."""
        within, outside = self.r.sample(INDICES, 2)
        if self.chance(0.4):
            self.tag(bsdf, "string", name="int_ior", value=within)
            self.tag(bsdf, "string", name="ext_ior", value=outside)
        elif self.chance(0.7):
            self.float(bsdf, "int_ior", self.uniform(1.1, 1.9))
            if self.chance(0.3):
                self.float(bsdf, "ext_ior", self.uniform(1.0, 1.09) if self.chance(0.7) else self.uniform(1.91, 2.2))

    def roughness(self, bsdf, attribute):
        if self.chance(0.8):
            self.tag(bsdf, "string", name="distribution", value=self.r.choice(("beckmann", "ggx")))
        if self.chance(0.5):
            self.number(bsdf, "alpha", 0.1, 0.6, attribute)
        else:
            for name in ("alpha_u", "alpha_v"):
                self.number(bsdf, name, 0.08, 0.6, attribute)
        self.maybe_boolean(bsdf, "sample_visible", 0.2)

    def medium(self, shape):
        """A homogeneous medium inside a closed shape, whose boundary lets light in."""
        kind = self.r.choice(("null", "null", "dielectric", "roughdielectric", "thindielectric"))
        bsdf = self.tag(shape, "bsdf", kind)
        if kind != "null":
            getattr(self, f"_{kind}")(bsdf, "", False)
        medium = self.tag(shape, "medium", "homogeneous", name="interior")
        self.colour(medium, "sigma_t", 0.2, 0.9, plain=True)  # Mitsuba takes no colour above 1: that is for the scale
        self.colour(medium, "albedo", 0.3, 0.95, plain=True)
        if self.chance(0.6):
            self.float(medium, "scale", self.uniform(0.5, 4.0))
        if self.chance(0.7):
            phase = self.tag(medium, "phase", self.r.choice(("hg", "isotropic")))
            if phase.get("type") == "hg":
                self.float(phase, "g", self.uniform(-0.7, 0.7))
