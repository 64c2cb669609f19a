"""Maps pbrt-v4's materials to Mitsuba's BSDFs. Called by `material_table.py`; pbrt-v3's are in `legacy_materials.py`.

pbrt's reflecting materials are two-sided, and its microfacets have the GGX distribution (Trowbridge-Reitz).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.pbrt.coats import coat_transmittance
from isonoise.scene.formats.pbrt.colours import Colours
from isonoise.scene.formats.pbrt.media import PRESETS
from isonoise.scene.formats.pbrt.parameters import SPECTRUM_TYPES, Parameters
from isonoise.scene.formats.pbrt.textures import Texture, Textures
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.material.presets import conductors

NULL = {"type": "null"}
"""The material of surfaces that are only boundaries of media."""

_SMOOTH_ALPHA = 1e-3  # below it pbrt takes a surface for smooth (TrowbridgeReitzDistribution::EffectivelySmooth)
_MAX_CONDUCTOR_REFLECTANCE = 0.9999  # as in pbrt-v4


@dataclass
class MaterialContext:
    """What the functions of this module need besides the parameters of a material."""

    textures: Textures
    colours: Colours
    report: ImportReport

    def number(self, parameters: Parameters, name: str, default: float, feature: str) -> float:
        """A number that may not vary over the surface: a texture is replaced by its mean."""
        texture = self.textures.number(parameters, name, default)
        if not isinstance(texture, np.ndarray):
            problem = f"a texture of '{name}' is replaced by its mean"
            self.report.limit(feature, problem, parameters.position_of(name).place)
        return float(self.textures.mean(texture).mean())

    def unbounded(self, parameters: Parameters, name: str, default: np.ndarray) -> Texture:
        """A colour that may exceed 1, such as eta, k or a coefficient of a medium: a constant or a texture."""
        if parameters.has_type(name, "texture"):
            return self.textures.colour(parameters, name, 1.0)
        value = parameters.find(name, "float", *SPECTRUM_TYPES)
        return default if value is None else self.colours.unbounded(value)

    def alphas(
        self, parameters: Parameters, remap: Callable[[np.ndarray], np.ndarray], default: float = 0.0, prefix: str = ""
    ) -> tuple[Texture, Texture]:
        """Roughness along u and v as Mitsuba's alpha."""
        names = [f"{prefix}{axis}roughness" for axis in "uv"]
        both = self.textures.number(parameters, f"{prefix}roughness", default)
        along = [self.textures.number(parameters, name, None) for name in names]
        along = [both if texture is None else texture for texture in along]
        textures = along[:1] if along[0] is along[1] else along
        if parameters.boolean("remaproughness", True):
            textures = [self.textures.map(f"remapped by {remap.__name__}", remap, texture) for texture in textures]
        return textures[0], textures[-1]

    def roughness(self, alphas: tuple[Texture, Texture]) -> dict:
        """The parameters of a rough BSDF; empty if it is smooth."""
        if all(isinstance(alpha, np.ndarray) and alpha.max() <= _SMOOTH_ALPHA for alpha in alphas):
            return {}
        self.report.use("roughness")
        u, v = (self.textures.to_number(self.at_least_smooth(alpha)) for alpha in alphas)
        if alphas[0] is alphas[1] or (isinstance(u, float) and u == v):
            return {"distribution": "ggx", "alpha": u}
        self.report.use("anisotropy")
        return {"distribution": "ggx", "alpha_u": u, "alpha_v": v}

    def at_least_smooth(self, alpha: Texture) -> Texture:
        """The roughness, at least the one below which a surface is smooth."""
        return self.textures.map("at least smooth", lambda values: np.maximum(values, _SMOOTH_ALPHA), alpha)

    def isotropic_roughness(self, alphas: tuple[Texture, Texture], place: str) -> dict:
        """Like `roughness`, for a BSDF with one number: the geometric mean over u, v and the surface."""
        means = [float(self.textures.mean(alpha).mean()) for alpha in alphas]
        if not all(isinstance(alpha, np.ndarray) for alpha in alphas):
            self.report.limit("roughness", "textured roughness below a coat is replaced by its mean", place)
        if not math.isclose(*means):
            self.report.limit("anisotropy", "the roughness of a coat along u and v is replaced by its mean", place)
        alpha = math.sqrt(means[0] * means[1])
        return self.roughness((np.full(3, alpha),) * 2)


def square_root(roughness: np.ndarray) -> np.ndarray:
    """pbrt-v4's alpha of a roughness."""
    return np.sqrt(np.maximum(roughness, 0.0))


def two_sided(bsdf: dict) -> dict:
    """A BSDF for both sides."""
    return {"type": "twosided", "bsdf": bsdf}


def diffuse(parameters: Parameters, context: MaterialContext, name: str = "reflectance") -> dict:
    """`diffuse`, whose colour has this name."""
    context.report.use("diffuse")
    if context.number(parameters, "sigma", 0.0, "diffuse"):
        problem = "'sigma' (Oren and Nayar's rough diffuse surface) is ignored"
        context.report.limit("diffuse", problem, parameters.position.place)
    reflectance = context.textures.colour(parameters, name, 0.5)
    return two_sided({"type": "diffuse", "reflectance": context.textures.to_colour(reflectance)})


def coated_diffuse(parameters: Parameters, context: MaterialContext) -> dict:
    """`coateddiffuse`."""
    context.report.use("diffuse")
    context.report.use("specular")
    place = parameters.position.place
    reflectance = context.textures.colour(parameters, "reflectance", 0.5)
    _ignore_scattering_in_coat(parameters, context)
    thickness = context.number(parameters, "thickness", 0.01, "specular")
    index = eta(parameters, "eta", 1.5, context)
    if thickness and index != 1:
        transmittance = coat_transmittance(thickness, index)
        name = f"times {transmittance}"
        reflectance = context.textures.map_bytes(name, lambda values: transmittance * values, reflectance)
    return plastic(reflectance, index, context.alphas(parameters, square_root), place, context)


def plastic(reflectance: Texture, index: float, alphas, place: str, context: MaterialContext) -> dict:
    """A diffuse base below a dielectric coat."""
    roughness = context.isotropic_roughness(alphas, place)
    if index == 1:
        return two_sided({"type": "diffuse", "reflectance": context.textures.to_colour(reflectance)})
    return two_sided(
        {
            "type": "roughplastic" if roughness else "plastic",
            "int_ior": index,
            "ext_ior": 1.0,
            "nonlinear": True,
            "diffuse_reflectance": context.textures.to_colour(reflectance),
            **roughness,
        }
    )


def conductor(parameters: Parameters, context: MaterialContext) -> dict:
    """`conductor`, by eta and k or by reflectance."""
    return metal(parameters, context, context.alphas(parameters, square_root))


def metal(parameters: Parameters, context: MaterialContext, alphas: tuple[Texture, Texture]) -> dict:
    """A conductor with roughness `alphas` along u and v."""
    context.report.use("metal")
    roughness = context.roughness(alphas)
    eta_, k = _eta_and_k(parameters, context, "")
    return two_sided(
        {
            "type": "roughconductor" if roughness else "conductor",
            "eta": context.textures.to_unbounded(eta_),
            "k": context.textures.to_unbounded(k),
            **roughness,
        }
    )


def _eta_and_k(parameters: Parameters, context: MaterialContext, prefix: str) -> tuple[Texture, Texture]:
    if f"{prefix}reflectance" in parameters:
        reflectance = context.textures.colour(parameters, f"{prefix}reflectance", 0.0)
        return np.ones(3), context.textures.map("k of reflectance", _k_of_reflectance, reflectance)
    copper = conductors()["Cu"]
    eta_, k = (context.unbounded(parameters, prefix + name, copper[i]) for i, name in enumerate(("eta", "k")))
    return eta_, k


def _k_of_reflectance(reflectance: np.ndarray) -> np.ndarray:
    """k of a conductor of eta 1 with this reflectance at normal incidence (pbrt-v4, ConductorMaterial)."""
    clamped = np.clip(reflectance, 0.0, _MAX_CONDUCTOR_REFLECTANCE)
    return 2.0 * np.sqrt(clamped) / np.sqrt(1.0 - clamped)


def dielectric(parameters: Parameters, context: MaterialContext) -> dict:
    """`dielectric`."""
    context.report.use("transmission")
    index = eta(parameters, "eta", 1.5, context)
    roughness = context.roughness(context.alphas(parameters, square_root)) if index != 1 else {}
    parameters.ignore("roughness", "uroughness", "vroughness", "remaproughness")
    return {"type": "roughdielectric" if roughness else "dielectric", "int_ior": index, "ext_ior": 1.0, **roughness}


def thin_dielectric(parameters: Parameters, context: MaterialContext) -> dict:
    """`thindielectric`."""
    context.report.use("transmission")
    return {"type": "thindielectric", "int_ior": eta(parameters, "eta", 1.5, context), "ext_ior": 1.0}


def coated_conductor(parameters: Parameters, context: MaterialContext) -> dict:
    """`coatedconductor`: the metal below the coat, with Disney's clearcoat on it."""
    place = parameters.position.place
    context.report.limit("clearcoat", "the coat of a coatedconductor is approximated by that of `principled`", place)
    _ignore_scattering_in_coat(parameters, context)
    context.number(parameters, "thickness", 0.01, "clearcoat")
    coat_index = eta(parameters, "interface.eta", 1.5, context)
    coat_alphas = context.alphas(parameters, square_root, prefix="interface.")
    metal_alphas = context.alphas(parameters, square_root, prefix="conductor.")
    prefix = "conductor." if "reflectance" not in parameters else ""
    eta_, k = (context.textures.mean(part) / coat_index for part in _eta_and_k(parameters, context, prefix))
    coat_alpha = min(float(context.textures.mean(coat_alphas[0]).mean()), 1.0)
    return two_sided(
        {
            "type": "principled",
            "base_color": rgb(np.clip(((eta_ - 1) ** 2 + k**2) / ((eta_ + 1) ** 2 + k**2), 0, 1)),
            "metallic": 1.0,
            "roughness": math.sqrt(min(max(float(context.textures.mean(metal_alphas[0]).mean()), 1e-3), 1.0)),
            "clearcoat": 1.0,
            # Disney's clearcoat has alpha 0.1 at gloss 0 and 0.001 at gloss 1
            "clearcoat_gloss": min(max((0.1 - coat_alpha) / 0.099, 0.0), 1.0),
        }
    )


def diffuse_transmission(parameters: Parameters, context: MaterialContext) -> dict:
    """`diffusetransmission`: the thin principled BSDF, whose reflected and transmitted colour are proportional."""
    context.report.use("transmission")
    scale = parameters.number("scale", 1.0)
    context.number(parameters, "sigma", 0.0, "transmission")
    parameters.ignore("remaproughness")
    reflected = context.textures.colour(parameters, "reflectance", 0.25)
    transmitted = context.textures.colour(parameters, "transmittance", 0.25)
    return thin_sheet(reflected, transmitted, scale, parameters.position.place, context)


def thin_sheet(reflected: Texture, transmitted: Texture, scale: float, place: str, context: MaterialContext) -> dict:
    """A thin sheet that reflects and transmits diffusely."""
    sum_ = context.textures.map(f"sum {scale}", lambda a, b: np.clip(scale * (a + b), 0, 1), reflected, transmitted)
    means = [context.textures.mean(part) for part in (reflected, transmitted)]
    total = sum(means).sum()
    share = float(means[1].sum() / total) if total > 0 else 0.0
    if share == 0:
        return two_sided({"type": "diffuse", "reflectance": context.textures.to_colour(sum_)})
    if not np.allclose(means[1], share * sum(means), atol=0.01):
        context.report.limit("transmission", "reflected and transmitted diffuse light get the same colour", place)
    context.report.limit("transmission", "diffuse transmission is approximated by `principledthin`", place)
    return {
        "type": "principledthin",
        "base_color": context.textures.to_colour(sum_),
        "roughness": 0.5,
        "spec_trans": 0.0,
        "diff_trans": 2.0 * share,
    }


def measured(parameters: Parameters, context: MaterialContext) -> dict:
    """`measured`, `hair`, and `fourier`: a grey diffuse surface in their place."""
    context.report.limit(
        "measured_materials", "measured materials and hair become diffuse grey", parameters.position.place
    )
    parameters.ignore(*(value.name for value in parameters.unused()))
    return two_sided({"type": "diffuse", "reflectance": 0.5})


def subsurface(parameters: Parameters, context: MaterialContext) -> dict:
    """`subsurface`: plastic with the diffuse reflectance of the medium (Jensen et al. 2001, equation 15)."""
    place = parameters.position.place
    context.report.limit("measured_materials", "subsurface scattering becomes plastic of the same colour", place)
    index = eta(parameters, "eta", 1.33, context)
    alphas = context.alphas(parameters, square_root)
    if "reflectance" in parameters or "Kd" in parameters:
        name = "reflectance" if "reflectance" in parameters else "Kd"
        reflectance = context.textures.colour(parameters, name, 0.5)
    else:
        preset = PRESETS.get(parameters.text("name", ""), PRESETS["Wholemilk"])
        scattering, absorption = (
            context.textures.mean(context.unbounded(parameters, name, np.array(preset[i])))
            for i, name in enumerate(("sigma_s", "sigma_a"))
        )
        albedo = scattering / np.maximum(scattering + absorption, 1e-20)
        root = np.sqrt(3 * (1 - albedo))
        internal = (1 + _INTERNAL_REFLECTION) / (1 - _INTERNAL_REFLECTION)
        reflectance = 0.5 * albedo * (1 + np.exp(-4 / 3 * internal * root)) * np.exp(-root)
    parameters.ignore("name", "mfp", "g", "scale", "Kr", "Kt")
    return plastic(reflectance, index, alphas, place, context)


_INTERNAL_REFLECTION = 0.5  # share of diffuse light that an interface of index 1.33 reflects back


def eta(parameters: Parameters, name: str, default: float, context: MaterialContext) -> float:
    """An index of refraction."""
    if name not in parameters:
        return default
    if parameters.has_type(name, "texture"):
        index = context.number(parameters, name, default, "transmission")
    else:
        index = context.colours.refractive_index(parameters.find(name, "float", *SPECTRUM_TYPES))
    if not 1e-3 <= index <= 1e3:
        parameters.position_of(name).raise_error(f"'{name}' has to be 0.001 to 1000, got {index:g}")
    return index


def _ignore_scattering_in_coat(parameters: Parameters, context: MaterialContext) -> None:
    parameters.ignore("maxdepth", "nsamples", "twosided", "g")
    if "albedo" in parameters and context.textures.mean(context.textures.colour(parameters, "albedo", 0.0)).any():
        context.report.limit("specular", "scattering inside a coat is ignored", parameters.position.place)


MATERIALS: dict[str, Callable[[Parameters, MaterialContext], dict]] = {
    "diffuse": diffuse,
    "coateddiffuse": coated_diffuse,
    "conductor": conductor,
    "dielectric": dielectric,
    "thindielectric": thin_dielectric,
    "coatedconductor": coated_conductor,
    "diffusetransmission": diffuse_transmission,
    "measured": measured,
    "hair": measured,
    "subsurface": subsurface,
}
"""By pbrt-v4's names; `mix` and `interface` are in `material_table.py`."""
