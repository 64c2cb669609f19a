"""The scene dicts of one pbrt shape: geometry, material, opacity and emission. Called by `scene_builder.py`."""

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.mesh_shape import mesh_shape
from isonoise.scene.formats.pbrt.graphics_state import GraphicsState
from isonoise.scene.formats.pbrt.lights import Lights
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.pbrt.shapes import Geometry, ShapeReader
from isonoise.scene.formats.pbrt.surfaces_of_revolution import is_mirroring
from isonoise.scene.formats.pbrt.textures import Textures
from isonoise.scene.mesh.mesh import Mesh, smooth_normals

_SIDE_DISTANCE = 1e-4  # between the two sides of a two-sided light, relative to its size
_MIN_DETERMINANT = 1e-30


def make_shapes(
    kind: str,
    parameters: Parameters,
    state: GraphicsState,
    bsdf: dict,
    reader: ShapeReader,
    textures: Textures,
    lights: Lights,
    is_in_object: bool,
) -> list[dict]:
    """No shape if it is invisible or left out, two for a light that emits on both sides, otherwise one."""
    _check_transform(state.to_world, parameters)
    report = reader.report
    opacity = _opacity(parameters, state, textures, lights, report)
    emits = state.area_light is not None
    if emits and is_in_object:
        report.limit("emission", "lights inside objects do not emit, as in pbrt", parameters.position.place)
        emits = False
    has_image = has_texture(bsdf) or has_texture(opacity) or (emits and "filename" in state.area_light)
    geometry = reader.read(kind, parameters, state.to_world, state.reverse_orientation, has_image)
    if geometry is None or opacity == 0:
        return []
    if opacity != 1:
        report.use("opacity")
        bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
    shape = _shape(geometry, bsdf)
    report.count("shapes")
    if not emits:
        return [shape]
    emitter = lights.area_emitter(state.area_light, geometry.area, geometry.light_count)
    if not state.area_light.boolean("twosided", False):
        return [shape | {"emitter": emitter}]
    return [shape | {"emitter": emitter}, _shape(_other_side(geometry), bsdf) | {"emitter": emitter}]


def _check_transform(to_world: np.ndarray, parameters: Parameters) -> None:
    is_finite = np.isfinite(to_world).all() and np.abs(to_world).max() < 1e18
    is_affine = is_finite and (to_world[3] == (0, 0, 0, 1)).all()
    if not is_affine or abs(np.linalg.det(to_world[:3, :3])) < _MIN_DETERMINANT:
        parameters.position.raise_error("the current transform cannot be inverted, or is not affine")


def _opacity(parameters: Parameters, state: GraphicsState, textures: Textures, lights: Lights, report) -> float | dict:
    """The value of a mask; 1: there is none."""
    alpha = textures.number(parameters, "alpha", None)
    if "shadowalpha" in parameters and alpha is None:
        report.limit(
            "opacity", "'shadowalpha' is ignored: shadows are opaque", parameters.position_of("shadowalpha").place
        )
    parameters.ignore("shadowalpha")
    if alpha is None:
        return 1
    opacity = textures.to_number(alpha)
    if not isinstance(opacity, float):
        return opacity
    if opacity <= 0 and state.area_light is not None:
        report.limit("emission", "an invisible light (alpha 0) becomes visible", parameters.position.place)
        return 1
    return min(max(opacity, 0.0), 1.0)


def has_texture(value: dict | float) -> bool:
    """Whether a BSDF or a value uses texture coordinates."""
    if not isinstance(value, dict) or value["type"] == "rgb":
        return False
    return value["type"] in ("bitmap", "checkerboard") or any(has_texture(part) for part in value.values())


def _shape(geometry: Geometry, bsdf: dict) -> dict:
    if geometry.analytic is not None:
        return geometry.analytic | {"bsdf": bsdf}
    mesh = geometry.mesh
    return mesh_shape(mesh, bsdf, face_normals=not (len(mesh.normals) or geometry.smooth))


def _other_side(geometry: Geometry) -> Geometry:
    """The geometry with front and back swapped, a little behind it."""
    if geometry.analytic is not None:
        shape = dict(geometry.analytic)
        faces_inwards = shape["flip_normals"] != (shape["type"] == "sphere" and is_mirroring(shape["to_world"]))
        behind = _SIDE_DISTANCE if faces_inwards else -_SIDE_DISTANCE
        if shape["type"] == "disk":
            size = np.linalg.norm(shape["to_world"][:3, 0])
            normal = np.linalg.inv(shape["to_world"])[2, :3]
            normal = normal / np.linalg.norm(normal)
            shape["to_world"] = transforms.translate(behind * size * normal) @ shape["to_world"]
        else:
            shape["radius"] = shape["radius"] * (1.0 + behind)
        shape["flip_normals"] = not shape["flip_normals"]
        return Geometry(None, shape)
    mesh = geometry.mesh
    size = float(np.ptp(mesh.vertices, axis=0).max())
    vertices = mesh.vertices - _SIDE_DISTANCE * size * smooth_normals(mesh.vertices, mesh.faces)
    flipped = Mesh(vertices, np.ascontiguousarray(mesh.faces[:, ::-1]), -mesh.normals, mesh.uvs)
    return Geometry(flipped, smooth=geometry.smooth)
