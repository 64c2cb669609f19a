"""Maps glTF cameras to Mitsuba 3's sensors. Called by `read.py`."""

import math

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.formats.gltf.nodes import PlacedNode
from isonoise.scene.formats.report import ImportReport

_FILM_HEIGHT = 512  # pixels, of a camera that states its aspect ratio
_MAX_FILM_SIDE = 4096
_FAR = 1e10  # far_clip of cameras that see to infinity
_MAX_CLIP = 1e30


def sensor(camera: JsonObject, placed: PlacedNode, report: ImportReport) -> dict:
    """The sensor of a camera at a node. Without an aspect ratio in the file, it has no film."""
    report.use("cameras", placed.name)
    report.count("cameras")
    kind = camera.string("type", choices=("perspective", "orthographic"))
    lens = camera.object(kind)
    if lens is None:
        camera.fail(kind, "it is missing")
    result = {"type": kind, "to_world": _to_world(placed, report), **_clip(lens)}
    if kind == "perspective":
        result |= {"fov": math.degrees(lens.number("yfov", low=1e-6, high=math.pi - 1e-6)), "fov_axis": "y"}
        aspect = lens.number("aspectRatio", None, 1e-6, 1e6)
    else:
        # the image of an orthographic sensor is 2 wide before to_world scales it
        half_width, half_height = (abs(lens.number(name)) for name in ("xmag", "ymag"))
        if not (1e-20 < half_width < 1e20 and 1e-20 < half_height < 1e20):
            lens.fail("xmag", "xmag and ymag have to differ from 0")
        result["to_world"] = result["to_world"] @ transforms.scale((half_width, half_width, 1.0))
        aspect = half_width / half_height
    if aspect is not None:
        result["film"] = _film(aspect)
    return result


def _clip(lens: JsonObject) -> dict:
    near = max(lens.number("znear", 0.0, 0.0, _MAX_CLIP), 1e-6)
    far = lens.number("zfar", 0.0, 0.0, _MAX_CLIP) or _FAR
    if far <= near:
        lens.fail("zfar", "it has to exceed znear")
    return {"near_clip": near, "far_clip": far}


def _to_world(placed: PlacedNode, report: ImportReport) -> np.ndarray:
    """Camera to world: glTF looks along -z with x to the right, Mitsuba 3 along +z with x to the left.

    The node's scale is left out.
    """
    right, up, back, origin = placed.to_world[:3].T
    if np.dot(np.cross(right, up), back) < 0:
        report.limit("cameras", "its transform mirrors; the image is not mirrored", placed.name)
    try:
        return transforms.look_at(origin, origin - back / np.linalg.norm(back), up)
    except (ValueError, FloatingPointError):
        placed.node.fail("", "the transform of its camera has no orientation")


def _film(aspect: float) -> dict:
    """A film of this ratio of width to height, 512 pixels high unless it is very wide."""
    height = min(_FILM_HEIGHT, max(1, round(_MAX_FILM_SIDE / aspect)))
    width = min(_MAX_FILM_SIDE, max(1, round(height * aspect)))
    return {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "gaussian"}}
