"""Images of all kinds of materials and emitters against Mitsuba 3: `shade` has the data that they need.

Other files test each of them without images. False alarms are below 2 % for each image under other seeds
(tests/references.py).
"""

import numpy as np
import pytest
from PIL import Image
from scalar_mitsuba import assert_same_picture

from isonoise.film.exr import write_exr
from isonoise.selftest.scenes import look_at, rgb

RED = {"type": "diffuse", "reflectance": rgb((0.8, 0.3, 0.2))}
GOLD = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx", "material": "Au"}
CHECKS = {"type": "checkerboard", "color0": 0.1, "color1": 0.8, "to_uv": np.diag([4.0, 4.0, 1.0, 1.0])}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Returns bitmaps of 8 x 8 texels: colours, and normals."""
    folder, random = tmp_path_factory.mktemp("images"), np.random.default_rng(21)
    pixels = {
        "colours": random.integers(0, 256, (8, 8, 3)),
        "normals": 255 * (random.random((8, 8, 3)) * [0.7, 0.7, 0.4] + [0.15, 0.15, 0.6]),
    }
    for name, values in pixels.items():
        Image.fromarray(values.astype(np.uint8)).save(folder / f"{name}.png")
    bitmap = {"type": "bitmap", "format": "variant"}
    return {name: bitmap | {"filename": str(folder / f"{name}.png"), "raw": name == "normals"} for name in pixels}


def transform(scale: float, offset, angle_rad: float = 0.4) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    matrix = np.eye(4)
    matrix[:3, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    matrix[:3, 3] = offset
    return matrix


def gallery(materials: list[dict], columns: int, size: tuple[int, int]) -> dict:
    """Balls of these materials in rows in front of a floor, under a lamp and a sky."""
    rows = -(-len(materials) // columns)
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}}
    lamp = {"type": "area", "radiance": rgb((12.0, 11.0, 9.0))}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6, "rr_depth": 100},
        "sensor": {
            "type": "perspective",
            "fov": 9.0 * columns,
            "to_world": look_at((0, -14, 6), (0, 0, 0)),
            "film": film,
        },
        "sky": {"type": "constant", "radiance": rgb((0.3, 0.35, 0.4))},
        "lamp": {"type": "sphere", "center": [4.0, -5.0, 8.0], "radius": 1.5, "emitter": lamp},
        "floor": {"type": "rectangle", "to_world": transform(9.0, (0, 0, -2.6), 0.0), "bsdf": {"type": "diffuse"}},
    }
    for index, material in enumerate(materials):
        x, y = index % columns - (columns - 1) / 2, index // columns - (rows - 1) / 2
        to_world = transform(0.85, (1.9 * x, 0.95 * y, 1.71 * y))
        scene[f"ball_{index}"] = {"type": "sphere", "to_world": to_world, "bsdf": material}
    return scene


def test_plastics_and_bumps(images, tmp_path):
    """Materials that need more data than their record: tables, textures, frames."""
    materials = [
        {"type": "roughplastic", "diffuse_reflectance": images["colours"], "alpha": 0.2},
        {"type": "bumpmap", "height": images["colours"], "inner": GOLD, "scale": 0.1},
        {"type": "normalmap", "normalmap": images["normals"], "inner": {"type": "twosided", "inner": RED}},
        {"type": "mask", "opacity": CHECKS, "inner": {"type": "twosided", "inner": RED}},
    ]
    assert_same_picture(gallery(materials, 2, (24, 20)), tmp_path)


@pytest.mark.long
def test_all_materials(images, tmp_path):
    colours = images["colours"]
    materials = [
        {"type": "diffuse", "reflectance": colours},
        {"type": "dielectric"},
        {"type": "thindielectric"},
        {"type": "conductor", "material": "Cu"},
        {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4, "material": "Al"},
        {"type": "roughdielectric", "alpha": 0.2, "distribution": "ggx"},
        {"type": "plastic", "diffuse_reflectance": colours, "nonlinear": True},
        {"type": "roughplastic", "diffuse_reflectance": rgb((0.2, 0.6, 0.3)), "alpha": 0.2},
        {
            "type": "principled",
            "base_color": rgb((0.8, 0.5, 0.2)),
            "metallic": 0.7,
            "anisotropic": 0.6,
            "clearcoat": 0.8,
        },
        {"type": "principled", "base_color": rgb((0.9, 0.8, 0.7)), "spec_trans": 0.9, "roughness": 0.3},
        {"type": "twosided", "inner": RED},
        {"type": "twosided", "front": RED, "back": GOLD},
        {"type": "mask", "opacity": CHECKS, "inner": {"type": "twosided", "inner": RED}},
        {"type": "blendbsdf", "weight": colours, "first": RED, "second": GOLD},
        {"type": "bumpmap", "height": colours, "inner": GOLD, "scale": 0.1},
        {"type": "normalmap", "normalmap": images["normals"], "inner": {"type": "twosided", "inner": RED}},
        {"type": "principled", "base_color": colours, "roughness": colours, "sheen": 0.7, "flatness": 0.6},
        {"type": "roughconductor", "alpha": colours, "distribution": "ggx"},
        {"type": "roughplastic", "diffuse_reflectance": colours, "nonlinear": True, "distribution": "ggx"},
        {"type": "blendbsdf", "weight": 0.5, "first": {"type": "null"}, "second": RED},
    ]
    assert_same_picture(gallery(materials, 5, (50, 40)), tmp_path)


@pytest.mark.long
def test_thin_sheets(images, tmp_path):
    """Seen from both sides and through: balls, whose far half lights the near one."""
    thin = {"type": "principledthin", "base_color": images["colours"], "roughness": 0.4}
    materials = [
        thin | {"diff_trans": 1.4, "sheen": 0.5, "sheen_tint": 0.5, "flatness": 0.5},
        thin | {"spec_trans": 0.8, "spec_tint": 0.5, "anisotropic": 0.7},
        thin | {"spec_trans": CHECKS, "diff_trans": images["colours"], "eta": 1.8},
        {"type": "mask", "opacity": 0.6, "inner": thin | {"spec_trans": 0.5, "diff_trans": 0.6}},
    ]
    assert_same_picture(gallery(materials, 2, (24, 20)), tmp_path)


LAMP_OBJ = """
v 1 0 0
v 0 1 0
v -1 0 0
v 0 -1 0
v 0 0 1
vn 0.9 0 0.4
vn 0 0.9 0.4
vn -0.9 0 0.4
vn 0 -0.9 0.4
vn 0 0 1
vt 0.1 0.1
vt 0.9 0.2
vt 0.8 0.8
vt 0.2 0.7
vt 0.5 0.5
f 1/1/1 2/2/2 5/5/5
f 2/2/2 3/3/3 5/5/5
f 3/3/3 4/4/4 5/5/5
f 4/4/4 1/1/1 5/5/5
"""


def test_all_emitters(images, tmp_path):
    """A floor lit by all kinds of emitters, textured if the kind allows it."""
    textured_emitter = {"emitter": {"type": "area", "radiance": images["colours"]}}
    (tmp_path / "lamp.obj").write_text(LAMP_OBJ)
    down = transform(0.6, (0, 0, 1.2)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    film = {"type": "hdrfilm", "width": 24, "height": 20, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 40.0, "to_world": look_at((0, -9, 5), (0, 0, 0.3)), "film": film},
        "floor": {"type": "rectangle", "to_world": transform(5.0, (0, 0, 0)), "bsdf": {"type": "diffuse"}},
        "plate": {"type": "rectangle", "to_world": down, **textured_emitter},
        "disk": {"type": "disk", "to_world": transform(1.0, (2, 0, 1)) @ down, **textured_emitter},
        "ball": {"type": "sphere", "center": [-2.0, 1.0, 0.8], "radius": 0.4, **textured_emitter},
        "bowl": {"type": "sphere", "center": [2.0, 1.5, 0.0], "radius": 0.7, "flip_normals": True, **textured_emitter},
        "tube": {
            "type": "cylinder",
            "p0": [-3.0, -1.0, 0.2],
            "p1": [-1.0, -1.5, 0.6],
            "radius": 0.15,
            **textured_emitter,
        },
        "mesh": {
            "type": "obj",
            "filename": str(tmp_path / "lamp.obj"),
            "to_world": transform(0.6, (0.8, -2.0, 0.3)),
            **textured_emitter,
        },
        "point": {"type": "point", "position": [-1.5, 2.5, 1.0], "intensity": rgb((0.5, 1.0, 0.8))},
        "spot": {"type": "spot", "to_world": look_at((3, -3, 3), (1, -2, 0)), "intensity": rgb((9.0, 3.0, 2.0))},
        "sun": {"type": "directional", "direction": [1.0, 0.4, -0.6], "irradiance": rgb((0.2, 0.2, 0.1))},
        "sky": {"type": "constant", "radiance": rgb((0.02, 0.03, 0.05))},
    }
    assert_same_picture(scene, tmp_path)


@pytest.mark.long
def test_projected_images(images, tmp_path):
    """A projector and a spot with a texture light a floor and a ball, which hides a part of it."""
    film = {"type": "hdrfilm", "width": 24, "height": 20, "rfilter": {"type": "box"}}
    image = {"type": "bitmap", "filename": images["colours"]["filename"]}
    place = look_at((-2, -2, 4), (0.5, 0.5, 0))
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 40.0, "to_world": look_at((0, -9, 5), (0, 0, 0.3)), "film": film},
        "floor": {"type": "rectangle", "to_world": transform(5.0, (0, 0, 0)), "bsdf": {"type": "diffuse"}},
        "ball": {"type": "sphere", "center": [0.6, 0.4, 0.5], "radius": 0.5},
        "projector": {"type": "projector", "to_world": place, "irradiance": image, "scale": 8.0, "fov": 35.0},
        "spot": {
            "type": "spot",
            "to_world": look_at((3, -3, 3), (1, -2, 0)),
            "intensity": rgb((9.0, 3.0, 2.0)),
            "cutoff_angle": 35.0,
            "texture": image,
        },
    }
    assert_same_picture(scene, tmp_path)


def test_an_environment_map_with_a_sun(tmp_path):
    """10^5 times as bright as the rest in one texel, to_world; a ball of rough metal sees it by both techniques."""
    pixels = np.random.default_rng(22).uniform(0.2, 1.0, (33, 64, 3)).astype(np.float32)
    pixels[9, 20] = 6e4
    write_exr(tmp_path / "sky.exr", {"": pixels}, {})
    to_world = np.eye(4)[[0, 2, 1, 3]] * [1, -1, 1, 1]  # y, the axis of the map, points up: along z
    film = {"type": "hdrfilm", "width": 24, "height": 20, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 30.0, "to_world": look_at((0, -6, 2), (0, 0, 0.4)), "film": film},
        "sky": {"type": "envmap", "filename": str(tmp_path / "sky.exr"), "scale": 0.5, "to_world": to_world},
        "floor": {"type": "rectangle", "to_world": transform(5.0, (0, 0, -1)), "bsdf": {"type": "diffuse"}},
        "ball": {"type": "sphere", "bsdf": GOLD},
    }
    assert_same_picture(scene, tmp_path)
