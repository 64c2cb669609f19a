"""Compiles the emitters of a scene to light records and the table that selects among them.

Called by `scene/compile.py`. Radiance is scaled so that the brightest emitter lies in [1, 2).
"""

import warnings
from dataclasses import dataclass

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene import structs
from isonoise.scene.accel.ploc import morton_order
from isonoise.scene.light import lights as lighting
from isonoise.scene.light.envmap import EnvironmentMap
from isonoise.scene.light.light_kinds import bits_where, kind_of_analytic, light_bits
from isonoise.scene.light.parallelograms import find_parallelograms
from isonoise.scene.material.textures import Textures, is_constant
from isonoise.scene.mesh.surfaces import Surfaces

ANALYTIC_LIGHTS = bits_where(lambda kind: kind.analytic is not None)
_LIGHTS_AT_INFINITY = bits_where(lambda kind: kind.is_environment) | light_bits("directional")
_MAX_FLOAT32 = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class AreaLight:
    """A shape with an area emitter."""

    emitter: dict
    surface: Surfaces  # of this shape alone
    first_primitive: int  # index of its first triangle, or of its analytic primitive
    texture: int  # index of the radiance texture, NONE if the radiance is constant


@dataclass(frozen=True)
class CompiledLights:
    """All lights of a scene, neighbours in space next to each other; those at infinity last."""

    records: np.ndarray  # (L,) structs.LIGHT
    projections: np.ndarray  # (P,) structs.PROJECTION
    cdf: np.ndarray  # (L, 2), CompiledScene.light_cdf
    environment_light: int  # index of the constant or environment-map light, -1 if there is none
    radiance_scale: float


def radiance_texture(emitter: dict, textures: Textures) -> int:
    """Index of the texture of an area emitter's radiance, NONE if the radiance is constant."""
    return structs.NONE if is_constant(emitter["radiance"]) else textures.index(emitter["radiance"], "radiance")


def projected_texture(emitter: dict, textures: Textures) -> int:
    """Index of the texture that an emitter without surface projects, NONE if it projects none."""
    name = lighting.kind_of(emitter).texture
    return textures.index(emitter[name], "radiance") if name else structs.NONE


def compile_lights(
    area_lights: list[AreaLight],
    emitters: list[tuple[dict, int]],
    environment: EnvironmentMap | None,
    textures: Textures,
    bounds: np.ndarray,
) -> CompiledLights:
    """Make the light records.

    `emitters` are those without surface, each with its `projected_texture`; `bounds` (2, 3) is the box around the
    scene. Raises SceneError where radiance leaves the range of 32-bit floats.
    """
    area_values = [
        lighting.emitted(light.emitter) if light.texture == structs.NONE else textures.mean(light.texture)
        for light in area_lights
    ]
    emitted = [environment.mean if e["type"] == "envmap" else lighting.emitted(e) for e, _ in emitters]
    means = [1.0 if texture == structs.NONE else textures.mean(texture) for _, texture in emitters]
    values = [value * mean for value, mean in zip(emitted, means, strict=True)]
    if not any(np.any(value) for value in (*area_values, *values)):
        warnings.warn(
            "the scene has no light, so its image is black; add an emitter, or an environment with --env", stacklevel=3
        )
    peak = [np.full(3, environment.largest)] if environment else []
    scale = lighting.radiance_scale([*area_values, *values, *peak])
    parts = [_area_lights(light, value * scale) for light, value in zip(area_lights, area_values, strict=True)]
    factors = [np.full((len(records), 3), scale) for records, _ in parts]  # that the kernels multiply by a texture
    projections = np.zeros(0, structs.PROJECTION)
    for (emitter, texture), value, own in zip(emitters, values, emitted, strict=True):
        record, center = _emitter_light(emitter, value * scale)
        if texture != structs.NONE:
            record["primitive"], record["texture"] = len(projections), texture
            projections = np.append(projections, _project(record, emitter, textures.aspect(texture)))
        parts.append((record, center))
        factors.append(own[None] * scale)
    if not parts:
        return CompiledLights(np.zeros(0, structs.LIGHT), projections, np.zeros((0, 2), np.float32), -1, scale)
    records, centers = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = _spatial_order(centers)
    records, factors = records[order], np.concatenate(factors)[order]
    is_textured = records["texture"] != structs.NONE
    if not np.isfinite(records["radiance"]).all():
        raise SceneError("the colour of an emitter exceeds the range of 32-bit floats")
    if is_textured.any() and scale > _MAX_FLOAT32:
        raise_too_dim()
    is_environment = records["kind"] & bits_where(lambda kind: kind.is_environment) != 0
    cdf, records["power_pmf"] = lighting.light_power_cdf(lighting.light_power_pmf(records, bounds))
    if is_textured.any():
        records["radiance"][is_textured] = factors[is_textured]
    environment_light = int(np.flatnonzero(is_environment)[0]) if is_environment.any() else -1
    return CompiledLights(records, projections, cdf, environment_light, scale)


def raise_too_dim() -> None:
    raise SceneError("the lights are too dim: scaled radiance exceeds the range of 32-bit floats")


def _area_lights(light: AreaLight, radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Records (n,) of an emissive shape's lights, and their centers (n, 3)."""
    surface = light.surface
    if len(surface.analytics):
        name = kind_of_analytic(int(surface.analytics["kind"][0])).name
        records, centers = lighting.surface_lights(name, np.zeros(1), surface.areas()[0]), surface.boxes().mean(axis=1)
    else:
        records = _mesh_lights(surface)
        centers = surface.vertices[0][surface.faces[0, records["primitive"]]].mean(axis=1)
    records["primitive"] += np.uint32(light.first_primitive)
    records["radiance"], records["texture"] = radiance, light.texture
    return records, centers


def _mesh_lights(surface: Surfaces) -> np.ndarray:
    """Records of the lights of a mesh: parallelograms, then the other triangles."""
    (areas,) = surface.areas()
    first, apexes = find_parallelograms(surface.vertices[0], surface.faces[0])
    is_single = np.ones(len(areas), bool)
    is_single[first] = is_single[first + 1] = False
    single = np.flatnonzero(is_single)
    pairs = lighting.surface_lights("parallelogram", first, areas[first] + areas[first + 1])
    pairs["apexes"] = apexes[:, 0] + 4 * apexes[:, 1]
    return np.concatenate([pairs, lighting.surface_lights("triangle", single, areas[single])])


def _emitter_light(emitter: dict, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The record (1,) of an emitter without surface, and its center (1, 3), not finite if it has none."""
    record = lighting.emitter_light(emitter, value)
    is_at_infinity = record["kind"][0] & _LIGHTS_AT_INFINITY
    return record, np.full((1, 3), np.inf) if is_at_infinity else record["position"].astype(float)


def _project(record: np.ndarray, emitter: dict, aspect: float) -> np.ndarray:
    """The structs.PROJECTION (1,) of an emitter's texture; sets what its light (1,) needs of it."""
    projection = lighting.kind_of(emitter).project(emitter, aspect)
    for member, number in projection.members.items():
        record[member] = number
    result = np.zeros(1, structs.PROJECTION)
    result["to_uv"] = projection.to_uv.ravel()
    return result


def _spatial_order(centers: np.ndarray) -> np.ndarray:
    """Order of lights with centers (n, 3) along a Morton curve; those without a center last.

    The inverse CDF maps stratified random numbers to lights in this order, so near numbers select near lights.
    """
    is_finite = np.isfinite(centers).all(axis=1)
    finite, others = np.flatnonzero(is_finite), np.flatnonzero(~is_finite)
    if not len(finite):
        return others
    corners = centers[finite].T.astype(float)
    return np.concatenate([finite[morton_order(corners, corners)], others])
