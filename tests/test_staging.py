"""The first picture of a model: camera, ground, studio and exposure. Nothing is rendered."""

import numpy as np
import pytest

from isonoise import View
from isonoise.errors import SceneError, UserError
from isonoise.scene import load_description
from isonoise.scene.camera import compile_camera
from isonoise.scene.formats.framing import FILL, find_extent
from isonoise.scene.formats.model_lights import brightness_by_own_lights
from isonoise.scene.formats.staging import stage
from isonoise.scene.formats.studio import GROUND_REFLECTANCE, WHITE, meter, sphere_brightness, studio_image
from isonoise.scene.image.image import Image
from isonoise.scene.transforms import look_at, rotate, scale, translate
from isonoise.scene.view import NO_VIEW, move_camera, rotation_from_y

SIZES = ((200, 150), (400, 100), (100, 400), (64, 64))
Y_UP, Z_UP = (0, 1, 0), (0, 0, 1)
SPHERE = {"type": "sphere"}


def staged(view=NO_VIEW, size=(200, 150), up=Y_UP, **shapes) -> dict:
    return stage(shapes or {"ball": SPHERE}, "a.obj", view, size, up).scene


def mesh(vertices, **more) -> dict:
    """A fan of triangles over the vertices."""
    faces = np.array([(0, i, i + 1) for i in range(1, len(vertices) - 1)])
    return {"type": "mesh", "vertices": np.asarray(vertices, float), "faces": faces, **more}


def cloud(seed: int = 0) -> dict:
    return mesh(np.random.default_rng(seed).normal(size=(50, 3)) * (3, 1, 0.5) + (100, -20, 7))


SQUARE = ((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))


def compiled_camera(scene: dict) -> np.ndarray:
    return compile_camera(load_description(scene)["sensor"], None)[0][0]


def image_points(scene: dict, points: np.ndarray) -> np.ndarray:
    """Where the camera sees points: (n, 2) in [-1, 1] within the image."""
    camera = compiled_camera(scene)
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    local = (points - to_world[:, 3]) @ to_world[:, :3]
    assert np.all(local[:, 2] > camera["near_clip"])
    assert np.all(local[:, 2] < camera["far_clip"])
    return local[:, :2] / local[:, 2:] / camera["tan_half_fov"]


def view_direction(scene: dict) -> np.ndarray:
    """From the model to the camera."""
    return -scene["sensor"]["to_world"][:3, 2]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("view", [NO_VIEW, View(fov=10), View(fov=90), View(up=(1, 2, -1))])
def test_a_model_fills_the_image_and_is_inside(size, view):
    """It touches the margin on both sides in one direction, and is in the middle of the other one."""
    scene = staged(view, size, it=cloud())
    found = image_points(scene, cloud()["vertices"])
    low, high = found.min(axis=0), found.max(axis=0)
    np.testing.assert_allclose(low, -high, rtol=1e-4)
    limiting = int(np.argmax(high))
    np.testing.assert_allclose([-low[limiting], high[limiting]], FILL, rtol=1e-4)
    assert high.max() <= FILL * 1.0001


@pytest.mark.parametrize(
    ("shape", "points"),
    [
        ({"type": "sphere", "center": (1, 2, 3), "radius": 2.0}, None),
        ({"type": "cube", "to_world": scale((1, 3, 2))}, [(1, 3, 2), (-1, -3, -2)]),
        ({"type": "rectangle"}, SQUARE),
        ({"type": "disk"}, [(1, 0, 0), (0, -1, 0)]),
        ({"type": "cylinder", "p0": (0, 0, 0), "p1": (0, 2, 0), "radius": 1.0}, [(1, 0, 0), (0, 2, 1)]),
    ],
    ids=lambda case: case["type"] if isinstance(case, dict) else "",
)
def test_shapes_of_every_type_are_framed(shape, points):
    extent = find_extent({"it": shape}, "a")
    if points is None:
        np.testing.assert_allclose([extent.low, extent.high], [(-1, 0, 1), (3, 4, 5)])
    else:
        assert np.all(np.asarray(points) >= extent.low - 1e-9)
        assert np.all(np.asarray(points) <= extent.high + 1e-9)
        assert np.abs(image_points(staged(it=shape), np.asarray(points, float))).max() < FILL + 0.01


def test_instances_are_framed_and_their_groups_are_not():
    group = {"type": "shapegroup", "a": mesh(SQUARE, to_world=scale(100.0)), "b": SPHERE}
    instances = {f"i{n}": {"type": "instance", "group": group, "to_world": translate((n, 0, 0))} for n in (5, 9)}
    extent = find_extent({"group": group, **instances}, "a")
    np.testing.assert_allclose([extent.low, extent.high], [(-95, -100, -1), (109, 100, 1)])


def test_many_instances_of_a_large_mesh_keep_its_outermost_points():
    points = np.random.default_rng(1).normal(size=(5000, 3))
    group = {"type": "shapegroup", "a": mesh(points)}
    instances = {f"i{n}": {"type": "instance", "group": group, "to_world": translate((n, 0, 0))} for n in range(20)}
    extent = find_extent(instances, "a")
    assert len(extent.points) < 20 * 1000
    np.testing.assert_allclose(extent.low, points.min(axis=0))
    np.testing.assert_allclose(extent.high, points.max(axis=0) + np.array((19, 0, 0)))


@pytest.mark.parametrize(
    ("rotation", "direction"),
    [(0, "y"), (90, "x"), (-90, "x"), (180, "y"), (90, "y"), (45, "x"), (30, "y")],
)
def test_flat_models_are_seen_from_their_front_and_not_from_the_side(rotation, direction):
    axis = {"x": (1, 0, 0), "y": (0, 1, 0)}[direction]
    turn = rotate(axis, rotation)
    towards = view_direction(staged(it=mesh(SQUARE, to_world=turn)))
    normal = turn[:3, 2]
    assert towards @ normal > 0.69 or normal[1] < -0.7  # its back, if the front is below
    assert abs(towards @ normal) > 0.69
    assert towards[1] > 0


@pytest.mark.parametrize("up", [Y_UP, Z_UP, (1, 2, -1)])
def test_the_camera_looks_down_and_the_ground_is_below(up):
    scene = staged(up=up, it=cloud())
    axis = np.array(up) / np.linalg.norm(up)
    assert np.degrees(np.arcsin(view_direction(scene) @ axis)) == pytest.approx(23.7, abs=0.1)
    assert abs(scene["sensor"]["to_world"][:3, 0] @ axis) < 1e-6  # the horizon is level
    ground = scene["ground"]["to_world"]
    heights = cloud()["vertices"] @ axis
    size = find_extent({"it": cloud()}, "a").size
    assert 0 < heights.min() - ground[:3, 3] @ axis < 2e-3 * size
    np.testing.assert_allclose(ground[:3, 2] / np.linalg.norm(ground[:3, 2]), axis, atol=1e-9)
    corners = ground @ np.array([(x, y, 0, 1) for x in (-1, 1) for y in (-1, 1)]).T
    nearest = np.abs((corners[:3].T - scene["sensor"]["to_world"][:3, 3]).min())
    assert nearest > size


@pytest.mark.parametrize("size", [(200, 150), (400, 100), (150, 200)])
def test_the_edge_of_the_ground_is_not_in_the_image(size):
    """Every corner of the image sees the ground."""
    scene = staged(size=size, it=cloud())
    camera = compiled_camera(scene)
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    ground = scene["ground"]["to_world"]
    to_ground = np.linalg.inv(ground)
    for x in (-1, 1):
        for y in (-1, 1):
            ray = to_world[:, :3] @ np.array([*(np.array([x, y]) * camera["tan_half_fov"]), 1])
            origin, direction = (to_ground @ np.array([*v, w]) for v, w in ((to_world[:, 3], 1), (ray, 0)))
            hit = origin - direction * origin[2] / direction[2]
            assert -origin[2] / direction[2] > 0
            assert np.abs(hit[:2]).max() < 1


@pytest.mark.parametrize(
    ("look_at", "expected"),
    [(((0, 0, 0), (0, 0, 5)), False), (((0, -9, 0), (0, 0, 1)), False), (((0, 9, 1), (0, 0, 0)), True)],
    ids=["inside", "below", "above"],
)
def test_no_ground_hides_the_model(look_at, expected):
    assert ("ground" in staged(View(look_at=look_at))) == expected


def test_a_uniform_environment_is_metered_at_its_radiance():
    for reflectance in (None, 1.0):
        level = meter(np.full((64, 128, 3), 3.0), np.array([0.6, 0.48, 0.64]), reflectance)
        assert level == pytest.approx(3.0, rel=2e-3)


def test_the_meter_weighs_directions_as_a_diffuse_sphere_does():
    """Against an integral over the sphere's disk of max(n . l, 0) / pi, for a light of irradiance 1."""
    z = np.linspace(-1, 1, 401)
    x, y = np.meshgrid(z, z)
    inside = x * x + y * y < 1
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)[inside]
    for degrees in (0, 30, 90, 150):
        light = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
        expected = np.maximum(normals @ light, 0).mean() / np.pi
        assert float(sphere_brightness(np.cos(np.radians(degrees)))) == pytest.approx(expected, rel=0.01)


def test_the_studio_has_no_visible_horizon():
    """Its lower half is as bright as the ground under the upper half, and so is the row above."""
    image = studio_image()[..., 0]
    rows = np.arange(len(image)) * np.pi / (len(image) - 1)
    solid_angle = np.sin(rows) * 4 * np.pi / (np.sin(rows).sum() * image.shape[1])
    irradiance = (image.sum(axis=1) * solid_angle * np.maximum(np.cos(rows), 0)).sum()
    np.testing.assert_allclose(image[64:], GROUND_REFLECTANCE * irradiance / np.pi, rtol=1e-4)
    np.testing.assert_allclose(image[62:64], image[64:66], rtol=1e-2)


@pytest.mark.parametrize("env", [False, True])
def test_a_white_sphere_gets_the_metered_brightness(env, tmp_path):
    """Whatever the radiance of the image around it."""
    view = NO_VIEW
    if env:
        from isonoise.film.exr import write_exr

        pixels = np.random.default_rng(0).random((32, 64, 3)).astype(np.float32) ** 8 * 1000
        write_exr(tmp_path / "env.exr", {"": pixels}, {})
        view = View(env=str(tmp_path / "env.exr"))
    scene = staged(view)
    emitter = scene["environment"]
    to_camera = emitter["to_world"][:3, :3].T @ view_direction(scene)
    level = meter(emitter["bitmap"].linear(), to_camera, GROUND_REFLECTANCE)
    assert emitter["scale"] * level == pytest.approx(WHITE)
    assert scene["sensor"]["film"]["exposure"] == 1.0


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_picture_does_not_depend_on_the_unit_of_length(unit):
    scene = staged(it={**cloud(), "to_world": scale(unit)})
    np.testing.assert_allclose(
        scene["sensor"]["to_world"][:3, 3] / unit, staged(it=cloud())["sensor"]["to_world"][:3, 3]
    )
    assert scene["environment"]["scale"] == pytest.approx(staged(it=cloud())["environment"]["scale"], rel=1e-9)


@pytest.mark.parametrize(
    ("light", "brightness"),
    [
        ({"type": "point", "position": (0, 2, 0), "intensity": 5e4}, 5e4 / (4 * np.pi * 5)),
        ({"type": "spot", "to_world": translate((0, 2, 0)), "intensity": 40.0}, 40 / (4 * np.pi * 5)),
        ({"type": "directional", "direction": (0, 0, -2), "irradiance": 1e5}, 1e5 * sphere_brightness(np.cos(0.62))),
    ],
    ids=["point", "spot", "directional"],
)
def test_models_with_lights_of_their_own_keep_them(light, brightness):
    """Candela and lux: the environment adds a tenth of their light, and the image sets the exposure."""
    scene = staged(it=mesh(SQUARE), light=light)
    towards = view_direction(scene)
    found = brightness_by_own_lights({"it": mesh(SQUARE), "light": light}, find_extent({"it": SPHERE}, ""), towards)
    assert found == pytest.approx(float(brightness), rel=0.5)
    assert "ground" not in scene
    assert "exposure" not in scene["sensor"]["film"]
    to_camera = scene["environment"]["to_world"][:3, :3].T @ towards
    level = scene["environment"]["scale"] * meter(scene["environment"]["bitmap"].linear(), to_camera, None)
    assert level == pytest.approx(0.1 * float(brightness), rel=0.5)


@pytest.mark.parametrize(
    ("radiance", "is_lamp", "is_lit"),
    [
        (0.05, False, False),
        ({"type": "rgb", "value": [17, 12, 4]}, True, True),
        ({"type": "bitmap", "bitmap": Image(np.zeros((2, 2, 3), np.uint8))}, False, False),
        ({"type": "bitmap", "bitmap": Image(np.full((2, 2, 3), 9, np.float32))}, True, True),
        ({"type": "mesh_attribute", "name": "vertex_color", "scale": 2.0}, False, False),
    ],
)
@pytest.mark.parametrize("size", [1.0, 0.05])
def test_emissive_models_are_in_the_studio_unless_they_light_themselves(radiance, is_lamp, is_lit, size):
    """A small lamp does not light the model. But a ground would make it a light that is hardly ever selected."""
    attributes = {"vertex_color": np.full((4, 3), 0.01, np.float32)}
    lamp = mesh(size * np.array(SQUARE), emitter={"type": "area", "radiance": radiance}, attributes=attributes)
    scene, is_lit = staged(it=lamp, ball=SPHERE), is_lit and size == 1
    assert ("ground" in scene) != is_lamp
    assert ("exposure" in scene["sensor"]["film"]) != is_lit


def test_an_environment_of_the_model_stays():
    scene = staged(ball=SPHERE, sky={"type": "constant", "radiance": 2.0})
    assert {"ground", "environment"}.isdisjoint(scene)


def cameras() -> dict:
    return {
        "it": SPHERE,
        "front": {"type": "perspective", "fov": 30.0, "to_world": look_at((0, 0, 9), (0, 0, 0), (0, 1, 0))},
        "top": {"type": "orthographic", "to_world": look_at((0, 9, 0), (0, 0, 0), (0, 0, 1)) @ scale((2, 2, 1))},
    }


@pytest.mark.parametrize(
    ("camera", "position"),
    [(None, (0, 0, 9)), ("top", (0, 9, 0)), ("T.op", (0, 9, 0)), ("1", (0, 9, 0)), (0, (0, 0, 9))],
)
def test_a_camera_of_the_model_is_chosen_by_name_or_number(camera, position):
    scene = staged(View(camera=camera), **cameras())
    sensors = [name for name in ("front", "top") if name in scene]
    assert len(sensors) == 1
    np.testing.assert_allclose(scene[sensors[0]]["to_world"][:3, 3], position)
    assert scene[sensors[0]]["film"]["width"] == 200
    load_description(scene)


@pytest.mark.parametrize(
    ("view", "shapes", "message"),
    [
        (View(camera="side"), cameras(), "there is no camera 'side'; the scene has: 0 'front', 1 'top'"),
        (View(camera=2), cameras(), "there is no camera '2'"),
        (View(camera=0), {"it": SPHERE}, "the scene has none"),
        (View(camera="top", fov=20), cameras(), "no angle of view"),
        (View(look_at=((1, 1, 1), (1, 1, 1))), {}, "two different points"),
        (View(look_at=((0, 0, 0), (1e-300, 0, 0))), {}, "two different points"),
        (View(camera="9" * 5000), cameras(), "there is no camera '999"),
        (View(look_at=((0, 5, 0), (0, 0, 0)), up=(0, 1, 0)), {}, "looks along --up"),
        (NO_VIEW, {"it": mesh([(1, 1, 1)] * 3)}, "no extent"),
        (NO_VIEW, {"it": mesh(np.array(SQUARE) * 1e308)}, "no extent"),
    ],
)
def test_views_that_do_not_fit_the_model(view, shapes, message):
    with pytest.raises((SceneError, UserError), match=message):
        staged(view, **shapes)


@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 1, 1), (1, 2000, 3), (2000, 1, 3), (513, 2, 3)])
def test_images_of_every_shape_can_be_metered(shape):
    """Those that are too small for an environment map are errors only later."""
    assert 1 < meter(np.full(shape, 2.0), np.array([1.0, 0.0, 0.0]), None) < 4


def test_views_accept_numbers_of_every_size_and_type():
    assert View(fov=np.float32(30)).fov == 30
    assert View(up=(0, 1e-300, 0)).up == (0, 1, 0)
    with pytest.raises(UserError, match="is not one point"):
        View(look_at=(1e39, 0, 0))
    far = move_camera({"type": "perspective"}, View(look_at=((1e20, 0, 0), (0, 0, 0))))["to_world"]
    assert far[:3, 2:].T.tolist() == [[-1, 0, 0], [1e20, 0, 0]]


def test_a_rotation_from_y_is_a_rotation_and_takes_y_there():
    for up in ((0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 2, -3), (1e-9, -1, 0)):
        matrix = rotation_from_y(up)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(matrix) == pytest.approx(1)
        np.testing.assert_allclose(matrix[:, 1], np.array(up) / np.linalg.norm(up), atol=1e-6)


def test_stl_files_stand_on_z(tmp_path):
    import small_files

    for suffix, up in (("stl", 2), ("ply", 1)):
        path = tmp_path / f"a.{suffix}"
        path.write_bytes(small_files.from_trimesh("stl") if suffix == "stl" else small_files.ply())
        scene = load_description(path)
        assert abs(scene["sensor"]["to_world"][up, 0]) < 1e-6
        assert scene["sensor"]["to_world"][up, 2] < 0


def test_a_converted_model_has_the_view_and_no_exposure(tmp_path):
    """Mitsuba 3 would refuse it."""
    from isonoise.convert.convert import convert

    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    convert(tmp_path / "a.obj", tmp_path / "b.xml", view=View(look_at=((0, 0, 9), (0, 0, 0))), size=(30, 20))
    assert "exposure" not in (tmp_path / "b.xml").read_text()
    sensor = load_description(tmp_path / "b.xml")["sensor"]
    np.testing.assert_allclose(sensor["to_world"][:3, 3], (0, 0, 9))
    assert (sensor["film"]["width"], sensor["film"]["height"]) == (30, 20)


def test_views_of_scenes_that_are_no_models(tmp_path):
    """Two sensors and an environment in the file; the camera keeps its place, and the nearest axis is up."""
    to_world = look_at((0, 3, 8), (0, 0, 0), (0, 1, 0))
    scene = {
        "type": "scene",
        "a": {"type": "perspective", "fov": 30.0, "to_world": to_world},
        "b": {"type": "thinlens", "focal_length": "50mm", "aperture_radius": 0.1},
        "sky": {"type": "constant"},
    }
    turned = load_description(scene, view=View(look_at=(5, 0, 0)))["a"]["to_world"]
    np.testing.assert_allclose(turned, look_at((0, 3, 8), (5, 0, 0), (0, 1, 0)), atol=1e-12)
    seen = load_description(scene, view=View(camera="b", fov=20, env="sky.hdr"), size=(4, 2))
    assert "a" not in seen
    assert "sky" not in seen
    assert (seen["b"]["fov"], seen["b"]["fov_axis"], seen["b"]["film"]["height"]) == (20, "x", 2)
    assert "focal_length" not in seen["b"]
    assert seen["environment"]["filename"].endswith("sky.hdr")
    level = load_description(scene, view=View(up=(1, 0, 0)))["a"]["to_world"]
    np.testing.assert_allclose(level[:3, 2:], to_world[:3, 2:])
    assert abs(level[0, 0]) < 1e-12
    assert level[0, 1] > 0.9


@pytest.mark.parametrize(
    "values", [{"fov": 0}, {"fov": "wide"}, {"look_at": (1, 2)}, {"look_at": ((0, 0, 0),) * 3}, {"up": (0, 0, 0)}]
)
def test_invalid_views_are_refused(values):
    with pytest.raises(UserError, match=f"{next(iter(values))} = "):
        View(**values)
