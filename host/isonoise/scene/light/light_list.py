"""Builds the list of light bounds that selects one of a few lights for next-event estimation.

Read by kernels/light/light_list.h. The bounds are those of the leaves of a light tree (`light_tree.py`); for few lights
a loop over all of them is faster than a traversal.
"""

import numpy as np

from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_tree import MIN_POWER_SHARE
from isonoise.scene.light.lights import compute_light_bounds

MAX_LISTED_LIGHTS = 32
_MIN_SQUARED_DISTANCE = 1e-30
"""Smallest squared distance that is distinguished, relative to the squared size of the scene: keeps weights finite."""


def use_light_list(lights: np.ndarray) -> bool:
    """Whether structs.LIGHT records are few enough for a list instead of a tree."""
    return len(lights) <= MAX_LISTED_LIGHTS


def build_light_list(scene: CompiledScene) -> np.ndarray:
    """structs.LIGHT_BOUND of all lights, (lights,); zeros for lights without power."""
    with_power = np.flatnonzero(scene.lights["power_pmf"])
    lights = compute_light_bounds(scene, scene.lights[with_power])
    squared_size = float((np.ptp(scene.bounds.astype(np.float64), axis=0) ** 2).sum()) or 1.0
    share = np.maximum(lights.intensity / lights.intensity.sum(), MIN_POWER_SHARE)
    fields = {
        "center": lights.center.T,
        "radius": lights.padded_radius(),
        "axis": lights.axis.T,
        "cos_spread": np.cos(lights.spread),
        "sin_spread": np.where(lights.spread > 0, np.sin(lights.spread), 0.0),
        "cos_edge": np.cos(lights.edge),
        "power_fraction": share,
        "intensity": share * squared_size,
        "max_irradiance": share
        * squared_size
        / np.maximum(0.25 * lights.radius**2, _MIN_SQUARED_DISTANCE * squared_size),
    }
    bounds = np.zeros(len(scene.lights), structs.LIGHT_BOUND)
    for name, values in fields.items():
        bounds[name][with_power] = values
    return bounds
