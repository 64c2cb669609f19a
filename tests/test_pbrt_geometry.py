"""Transforms, cameras, shapes and instances of pbrt files, against closed forms."""

import numpy as np
import pytest
from pbrt_files import TRIANGLE, objects, only, read_world

from isonoise.scene.camera import compile_camera
from isonoise.scene.formats.pbrt.shapes import to_world_space
from isonoise.scene.mesh.mesh import Mesh

QUAD = '"point3 P" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]'
CAMERAS = {
    "square": ('LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "perspective" "float fov" 40', 32, 32),
    "wide": ('LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "perspective" "float fov" 40', 64, 32),
    "high": ('LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "perspective" "float fov" 40', 32, 64),
    "mirrored": ('Scale -1 1 1 LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "perspective" "float fov" 40', 48, 32),
    "scaled": ('Scale 2 2 2 Translate 0 0 5 Rotate 20 0 1 0 Camera "perspective" "float fov" 60', 48, 32),
    "window": (
        'LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "perspective" "float fov" 40 "float screenwindow" [-0.5 1 -1 0.25]',
        36,
        30,
    ),
    "halffov": ('Translate 0 0 5 Camera "perspective" "float halffov" 20', 32, 24),
    "orthographic": (
        'LookAt 3 2 -6 0.1 0.3 0 0 1 0 Camera "orthographic" "float screenwindow" [-2 3 -1.5 2.25]',
        40,
        30,
    ),
}


def pbrt_pixel(camera_from_world: np.ndarray, point, fov, window, size, orthographic: bool) -> np.ndarray:
    """Where pbrt-v4 projects a point: the perspective transform of its book, section 5.2."""
    x, y, z = (camera_from_world @ [*point, 1.0])[:3]
    if not orthographic:
        x, y = np.array([x, y]) / (z * np.tan(np.radians(fov) / 2))
    x_min, x_max, y_min, y_max = window
    return np.array([(x - x_min) / (x_max - x_min), (y_max - y) / (y_max - y_min)]) * size


def isonoise_pixel(sensor: dict, point) -> np.ndarray:
    """Where the kernel `generate` sends a ray through the point."""
    (camera,), _ = compile_camera(
        sensor | {"principal_point_offset_x": 0.0, "principal_point_offset_y": 0.0} | sensor, None
    )
    to_world = np.eye(4)
    to_world[:3] = camera["to_world"].reshape(3, 4)
    local = np.linalg.inv(to_world) @ [*point, 1.0]
    slope = local[:2] / (1.0 if sensor["type"] == "orthographic" else local[2])
    return (0.5 * (1 - slope / camera["tan_half_fov"]) - camera["principal_point"]) * camera["film_size"]


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_project_as_pbrt_does(tmp_path, name):
    text, width, height = CAMERAS[name]
    film = f'Film "rgb" "integer xresolution" {width} "integer yresolution" {height}\n'
    scene, report = read_world(tmp_path, 'CoordSysTransform "camera" Shape "sphere"', film + text)
    camera_from_world = np.linalg.inv(only(scene, "sphere")["to_world"])
    aspect = width / height
    window = (-max(aspect, 1), max(aspect, 1), -max(1 / aspect, 1), max(1 / aspect, 1))
    fov = 60 if name == "scaled" else 40
    if "screenwindow" in text:
        window = tuple(float(word) for word in text.partition("[")[2].rstrip("]").split())
    assert not report.warnings()
    for point in ((0.2, 0.5, 0.1), (-1.0, 0.3, 0.7), (0.4, -0.8, 0.0)):
        expected = pbrt_pixel(camera_from_world, point, fov, window, (width, height), name == "orthographic")
        assert isonoise_pixel(scene["sensor"], point) == pytest.approx(expected, abs=1e-3)


def test_transforms_multiply_from_the_right(tmp_path):
    world = """
    Translate 1 2 3
    CoordinateSystem "moved"
    Rotate 90 0 0 2
    ConcatTransform [2 0 0 0 0 3 0 0 0 0 4 0 1 0 0 1]
    Shape "trianglemesh" "point3 P" [1 0 0 0 1 0 0 0 1] "integer indices" [0 1 2]
    CoordSysTransform "moved"
    Shape "trianglemesh" "point3 P" [1 0 0 0 1 0 0 0 1]
    Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 7 1]
    TransformBegin Identity Translate 9 9 9 TransformEnd
    Shape "trianglemesh" "point3 P" [1 0 0 0 1 0 0 0 1]
    """
    scene, _ = read_world(tmp_path, world)
    first, second, third = (mesh["vertices"] for mesh in objects(scene, "mesh"))
    # scale and translate along x, then turn x to y and y to -x, then translate
    assert first == pytest.approx(np.array([[1, 5, 3], [-2, 3, 3], [1, 3, 7]]), abs=1e-12)
    assert second == pytest.approx(np.array([[2, 2, 3], [1, 3, 3], [1, 2, 4]]), abs=1e-12)
    assert third == pytest.approx(np.array([[1, 0, 7], [0, 1, 7], [0, 0, 8]]), abs=1e-12)


def test_attributes_are_restored(tmp_path):
    world = f"""
    Attribute "shape" "float radius" 3
    AttributeBegin
      Attribute "shape" "float radius" 2
      Material "dielectric" ReverseOrientation Translate 1 0 0
      AreaLightSource "diffuse" "rgb L" [1 2 3]
      Shape "sphere"
      Shape "sphere" "float radius" 5
    AttributeEnd
    Shape "sphere"
    {TRIANGLE}
    """
    scene, report = read_world(tmp_path, world)
    first, second, third = objects(scene, "sphere")
    assert [shape["radius"] for shape in (first, second, third)] == [2, 5, 3]
    assert [shape["flip_normals"] for shape in (first, second, third)] == [True, True, False]
    assert first["bsdf"]["type"] == "dielectric"
    assert third["bsdf"]["type"] == "twosided"
    assert first["emitter"]["radiance"]["value"] == [1, 2, 3]
    assert "emitter" not in third
    assert third["to_world"] == pytest.approx(np.eye(4))
    assert not report.warnings()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("has_normals", [False, True])
def test_triangle_normals_follow_pbrt(mirrored, reverse, has_normals):
    """pbrt-v4's Triangle: the normal of the vertices' order, or the side of N; mirrored with the object."""
    mesh = Mesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        np.array([[0, 2, 1]] if has_normals else [[0, 1, 2]]),  # with normals the order does not count
        np.array([[0.0, 0, 2]] * 3) if has_normals else np.zeros((0, 3)),
    )
    to_world = np.diag([-2.0 if mirrored else 2.0, 3.0, 4.0, 1.0])
    placed = to_world_space(mesh, to_world, reverse)
    first, second, third = placed.vertices[placed.faces[0]]
    expected = [0, 0, -1 if reverse else 1]
    normal = np.cross(second - first, third - first)
    assert normal / np.linalg.norm(normal) == pytest.approx(expected)
    if has_normals:
        assert placed.normals == pytest.approx(np.array([expected] * 3))


@pytest.mark.parametrize("shape", ["sphere", "disk", "cylinder"])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
def test_mirrored_quadrics_keep_their_front(tmp_path, shape, mirrored, reverse):
    """The front is outside or at +z. Mitsuba turns the normals of mirrored spheres inwards (its sphere.cpp)."""
    text = f'{"Scale -1 1 1" if mirrored else ""} {"ReverseOrientation" if reverse else ""} Shape "{shape}"'
    made = only(read_world(tmp_path, text)[0], shape)
    assert made["flip_normals"] == (reverse != (mirrored and shape == "sphere"))


def test_texture_coordinates_have_v_at_the_top(tmp_path):
    world = f'Shape "trianglemesh" {QUAD} "point2 uv" [0 0 1 0 0 1 1 1] "integer indices" [0 1 2 2 1 3]'
    mesh = only(read_world(tmp_path, world)[0], "mesh")
    assert mesh["texcoords"].tolist() == [[0, 1], [1, 1], [0, 0], [1, 0]]
    assert mesh["face_normals"] is True  # pbrt shades meshes without normals flat


def test_quadrics_are_analytic_where_they_are_whole(tmp_path):
    world = """
    Shape "sphere" "float radius" 2
    Shape "disk" "float height" 3 "float radius" 2
    Shape "cylinder" "float radius" 2 "float zmin" -1 "float zmax" 3
    """
    scene, report = read_world(tmp_path, world)
    assert only(scene, "sphere")["radius"] == 2
    assert only(scene, "disk")["to_world"] == pytest.approx(
        np.array([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]])
    )
    cylinder = only(scene, "cylinder")
    assert (cylinder["p0"], cylinder["p1"], cylinder["radius"]) == ((0, 0, -1), (0, 0, 3), 2)
    assert not report.warnings()


QUADRIC_AREAS = {
    '"sphere" "float radius" 2 "float zmin" -1 "float zmax" 0.5': 2 * np.pi * 2 * 1.5,
    '"sphere" "float phimax" 90': np.pi,
    '"disk" "float radius" 2 "float innerradius" 1 "float phimax" 180': 1.5 * np.pi,
    '"cylinder" "float radius" 2 "float zmin" 0 "float zmax" 3 "float phimax" 90': 3 * np.pi,
    '"cone" "float radius" 3 "float height" 4': 15 * np.pi,
    '"paraboloid" "float radius" 1 "float zmax" 1': np.pi / 6 * (5**1.5 - 1),
}


@pytest.mark.parametrize("shape", QUADRIC_AREAS)
def test_partial_quadrics_are_meshes_with_their_area(tmp_path, shape):
    scene, report = read_world(tmp_path, f"Shape {shape}")
    mesh = only(scene, "mesh")
    first, second, third = (mesh["vertices"][mesh["faces"][:, corner]] for corner in range(3))
    crosses = np.cross(second - first, third - first)
    areas = 0.5 * np.linalg.norm(crosses, axis=1)
    assert areas.sum() == pytest.approx(QUADRIC_AREAS[shape], rel=1e-3)
    normals = mesh["normals"][mesh["faces"]].mean(axis=1)
    is_large = areas > 1e-9
    cosines = np.einsum("ij,ij->i", crosses, normals)[is_large] / (2 * areas[is_large])
    assert cosines.min() > 0.99 if "cone" not in shape and "paraboloid" not in shape else cosines.min() > 0.9
    if '"sphere"' in shape or '"cylinder"' in shape:
        assert (np.einsum("ij,ij->i", mesh["vertices"], mesh["normals"]) > -1e-9).all()  # outwards
    assert "fine meshes" in report.warnings()[0]


def test_distorted_spheres_are_meshes(tmp_path):
    scene, _ = read_world(tmp_path, 'Scale 1 2 3 Shape "sphere"')
    points = only(scene, "mesh")["vertices"] / (1, 2, 3)
    assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 1e-6


def test_bilinear_patches(tmp_path):
    flat, _ = read_world(tmp_path, f'Shape "bilinearmesh" {QUAD} "integer indices" [0 1 2 3]')
    mesh = only(flat, "mesh")
    assert len(mesh["faces"]) == 2
    assert mesh["texcoords"].tolist() == [[0, 1], [1, 1], [0, 0], [1, 0]]
    saddle, report = read_world(tmp_path, 'Shape "bilinearmesh" "point3 P" [-1 -1 1 1 -1 -1 -1 1 -1 1 1 1]')
    mesh = only(saddle, "mesh")
    x, y, z = mesh["vertices"].T
    assert z == pytest.approx(x * y)
    assert len(mesh["faces"]) == 128
    assert not report.warnings()
    for scene in (flat, saddle):
        mesh = only(scene, "mesh")
        first, second, third = (mesh["vertices"][mesh["faces"][:, corner]] for corner in range(3))
        assert (np.cross(second - first, third - first)[:, 2] > 0).all()  # dp/du x dp/dv


OCTAHEDRON = """
"point3 P" [1 0 0 0 1 0 -1 0 0 0 -1 0 0 0 1 0 0 -1]
"integer indices" [0 1 4 1 2 4 2 3 4 3 0 4 1 0 5 2 1 5 3 2 5 0 3 5]
"""


def test_subdivision_surfaces_lie_on_the_limit_surface(tmp_path):
    """More levels add vertices of the same surface; the limit of a vertex of valence 4 is known."""
    meshes = [
        only(read_world(tmp_path, f'Shape "loopsubdiv" "integer levels" {levels} {OCTAHEDRON}')[0], "mesh")
        for levels in (0, 1, 3)
    ]
    assert [len(mesh["faces"]) for mesh in meshes] == [8, 32, 512]
    # beta = 3/32, weight of a neighbour 1/(4 + 3/(8 beta)) = 1/8; the neighbours of (1, 0, 0) cancel
    assert meshes[0]["vertices"][0] == pytest.approx([0.5, 0, 0])
    for mesh in meshes[1:]:
        assert mesh["vertices"][:6] == pytest.approx(meshes[0]["vertices"])
        first, second, third = (mesh["vertices"][mesh["faces"][:, corner]] for corner in range(3))
        assert (np.einsum("ij,ij->i", np.cross(second - first, third - first), first) > 0).all()  # outwards
    assert meshes[2]["face_normals"] is False


def test_borders_of_subdivision_surfaces_are_splines(tmp_path):
    """The border of a flat square stays in its plane, its corners move as those of a cubic B-spline."""
    square = '"point3 P" [0 0 0 1 0 0 1 1 0 0 1 0] "integer indices" [0 1 2 0 2 3]'
    scene, report = read_world(tmp_path, f'Shape "loopsubdiv" "integer levels" 2 {square}')
    mesh = only(scene, "mesh")
    # limit of a corner: (1 - 2/5) p + 1/5 of its neighbours, after two steps of 3/4 p + 1/8 of them
    ring = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    for _ in range(2):
        even = 0.75 * ring + 0.125 * (np.roll(ring, 1, axis=0) + np.roll(ring, -1, axis=0))
        odd = 0.5 * (ring + np.roll(ring, -1, axis=0))
        ring = np.stack([even, odd], axis=1).reshape(-1, 2)
    limit = 0.6 * ring + 0.2 * (np.roll(ring, 1, axis=0) + np.roll(ring, -1, axis=0))
    assert mesh["vertices"][0, :2] == pytest.approx(limit[0])
    assert not mesh["vertices"][:, 2].any()
    assert not report.warnings()


def test_height_fields(tmp_path):
    scene, _ = read_world(tmp_path, 'Shape "heightfield" "integer nu" 3 "integer nv" 2 "float Pz" [0 1 2 3 4 5]')
    mesh = only(scene, "mesh")
    assert mesh["vertices"][4].tolist() == [0.5, 1, 4]
    assert len(mesh["faces"]) == 4


def test_ply_meshes_are_read_from_the_scenes_folder(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "property float u\nproperty float v\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "quad.ply").write_text(header + "0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n")
    scene, report = read_world(tmp_path, 'Translate 0 0 2 Shape "plymesh" "string filename" "quad.ply"')
    mesh = only(scene, "mesh")
    assert mesh["vertices"].tolist() == [[0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]]
    assert mesh["texcoords"].tolist() == [[0, 1], [1, 1], [1, 0], [0, 0]]
    assert len(mesh["faces"]) == 2
    assert not report.warnings()


def test_instances_share_a_group(tmp_path):
    world = """
    AttributeBegin Translate 1 0 0 ObjectBegin "pair"
      Shape "sphere"
      AreaLightSource "diffuse" Shape "sphere" "float radius" 2
    ObjectEnd AttributeEnd
    Translate 0 5 0 ObjectInstance "pair" Scale 2 2 2 ObjectInstance "pair"
    ObjectBegin "nothing" Shape "curve" ObjectEnd ObjectInstance "nothing"
    """
    scene, report = read_world(tmp_path, world)
    first, second = objects(scene, "instance")
    assert first["group"] is second["group"]
    assert first["group"]["type"] == "shapegroup"
    spheres = [value for value in first["group"].values() if isinstance(value, dict)]
    assert [sphere["radius"] for sphere in spheres] == [1, 2]
    assert spheres[0]["to_world"][:3, 3].tolist() == [1, 0, 0]
    assert second["to_world"] == pytest.approx(np.array([[2, 0, 0, 0], [0, 2, 0, 5], [0, 0, 2, 0], [0, 0, 0, 1]]))
    assert all("emitter" not in sphere for sphere in spheres)
    texts = " ".join(report.warnings())
    assert "lights inside objects do not emit" in texts
    assert "'curve' is left out" in texts


def test_film_crop_filter_and_lens(tmp_path):
    options = """
    Film "rgb" "integer xresolution" 100 "integer yresolution" 50 "float cropwindow" [0.25 0.755 0 0.5]
    PixelFilter "triangle" "float xradius" 1.5 "float yradius" 1.5
    Integrator "volpath" "integer maxdepth" 7
    Camera "perspective" "float lensradius" 0.1 "float focaldistance" 3
    """
    scene, report = read_world(tmp_path, "", options)
    film, sensor = scene["sensor"]["film"], scene["sensor"]
    window = [film[f"crop_{name}"] for name in ("offset_x", "offset_y", "width", "height")]
    assert window == [25, 0, 51, 25]  # pbrt rounds both ends up
    assert film["rfilter"] == {"type": "tent", "radius": 1.5}
    assert (sensor["type"], sensor["aperture_radius"], sensor["focus_distance"]) == ("thinlens", 0.1, 3)
    assert scene["integrator"] == {"type": "path", "max_depth": 8}
    assert not report.warnings()


def test_legacy_filters(tmp_path):
    scene, _ = read_world(tmp_path, "", 'Film "image" PixelFilter "gaussian" "float alpha" 0.5 "float xwidth" 2')
    film = scene["sensor"]["film"]
    assert film["rfilter"] == {"type": "gaussian", "stddev": 1.0}
    assert (film["width"], film["height"]) == (640, 480)


def test_motion_keeps_the_start(tmp_path):
    world = "ActiveTransform EndTime Translate 9 9 9 ActiveTransform All\n" + TRIANGLE
    scene, report = read_world(tmp_path, world)
    assert only(scene, "mesh")["vertices"][0].tolist() == [0, 0, 0]
    assert "start of the exposure" in report.warnings()[0]
