"""Texture coordinates and attributes of meshes, against the rules and against Mitsuba."""

import numpy as np
import pytest
from small_scene import lamp_over_floor

import isonoise
from isonoise.errors import SceneError
from isonoise.scene.mesh.load_mesh import load_mesh
from isonoise.scene.mesh.obj import _index_corners, read_obj
from isonoise.scene.mesh.ply import read_ply
from isonoise.scene.mesh.ply_attributes import find_attributes

TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt .25 .75\nvt .5 .125 9\nvt -3 1e3\nvn 0 0 1\nvn 0 0.6 0.8\n"


def corner_values(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Positions (t, 3, 3) and uvs (t, 3, 2) of the corners of all triangles."""
    return mesh.vertices[mesh.faces], mesh.uvs[mesh.faces]


def parameters_of(mitsuba, **shape) -> dict[str, np.ndarray]:
    parameters = mitsuba.traverse(mitsuba.load_dict(shape))
    sizes = {"vertex_positions": 3, "vertex_normals": 3, "vertex_texcoords": 2, "faces": 3}
    return {
        name: np.array(parameters[name]).reshape(-1, sizes.get(name, 1))
        for name in list(parameters.keys())
        if name in sizes or name.startswith(("vertex_", "face_"))
    }


OBJ = {
    "texture": "f 1/1 2/2 3/3",
    "all": "f 1/1/1 2/2/1 3/3/2",
    "quad and seam": "f 1/1 2/2 4/3 3/1\nf 1/3 2/2 3/3",
    "shared": "f 1/1 2/2 3/3\nf 2/2 4/1 3/3",
}


@pytest.mark.parametrize("flip", [True, False])
@pytest.mark.parametrize("faces", OBJ.values(), ids=OBJ)
def test_obj_against_mitsuba(faces, flip, write_file, mitsuba):
    path = write_file("a.obj", TRIANGLES + faces + "\n")
    theirs = parameters_of(mitsuba, type="obj", filename=str(path), flip_tex_coords=flip)
    positions, uvs = corner_values(read_obj(path, flip).mesh)
    corners = theirs["faces"]
    np.testing.assert_array_equal(positions, theirs["vertex_positions"][corners])
    np.testing.assert_array_equal(uvs, theirs["vertex_texcoords"][corners])


def test_obj_flips_v_by_default(write_file):
    path = write_file("a.obj", TRIANGLES + "f 1/1 2/2 3/3\n")
    shape = {"type": "obj", "filename": str(path)}
    for flip, v in ((True, [0.25, 0.875, -999]), (False, [0.75, 0.125, 1000])):
        mesh = load_mesh({**shape, "flip_tex_coords": flip})
        assert mesh.uvs.dtype == np.float32
        np.testing.assert_array_equal(mesh.uvs, np.stack([[0.25, 0.5, -3], v], axis=1))


def test_obj_vertices_split_where_their_coordinates_differ(write_file):
    mesh = read_obj(write_file("a.obj", TRIANGLES + "f 1/1 2/2 3/3\nf 2/1 4/1 3/3\nf 2/2 4/1 3/3\n")).mesh
    assert mesh.vertices.shape == (5, 3)  # 2/1 and 2/2 are different
    np.testing.assert_array_equal(mesh.uvs[mesh.faces[:, 0]], [[0.25, 0.25], [0.25, 0.25], [0.5, 0.875]])


def test_obj_corners_without_coordinates_have_zero(write_file):
    mesh = read_obj(write_file("a.obj", TRIANGLES + "f 1/1 2/2 3/3\nf 1 2 4\n")).mesh
    np.testing.assert_array_equal(mesh.uvs[mesh.faces[1]], np.zeros((3, 2)))
    assert read_obj(write_file("a.obj", TRIANGLES + "f 1//1 2//1 3//1\n")).mesh.uvs.shape == (0, 2)
    # Coordinates that no face uses are not parsed.
    assert read_obj(write_file("a.obj", TRIANGLES + "vt x\nf 1 2 3\n")).mesh.uvs.shape == (0, 2)


@pytest.mark.parametrize("line", ["vt .5", "vt a b", "vt .5 x"])
def test_obj_coordinates_are_two_numbers(line, write_file):
    with pytest.raises(SceneError, match="a line that begins with 'vt' needs two numbers"):
        read_obj(write_file("a.obj", TRIANGLES + line + "\nf 1/1 2/2 3/3\n"))


def test_uvs_that_are_not_finite_become_zero(write_file):
    path = write_file("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt nan 0\nvt inf -inf\nvt 1e300 .25\nf 1/1 2/2 3/3\n")
    np.testing.assert_array_equal(read_obj(path, False).mesh.uvs, [[0, 0], [0, 0], [0, 0.25]])
    path = write_file("a.ply", ply(["float u", "float v"], [], "nan 1e300", ""))
    np.testing.assert_array_equal(read_ply(path).uvs, np.zeros((3, 2)))


def test_obj_corner_keys_do_not_overflow():
    """Corners whose keys would differ by 2^64: 2^22 uvs and normals each, and vertices 2^20 apart."""
    last = 2**22 - 2
    vertices = np.broadcast_to(np.arange(2**20 + 1.0)[:, None], (2**20 + 1, 3))
    normals = np.broadcast_to(1.0, (last + 1, 3))
    uvs = np.broadcast_to(np.float32(1), (last + 1, 2))
    corners = np.array([[0, last, last], [2**20, last, last], [1, last, last]])
    mesh, _ = _index_corners(vertices, normals, uvs, corners, np.array([[0, 1, 2]]))
    assert mesh.vertices[mesh.faces[0], 0].tolist() == [0, 2**20, 1]


def ply(vertex: list[str], face: list[str], vertex_row: str, face_row: str) -> str:
    """An ASCII file of one triangle whose vertices all have the same additional values."""
    properties = ["float x", "float y", "float z", *vertex]
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property {name}\n" for name in properties)
    header += "element face 1\nproperty list uchar int vertex_indices\n"
    header += "".join(f"property {name}\n" for name in face) + "end_header\n"
    return header + "".join(f"{x} {y} 0 {vertex_row}\n" for x, y in ((0, 0), (1, 0), (0, 1))) + f"3 0 1 2 {face_row}\n"


RGB = ["red", "green", "blue"]
PLY = {
    "u v": (["float u", "float v"], [], ".25 .75", ""),
    "s t": (["float s", "float t"], [], ".25 .75", ""),
    "texture_u": (["double texture_u", "half texture_v"], [], ".25 .75", ""),
    "u v before s t": (["float s", "float t", "float u", "float v"], [], "1 2 .25 .75", ""),
    "not s alone": (["float s"], [], "1", ""),
    "colour": ([f"float {c}" for c in RGB], [], "1 .5 .25", ""),
    "colour with alpha": ([f"float {c}" for c in (*RGB, "alpha")], [], "1 .5 .25 .75", ""),
    "r g b": (["float u", "float v", "float r", "float g", "float b"], [], ".1 .2 1 .5 .25", ""),
    "colour in another order": (["float b", "float x_x", "float g", "float r"], [], "1 .5 .25 .75", ""),
    "one": (["float heat_x"], [], "7", ""),
    "two": (["float heat_x", "float heat_y"], [], "1 2", ""),
    "three": ([f"float heat_{c}" for c in "xyz"], [], "1 2 3", ""),
    "four": ([f"float heat_{c}" for c in "xyzw"], [], "1 2 3 4", ""),
    "numbered": ([f"float a_{c}" for c in "012"] + [f"float b_{c}" for c in "123"], [], "1 2 3 4 5 6", ""),
    "prefixed colour": ([f"float top_{c}" for c in "rgb"] + ["float low_r"], [], "1 2 3 4", ""),
    "wrong order": (["float heat_y", "float heat_z"], [], "1 2", ""),
    "interrupted": (["float heat_x", "float q", "float heat_y", "float heat_z"], [], "1 2 3 4", ""),
    "long ending": (["float heat_xx", "float heat"], [], "1 2", ""),
    "prefix with _": (["float my_heat_x", "float my_other_x"], [], "1 2", ""),
    "whole numbers": ([f"ushort {c}" for c in RGB] + ["int heat_x", "short it_x"], [], "0 1000 65535 50000 -3", ""),
    "face colour": ([], [f"float {c}" for c in RGB], "", "1 .5 .25"),
    "face values": ([], ["float heat_x", "float it_0", "float it_1", "float it_2", "ushort a_x"], "", "1 2 3 4 9000"),
    "both": (["float heat_x"], ["float heat_x"], "1", "2"),
}


@pytest.mark.parametrize("case", PLY.values(), ids=PLY)
def test_ply_against_mitsuba(case, write_file, mitsuba):
    path = write_file("a.ply", ply(*case))
    theirs = parameters_of(mitsuba, type="ply", filename=str(path))
    mesh = read_ply(path)
    uvs = theirs.pop("vertex_texcoords")
    np.testing.assert_array_equal(mesh.uvs, uvs)
    theirs = {name: values for name, values in theirs.items() if name not in ("vertex_positions", "vertex_normals")}
    del theirs["faces"]
    assert set(mesh.attributes) == set(theirs)
    for name, values in mesh.attributes.items():
        rows = 1 if name.startswith("face_") else 3
        assert values.dtype == np.float32
        np.testing.assert_allclose(values, theirs[name].reshape(rows, -1), rtol=2e-6)


def test_ply_flips_v_on_request(write_file, mitsuba):
    path = write_file("a.ply", ply(["float u", "float v"], [], ".25 .125", ""))
    theirs = parameters_of(mitsuba, type="ply", filename=str(path), flip_tex_coords=True)
    mesh = load_mesh({"type": "ply", "filename": str(path), "flip_tex_coords": True})
    np.testing.assert_array_equal(mesh.uvs, theirs["vertex_texcoords"])
    np.testing.assert_array_equal(mesh.uvs, [[0.25, 0.875]] * 3)


@pytest.mark.parametrize("order", ["ascii", "<", ">"])
def test_byte_colours_are_srgb(order, write_file):
    """255 is 1 and 128 is 0.2158605 linear (IEC 61966-2-1). Mitsuba decodes integers of every other size so."""
    name = {"ascii": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    text = ply([f"uchar {c}" for c in (*RGB, "alpha")], ["uchar it_x"], "255 128 10 0", "128").replace("ascii", name)
    if order != "ascii":
        head = text[: text.index("end_header") + 11].encode()
        vertices = np.zeros(3, np.dtype([("p", order + "f4", 3), ("c", "u1", 4)]))
        vertices["p"], vertices["c"] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [255, 128, 10, 0]
        face = np.array([(3, [0, 1, 2], 128)], np.dtype([("n", "u1"), ("i", order + "i4", 3), ("it", "u1")]))
        text = head + vertices.tobytes() + face.tobytes()
    attributes = read_ply(write_file("a.ply", text)).attributes
    np.testing.assert_allclose(attributes["vertex_color"], [[1, 0.2158605, 0.0030352698, 0]] * 3, rtol=1e-6)
    np.testing.assert_allclose(attributes["face_it"], [[0.2158605]], rtol=1e-6)


def test_face_values_apply_to_all_triangles_of_a_polygon(write_file):
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 4\nproperty float heat_x\nproperty list uchar int vertex_index\nproperty float r\n"
    header += "property list uchar float ignored\nproperty float g\nproperty float b\nend_header\n"
    rows = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 .5 0\n"
    rows += "10 3 0 1 2 .1 0 .2 .3\n20 4 0 1 2 3 .4 2 9 9 .5 .6\n30 5 0 1 2 3 4 .7 1 9 .8 .9\n40 3 1 2 3 1 0 0 0\n"
    mesh = read_ply(write_file("a.ply", header + rows))
    assert len(mesh.faces) == 7
    assert mesh.attributes["face_heat"].tolist() == [[10], [20], [20], [30], [30], [30], [40]]
    expected = [[0.1, 0.2, 0.3]] + [[0.4, 0.5, 0.6]] * 2 + [[0.7, 0.8, 0.9]] * 3 + [[1, 0, 0]]
    np.testing.assert_array_equal(mesh.attributes["face_color"], np.float32(expected))


def test_attribute_names():
    names = ["", "a_x", "a_y", "a_z", "a_x", "b_1", "r", "c_r", "c_g", "c_b", "g", "b", "color_x"]
    expected = {"face_color": [6, 10, 11], "face_b": [5], "face_c_color": [7, 8, 9]}
    assert find_attributes(names, "face") == expected  # the four a_... in a row match no suffixes


def test_rectangle(mitsuba):
    mesh = load_mesh({"type": "rectangle"})
    rectangle = mitsuba.load_dict({"type": "rectangle"})
    for x, y in ((-0.75, 0.5), (0.25, -0.125), (0.9, 0.7)):
        ray = mitsuba.Ray3f([x, y, 1], [0, 0, -1])
        uv = rectangle.ray_intersect(ray).uv
        np.testing.assert_allclose(interpolated(mesh, np.array([x, y, 0])), [uv[0], uv[1]], atol=1e-6)


def interpolated(mesh, point: np.ndarray) -> np.ndarray:
    """Texture coordinates at a point of the mesh."""
    for face in mesh.faces:
        a, b, c = mesh.vertices[face]
        weights, residuals, _, _ = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)
        if np.allclose(residuals, 0, atol=1e-12) and weights.min() >= 0 and weights.sum() <= 1:
            return np.array([1 - weights.sum(), *weights]) @ mesh.uvs[face]
    raise AssertionError("the point is not on the mesh")


def test_cube(mitsuba):
    mesh = load_mesh({"type": "cube"})
    theirs = parameters_of(mitsuba, type="cube")
    np.testing.assert_array_equal(mesh.faces, theirs["faces"])
    np.testing.assert_array_equal(mesh.vertices, theirs["vertex_positions"])
    np.testing.assert_array_equal(mesh.uvs, theirs["vertex_texcoords"])


@pytest.mark.usefixtures("one_lane")
@pytest.mark.parametrize("normals", ["", "0 0 1", "0 0 -1"])
@pytest.mark.parametrize("flip", [False, True])
def test_without_uvs_they_are_barycentric(flip, normals, write_file):
    """The corners of a triangle, in file order, have uvs (0, 0), (1, 0) and (0, 1), as in Mitsuba 3.9.1.

    The floor has an anisotropic bsdf with a checkerboard. Normals that oppose the winding reverse it.
    """
    corners = ["-1 -1 0", "1.2 -1 0", "-1 1 0", "1.1 1 0", "-1 1.1 0", "1.2 -1 0"]

    def render(uvs):
        rows = [" ".join(filter(None, row)) for row in zip(corners, [normals] * 6, uvs, strict=True)]
        names = ["x", "y", "z", *(("nx", "ny", "nz") if normals else ()), *(("u", "v") if uvs[0] else ())]
        head = ["ply", "format ascii 1.0", "element vertex 6", *(f"property float {name}" for name in names)]
        head += ["element face 2", "property list uchar int vertex_indices", "end_header"]
        path = write_file("floor.ply", "\n".join([*head, *rows, "3 0 1 2", "3 3 4 5", ""]))
        checks = {"type": "checkerboard", "to_uv": np.diag([4.0, 3.0, 1.0, 1.0])}
        metal = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.5, "specular_reflectance": checks}
        floor = {"type": "ply", "filename": str(path), "flip_normals": flip}
        scene = lamp_over_floor() | {"floor": floor | {"bsdf": {"type": "twosided", "bsdf": metal}}}
        return isonoise.render(scene, spp=16).statistics.rgb

    without_uvs, with_uvs = render([""] * 6), render(["0 0", "1 0", "0 1"] * 2)
    assert without_uvs.mean() > 0.01
    np.testing.assert_allclose(without_uvs, with_uvs, rtol=1e-4, atol=1e-6)
