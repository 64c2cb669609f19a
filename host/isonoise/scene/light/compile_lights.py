"""Compiles the emitters of a scene to light records and the table that selects among them.

Called by `scene/compile.py`. Radiance is scaled so that the brightest emitter lies in [1, 2).
"""

from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.light import lights as lighting
from isonoise.scene.light.envmap import EnvironmentMap
from isonoise.scene.light.light_kinds import bits_where
from isonoise.scene.material.textures import Textures, is_constant
from isonoise.scene.mesh.surfaces import Surface

_MAX_FLOAT32 = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class AreaLight:
    """A shape with an area emitter."""

    emitter: dict
    surface: Surface
    first_primitive: int  # index of its first triangle, or of its analytic primitive
    texture: int  # index of the radiance texture, NONE if the radiance is constant


@dataclass(frozen=True)
class CompiledLights:
    """All lights of a scene: those of area lights first, then the emitters without a surface."""

    records: np.ndarray  # (L,) structs.LIGHT
    cdf: np.ndarray  # (L,) uint64, CompiledScene.light_cdf
    first_light: np.ndarray  # (area lights,) uint32: index of each area light's first record
    environment_light: int  # index of the constant or environment-map light, -1 if there is none
    radiance_scale: float


def radiance_texture(emitter: dict, textures: Textures) -> int:
    """Index of the texture of an area emitter's radiance, NONE if the radiance is constant."""
    return structs.NONE if is_constant(emitter["radiance"]) else textures.index(emitter["radiance"], "radiance")


def compile_lights(
    area_lights: list[AreaLight],
    emitters: list[dict],
    environment: EnvironmentMap | None,
    textures: Textures,
    bounds: np.ndarray,
) -> CompiledLights:
    """Make the light records. `bounds` (2, 3) is the box around the scene.

    Raises SceneError where radiance leaves the range of 32-bit floats.
    """
    area_values = [
        lighting.emitted(light.emitter) if light.texture == structs.NONE else textures.mean(light.texture)
        for light in area_lights
    ]
    values = [environment.mean if e["type"] == "envmap" else lighting.emitted(e) for e in emitters]
    peak = [np.full(3, environment.largest)] if environment else []
    scale = lighting.radiance_scale([*area_values, *values, *peak])
    parts = [_area_records(light, value * scale) for light, value in zip(area_lights, area_values, strict=True)]
    first_light = np.cumsum([0, *map(len, parts)])[:-1].astype(np.uint32)
    parts += [lighting.emitter_light(e, value * scale) for e, value in zip(emitters, values, strict=True)]
    if not parts:
        return CompiledLights(np.zeros(0, structs.LIGHT), np.zeros(0, np.uint64), first_light, -1, scale)
    records = np.concatenate(parts)
    is_textured = records["texture"] != structs.NONE
    if not np.isfinite(records["radiance"]).all():
        raise SceneError("the colour of an emitter exceeds the range of 32-bit floats")
    if is_textured.any() and scale > _MAX_FLOAT32:
        raise_too_dim()
    is_environment = records["kind"] & bits_where(lambda kind: kind.is_environment) != 0
    cdf, records["power_pmf"] = lighting.light_power_cdf(lighting.light_power_pmf(records, bounds))
    records["radiance"][is_textured] = scale  # the kernel multiplies it by the texture
    environment_light = int(np.flatnonzero(is_environment)[0]) if is_environment.any() else -1
    return CompiledLights(records, cdf, first_light, environment_light, scale)


def raise_too_dim() -> None:
    raise SceneError("the lights are too dim: scaled radiance exceeds the range of 32-bit floats")


def _area_records(light: AreaLight, radiance: np.ndarray) -> np.ndarray:
    analytic = light.surface.analytic
    kind = None if analytic is None else int(analytic["kind"][0])
    return lighting.surface_lights(kind, light.first_primitive, light.surface.areas, radiance, light.texture)
