"""Maps pbrt-v3's materials to Mitsuba's BSDFs, where pbrt-v4 has others. Called by `material_table.py`.

The correspondence is that of pbrt-v4's own `--upgrade`, or closer where Mitsuba has the material itself.
"""

from collections.abc import Callable

import numpy as np

from isonoise.scene.formats.pbrt.materials import (
    MaterialContext,
    diffuse,
    eta,
    measured,
    metal,
    plastic,
    subsurface,
    thin_sheet,
    two_sided,
)
from isonoise.scene.formats.pbrt.parameters import Parameters


def legacy_alpha(roughness: np.ndarray) -> np.ndarray:
    """pbrt-v3's alpha of a roughness (TrowbridgeReitzDistribution::RoughnessToAlpha)."""
    x = np.log(np.maximum(roughness, 1e-3))
    return 1.62142 + x * (0.819955 + x * (0.1734 + x * (0.0171201 + x * 0.000640711)))


def matte(parameters: Parameters, context: MaterialContext) -> dict:
    """`matte`."""
    return diffuse(parameters, context, "Kd")


def legacy_plastic(parameters: Parameters, context: MaterialContext, index: float = 1.5) -> dict:
    """`plastic` and `substrate`: a diffuse base below a coat of this index of refraction."""
    context.report.use("diffuse")
    context.report.use("specular")
    specular = context.textures.mean(context.textures.colour(parameters, "Ks", 0.25))
    base = context.textures.colour(parameters, "Kd", 0.25)
    alphas = context.alphas(parameters, legacy_alpha, 0.1)
    if not specular.any():
        return two_sided({"type": "diffuse", "reflectance": context.textures.to_colour(base)})
    place = parameters.position.place
    context.report.limit("specular", "pbrt-v3's diffuse and glossy layers become a coat over a base", place)
    return plastic(base, index, alphas, place, context)


def legacy_metal(parameters: Parameters, context: MaterialContext) -> dict:
    """`metal`."""
    return metal(parameters, context, context.alphas(parameters, legacy_alpha, 0.01))


def mirror(parameters: Parameters, context: MaterialContext) -> dict:
    """`mirror`: a perfect mirror times Kr."""
    context.report.use("metal")
    factor = context.textures.to_colour(context.textures.colour(parameters, "Kr", 0.9))
    return two_sided({"type": "conductor", "material": "none", "specular_reflectance": factor})


def glass(parameters: Parameters, context: MaterialContext) -> dict:
    """`glass`."""
    context.report.use("transmission")
    index = _index(parameters, context)
    roughness = context.roughness(_glass_alphas(parameters, context)) if index != 1 else {}
    factors = {}
    for name, factor in (("Kr", "specular_reflectance"), ("Kt", "specular_transmittance")):
        if name in parameters:
            factors[factor] = context.textures.to_colour(context.textures.colour(parameters, name, 1.0))
    kind = "roughdielectric" if roughness else "dielectric"
    return {"type": kind, "int_ior": index, "ext_ior": 1.0, **factors, **roughness}


def _index(parameters: Parameters, context: MaterialContext) -> float:
    return eta(parameters, "eta" if "eta" in parameters else "index", 1.5, context)


def _glass_alphas(parameters: Parameters, context: MaterialContext):
    """Glass is smooth unless a roughness is given: the remapping of 0 is not 0."""
    if any(name in parameters for name in ("uroughness", "vroughness", "roughness")):
        return context.alphas(parameters, _legacy_alpha_or_smooth)
    return np.zeros(3), np.zeros(3)


def _legacy_alpha_or_smooth(roughness: np.ndarray) -> np.ndarray:
    return np.where(roughness == 0, 0.0, legacy_alpha(roughness))


def uber(parameters: Parameters, context: MaterialContext) -> dict:
    """`uber`: a coat over a diffuse base, with an opacity."""
    place = parameters.position.place
    for name in ("Kr", "Kt"):
        if name in parameters and context.textures.mean(context.textures.colour(parameters, name, 0.0)).any():
            context.report.limit("specular", f"'{name}' of the material uber is ignored", place)
    inner = legacy_plastic(parameters, context, _index(parameters, context))
    opacity = context.textures.colour(parameters, "opacity", 1.0)
    if isinstance(opacity, np.ndarray) and (opacity == 1).all():
        return inner
    context.report.use("opacity")
    return {"type": "mask", "opacity": context.textures.to_number(opacity), "bsdf": inner}


def translucent(parameters: Parameters, context: MaterialContext) -> dict:
    """`translucent`: its diffuse part."""
    place = parameters.position.place
    if not ("Ks" in parameters and not context.textures.mean(context.textures.colour(parameters, "Ks", 0.25)).any()):
        context.report.limit("transmission", "the glossy part of the material translucent is ignored", place)
    parameters.ignore("roughness", "remaproughness")
    base = context.textures.colour(parameters, "Kd", 0.25)
    parts = [
        context.textures.map("product", lambda a, b: a * b, base, context.textures.colour(parameters, name, 0.5))
        for name in ("reflect", "transmit")
    ]
    return thin_sheet(*parts, 1.0, place, context)


def disney(parameters: Parameters, context: MaterialContext) -> dict:
    """`disney`: Mitsuba's principled BSDF is the same model."""
    names = {"roughness": 0.5, "anisotropic": 0.0, "metallic": 0.0, "spectrans": 0.0, "speculartint": 0.0}
    names |= {"sheen": 0.0, "sheentint": 0.5, "clearcoat": 0.0, "clearcoatgloss": 1.0}
    renamed = {"spectrans": "spec_trans", "speculartint": "spec_tint", "sheentint": "sheen_tint"}
    renamed |= {"clearcoatgloss": "clearcoat_gloss"}
    bsdf = {
        "type": "principled",
        "base_color": context.textures.to_colour(context.textures.colour(parameters, "color", 0.5)),
        "eta": eta(parameters, "eta", 1.5, context),
    }
    for name, default in names.items():
        number = context.textures.to_number(context.textures.number(parameters, name, default))
        bsdf[renamed.get(name, name)] = min(max(number, 0.0), 1.0) if isinstance(number, float) else number
    if parameters.boolean("thin", False):
        context.report.limit("transmission", "'thin' of the material disney is ignored", parameters.position.place)
    if context.textures.mean(context.unbounded(parameters, "scatterdistance", np.zeros(3))).any():
        problem = "'scatterdistance' of the material disney is ignored: the surface is diffuse"
        context.report.limit("measured_materials", problem, parameters.position.place)
    parameters.ignore("flatness", "difftrans")  # only thin surfaces have them
    context.report.use("diffuse")
    is_opaque = bsdf["spec_trans"] == 0
    return two_sided(bsdf) if is_opaque else bsdf


LEGACY_MATERIALS: dict[str, Callable[[Parameters, MaterialContext], dict]] = {
    "matte": matte,
    "plastic": legacy_plastic,
    "substrate": legacy_plastic,
    "metal": legacy_metal,
    "mirror": mirror,
    "glass": glass,
    "uber": uber,
    "translucent": translucent,
    "disney": disney,
    "fourier": measured,
    "kdsubsurface": subsurface,
}
"""By pbrt-v3's names."""
