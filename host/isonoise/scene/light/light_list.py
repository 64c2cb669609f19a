"""Bounds of the lights of a scene, by which next-event estimation picks one of some (kernels/light/light_list.h).

They are those of the leaves of a tree of lights (scene/light_tree.py); a loop over few is faster than a walk.
"""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_bounds import compute_light_bounds
from isonoise.scene.light.light_tree import MIN_POWER_SHARE

MAX_LISTED_LIGHTS = 32
"""Lights up to which the list is used."""
_NEAREST = 1e-30
"""Square of the least distance that counts, in sizes of the scene: keeps weights finite."""


def use_light_list(lights: np.ndarray) -> bool:
    """Whether these LIGHT records are so few that a list is better than a tree."""
    return len(lights) <= MAX_LISTED_LIGHTS


def build_light_list(scene: CompiledScene) -> np.ndarray:
    """structs.LIGHT_BOUND of all lights, (lights,); of those without power all is 0."""
    bright = np.flatnonzero(scene.lights["selection_pmf"])
    of = compute_light_bounds(scene, scene.lights[bright])
    center = 0.5 * (of.lower + of.upper)
    size2 = float((np.ptp(scene.bounds.astype(np.float64), axis=0) ** 2).sum()) or 1.0
    share = np.maximum(of.intensity / of.intensity.sum(), MIN_POWER_SHARE)
    bounds = np.zeros(len(scene.lights), structs.LIGHT_BOUND)
    entries = {
        "center": center.T,
        "radius": of.radius + 2.0**-22 * np.abs(center).max(axis=0),  # the middle is rounded
        "axis": of.axis.T,
        "cos_spread": np.cos(of.spread),
        "sin_spread": np.where(of.spread > 0, np.sin(of.spread), 0.0),
        "cos_edge": np.cos(of.edge),
        "share": share,
        "intensity": share * size2,
        "most": share * size2 / np.maximum(0.25 * of.radius**2, _NEAREST * size2),
    }
    for name, values in entries.items():
        bounds[name][bright] = values
    return bounds
