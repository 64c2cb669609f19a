"""The opaque layers of glTF materials: base with specular reflection, sheen, clearcoat. Called by `materials.py`.

Mitsuba 3 has no layered BSDF for arbitrary bases. Sheen and clearcoat become a `blendbsdf` with a lobe of their own,
so no energy is gained.
"""

import math
from collections.abc import Callable

import numpy as np

from isonoise.scene.formats.gltf.surface import SurfaceContext, blend, two_sided
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.spectra import MITSUBA_LUMINANCE

_COAT = "KHR_materials_clearcoat"
_DEFAULT_IOR = 1.5
_MAX_NORMAL_REFLECTANCE = 0.9
_COAT_NORMAL_REFLECTANCE = 0.04
COAT_ALBEDO = _COAT_NORMAL_REFLECTANCE + (1.0 - _COAT_NORMAL_REFLECTANCE) / 21.0
"""Mean over all directions of the coat's reflectance f + (1 - f)(1 - cos)^5, cosine-weighted: the share of light that
does not reach a base."""

_SHEEN_ALBEDO = (0.0, 0.0370, 0.0753, 0.1116, 0.1436, 0.1703, 0.1919, 0.2091, 0.2226, 0.2333, 0.2419)
"""Mean albedo over all directions of the Charlie sheen with white colour, for roughness 0, 0.1, ... 1 (Estevez, Kulla,
"Production Friendly Microfacet Sheen BRDF", 2017, with Ashikhmin's visibility as in KHR_materials_sheen)."""

_CLOTH_ALBEDO = 1.0652
"""The same of the diffuse lobe of `principled` with roughness 1 and a white base."""


def opaque_base(context: SurfaceContext, base_colour: dict, **changes) -> dict:
    """The metallic-roughness model with its specular extensions, on both sides.

    `changes` are parameters of `principled` that replace the material's. With a changed eta, the factor on the specular
    reflection is left out.
    """
    pbr = "pbrMetallicRoughness"
    bsdf = {
        "type": "principled",
        "base_color": base_colour,
        "metallic": context.number(pbr, "metallicFactor", 1.0, "metallicRoughnessTexture", 2),
        "roughness": context.number(pbr, "roughnessFactor", 1.0, "metallicRoughnessTexture", 1),
        "eta": 1.0,
    } | changes
    bsdf |= _anisotropy(context, bsdf["roughness"])
    reflecting = two_sided(bsdf | {"eta": _eta(context)} | changes)
    weight = _specular_weight(context)
    if bsdf["metallic"] == 1 or "eta" in changes or weight == 1:  # a metal has no dielectric part
        return reflecting
    return blend(weight, two_sided(bsdf), reflecting)


def _specular_weight(context: SurfaceContext) -> float | dict:
    """The factor on the reflection of dielectrics, at all angles."""
    return context.number("KHR_materials_specular", "specularFactor", 1.0, "specularTexture", 3)


def index_of_refraction(context: SurfaceContext) -> float:
    """Of KHR_materials_ior."""
    ior = context.material.factor("KHR_materials_ior", "ior", _DEFAULT_IOR)
    return max(ior, 1.0) if ior else _eta_of_reflectance(_MAX_NORMAL_REFLECTANCE)  # 0 stands for total reflection


def _eta(context: SurfaceContext) -> float:
    """The index of refraction whose reflectance at normal incidence is that of ior and specularColor."""
    ior = index_of_refraction(context)
    factors = context.material.factors("KHR_materials_specular", "specularColorFactor", 3, 1.0)
    texture = context.texture("specularColorTexture")
    colour = np.multiply(context.parameters.bitmaps.mean(texture.image) if texture else 1.0, factors)
    if texture and context.parameters.bitmaps.constant(texture.image) is None:
        context.limit("specular", "the mean of the texture of the specular colour is used")
    if np.ptp(colour) > 1e-3:
        context.limit(
            "specular", "reflection of dielectrics has no colour: the luminance of the specular colour is used"
        )
    elif (colour == 1).all():
        return ior
    return _eta_of_reflectance(((ior - 1.0) / (ior + 1.0)) ** 2 * float(np.maximum(colour, 0.0) @ MITSUBA_LUMINANCE))


def _eta_of_reflectance(reflectance: float) -> float:
    root = math.sqrt(min(reflectance, _MAX_NORMAL_REFLECTANCE))
    return (1.0 + root) / (1.0 - root)


def _anisotropy(context: SurfaceContext, roughness: float | dict) -> dict:
    """Parameters of `principled` for KHR_materials_anisotropy, whose alpha is larger along the tangent.

    glTF: alpha_t = alpha + (1 - alpha) strength^2 and alpha_b = alpha. principled: alpha_t = roughness^2 / aspect and
    alpha_b = roughness^2 aspect, with aspect^2 = 1 - 0.9 anisotropic.
    """
    part = "KHR_materials_anisotropy"
    strength = min(max(context.material.factor(part, "anisotropyStrength", 0.0), 0.0), 1.0)
    if strength == 0:
        return {}
    if context.texture("anisotropyTexture") or math.sin(context.material.factor(part, "anisotropyRotation", 0.0)):
        context.limit("anisotropy", "highlights are stretched along u: rotation and texture are left out")
    if isinstance(roughness, dict):
        context.limit("anisotropy", "with a texture of roughness it is left out")
        return {}
    alpha = roughness * roughness
    along = alpha + (1.0 - alpha) * strength * strength
    if not along > alpha:  # a strength that rounding loses; both may be 0
        return {}
    if alpha < 0.1 * along:
        context.limit("anisotropy", "alpha across is at least a tenth of alpha along the highlight")
        alpha = 0.1 * along
    return {"anisotropic": (1.0 - alpha / along) / 0.9, "roughness": (along * alpha) ** 0.25}


def add_sheen(context: SurfaceContext, base: dict) -> dict:
    """The base under the sheen of KHR_materials_sheen: a share of a cloth-like diffuse lobe in its colour."""
    part, parameters, bitmaps = "KHR_materials_sheen", context.parameters, context.parameters.bitmaps
    factors = np.clip(context.material.factors(part, "sheenColorFactor", 3, 0.0), 0.0, 1.0)
    if not factors.any():
        return base
    roughness = context.number(part, "sheenRoughnessFactor", 0.0, "sheenRoughnessTexture", 3)
    if isinstance(roughness, dict):
        context.limit("sheen", "the mean of the texture of its roughness is used")
        roughness = float(bitmaps.mean(roughness["bitmap"], raw=True)[0])
    albedo = float(np.interp(roughness, np.linspace(0.0, 1.0, len(_SHEEN_ALBEDO)), _SHEEN_ALBEDO))
    texture = context.texture("sheenColorTexture")
    colour = parameters.colour(texture, factors)
    if colour["type"] == "rgb":
        largest = max(colour["value"])
        weight, hue = albedo * largest, rgb(np.divide(colour["value"], _CLOTH_ALBEDO * max(largest, 1e-9)))
    else:
        largest = bitmaps.largest_channel(colour["bitmap"])
        weight = parameters.show(texture, bitmaps.scaled(largest, albedo, raw=True), raw=True)
        hue = parameters.show(texture, bitmaps.ratio(colour["bitmap"], largest, 1.0 / _CLOTH_ALBEDO), raw=True)
    context.limit("sheen", "it has the right mean albedo, but is less bright at grazing angles")
    cloth = {"type": "principled", "base_color": hue, "roughness": 1.0, "eta": 1.0}
    return blend(weight, base, two_sided(cloth))


def add_clearcoat(context: SurfaceContext, build: Callable[..., dict], is_transmissive: bool) -> dict:
    """The layers below, made by `build`, under the clearcoat of KHR_materials_clearcoat.

    Parameters
    ----------
    build : makes the layers below; keywords are a factor on the base colour, and replace parameters of the base
    is_transmissive : whether light passes the layers below
    """
    strength = context.material.factor(_COAT, "clearcoatFactor", 0.0)
    if not strength > 0:
        return build()
    roughness = context.number(_COAT, "clearcoatRoughnessFactor", 0.0, "clearcoatRoughnessTexture", 1)
    texture, strength = context.texture("clearcoatTexture"), min(strength, 1.0)
    metallic = context.number("pbrMetallicRoughness", "metallicFactor", 1.0, "metallicRoughnessTexture", 2)
    has_one_normal = context.texture("normalTexture") is None and context.texture("clearcoatNormalTexture") is None
    if metallic == 0 and not is_transmissive and has_one_normal and _specular_weight(context) == 1:
        coated = _coated_dielectric(context, build, roughness)
        return blend(context.parameters.number(texture, 0, strength), build(), coated)
    context.limit("clearcoat", "on metals, glass and other normals than the coat's, it is too dark at grazing angles")
    coat = {
        "type": "principled",
        "base_color": _COAT_NORMAL_REFLECTANCE / COAT_ALBEDO,
        "metallic": 1.0,
        "roughness": roughness,
    }
    weight = context.parameters.number(texture, 0, strength * COAT_ALBEDO)
    return blend(weight, build(), add_normal_map(context, two_sided(coat), "clearcoatNormalTexture"))


def _coated_dielectric(context: SurfaceContext, build: Callable[..., dict], roughness: float | dict) -> dict:
    """Half of the base with the roughness of the base, half with that of the coat.

    Each reflects twice as much as alone: at normal incidence 4 % in the coat, and what the coat lets through in the
    base; at grazing angles, half of all light each. The base colour gets darker by what the coat keeps from it.
    """
    base_reflectance = ((_eta(context) - 1.0) / (_eta(context) + 1.0)) ** 2
    eta_below = _eta_of_reflectance(2.0 * (1.0 - _COAT_NORMAL_REFLECTANCE) * base_reflectance)
    eta_coat = _eta_of_reflectance(2.0 * _COAT_NORMAL_REFLECTANCE)
    below, coat = (
        build(1.0 - COAT_ALBEDO, eta=eta, **more)
        for eta, more in ((eta_below, {}), (eta_coat, {"roughness": roughness}))
    )
    return blend(0.5, below, coat)


def add_normal_map(context: SurfaceContext, bsdf: dict, name: str = "normalTexture") -> dict:
    """The BSDF with the normals of a texture.

    glTF's green component points up in the image. So does the second axis of Mitsuba's shading frame, n x dp/du, unless
    the image is mirrored on the surface.
    """
    texture = context.texture(name)
    if texture is None:
        return bsdf
    if not context.parameters.is_shown(texture):
        context.report.limit("normal_map", "it uses other texture coordinates than the rest: left out", texture.place)
        return bsdf
    scale = texture.scale
    rotation = np.eye(2) if context.primitive.has_tangents else _rotation_to_mesh(texture.sampling.to_uv)
    sign = -1.0 if context.primitive.has_mirrored_uvs else 1.0
    matrix = np.diag([1.0, sign]) @ rotation * scale
    image = context.parameters.bitmaps.normal_map(texture.image, tuple(map(tuple, np.round(matrix, 12).tolist())))
    return {"type": "normalmap", "normalmap": context.parameters.show(texture, image, raw=True), "bsdf": bsdf}


def _rotation_to_mesh(to_uv) -> np.ndarray:
    """(2, 2): from the tangents of the image's coordinates to those of the mesh's; both have their second axis up."""
    (a, b, _), (c, d, _) = to_uv
    determinant = a * d - b * c
    along = np.array([d, c]) * np.sign(determinant)  # the direction of the image's u: inverse map of (1, 0), v up
    length = np.linalg.norm(along)
    if not length > 0:
        return np.eye(2)
    x, y = along / length
    return np.array([[x, -y * np.sign(determinant)], [y, x * np.sign(determinant)]])
