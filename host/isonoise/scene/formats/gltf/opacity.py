"""Opacity and emission of glTF materials. Called by `materials.py`."""

import numpy as np

from isonoise.scene.formats.gltf.surface import SurfaceContext
from isonoise.scene.formats.mesh_shape import rgb

_PBR, _BASE = "pbrMetallicRoughness", "baseColorTexture"
_MAX_RADIANCE = 1e30
_MAX_CUTOFF = 2.0  # hides every alpha, like all above 1; huge ones would overflow in an image
VERTEX_ALPHA = "vertex_alpha"
"""Name of the attribute with the alpha of COLOR_0."""


def add_opacity(context: SurfaceContext, bsdf: dict) -> dict:
    """The BSDF inside masks: glTF's alphaMode BLEND is coverage, MASK compares alpha with a cutoff."""
    opacity = _opacity(context)
    masked = bsdf if opacity == 1 else {"type": "mask", "opacity": opacity, "bsdf": bsdf}
    if not (context.primitive.has_vertex_alpha and _mode(context) != "OPAQUE"):
        return masked
    if _mode(context) == "MASK":
        context.limit("opacity", "the alpha of vertices is not compared with the cutoff")
    attribute = {"type": "mesh_attribute", "name": VERTEX_ALPHA}
    return {"type": "mask", "opacity": attribute, "bsdf": masked}


def _mode(context: SurfaceContext) -> str:
    return context.material.values.string("alphaMode", "OPAQUE", ("OPAQUE", "MASK", "BLEND"))


def _opacity(context: SurfaceContext) -> float | dict:
    """A number or a texture of them, without the alpha of vertices."""
    texture = context.texture(_BASE)
    factor = context.material.factors(_PBR, "baseColorFactor", 4, 1.0)[3]
    if _mode(context) == "OPAQUE":
        return 1.0
    opacity = context.parameters.number(texture, 3, factor)
    if _mode(context) == "BLEND":
        return opacity
    cutoff = min(max(context.material.values.number("alphaCutoff", 0.5), 0.0), _MAX_CUTOFF)
    if not isinstance(opacity, dict):
        return float(opacity >= cutoff)
    bitmaps = context.parameters.bitmaps
    image = bitmaps.threshold(bitmaps.alpha(texture.image), cutoff, min(factor, 1.0))
    return context.parameters.show(texture, image, raw=True)


def emission(context: SurfaceContext) -> dict | None:
    """The `area` emitter: emissiveFactor times texture times KHR_materials_emissive_strength."""
    strength = context.material.factor("KHR_materials_emissive_strength", "emissiveStrength", 1.0)
    factors = np.array(context.material.factors("", "emissiveFactor", 3, 0.0)) * max(strength, 0.0)
    radiance = context.parameters.colour(context.texture("emissiveTexture"), factors, _MAX_RADIANCE)
    return emitter(context, "emissiveTexture", radiance)


def emitter(context: SurfaceContext, name: str, radiance: dict) -> dict | None:
    """The `area` emitter of a radiance, which may show the material's texture of this name; None if it is black.

    Nothing is emitted where the surface is transparent.
    """
    is_black = not any(radiance["value"]) if radiance["type"] == "rgb" else False
    if radiance["type"] == "bitmap":
        is_black = not radiance["bitmap"].pixels.any()
    return None if is_black else {"type": "area", "radiance": _covered(context, radiance, name)}


def _covered(context: SurfaceContext, radiance: dict, name: str) -> dict:
    """Radiance times opacity: Mitsuba 3 emits also where a mask is transparent."""
    opacity = _opacity(context)
    if opacity == 1:
        return radiance
    bitmaps, kind = context.parameters.bitmaps, radiance["type"]
    cover = bitmaps.clipped(opacity["bitmap"]) if isinstance(opacity, dict) else opacity
    if kind == "rgb" and cover is opacity:
        return rgb(np.multiply(radiance["value"], opacity))
    if kind == "rgb":
        image = bitmaps.scaled(cover, radiance["value"], raw=True)
        return context.parameters.show(context.texture(_BASE), image, raw=False)
    if kind == "bitmap" and cover is opacity:
        return radiance | {"bitmap": bitmaps.scaled(radiance["bitmap"], opacity)}
    is_similar = kind == "bitmap" and context.texture(name).sampling == context.texture(_BASE).sampling
    if is_similar and radiance["bitmap"].pixels.shape[:2] == cover.pixels.shape[:2]:
        return radiance | {"bitmap": bitmaps.product(radiance["bitmap"], cover)}
    context.limit("emission", "transparent parts emit too")
    return radiance
