"""Completes the scene of a model: a camera that frames it, a ground and a studio around it. Called by `load`.

The rules are in host/docs/scenes.md. The camera is found by `framing.py`, the light by `studio.py`.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.framing import Extent, find_extent, frame, three_quarter_direction, turn_to
from isonoise.scene.formats.model_lights import brightness_by_own_lights, has_lamp
from isonoise.scene.formats.studio import GROUND_REFLECTANCE, WHITE, meter, studio_image
from isonoise.scene.image.image import Image, read_image
from isonoise.scene.material.bsdf_kinds import KIND_OF_PLUGIN
from isonoise.scene.view import (
    View,
    environment_map,
    find_camera,
    is_environment,
    move_camera,
    resized,
    rotation_from_y,
    sensors_of,
)

_IMAGE_SIZE = (512, 512)
_LENS_DEGREES = 46.8  # angle of view along the diagonal: that of a 50 mm lens of a 35 mm camera
_FILM = {"type": "hdrfilm", "width": _IMAGE_SIZE[0], "height": _IMAGE_SIZE[1], "rfilter": {"type": "gaussian"}}
_SAMPLER = {"type": "multijitter", "sample_count": 64}
_MAX_DEPTH = 16
_GROUND_SIZE = 20.0  # half its side, in the model's sizes
_GROUND_GAP = 1e-3  # between model and ground, in the model's sizes: a floor of the model stays in sight
_MIN_OWN_BRIGHTNESS = 0.1 * WHITE
"""Brightness by a model's own lights from which on they light it, and not the studio."""
_FILL_SHARE = 0.1  # light of the environment around a model that is lit by its own lights, in the light of those


class _Pose(NamedTuple):
    """How the model stands before the camera."""

    extent: Extent
    to_world: np.ndarray  # (3, 3): rotates y to the model's up
    position: np.ndarray  # of the camera
    to_camera: np.ndarray  # unit vector from the model to the camera


class StagedScene(NamedTuple):
    """What `stage` returns."""

    scene: dict  # complete
    added: list[str]  # what the model lacked, for people
    bounds: np.ndarray  # (2, 3): of the model alone


def stage(
    scene: Mapping, file: str, view: View, size: tuple[int, int] | None, up: tuple[float, float, float]
) -> StagedScene:
    """The scene of a model with what it lacks: integrator, camera, ground, environment.

    Parameters
    ----------
    scene : dict of a reader
    file : names the model in errors
    view : what the caller wants to see
    size : width and height of the image; None: those of the model's camera, else `_IMAGE_SIZE`
    up : direction that is up unless `view` has another

    Raises SceneError if the model has no extent, UserError if `view` does not fit it.
    """
    extent, to_world = find_extent(scene, file), rotation_from_y(view.up or up)
    sensors = sensors_of(scene)
    added, bounds = [], np.stack([extent.low, extent.high])
    if sensors or view.camera is not None:
        name, sensor = find_camera(sensors, view.camera)
    else:
        added.append("a camera that frames the model")
        name, sensor = "sensor", _framing_sensor(extent, view, size or _IMAGE_SIZE, to_world)
    sensor = {"film": _FILM, "sampler": _SAMPLER, **move_camera(sensor, view)}
    if size is not None:
        sensor["film"] = resized(sensor["film"], size)
    others = {key: part for key, part in scene.items() if key not in sensors}
    integrator = "volpath" if has_volumes(others) else "path"
    staged = {"type": "scene", "integrator": {"type": integrator, "max_depth": _MAX_DEPTH}, **others}
    if view.env is None and any(map(is_environment, scene.values())):
        return StagedScene({**staged, name: sensor}, added, bounds)
    added.append("a studio" if view.env is None else f"the environment {view.env}")
    staged = {key: part for key, part in staged.items() if not is_environment(part)}
    pose = _pose(extent, to_world, sensor)
    own_brightness = brightness_by_own_lights(scene, extent, pose.to_camera)
    if own_brightness > _MIN_OWN_BRIGHTNESS:
        share = _FILL_SHARE if view.env is None else 1.0
        staged[_unused("environment", staged)] = _environment(view, pose, share * own_brightness, has_ground=False)
        added[-1] += f", which adds {100 * share:.0f} % to the model's own lights"
    else:
        has_ground = _can_have_ground(pose) and not has_lamp(scene)  # the ground would make it a rarely sampled light
        staged[_unused("environment", staged)] = _environment(view, pose, WHITE, has_ground)
        if has_ground:
            added.append("a ground")
            staged[_unused("ground", staged)] = _ground(extent, to_world)
        sensor["film"] = {"exposure": 1.0, **sensor["film"]}
    return StagedScene({**staged, _unused(name, staged): sensor}, added, bounds)


def has_volumes(scene: Mapping) -> bool:
    """Whether there are media or surfaces that light passes straight: the shadow rays of `path` end there."""
    queue, visited = [scene], set()
    while queue:
        part = queue.pop()
        if id(part) not in visited:
            visited.add(id(part))
            kind = KIND_OF_PLUGIN.get(part.get("type"))
            if "interior" in part or (kind and kind.passes_through):
                return True
            queue += [value for value in part.values() if isinstance(value, Mapping)]
    return False


def _framing_sensor(extent: Extent, view: View, size: tuple[int, int], to_world: np.ndarray) -> dict:
    """A camera that frames the model in an image of this size."""
    width, height = size
    if view.fov is None:
        half_diagonal = math.tan(math.radians(_LENS_DEGREES / 2))
        tangent = half_diagonal * width / math.hypot(width, height)
    else:
        tangent = math.tan(math.radians(view.fov / 2))
    to_camera = three_quarter_direction(extent, to_world)
    matrix = frame(extent, to_camera, to_world[:, 1], (tangent, tangent * height / width))
    distance = float(np.linalg.norm(matrix[:3, 3] - extent.center))
    return {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(tangent)),
        "fov_axis": "x",
        "near_clip": 1e-3 * min(extent.size, distance),
        "far_clip": distance + 1e3 * extent.size,
        "to_world": matrix,
    }


def _pose(extent: Extent, to_world: np.ndarray, sensor: Mapping) -> _Pose:
    camera = np.asarray(sensor.get("to_world", np.eye(4)), float)
    forward = camera[:3, 2] / np.linalg.norm(camera[:3, 2])
    return _Pose(extent, to_world, camera[:3, 3], -forward)


def _can_have_ground(pose: _Pose) -> bool:
    """Whether the camera is outside the box around the model, and above its lowest point, so that it looks down."""
    extent, up = pose.extent, pose.to_world[:, 1]
    is_inside = ((pose.position >= extent.low) & (pose.position <= extent.high)).all()
    return not is_inside and float(pose.position @ up) > _lowest(extent, up)


def _lowest(extent: Extent, up: np.ndarray) -> float:
    """Height of the ground."""
    return float((extent.points @ up).min()) - _GROUND_GAP * extent.size


def _ground(extent: Extent, to_world: np.ndarray) -> dict:
    """A horizontal square below the model."""
    up = to_world[:, 1]
    center = extent.center + (_lowest(extent, up) - extent.center @ up) * up
    matrix = (
        transforms.translate(center) @ transforms.rotation_from_z(up) @ transforms.scale(_GROUND_SIZE * extent.size)
    )
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": GROUND_REFLECTANCE}}
    return {"type": "rectangle", "to_world": matrix, "bsdf": bsdf}


def _environment(view: View, pose: _Pose, brightness: float, has_ground: bool) -> dict:
    """The studio, turned to the camera, or the view's image; scaled to this brightness of a white diffuse sphere."""
    if view.env is None:
        image, emitter = Image(studio_image()), {"type": "envmap"}
        emitter["to_world"] = _affine(pose.to_world @ turn_to(pose.to_world.T @ pose.to_camera))
    else:
        image, emitter = read_image(view.env), environment_map(view)
        del emitter["filename"]
        emitter["to_world"] = _affine(pose.to_world)
    rotation = emitter["to_world"][:3, :3]
    reflectance = GROUND_REFLECTANCE if has_ground else None
    level = meter(image.linear(), rotation.T @ pose.to_camera, reflectance)
    return emitter | {"bitmap": image, "scale": brightness / level if level > 0 else 1.0}


def _affine(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def _unused(name: str, scene: Mapping) -> str:
    """The name, or with a number behind it if the scene has it."""
    number, unused = 1, name
    while unused in scene:
        number, unused = number + 1, f"{name}_{number}"
    return unused
