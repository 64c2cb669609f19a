"""Shapes and cameras in world space, against closed forms and against Mitsuba."""

import itertools

import numpy as np
import pytest

from isonoise.scene import compile_scene, load_description, structs

SHEAR = np.array([[1.2, 0.3, 0, 1], [0, 0.7, 0.2, 2], [0.1, 0, 1.5, 3], [0, 0, 0, 1.0]])
ROTATION_AND_SCALE = np.array([[0, -2, 0, 1], [2, 0, 0, -1], [0, 0, 2, 0.5], [0, 0, 0, 1.0]])  # 90 degrees, factor 2
TRANSFORMS = {
    "identity": np.eye(4),
    "mirrored in x": np.diag([-1.0, 1, 1, 1]),
    "mirrored in z": np.diag([1.0, 1, -1, 1]),
    "rotated and scaled": ROTATION_AND_SCALE,
    "rotated and mirrored": ROTATION_AND_SCALE @ np.diag([1.0, -1, 1, 1]),
}
ANY_AFFINE = {**TRANSFORMS, "sheared": SHEAR, "sheared and mirrored": SHEAR @ np.diag([1.0, 1, -1, 1])}


def compile_shape(**shape):
    return compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "it": shape}))


def face_normals(scene) -> np.ndarray:
    a, b, c = (scene.vertices[scene.faces[:, i]].astype(float) for i in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_rectangle_faces_plus_z():
    scene = compile_shape(type="rectangle")
    assert scene.bounds.tolist() == [[-1, -1, 0], [1, 1, 0]]
    np.testing.assert_array_equal(face_normals(scene), [[0, 0, 1]] * 2)
    assert len(scene.vertex_normals) == 0


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("to_world", ANY_AFFINE.values(), ids=ANY_AFFINE)
def test_cube_faces_outwards_under_any_transform(to_world, flip):
    scene = compile_shape(type="cube", to_world=to_world, flip_normals=flip)
    centers = scene.vertices[scene.faces].mean(axis=1) - scene.vertices.mean(axis=0)
    outward = np.einsum("ij,ij->i", face_normals(scene), centers)
    assert len(scene.faces) == 12
    assert np.all(outward < 0 if flip else outward > 0)


def test_sphere_combines_center_radius_and_transform():
    # Mitsuba 3.9.1: center [3, 0, 5], radius 6
    to_world = np.array([[3, 0, 0, 0], [0, 3, 0, 0], [0, 0, 3, 5], [0, 0, 0, 1.0]])
    sphere = compile_shape(type="sphere", center=[1, 0, 0], radius=2, to_world=to_world).analytics[0]
    assert sphere["center"].tolist() == [3, 0, 5]
    assert sphere["radius"] == 6
    # In Mitsuba a mirrored sphere is inside out.
    assert (
        compile_shape(type="sphere", to_world=np.diag([-1, 1, 1, 1])).shapes["flags"][0] == structs.SHAPE_FLIP_NORMALS
    )


def test_non_uniform_scales_of_spheres_and_cylinders_use_the_first_axis():
    with pytest.warns(UserWarning, match="shape 'it': non-uniform scale"):
        scene = compile_shape(type="sphere", to_world=np.diag([1, 2, 3, 1]))
    assert scene.bounds.tolist() == [[-1] * 3, [1] * 3]  # as Mitsuba 3.9.1
    with pytest.warns(UserWarning, match="non-uniform scale"):
        compile_shape(type="cylinder", to_world=np.diag([1, 2, 1, 1]))


def test_cylinder_from_point_to_point():
    scene = compile_shape(type="cylinder", p0=[1, 2, 3], p1=[1, 2, 7], radius=0.5, emitter={"type": "area"})
    assert scene.bounds.tolist() == [[0.5, 1.5, 3], [1.5, 2.5, 7]]
    assert scene.lights["area"][0] == pytest.approx(2 * np.pi * 0.5 * 4)
    to_world = scene.analytics["to_world"][0].reshape(3, 4)
    np.testing.assert_allclose(to_world @ [0, 0, 0, 1], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(to_world @ [0, 0, 1, 1], [1, 2, 7], atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "to_world"),
    [("disk", SHEAR), ("disk", ROTATION_AND_SCALE), ("cylinder", ROTATION_AND_SCALE), ("sphere", ROTATION_AND_SCALE)],
)
def test_analytic_transforms_are_inverses(shape, to_world):
    record = compile_shape(type=shape, to_world=to_world).analytics[0]
    product = np.vstack([record["to_world"].reshape(3, 4), [0, 0, 0, 1]]) @ np.vstack(
        [record["to_object"].reshape(3, 4), [0, 0, 0, 1]]
    )
    np.testing.assert_allclose(product, np.eye(4), atol=1e-6)


def front_normals(scene, points: np.ndarray) -> np.ndarray:
    """Unit normals of the front side of the only shape of a scene, at points that have to be on its surface."""
    if not len(scene.analytics):
        a, b, c = (scene.vertices[scene.faces[:, i]].astype(float) for i in range(3))
        normals = face_normals(scene)
        result = []
        for p in points:
            inside = np.stack(
                [np.einsum("ij,ij->i", np.cross(y - x, p - x), normals) for x, y in ((a, b), (b, c), (c, a))]
            )
            score = np.abs(np.einsum("ij,ij->i", p - a, normals)) + np.maximum(-inside.min(axis=0), 0)
            assert score.min() < 1e-5
            result.append(normals[np.argmin(score)])
        return np.array(result)
    record, flip = scene.analytics[0], scene.shapes["flags"][0] & structs.SHAPE_FLIP_NORMALS
    if record["kind"] == structs.ANALYTIC_SPHERE:
        normals = (points - record["center"]) / record["radius"]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    else:
        to_object = record["to_object"].reshape(3, 4).astype(float)
        local = points @ to_object[:, :3].T + to_object[:, 3]
        if record["kind"] == structs.ANALYTIC_DISK:
            np.testing.assert_allclose(local[:, 2], 0, atol=1e-5)
            assert np.all(np.linalg.norm(local[:, :2], axis=1) <= 1 + 1e-5)
            local = np.tile([0.0, 0, 1], (len(points), 1))
        else:
            np.testing.assert_allclose(np.linalg.norm(local[:, :2], axis=1), 1, atol=1e-5)
            assert np.all((local[:, 2] > -1e-5) & (local[:, 2] < 1 + 1e-5))
            local = local * (1, 1, 0)
        normals = local @ to_object[:, :3]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return -normals if flip else normals


SHAPES = [(name, t) for name in ("sphere", "cylinder") for t in TRANSFORMS]
SHAPES += [(name, t) for name in ("rectangle", "cube", "disk") for t in ANY_AFFINE]


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize(("name", "transform"), SHAPES)
def test_surfaces_and_front_sides_agree_with_mitsuba(name, transform, flip, mitsuba):
    """Points sampled by Mitsuba are on the surface, and shading normals (the emissive side), area and bounds agree.

    Mitsuba's normals are those of ray hits: those of its samples are wrong on rotated spheres (3.9.1).
    """
    shape = {"type": name, "flip_normals": flip}
    if name == "cylinder":
        shape |= {"p0": [0.1, 0.2, 0.3], "p1": [0.5, -0.4, 1.3], "radius": 0.7}
    if name == "sphere":
        shape |= {"center": [0.1, 0.2, 0.3], "radius": 0.7}
    matrix = ANY_AFFINE[transform]
    theirs = mitsuba.load_dict({**shape, "to_world": mitsuba.ScalarTransform4f(matrix)})
    samples = [theirs.sample_position(0.0, point) for point in itertools.product((0.15, 0.4, 0.85), repeat=2)]
    points = np.array([np.array(sample.p) for sample in samples], float)
    scene = compile_shape(**shape, to_world=matrix, emitter={"type": "area"})
    normals = front_normals(scene, points)
    world = mitsuba.load_dict({"type": "scene", "it": theirs})
    for point, normal in zip(points, normals, strict=True):
        hit = world.ray_intersect(mitsuba.Ray3f(point + 0.01 * normal, -normal))
        np.testing.assert_allclose(np.array(hit.p), point, atol=1e-4)
        np.testing.assert_allclose(np.array(hit.sh_frame.n), normal, atol=1e-4)
    assert scene.lights["area"].sum() == pytest.approx(theirs.surface_area(), rel=2e-5)
    box = theirs.bbox()
    np.testing.assert_allclose(scene.bounds, [np.array(box.min), np.array(box.max)], atol=2e-5)


CAMERAS = [
    {"fov": 40.0},
    {"fov": 40.0, "fov_axis": "y"},
    {"fov": 40.0, "fov_axis": "diagonal"},
    {"fov": 40.0, "fov_axis": "smaller"},
    {"fov": 40.0, "fov_axis": "larger"},
    {"focal_length": "35mm"},
    {},
    {"fov": 60.0, "principal_point_offset_x": 0.1, "principal_point_offset_y": -0.2, "near_clip": 0.5, "far_clip": 7.0},
]
FILMS = [
    {"width": 200, "height": 100},
    {"width": 30, "height": 90},
    {"width": 64, "height": 64, "crop_offset_x": 16, "crop_offset_y": 4, "crop_width": 20, "crop_height": 50},
]
VIEW = [[0.8, 0, 0.6, 1], [0, 1, 0, 2], [-0.6, 0, 0.8, 3], [0, 0, 0, 1]]


@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("sensor", CAMERAS)
def test_camera_rays_agree_with_mitsuba(sensor, film, mitsuba):
    """Rays through points of the image, computed from structs.CAMERA."""
    description = {"type": "perspective", **sensor, "film": {"type": "hdrfilm", **film, "rfilter": {"type": "box"}}}
    theirs = mitsuba.load_dict({**description, "to_world": mitsuba.ScalarTransform4f(np.array(VIEW))})
    camera = compile_scene(
        load_description({"type": "scene", "sensor": {**description, "to_world": np.array(VIEW)}})
    ).camera[0]
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    for image in itertools.product((0.0, 0.3, 1.0), repeat=2):
        ray, _ = theirs.sample_ray(0.0, 0.0, image, (0.0, 0.0))
        pixel = camera["crop_offset"] + np.array(image) * camera["crop_size"]
        slope = camera["tan_half_fov"] * (1 - 2 * (pixel / camera["film_size"] + camera["principal_point"]))
        forward = np.array([*slope, 1.0])
        direction = to_world[:, :3] @ forward
        np.testing.assert_allclose(np.array(ray.d), direction / np.linalg.norm(direction), atol=2e-6)
        origin = to_world[:, 3] + camera["near_clip"] * direction
        np.testing.assert_allclose(np.array(ray.o), origin, atol=2e-6)
        length = (camera["far_clip"] - camera["near_clip"]) * np.linalg.norm(direction)
        assert ray.maxt == pytest.approx(length, rel=1e-5)


def test_camera_axes_in_closed_form():
    def tangents(**sensor):
        scene = {
            "type": "scene",
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 40, "height": 20}, **sensor},
        }
        return compile_scene(load_description(scene)).camera["tan_half_fov"][0].tolist()

    assert tangents(fov=90) == pytest.approx([1, 0.5])
    assert tangents(fov=90, fov_axis="larger") == pytest.approx([1, 0.5])
    assert tangents(fov=90, fov_axis="y") == pytest.approx([2, 1])
    assert tangents(fov=90, fov_axis="smaller") == pytest.approx([2, 1])
    assert np.hypot(*tangents(fov=90, fov_axis="diagonal")) == pytest.approx(1)
    assert np.hypot(*tangents(focal_length="50mm")) == pytest.approx(np.hypot(36, 24) / 100)


@pytest.mark.parametrize(
    ("rfilter", "name", "radius"),
    [
        ({"type": "box"}, "box", 0.5),
        ({"type": "tent"}, "tent", 1.0),
        ({"type": "tent", "radius": 2.5}, "tent", 2.5),
        ({"type": "gaussian"}, "gaussian", 2.0),
        ({"type": "gaussian", "stddev": 1.0}, "gaussian", 4.0),  # Mitsuba 3.9.1 prints radius=4.00
    ],
)
def test_filters(rfilter, name, radius):
    film = {"type": "hdrfilm", "rfilter": rfilter}
    scene = compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective", "film": film}}))
    assert (scene.filter, scene.camera["filter_radius"][0]) == (name, radius)


def test_emitters_without_surface():
    def light(**emitter):
        return compile_scene(
            load_description({"type": "scene", "sensor": {"type": "perspective"}, "it": emitter})
        ).lights[0]

    turn = [[0, 0, 1, 4], [1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 0, 1]]
    assert light(type="point", position=[1, 2, 3])["position"].tolist() == [1, 2, 3]
    assert light(type="point", to_world=turn)["position"].tolist() == [4, 5, 6]
    assert light(type="directional", direction=[0, 0, -2])["position"].tolist() == [0, 0, -1]
    assert light(type="directional", to_world=turn)["position"].tolist() == [1, 0, 0]
    assert light(type="directional")["position"].tolist() == [0, 0, 1]
