"""Maps the lights of KHR_lights_punctual to Mitsuba 3's emitters. Called by `read.py`.

Units are as in the file: candela become W / sr and lux become W / m².
"""

import math
from collections.abc import Callable

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.gltf.document import Document
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.nodes import PlacedNode
from isonoise.scene.formats.mesh_shape import rgb
from isonoise.scene.formats.report import ImportReport

_EXTENSION = "KHR_lights_punctual"
_MAX_INTENSITY, _MAX_CHANNEL = 1e30, 1e6  # products stay within 32-bit floats
_MAX_CUTOFF_DEGREES = 89.99
_MIN_TRANSITION = 1e-6  # radians between inner and outer cone: less is a hard edge


def emitter(placed: PlacedNode, document: Document, report: ImportReport) -> dict | None:
    """The emitter of a node; None if it has none or emits nothing."""
    reference = placed.node.extension(_EXTENSION)
    if reference is None:
        return None
    listed = document.root.extension(_EXTENSION)
    lights = listed.objects("lights") if listed else []
    index = reference.integer("light")
    if index >= len(lights):
        reference.fail("light", f"there is no light {index}; the file has {len(lights)}")
    light = lights[index]
    kind = light.string("type", choices=("point", "spot", "directional"))
    report.use(f"{kind}_lights", placed.name)
    report.count("lights")
    intensity = light.number("intensity", 1.0, 0.0, _MAX_INTENSITY)
    channels = [min(channel, _MAX_CHANNEL) * intensity for channel in light.numbers("color", 3, (1.0,) * 3)]
    if not max(channels) > 0:
        return None
    if kind != "directional" and "range" in light:
        report.limit(f"{kind}_lights", "its range is ignored: light falls off with the square of distance", placed.name)
    colour = rgb(max(channel, 0.0) for channel in channels)
    if kind == "point":
        return {"type": "point", "intensity": colour, "position": placed.to_world[:3, 3].tolist()}
    if kind == "spot":
        return {"type": "spot", "intensity": colour, "to_world": _to_world(placed), **_cone(light, placed, report)}
    return {"type": "directional", "irradiance": colour, "to_world": _to_world(placed)}


def _to_world(placed: PlacedNode) -> np.ndarray:
    """Mitsuba 3's lights shine along +z, glTF's along -z. The node's scale does not matter."""
    back, origin = placed.to_world[:3, 2:].T
    try:
        return transforms.look_at(origin, origin - back / np.linalg.norm(back))
    except (ValueError, FloatingPointError):
        placed.node.fail("", "the transform of its light has no orientation")


def _cone(light: JsonObject, placed: PlacedNode, report: ImportReport) -> dict:
    """The angles of a spot.

    Between inner and outer cone glTF's intensity is the square of a linear function of the cosine. Mitsuba 3's is
    linear in the angle from beam_width to cutoff_angle; the latter is chosen so that the power is the same.
    """
    spot = light.object("spot")
    inner = spot.number("innerConeAngle", 0.0, 0.0, math.pi / 2) if spot else 0.0
    outer = spot.number("outerConeAngle", math.pi / 4, 0.0, math.pi / 2 + 1e-6) if spot else math.pi / 4
    if inner > outer or outer == 0:
        spot.fail("innerConeAngle", "it has to be smaller than outerConeAngle")
    cutoff = outer
    if outer - inner > _MIN_TRANSITION:
        problem = "the falloff between its inner and outer cone is linear in the angle, with the same power"
        report.limit("spot_lights", problem, placed.name)
        power = 1.0 - math.cos(inner) + (math.cos(inner) - math.cos(outer)) / 3.0  # over 2 pi
        cutoff = _bisect(lambda angle: 1.0 - (math.sin(angle) - math.sin(inner)) / (angle - inner), power, inner, outer)
    cutoff_degrees = min(math.degrees(cutoff), _MAX_CUTOFF_DEGREES)
    return {"cutoff_angle": cutoff_degrees, "beam_width": min(math.degrees(inner), cutoff_degrees)}


def _bisect(function: Callable[[float], float], value: float, low: float, high: float) -> float:
    """Where an increasing function has a value, to 2^-30 of the interval; its end nearest to it if it is not inside."""
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < value else (low, middle)
    return high
