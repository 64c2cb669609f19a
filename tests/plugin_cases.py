"""For every plugin and parameter of the vocabulary, a scene that uses it."""

from pathlib import Path

import numpy as np
import small_files

from isonoise.scene.image.image import Image
from isonoise.scene.vocabulary import PLUGINS
from isonoise.scene.vocabulary.plugin import COLOURS, Parameter, Plugin
from isonoise.scene.volume.grid_file import VolumeGrid

SUPPORTED_PLUGINS = [plugin for plugin in PLUGINS if plugin.kind != "scene"]
PARAMETERS = [(plugin, parameter) for plugin in SUPPORTED_PLUGINS for parameter in plugin.parameters]
CHECKERBOARD = {"type": "checkerboard", "color0": 0.9, "color1": 0.1}
COLOUR = {"type": "rgb", "value": [0.2, 0.3, 0.4]}
ROTATION_AND_SHIFT = np.array([[1, 0, 0, 0.25], [0, 0, -1, 0.5], [0, 1, 0, -0.125], [0, 0, 0, 1.0]])
SHEARED = np.array([[2, 0.5, 0, 0.25], [0, 3, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1.0]])
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])


def write_files(folder: Path) -> Path:
    """Write different files a.* and b.* of each format to a folder; return it."""
    for number, name in enumerate("ab"):
        content = {
            "png": small_files.image_file("PNG", number),
            "obj": small_files.obj(number),
            "ply": small_files.ply(shift=number),
            "serialized": small_files.serialized(shift=number),
            "vol": small_files.vol(number),
        }
        for suffix, data in content.items():
            (folder / f"{name}.{suffix}").write_bytes(data)
    return folder


def minimal_plugin(plugin: Plugin, files: Path) -> dict:
    """A plugin with its required parameters and children only."""
    name, matt = plugin.name, {"type": "diffuse"}
    suffix = {"bitmap": "png", "envmap": "png", "gridvolume": "vol"}.get(name, name)
    required_values = {
        "filename": str(files / f"a.{suffix}"),
        "vertices": TRIANGLE,
        "faces": np.array([[0, 1, 2]]),
        "aperture_radius": 0.1,
        "weight": 0.4,
        "normalmap": CHECKERBOARD,
        "name": "vertex_color",
        "value": 0.25,
        "color": {"type": "rgb", "value": [0.1, 0.5, 0.6]},
    }
    result = {"type": name}
    if name in ("bitmap", "envmap", "gridvolume"):
        result["filename"] = required_values["filename"]
    for parameter in plugin.parameters:
        if parameter.required:
            assert parameter.name in required_values, f"add a value for '{parameter.name}' of {name} here"
            result[parameter.name] = required_values[parameter.name]
    for child in plugin.children:
        nested = {
            "bsdf": matt,
            "texture": CHECKERBOARD,
            "integrator": {"type": "path"},
            "shape": {"type": "shapegroup", "inside": {"type": "cube"}} if name == "instance" else {"type": "cube"},
        }
        for number in range(child.min_count):
            assert child.kind in nested, f"add a {child.kind} for {name} here"
            result[f"{child.kind}_{number}"] = nested[child.kind]
    return result


def scene_with(plugin: Plugin, description: dict, files: Path) -> dict:
    """A scene in which a plugin of this kind affects the image."""
    sampler, film = {"type": "independent"}, {"type": "hdrfilm", "width": 4, "height": 3}
    sensor, integrator, matt = (
        {"type": "perspective"},
        {"type": "path", "max_depth": 9},
        {"type": "diffuse", "reflectance": CHECKERBOARD},
    )
    mesh = {"type": "ply", "filename": str(files / "a.ply"), "bsdf": matt}
    light, extra = {"type": "point", "position": [0, 0, -2]}, {}
    if plugin.kind == "integrator":
        integrator = description
    elif plugin.kind == "sensor":
        sensor = description
    elif plugin.kind == "film":
        film = description
    elif plugin.kind == "rfilter":
        film = film | {"rfilter": description}
    elif plugin.kind == "sampler":
        sampler = description
    elif plugin.kind == "bsdf":
        mesh["bsdf"] = description
    elif plugin.kind == "texture":
        mesh["bsdf"] = {"type": "diffuse", "reflectance": description}
    elif plugin.kind == "emitter" and plugin.name == "area":
        mesh["emitter"] = description
    elif plugin.kind == "emitter":
        light = description
    elif plugin.name == "shapegroup":
        mesh = {"type": "instance", "group": description}
    elif plugin.name == "instance":
        mesh = description
    elif plugin.kind == "shape":
        colours = {"type": "mesh_attribute", "name": "vertex_color"}
        mesh = description | {
            "bsdf": {"type": "diffuse", "reflectance": colours} if "attributes" in description else matt
        }
    elif plugin.kind in ("medium", "phase", "volume"):
        integrator = {"type": "volpath", "max_depth": 9}
        medium = {
            "medium": description,
            "phase": {"type": "homogeneous", "inside": description},
            "volume": {"type": "heterogeneous", "sigma_t": description},
        }[plugin.kind]
        mesh = {"type": "sphere", "interior": medium, "bsdf": {"type": "null"}}
    else:
        raise AssertionError(f"add the use of a {plugin.kind} in a scene here")
    sensor = sensor | {"film": film, "sampler": sampler}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "mesh": mesh, "light": light, **extra}


def plugin_and_value(plugin: Plugin, parameter: Parameter, files: Path) -> tuple[dict, dict]:
    """(plugin with the context that the parameter needs, {parameter: a value other than the default})."""
    wide = {"irradiance": {"type": "bitmap", "filename": str(files / "a.png")}} if plugin.name == "projector" else {}
    context = {
        "fov_axis": {"fov": 40.0, **wide},
        "crop_offset_x": {"width": 9, "crop_width": 3},
        "crop_offset_y": {"height": 9, "crop_height": 3},
        "crop_width": {"width": 9},
        "crop_height": {"height": 9},
        "shutter_open": {"shutter_close": 5.0},
        "aovs": {"aovs": "depth:depth"},
        "alpha_u": {"alpha_u": 0.4, "alpha_v": 0.4},
        "alpha_v": {"alpha_u": 0.4, "alpha_v": 0.4},
        "attributes": {"attributes": {"vertex_color": TRIANGLE}},
        "bitmap": {"bitmap": Image(np.zeros((3, 3, 3), np.uint8))},
        "grid": {"grid": VolumeGrid(np.ones((2, 2, 2, 1), np.float32))},
        "data": {"data": np.ones((2, 2, 2))},
    }
    special = {
        "focal_length": "35mm",
        "fov_axis": "y",
        "material": "Au",
        "name": "face_heat",
        "shape_index": 1,
        "to_uv": SHEARED,
        "vertices": TRIANGLE * 2,
        "faces": np.array([[0, 2, 1]]),
        "normals": np.array([[0, 0, 1], [0, 0.6, 0.8], [0.6, 0, 0.8]]),
        "texcoords": TRIANGLE[:, :2],
        "attributes": {"vertex_color": TRIANGLE / 2},
        "bitmap": Image(np.eye(3, dtype=np.uint8)[..., None]),
        "grid": VolumeGrid(np.ones((1, 2, 3, 1), np.float32)),
        "data": np.ones((3, 2, 1, 3)),
        "format": "fp16",
        "pixel_format": "rgba",
        "component_format": "float32",
        "file_format": "openexr",
        "aovs": "n:sh_normal",
        "filename": minimal_plugin(plugin, files).get("filename", "").replace("a.", "b."),
    }
    if plugin.name == "bitmap":
        special["data"], context["data"] = np.eye(3, dtype=np.uint8), {"data": np.zeros((3, 3, 3), np.uint8)}
    value = special.get(parameter.name)
    if value is None:
        value = generic_value(parameter)
    description = minimal_plugin(plugin, files) | context.get(parameter.name, {})
    if parameter.name in ("bitmap", "grid", "data"):
        del description["filename"]
    return description, {parameter.name: value}


def generic_value(parameter: Parameter):
    if parameter.type in COLOURS:
        return COLOUR
    if parameter.choices:
        return next(choice for choice in parameter.choices if choice != parameter.default)
    if parameter.type in ("float", "integer"):
        numbers = (0.3, 0.7, 3.5, 30.0) if parameter.type == "float" else (2, 3, 1)
        return next(number for number in numbers if parameter.admits(number) and number != parameter.default)
    return {
        "boolean": not parameter.default,
        "index": 1.7,
        "vector": [0.3, 0.2, 0.9],
        "transform": ROTATION_AND_SHIFT,
        "texture": CHECKERBOARD | {"color0": 0.6},
        "any": "x",
        "raw": 0.6,
    }[parameter.type]


def case_id(case) -> str:
    return f"{case.kind}-{case.name}" if isinstance(case, Plugin) else getattr(case, "name", "")
