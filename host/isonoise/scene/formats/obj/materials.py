"""Maps MTL materials to bsdfs and emitters. Called by `read.py`.

A material with statements of the PBR extension (Pr, Pm, ...), or written by Blender, is `principled`. Others follow
`illum`: glass, mirrors, metal, a glossy coat on a diffuse base, or diffuse. See `support.py`.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.obj.mtl import Material
from isonoise.scene.formats.obj.textures import Textures
from isonoise.scene.formats.report import ImportReport

_MIRRORS, _FRESNEL_MIRRORS, _TRANSPARENT = (3, 8), (5,), (4, 6, 7)  # values of illum
_DEFAULT_IOR = 1.5
_METAL_RATIO, _MIN_METAL_SPECULAR = 0.1, 0.4  # Kd to Ks at most, and Ks at least, of what is taken for metal
_BUMP_HEIGHT = 0.01  # of white, as a fraction of the image's width on the surface: MTL has no unit of height
_MAX_BLENDER_EXPONENT = 1000.0
_MAX_CLEARCOAT_ALPHA, _MIN_CLEARCOAT_ALPHA = 0.1, 0.001  # of `principled` at clearcoat_gloss 0 and 1
_UNMAPPED_MAPS = {"decal": "textures", "refl": "environment", "pcr": "clearcoat"}


class Materials:
    """Makes the bsdfs of an OBJ file."""

    def __init__(self, path: Path, folder: Path | None, report: ImportReport):
        self.report, self.textures = report, Textures(path, folder, report)

    def bsdf(self, material: Material, uv_length: float, has_colours: bool) -> dict:
        """The bsdf of a material for a mesh.

        `uv_length` is the mean length of a unit of its texture coordinates; `has_colours` tells whether the attribute
        `vertex_color`, which includes Kd, is its diffuse colour.
        """
        if material.has_spectra:
            self.report.limit("spectra", "files with spectra are not read: the colour is left out", material.name)
        for name, feature in _UNMAPPED_MAPS.items():
            if name in material.maps:
                self.report.limit(feature, f"map '{name}' is left out", material.name)
        diffuse = {"type": "mesh_attribute", "name": "vertex_color"} if has_colours else self._diffuse(material)
        if _is_pbr(material):
            bsdf, is_glass = self._principled(material, diffuse), self._is_glass(material)
        elif is_glass := self._is_glass(material):
            bsdf = self._glass(material)
        else:
            bsdf = self._opaque(material, diffuse)
        bsdf = self._with_shading_normals(material, bsdf, uv_length)
        bsdf = bsdf if is_glass else {"type": "twosided", "bsdf": bsdf}
        return bsdf if is_glass and not _is_pbr(material) else self._with_opacity(material, bsdf)

    def radiance(self, material: Material) -> dict | None:
        """The emitted radiance; None if the material does not emit."""
        factor = material.numbers.get("ke", [0.0] * 3)
        texture = self.textures.colour(material.maps.get("ke"), _factor_of_map(factor))
        if texture is None and max(factor) <= 0:
            return None
        self.report.use("emission")
        return texture or rgb(factor)

    def diffuse_factor(self, material: Material) -> np.ndarray:
        """The factor Kd (3,) on a texture or vertex colours, at most 1."""
        has_map = "kd" in material.maps
        values = np.array(material.numbers.get("kd", [1.0 if has_map else 0.5] * 3))
        if values.max() > 1:
            self.report.limit("diffuse", "a reflectance above 1 is taken as 1", material.name)
        # Blender writes Kd for viewers that do not show textures; others multiply, except for a Kd of 0
        return np.ones(3) if has_map and (material.is_from_blender or not values.any()) else np.minimum(values, 1.0)

    def _diffuse(self, material: Material, factor: float = 1.0) -> dict:
        """Kd times its texture and a factor."""
        self.report.use("diffuse")
        values = factor * self.diffuse_factor(material)
        return self.textures.colour(material.maps.get("kd"), values) or rgb(np.minimum(values, 1.0))

    def _specular_factor(self, material: Material) -> np.ndarray:
        """The factor Ks (3,), at most 1."""
        has_map = "ks" in material.maps
        values = np.minimum(material.numbers.get("ks", [1.0 if has_map else 0.0] * 3), 1.0)
        return np.ones(3) if has_map and not values.any() else values

    def _specular(self, material: Material, factor: float = 1.0) -> dict:
        """Ks times its texture and a factor."""
        self.report.use("specular")
        values = factor * self._specular_factor(material)
        return self.textures.colour(material.maps.get("ks"), values) or rgb(np.minimum(values, 1.0))

    def _is_glass(self, material: Material) -> bool:
        """Whether a material refracts. Programs write `illum 4` with Ni 1, or a texture, for opaque materials too."""
        if _illum(material) not in _TRANSPARENT or material.is_from_blender:
            return False
        return _ior(material) != 1 and not {"kd", "d"} & set(material.maps)

    def _glass(self, material: Material) -> dict:
        """Smooth glass. Light passes two surfaces, so each has the square root of Tf."""
        self.report.use("transmission")
        tint = np.array(material.numbers.get("tf", [1.0] * 3))
        if tint.max() != 1 and tint.any():
            problem = "only the hue of Tf is used, because programs disagree whether a large Tf is clear or opaque"
            self.report.limit("transmission", problem, material.name)
        tint = tint / tint.max() if tint.any() else np.ones(3)
        glass = {"type": "dielectric", "int_ior": _ior(material), "ext_ior": 1.0}
        return glass if (tint == 1).all() else glass | {"specular_transmittance": rgb(np.sqrt(tint))}

    def _opaque(self, material: Material, diffuse: dict) -> dict:
        """Metal, mirrors, a coat on a diffuse base, or diffuse."""
        illum, specular = _illum(material), self._specular_factor(material)
        if illum < 2 or not specular.any():
            return {"type": "diffuse", "reflectance": diffuse}
        kd = self.diffuse_factor(material).max()
        is_metal = specular.max() >= _MIN_METAL_SPECULAR and kd <= _METAL_RATIO * specular.max()
        if illum in (*_MIRRORS, *_FRESNEL_MIRRORS) and is_metal:
            self.report.use("metal")
            return {"type": "conductor", "material": "none", "specular_reflectance": self._specular(material)}
        if is_metal:
            self.report.use("metal")
            metal = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
            return metal | {"alpha": self._alpha(material), "specular_reflectance": self._specular(material)}
        if illum in _MIRRORS:
            return self._partial_mirror(material, kd, specular.max(), diffuse)
        ior = _ior(material)
        coat = {"int_ior": ior if ior > 1 else _DEFAULT_IOR, "ext_ior": 1.0}
        coat |= {"diffuse_reflectance": diffuse, "specular_reflectance": self._specular(material)}
        if illum in _FRESNEL_MIRRORS:
            return {"type": "plastic", **coat}
        if "ns" in material.maps:
            return self._textured_roughness(material, diffuse, specular)
        return {"type": "roughplastic", "distribution": "ggx", "alpha": self._alpha(material), **coat}

    def _partial_mirror(self, material: Material, kd: float, ks: float, diffuse: dict) -> dict:
        """Kd diffuse plus Ks mirrored; both are scaled if their sum exceeds 1."""
        total = kd + ks
        if total > 1:
            self.report.limit("specular", "Kd + Ks exceeds 1: both are reduced", material.name)
        scale = min(total, 1.0)  # the blend's weights sum to 1
        mirror, base_factor = self._specular(material, scale / ks), scale / kd if kd else 1.0
        has_colours = diffuse["type"] == "mesh_attribute"
        base = diffuse | {"scale": base_factor} if has_colours else self._diffuse(material, base_factor)
        parts = (
            {"type": "diffuse", "reflectance": base},
            {"type": "conductor", "material": "none", "specular_reflectance": mirror},
        )
        return {"type": "blendbsdf", "weight": ks / total, "first": parts[0], "second": parts[1]}

    def _alpha(self, material: Material) -> float:
        """The roughness of a Blinn-Phong exponent: alpha² = 2 / (Ns + 2) (Walter et al. 2007)."""
        self.report.use("roughness")
        exponent = material.numbers.get("ns", [10.0])[0]
        return float(_alpha_of_exponent(exponent))

    def _textured_roughness(self, material: Material, diffuse: dict, specular: np.ndarray) -> dict:
        """A coat whose exponent is a texture: `principled`, whose reflection has no colour."""
        self.report.use("roughness")
        self.report.use("specular")
        if "ks" in material.maps or np.ptp(specular):
            self.report.limit("specular", "with map_Ns, only the mean of Ks is used", material.name)
        exponent = material.numbers.get("ns", [1.0])[0] or 1.0
        roughness = self.textures.number(
            material.maps["ns"], f"Ns {exponent}", lambda values: np.sqrt(_alpha_of_exponent(exponent * values))
        )
        return {
            "type": "principled",
            "base_color": diffuse,
            "roughness": roughness or math.sqrt(_alpha_of_exponent(exponent)),
            "specular": float(specular.mean()),
        }

    def _principled(self, material: Material, diffuse: dict) -> dict:
        """The PBR extension, or what Blender wrote."""
        numbers, maps, textures = material.numbers, material.maps, self.textures
        bsdf = {"type": "principled", "base_color": diffuse}
        bsdf["roughness"] = self._scaled_number(material, "pr", _default_roughness(material))
        bsdf["metallic"] = self._scaled_number(material, "pm", _default_metallic(material))
        for packed, channels in (("rma", (0, 1)), ("orm", (1, 2))):  # roughness and metalness are channels of one image
            if packed in maps:
                for name, channel in zip(("roughness", "metallic"), channels, strict=True):
                    one = replace(maps[packed], options=maps[packed].options | {"imfchan": ["rgb"[channel]]})
                    bsdf[name] = textures.number(one) or bsdf[name]
        for key, name, feature in (("ps", "sheen", "sheen"), ("pc", "clearcoat", "clearcoat")):
            if numbers.get(key, [0.0])[0] > 0 or key in maps:
                self.report.use(feature)
                bsdf[name] = self._scaled_number(material, key, 0.0)
        if "clearcoat" in bsdf:
            alpha = numbers.get("pcr", [0.0])[0] ** 2
            gloss = (_MAX_CLEARCOAT_ALPHA - alpha) / (_MAX_CLEARCOAT_ALPHA - _MIN_CLEARCOAT_ALPHA)
            bsdf["clearcoat_gloss"] = min(max(gloss, 0.0), 1.0)
        if numbers.get("aniso", [0.0])[0] > 0:
            self.report.use("anisotropy")
            bsdf["anisotropic"] = min(numbers["aniso"][0], 1.0)
            if numbers.get("anisor", [0.0])[0]:
                self.report.limit("anisotropy", "its rotation (anisor) is left out", material.name)
        if self._is_glass(material):
            self.report.use("transmission")
            bsdf["spec_trans"] = 1.0
        if material.is_from_blender and "ks" in numbers and "pr" not in numbers:
            bsdf["specular"] = float(np.clip(np.mean(numbers["ks"]), 0.0, 1.0))
        else:
            bsdf["eta"] = _ior(material) if _ior(material) > 1 else _DEFAULT_IOR
        return bsdf

    def _scaled_number(self, material: Material, key: str, default: float) -> float | dict:
        """A number of the PBR extension times its texture."""
        feature = {"pr": "roughness", "pm": "metal", "ps": "sheen", "pc": "clearcoat"}[key]
        if key in material.numbers or key in material.maps:
            self.report.use(feature)
        value = min(material.numbers.get(key, [default])[0], 1.0)
        factor = material.numbers.get(key, [1.0])[0] or 1.0
        convert = None if factor == 1 else lambda values: np.minimum(factor * values, 1.0)
        texture = self.textures.number(material.maps.get(key), f"times {factor}", convert)
        return texture or value

    def _with_shading_normals(self, material: Material, bsdf: dict, uv_length: float) -> dict:
        """The bsdf with the normal map, or else the bump map, of a material."""
        normals, bump = material.maps.get("norm"), material.maps.get("bump")
        if bump is None and "disp" in material.maps:
            bump = material.maps["disp"]
            self.report.limit("bump_map", "displacement changes only the shading, not the shape", material.name)
        if normals is None and bump is not None and self.textures.is_normal_map(bump):
            normals, bump = bump, None
        if normals is not None and (image := self.textures.image(normals)) is not None:
            self.report.use("normal_map")
            if bump is not None:
                self.report.limit("bump_map", "left out: there is a normal map too", material.name)
            strength = float(normals.numbers("bm", (1.0,))[0])
            image = self.textures.bitmaps.normal_map(image, ((strength, 0), (0, strength)))
            texture = self.textures.bitmaps.texture(image, raw=True, sampling=self.textures.sampling(normals))
            return {"type": "normalmap", "normalmap": texture, "bsdf": bsdf}
        if bump is not None and (heights := self.textures.number(bump)) is not None:
            self.report.use("bump_map")
            scale = float(bump.numbers("bm", (1.0,))[0]) * _BUMP_HEIGHT * uv_length
            return {"type": "bumpmap", "scale": scale, "heights": heights, "bsdf": bsdf}
        return bsdf

    def _with_opacity(self, material: Material, bsdf: dict) -> dict:
        """The bsdf with d, Tr and their textures as a mask."""
        opacity = _opacity(material)
        texture, factor = material.maps.get("d"), opacity or 1.0
        convert = None if factor == 1 else lambda values: factor * values
        if texture is None and "tr" in material.maps:
            texture, convert = material.maps["tr"], lambda values: 1.0 - values
        image = self.textures.number(texture, f"opacity {factor} {texture is material.maps.get('d')}", convert, True)
        if image is None and opacity >= 1:
            return bsdf
        self.report.use("opacity")
        if material.has_halo:
            self.report.limit("opacity", "-halo is left out: opacity is the same in all directions", material.name)
        return {"type": "mask", "opacity": image or opacity, "bsdf": bsdf}


def _illum(material: Material) -> int:
    """The illumination model; without one, Ks decides."""
    has_specular = "ks" in material.maps or max(material.numbers.get("ks", [0.0])) > 0
    return int(material.numbers.get("illum", [2 if has_specular else 1])[0])


def _ior(material: Material) -> float:
    value = material.numbers.get("ni", [_DEFAULT_IOR])[0]
    return min(max(value, 0.1), 10.0) if value else _DEFAULT_IOR


def _opacity(material: Material) -> float:
    """d, or else 1 - Tr; a Tr of 1 alone is meant as d."""
    numbers = material.numbers
    if "d" in numbers:
        return min(numbers["d"][0], 1.0)
    if "tr" in numbers:
        return 1.0 if numbers["tr"][0] >= 1 else 1.0 - numbers["tr"][0]
    if _illum(material) in _TRANSPARENT and _ior(material) == 1 and "tf" in numbers:
        return min(float(np.mean(numbers["tf"])), 1.0)  # of Maya, which writes 1 - transparency
    return 1.0


def _is_pbr(material: Material) -> bool:
    keys = {"pr", "pm", "ps", "pc", "rma", "orm"}
    return material.is_from_blender or bool(keys & (set(material.numbers) | set(material.maps)))


def _alpha_of_exponent(exponent):
    return np.clip(np.sqrt(2.0 / (np.asarray(exponent) + 2.0)), 1e-3, 1.0)


def _default_roughness(material: Material) -> float:
    """The roughness, where there is no Pr. Blender writes Ns = 1000 (1 - roughness)²."""
    exponent = material.numbers.get("ns")
    if exponent is None:
        return 0.5
    if material.is_from_blender:
        return 1.0 - math.sqrt(min(exponent[0] / _MAX_BLENDER_EXPONENT, 1.0))
    return math.sqrt(_alpha_of_exponent(exponent[0]))


def _default_metallic(material: Material) -> float:
    """The metalness, where there is no Pm. Blender writes it as Ka, with illum 3 or 6."""
    if material.is_from_blender and _illum(material) in (3, 6):
        return min(max(material.numbers.get("ka", [0.0])), 1.0)
    return 0.0


def _factor_of_map(values: list[float]) -> list[float]:
    """The factor on a texture: a colour of 0 beside a texture is meant as no factor."""
    return values if max(values) > 0 else [1.0] * 3
