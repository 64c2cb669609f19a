"""Scenes far from the origin, and of extreme sizes: they give the image of the same scene near the origin.

A moved scene differs from the original one in the last bits of positions only. So with the same seed nearly all paths
are the same, and the images differ by much less than their noise.
"""

import warnings

import numpy as np
import pytest
from instance_scenes import make_transform, with_instances
from media_scenes import look_at
from small_scene import lamp_over_floor

from isonoise.film.exr import write_exr
from isonoise.render_scene import render
from isonoise.scene import CompiledScene, compile_scene, load_description, structs
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.scene.placement import UNPLACED, Placement, find_placement

OFFSETS = [10.0**exponent for exponent in (3, 6, 9, 12)]
SCALES = [10.0**exponent for exponent in (-18, -12, 12, 18)]
STEP = 2.0**-24


def sensor_of(camera: str, scale: float, offset: float) -> dict:
    view = look_at(scale * np.array([0.0, -2.6, 1.8]) + offset, scale * np.array([0.0, 0.0, 0.2]) + offset, (0, 0, 1))
    cameras = {
        "perspective": {"fov": 40.0, "to_world": view},
        "thinlens": {"fov": 40.0, "to_world": view, "aperture_radius": 0.1 * scale, "focus_distance": 3.0 * scale},
        "orthographic": {"to_world": view @ np.diag([scale, scale, 1.0, 1.0])},
    }
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    clips = {"near_clip": 0.01 * scale, "far_clip": 100.0 * scale}
    return {"type": camera, **cameras[camera], **clips, "film": film}


def room(scale: float = 1.0, offset: float = 0.0, camera: str = "perspective", sky: dict | None = None) -> dict:
    """A scene with every plugin that has a length, in a unit of length `scale` and moved by `offset` along each axis.

    Point and spot lights, a lamp, the sun and a sky light a textured floor, round shapes, an instance and a fog.
    """

    def at(*point: float) -> list[float]:
        return (scale * np.array(point) + offset).tolist()

    def place(matrix: np.ndarray) -> np.ndarray:
        placed = np.diag([scale, scale, scale, 1.0]) @ matrix
        placed[:3, 3] += offset
        return placed

    fog = {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": [0.8, 0.5, 0.3]}, "albedo": 0.8}
    pattern = {"type": "checkerboard", "color0": 0.1, "color1": 0.8, "to_uv": np.diag([4.0, 2.0, 1.0, 1.0])}
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 6},
        "sensor": sensor_of(camera, scale, offset),
        "floor": {
            "type": "rectangle",
            "to_world": place(np.eye(4)),
            "bsdf": {"type": "diffuse", "reflectance": pattern},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": place(make_transform((0.3, 0.3, 1.0), (0.4, 0.2, 1.0)) @ mirrored),
            "emitter": {"type": "area", "radiance": 5.0},
        },
        "ball": {
            "type": "sphere",
            "center": at(0.5, 0.2, 0.3),
            "radius": 0.25 * scale,
            "bsdf": {"type": "roughconductor", "alpha": 0.3},
        },
        "tube": {
            "type": "cylinder",
            "p0": at(-0.5, 0.5, 0.2),
            "p1": at(0.5, 0.5, 0.4),
            "radius": 0.05 * scale,
            "bsdf": {"type": "bumpmap", "scale": 0.1 * scale, "map": pattern, "inner": {"type": "diffuse"}},
        },
        "disk": {"type": "disk", "to_world": place(make_transform((0.2, 0.2, 0.2), (-0.6, 0.3, 0.3), seed=4))},
        "fog": {
            "type": "sphere",
            "center": at(-0.4, -0.3, 0.3),
            "radius": 0.3 * scale,
            "bsdf": {"type": "null"},
            "interior": {**fog, "scale": 2.0 / scale},
        },
        "copy": {
            "type": "instance",
            "to_world": place(make_transform((0.2, 0.3, 0.2), (0.4, -0.4, 0.4), seed=5)),
            "group": {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.6}, "box": {"type": "cube"}},
        },
        "point": {"type": "point", "position": at(0.3, 0.1, 0.9), "intensity": 0.3 * scale**2},
        "spot": {
            "type": "spot",
            "to_world": place(make_transform((1, 1, 1), (0.0, 0.0, 1.5)) @ mirrored),
            "intensity": {"type": "rgb", "value": [0.5 * scale**2, 0.4 * scale**2, 0.3 * scale**2]},
        },
        "sun": {"type": "directional", "direction": [0.3, 0.2, -1.0], "irradiance": 0.2},
        "sky": sky or {"type": "constant", "radiance": 0.1},
    }


def points_lengths_and_intensities(scene: dict) -> tuple[np.ndarray, ...]:
    """All numbers of a compiled scene that depend on its place and its unit of length, by their dimension."""
    compiled = compile_scene(load_description(scene))
    camera, lights = compiled.camera, compiled.lights
    is_lamp = np.isin(lights["kind"], (light_bits("point"), light_bits("spot")))
    analytics = compiled.analytics[: compiled.group_offsets[0, 1]]
    matrices = [array["to_world"].reshape(-1, 3, 4) for array in (analytics, compiled.instances, camera)]
    points = [compiled.vertices[:8], analytics["center"][analytics["radius"] > 0], lights["position"][is_lamp]]
    points += [matrix[:, :, 3] for matrix in matrices]
    linear = [matrix[:, :, :3].ravel() for matrix in matrices[:2]]
    clips = [camera[name] for name in ("near_clip", "far_clip", "aperture_radius", "focus_distance")]
    film = [camera["to_world"].reshape(3, 4)[:, :2].ravel()] if camera["kind"] == structs.CAMERA_ORTHOGRAPHIC else []
    bumps = compiled.bsdfs["constants"][compiled.bsdfs["kind"] == bsdf_bits("bump"), 0]
    lengths = [analytics["radius"], *linear, *clips, *film, bumps]
    intensities = lights["radiance"][is_lamp] / compiled.radiance_scale
    return np.concatenate(points), np.concatenate(lengths), intensities, compiled.media["sigma_t"]


@pytest.mark.parametrize("camera", ["perspective", "thinlens", "orthographic"])
@pytest.mark.parametrize(
    ("scale", "offset"), [*((1.0, x) for x in OFFSETS), *((s, 0.0) for s in SCALES), (1e-9, 1.0), (1e9, 1e20)]
)
def test_every_length_of_a_moved_scene_is_placed_alike(camera, scale, offset):
    """The tolerance is the rounding of coordinates: to 64 bits in the scene, to 32 bits on the device."""
    points, lengths, intensities, densities = points_lengths_and_intensities(room(camera=camera))
    placed = points_lengths_and_intensities(room(scale, offset, camera))
    unit = np.linalg.norm(np.ptp(placed[0][:4], axis=0)) / np.linalg.norm(np.ptp(points[:4], axis=0))
    assert 2.0**-31 < unit < 2.0**31
    shift = (placed[0][:4] - unit * points[:4]).mean(axis=0)
    assert np.abs(shift).max() <= 4 * unit
    tolerance = 16 * STEP + 4 * 2.0**-53 * offset / scale
    np.testing.assert_allclose((placed[0] - shift) / unit, points, atol=4 * tolerance)
    np.testing.assert_allclose(placed[1] / unit, lengths, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(placed[2] / unit**2, intensities, rtol=tolerance)
    np.testing.assert_allclose(placed[3] * unit, densities, rtol=tolerance)


@pytest.mark.filterwarnings("ignore")  # about the camera, which stays
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-9, 1.0), (1e9, 1e20)])
def test_a_moved_and_scaled_projector_gives_the_same_irradiance(scale, offset):
    """pi / (z² cos) at the centre of a ball, for an image of 1. z is in the projector's space, whose unit is scaled."""
    place, rigid = np.diag([scale, scale, scale, 1.0]), make_transform((1, 1, 1), (0.0, 0.5, -4.0))
    place[:3, 3] = offset
    centre = np.array([0.3, 0.1, 1.0])
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "ball": {"type": "sphere", "to_world": place, "center": centre.tolist()},
        "lamp": {"type": "projector", "to_world": place @ rigid, "irradiance": 1.0},
    }
    compiled = compile_scene(load_description(scene))
    light, rows = compiled.lights[0], compiled.projections["to_uv"][0].reshape(3, 3).astype(float)
    arm = (compiled.analytics["center"][0] - light["position"]).astype(float)
    cosine = light["axis"] @ arm / np.linalg.norm(arm)
    irradiance = light["radiance"] / compiled.radiance_scale / ((rows[2] @ arm) ** 2 * cosine)
    arm = rigid[:3, :3].T @ (centre - rigid[:3, 3])
    expected = np.pi / (arm[2] ** 2 * scale * arm[2] / np.linalg.norm(arm))
    np.testing.assert_allclose(irradiance, expected, rtol=1e-4)


def test_groups_are_placed_in_their_own_space():
    """A mesh far from the origin of its group, and an instance that brings it back."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2]])

    def scene(offset: float) -> CompiledScene:
        mesh = {"type": "mesh", "vertices": vertices + offset, "faces": faces, "face_normals": True}
        return compile_scene(
            load_description(with_instances({"mesh": mesh}, make_transform(2.0, (3 - 2 * offset,) * 3)))
        )

    near, far = scene(0.0), scene(1e8)
    for compiled in (near, far):
        matrix = compiled.instances["to_world"].reshape(3, 4)
        world = compiled.vertices @ matrix[:, :3].T + matrix[:, 3]
        np.testing.assert_allclose(world, 3 + 2 * vertices, atol=64 * STEP)
    assert np.abs(far.vertices).max() <= 2


def test_usual_scenes_stay_where_they_are():
    random = np.random.default_rng(1)
    centers = random.uniform(-100, 100, (1000, 1, 3))
    boxes = centers + random.uniform(0.01, 1, (1000, 1, 1)) * [[[-1.0] * 3, [1.0] * 3]]
    for usual in (boxes, boxes * 1e6, boxes * 1e-6, boxes + 100, np.zeros((0, 2, 3)), np.zeros((3, 2, 3))):
        assert find_placement(usual).is_identity
    lonely = np.concatenate([boxes, boxes[:1] + 1e12])  # a star
    assert find_placement(lonely).is_identity
    assert not find_placement(boxes + 1e5).is_identity
    assert find_placement(boxes * 1e-12).scale > 1


def test_placements_follow_each_other():
    first, second = Placement(np.array([3.0, -2.0, 1.0]), 0.25), Placement(np.array([0.5, 0.25, 8.0]), 16.0)
    np.testing.assert_array_equal(first.then(second).to_placed(), second.to_placed() @ first.to_placed())
    np.testing.assert_array_equal(first.from_placed() @ first.to_placed(), np.eye(4))
    assert UNPLACED.then(UNPLACED).is_identity


def messages(scene: dict) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        compile_scene(load_description(scene))
    return "\n".join(str(warning.message) for warning in caught)


def test_what_stays_inaccurate_is_said():
    assert messages(room()) == messages(room(1.0, 1e9)) == messages(room(1e-18)) == ""
    speck = {"type": "sphere", "center": [1e5, 0, 0], "radius": 0.1}
    assert "shape 'speck': far from the other shapes for its size" in messages(room() | {"speck": speck})
    assert "round its corners to 3.0% of its size" in messages(room() | {"speck": speck})
    far_camera = room()["sensor"] | {"to_world": look_at((0, 0, 1e6), (0, 0, 0)), "far_clip": 1e9}
    assert "the camera is 5e+05 times the scene's size away" in messages(room() | {"sensor": far_camera})
    assert "64-bit floats round its shapes to" in messages(room(1.0, 1e14))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32) + np.float32(1e6)
    mesh = {"type": "mesh", "vertices": corners.astype(float), "faces": np.array([[0, 1, 2]]), "face_normals": True}
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "mesh": mesh}
    assert "shape 'mesh': its vertices are 32-bit floats far from their origin, rounded to 6.0%" in messages(scene)
    mesh["vertices"] = mesh["vertices"] + 1 / 3  # as a text file may have them
    assert "32-bit floats far from" not in messages(scene)


def images(scenes: list[dict], spp: int) -> list:
    return [render(scene, spp=spp, strategy="uniform", seed=1).statistics for scene in scenes]


def assert_same_image(statistics, expected) -> None:
    """Most paths are the same, so the images differ by less than a quarter of their noise, and means by 0.2 %."""
    error = np.sqrt(expected.variance_of_mean().mean())
    assert np.sqrt(((statistics.mean - expected.mean) ** 2).mean()) < 0.25 * error
    assert statistics.mean.mean() == pytest.approx(expected.mean.mean(), rel=2e-3)


MOVES = [(1.0, 1e3), (1.0, 1e6), (1.0, 1e9), (1.0, 1e12), (1e-18, 0.0), (1e-12, 0.0), (1e12, 0.0), (1e18, 0.0)]


def test_a_moved_scene_gives_the_same_image():
    def lamp(scale: float, offset: float) -> dict:
        scene = lamp_over_floor()
        place = np.diag([scale, scale, scale, 1.0])
        place[:3, 3] = offset
        sensor = scene["sensor"] | {"near_clip": 1e-2 * scale, "far_clip": 1e2 * scale}
        sensor["to_world"] = place @ sensor["to_world"] @ np.diag([1 / scale, 1 / scale, 1 / scale, 1.0])
        shapes = {k: scene[k] | {"to_world": place @ scene[k].get("to_world", np.eye(4))} for k in ("floor", "lamp")}
        return scene | shapes | {"sensor": sensor}

    expected, *moved = images([lamp(1.0, 0.0), lamp(1.0, 1e6), lamp(1e-18, 0.0)], spp=64)
    for statistics in moved:
        assert_same_image(statistics, expected)


@pytest.mark.long
@pytest.mark.parametrize("camera", ["perspective", "thinlens", "orthographic"])
def test_a_moved_scene_with_every_length_gives_the_same_image(camera, tmp_path):
    sky = np.random.default_rng(5).uniform(0.0, 0.3, (8, 16, 3)).astype(np.float32)
    write_exr(tmp_path / "sky.exr", {"": sky}, {})
    turned = make_transform((1, 1, 1), (0, 0, 0), seed=6)
    sky = {"type": "envmap", "filename": str(tmp_path / "sky.exr"), "to_world": turned}
    expected, *moved = images([room(*move, camera, sky) for move in [(1.0, 0.0), *MOVES]], spp=256)
    for statistics in moved:
        assert_same_image(statistics, expected)


def test_a_clipped_scene_is_said():
    for clip, message in (({"near_clip": 100.0}, "nearer than near_clip"), ({"far_clip": 0.1}, "beyond far_clip")):
        assert message in messages(room() | {"sensor": room()["sensor"] | {"far_clip": 1e4} | clip})
