"""Lights of a scene: one record per emissive primitive or emitter, picked in proportion to their power."""

import math

import numpy as np

from isonoise.scene import structs
from isonoise.scene.spectra import MITSUBA_LUMINANCE, colour_to_rgb

_EXPONENT = 1000  # within float64
_KINDS = {
    structs.ANALYTIC_SPHERE: structs.LIGHT_SPHERE,
    structs.ANALYTIC_DISK: structs.LIGHT_DISK,
    structs.ANALYTIC_CYLINDER: structs.LIGHT_CYLINDER,
}
_VALUES = {
    "area": "radiance",
    "constant": "radiance",
    "point": "intensity",
    "spot": "intensity",
    "directional": "irradiance",
}


def emitted(emitter: dict) -> np.ndarray:
    """Linear RGB (3,) float64 of what an emitter emits, in its own unit."""
    return colour_to_rgb(emitter[_VALUES[emitter["type"]]], "radiance")


def radiance_scale(values: list[np.ndarray]) -> float:
    """2^-floor(log2(max luminance)): brings the brightest emitter into [1, 2). 1 without light."""
    brightest = max((float(value @ MITSUBA_LUMINANCE) for value in values), default=0.0)
    if not brightest > 0:
        return 1.0
    return 2.0 ** min(max(1 - math.frexp(brightest)[1], -_EXPONENT), _EXPONENT)


def surface_lights(kind: int | None, first: int, areas: np.ndarray, value: np.ndarray, texture: int) -> np.ndarray:
    """Lights of an emissive shape's primitives, in their order. `kind` is the analytic kind, None for triangles."""
    lights = np.zeros(len(areas), structs.LIGHT)
    lights["kind"] = structs.LIGHT_TRIANGLE if kind is None else _KINDS[kind]
    lights["primitive"] = first + np.arange(len(areas))
    lights["area"] = areas
    lights["radiance"] = value
    lights["texture"] = texture
    return lights


def emitter_light(emitter: dict, value: np.ndarray) -> np.ndarray:
    """The light (1,) of an emitter without surface."""
    light = np.zeros(1, structs.LIGHT)
    light["primitive"] = structs.NONE
    light["radiance"] = value
    light["texture"] = structs.NONE
    to_world = emitter.get("to_world", np.eye(4))
    if emitter["type"] == "point":
        light["kind"] = structs.LIGHT_POINT
        light["position"] = emitter.get("position", to_world[:3, 3])
    elif emitter["type"] == "spot":
        light["kind"] = structs.LIGHT_SPOT
        light["position"] = to_world[:3, 3]
        light["axis"] = to_world[:3, 2] / np.linalg.norm(to_world[:3, 2])
        cutoff = np.radians(emitter["cutoff_angle"])
        light["cutoff"] = cutoff
        beam = np.radians(emitter.get("beam_width", 0.75 * emitter["cutoff_angle"]))  # Mitsuba 3's default
        light["inverse_transition"] = 1.0 / max(cutoff - beam, 1e-6)  # a hard edge is one of a millionth of a radian
    elif emitter["type"] == "directional":
        light["kind"] = structs.LIGHT_DIRECTIONAL
        direction = np.asarray(emitter.get("direction", to_world[:3, 2]), float)
        light["position"] = direction / np.linalg.norm(direction)
    elif emitter["type"] == "envmap":
        light["kind"] = structs.LIGHT_ENVIRONMENT_MAP
    else:
        light["kind"] = structs.LIGHT_CONSTANT
    return light


def light_selection_pmf(lights: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Probabilities (l,) float64 in proportion to power, summing to 1.

    Power is pi A L for a surface, 4 pi I for a point, that of the cone for a spot; directional and constant light count
    what enters the sphere around the scene: pi r^2 E and 4 pi^2 r^2 L, as in pbrt's and Mitsuba's power light samplers.
    All zero is uniform.
    """
    radius = bounding_radius(bounds)
    factor = np.pi * lights["area"].astype(np.float64)
    factor[lights["kind"] == structs.LIGHT_POINT] = 4.0 * np.pi
    spot = lights["kind"] == structs.LIGHT_SPOT
    factor[spot] = spot_solid_angle(lights[spot])
    factor[lights["kind"] == structs.LIGHT_DIRECTIONAL] = np.pi * radius**2
    factor[np.isin(lights["kind"], (structs.LIGHT_CONSTANT, structs.LIGHT_ENVIRONMENT_MAP))] = (
        4.0 * np.pi**2 * radius**2
    )
    power = factor * (lights["radiance"].astype(np.float64) @ MITSUBA_LUMINANCE)
    largest = power.max()
    if not largest > 0:
        return np.full(len(lights), 1.0 / len(lights))
    power /= largest  # the sum of a million powers of 1e38 is still a number
    return power / power.sum()


def bounding_radius(bounds: np.ndarray) -> float:
    """Radius of the sphere around a box (2, 3); 1 if it is a point."""
    return 0.5 * float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0


def spot_solid_angle(spots: np.ndarray) -> np.ndarray:
    """Solid angle (n,) float64 that has the power of spots of intensity 1: the mean of that of the beam and all."""
    cutoff = spots["cutoff"].astype(np.float64)
    beam = cutoff - 1.0 / spots["inverse_transition"]
    return 2.0 * np.pi * (1.0 - 0.5 * (np.cos(beam) + np.cos(cutoff)))
