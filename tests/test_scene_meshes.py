"""OBJ, PLY, STL and GLB: triangles, their order and normals, and rejected files."""

import os
import struct
import time
import tracemalloc

import numpy as np
import pytest
from records import slot

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.mesh.triangle_records import triangle_records

MIRROR = np.diag([-1.0, 1, 1, 1])


def compile_mesh(path, **extra):
    kind = path.suffix[1:]
    shape = {"type": kind, "filename": str(path), **extra}
    return compile_scene(load_description({"type": "scene", "sensor": {"type": "perspective"}, "it": shape}))


def icosphere(levels: int) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=levels)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def obj_text(vertices, faces) -> str:
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in np.add(faces, 1)]
    return "\n".join(lines) + "\n"


def ply_bytes(vertices, faces, order: str = "<") -> bytes:
    name = {"<": "little", ">": "big"}[order]
    header = (
        f"ply\nformat binary_{name}_endian 1.0\ncomment made\nelement vertex {len(vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    records = np.zeros(len(faces), np.dtype([("n", "u1"), ("i", order + "i4", 3)]))
    records["n"], records["i"] = 3, faces
    return header.encode() + np.asarray(vertices, order + "f4").tobytes() + records.tobytes()


FACES = {
    "plain": "f 1 2 3",
    "texture": "f 1/1 2/2 3/1",
    "normal": "f 1//1 2//1 3//1",
    "all": "f 1/1/1 2/2/1 3/1/1",
    "negative": "f -3 -2 -1",
    "negative all": "f -3/-2/-1 -2/-1/-1 -1/-1/-1",
    "tabs and returns": "\tf\t1  2 3 \r",
    "continued": "f 1 2 \\\n 3",
    "comment": "f 1 2 3 # a face",
}


@pytest.mark.parametrize("face", FACES.values(), ids=FACES)
def test_obj_face_forms(face, write_file):
    text = f"# a\nmtllib a.mtl\no it\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvt 1 1 0\nvn 0 0 2\ns 1\n{face}\n"
    scene = compile_mesh(write_file("a.obj", text))
    assert len(scene.faces) == 1
    np.testing.assert_array_equal(scene.vertices[scene.faces[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(scene.vertex_normals, [[0, 0, 1]] * 3)


def test_obj_with_mixed_polygons_and_face_forms(write_file):
    text = (
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nvt 0 0\nvn 0 0 1\n"
        "f 1 2 3 4\nf 1/1 2/1 3/1\nl 1 2\nf 1//1 2//1 3//1 4//1 5//1\nv 5 5 5\nf -1 1 2\n"
    )
    scene = compile_mesh(write_file("a.obj", text), face_normals=True)
    triangles = scene.vertices[scene.faces][:, :, :2].tolist()
    a, b, c, d, e = [0, 0], [1, 0], [1, 1], [0, 1], [-1, 0.5]
    assert triangles == [[a, b, c], [a, c, d], [a, b, c], [a, b, c], [a, c, d], [a, d, e], [[5, 5], a, b]]


def test_shading_normals(write_file):
    """Normals of the file, else smooth angle-weighted normals; none with face_normals."""
    tent = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n"
    smooth = compile_mesh(write_file("a.obj", tent))
    assert smooth.shapes["flags"][0] == structs.SHAPE_VERTEX_NORMALS
    # At vertex 1 the faces +z and +x meet, both with right angles; 2 and 4 belong to one face each.
    half = np.sqrt(0.5)
    np.testing.assert_allclose(smooth.vertex_normals[[0, 1, 3]], [[half, 0, half], [0, 0, 1], [1, 0, 0]], atol=1e-6)
    flat = compile_mesh(write_file("a.obj", tent), face_normals=True)
    assert flat.shapes["flags"][0] == 0
    assert flat.vertex_normals.shape == (0, 3)
    given = compile_mesh(write_file("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 3 4\nf 1//1 2//1 3//1\n"))
    np.testing.assert_allclose(given.vertex_normals, [[0, 0.6, 0.8]] * 3, atol=1e-6)
    partly = compile_mesh(write_file("c.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 3 4\nf 1//1 2//1 3\n"))
    np.testing.assert_allclose(partly.vertex_normals[-1], [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("normal", "extra", "front"),
    [  # front side (z) of Mitsuba 3.9.1's shading frame; the winding in the file is +z
        ("0 0 1", {}, 1),
        ("0 0 -1", {}, -1),
        ("0 0 -1", {"face_normals": True}, 1),
        ("0 0 1", {"to_world": MIRROR}, 1),
        ("0 0 1", {"to_world": MIRROR, "face_normals": True}, -1),
        (None, {"to_world": MIRROR}, -1),
        (None, {"flip_normals": True}, -1),
        ("0 0 1", {"flip_normals": True}, -1),
        ("0 0 1", {"flip_normals": True, "to_world": MIRROR}, -1),
        (None, {"flip_normals": True, "to_world": MIRROR}, 1),
    ],
)
def test_front_sides(normal, extra, front, write_file):
    corner = "//1" if normal else ""
    text = f"v -1 -1 0\nv 1 -1 0\nv 0 1 0\n{f'vn {normal}' if normal else ''}\nf 1{corner} 2{corner} 3{corner}\n"
    scene = compile_mesh(write_file("a.obj", text), **extra)
    a, b, c = scene.vertices[scene.faces[0]]
    assert np.sign(np.cross(b - a, c - a)[2]) == front
    assert np.all(np.sign(scene.vertex_normals[:, 2]) == front)


def test_ply_forms_agree(write_file):
    vertices, faces = icosphere(2)
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    header += f"element face {len(faces)}\nproperty list uchar int vertex_index\nend_header\n"
    body = "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices) + "".join(
        f"3 {a} {b} {c}\n" for a, b, c in faces
    )
    scenes = [
        compile_mesh(write_file("a.ply", header + body)),
        compile_mesh(write_file("l.ply", ply_bytes(vertices, faces))),
        compile_mesh(write_file("b.ply", ply_bytes(vertices, faces, ">"))),
        compile_mesh(write_file("o.obj", obj_text(vertices.astype(np.float32), faces))),
    ]
    for scene in scenes:
        np.testing.assert_array_equal(scene.faces, faces)
        np.testing.assert_allclose(scene.vertices, vertices, atol=1e-6)
        np.testing.assert_allclose(scene.vertex_normals, vertices, atol=2e-2)
    assert scenes[1].hash == scenes[2].hash


def test_ply_with_mixed_polygons_and_other_elements(write_file):
    header = (
        "ply\nformat binary_little_endian 1.0\nelement material 2\nproperty list uchar float weights\nproperty int id\n"
        "element vertex 5\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\n"
        "property float nx\nproperty float ny\nproperty float nz\nproperty float u\nproperty float v\n"
        "element face 3\nproperty uchar flags\nproperty list uchar uint vertex_indices\n"
        "property list uchar float texcoord\n"
        "element edge 1\nproperty int a\nend_header\n"
    )
    body = struct.pack("<B2fi", 2, 1, 2, 7) + struct.pack("<Bi", 0, 8)
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (2, 2)]
    body += b"".join(struct.pack("<dddB5f", x, y, 0, 255, 0, 0, 1, 0, 0) for x, y in corners)
    for polygon, texture in (((0, 1, 2, 3), (1, 2)), ((0, 1, 4), ()), ((0, 1, 2, 3), (3,))):
        body += struct.pack(f"<BB{len(polygon)}IB{len(texture)}f", 0, len(polygon), *polygon, len(texture), *texture)
    scene = compile_mesh(write_file("a.ply", header.encode() + body + struct.pack("<i", 3)))
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(scene.vertex_normals, [[0, 0, 1]] * 5)


PLY = (
    "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
BINARY = PLY.replace("ascii", "binary_little_endian")
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
INVALID_MESHES = [
    ("a.obj", "", "no faces"),
    ("a.obj", TRIANGLE, "no faces"),
    ("a.obj", TRIANGLE + "f 1 2 4\n", "uses a vertex that does not exist .there are 3"),
    ("a.obj", TRIANGLE + "f 1 2 0\n", "uses a vertex that does not exist"),
    ("a.obj", TRIANGLE + "f 1 2 -4\n", "uses a vertex that does not exist"),
    ("a.obj", TRIANGLE + "f 1 2 99999999999999999999\n", "uses a vertex that does not exist"),
    ("a.obj", TRIANGLE + "f 1//1 2//1 3//1\n", "uses a normal that does not exist"),
    ("a.obj", TRIANGLE + "f 1/2 2/2 3/2\n", "uses a texture coordinate that does not exist"),
    ("a.obj", TRIANGLE + "f 1 2\n", "fewer than three corners|no faces, only vertices"),
    ("a.obj", TRIANGLE + "f a b c\n", "the corners of a face are whole numbers"),
    ("a.obj", TRIANGLE + "f 1.5 2 3\n", "the corners of a face are whole numbers"),
    ("a.obj", TRIANGLE + "f nan 2 3\n", "the corners of a face are whole numbers"),
    ("a.obj", TRIANGLE + "f 1/1/1/1 2/1/1/1 3/1/1/1\n", "exist|whole numbers"),
    ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a finite number"),
    ("a.obj", "v 0 0 1e999\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a finite number"),
    ("a.obj", "v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "needs three numbers"),
    ("a.obj", "v 0 0 x\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "needs three numbers"),
    ("a.obj", bytes(range(256)), "contains binary data"),
    ("a.ply", "", "not a PLY file"),
    ("a.ply", bytes(5000), "not a PLY file"),
    ("a.ply", "ply\nformat ascii 1.0\n", "its header has no end"),
    ("a.ply", PLY.replace("ascii", "utf8").format(3, 1), "its format is none of"),
    ("a.ply", PLY.format("x", 1), "invalid header line"),
    ("a.ply", PLY.replace("float x", "foat x").format(3, 1), "invalid header line"),
    ("a.ply", PLY.replace("property float z\n", "").format(3, 1) + "0 0\n" * 3 + "3 0 1 2\n", "lack x, y or z"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n", "truncated: its header states 3 of element 'vertex'"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n", "truncated: its header states 1 of element 'face'"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "uses a vertex that does not exist .there are 3"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "uses a vertex that does not exist"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "fewer than three corners"),
    ("a.ply", PLY.format(3, 1) + "0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n", "not a finite number"),
    ("a.ply", PLY.format(3, 0) + "0 0 0\n1 0 0\n0 1 0\n", "needs vertices and faces"),
    ("a.ply", PLY.format(0, 1) + "3 0 0 0\n", "uses a vertex that does not exist"),
    ("a.ply", BINARY.format(10**9, 1) + "0" * 100, "truncated: its header states 1000000000 of element 'vertex'"),
    ("a.ply", BINARY.format(0, 10**9) + "0" * 100, "states 1000000000|fewer than three|list of element"),
    ("a.ply", PLY.format(10**14, 1) + "0 " * 100, "truncated: its header states"),
]


@pytest.mark.parametrize(("name", "content", "message"), INVALID_MESHES)
def test_invalid_meshes_are_rejected_in_bounded_memory(name, content, message, write_file):
    path = write_file(name, content)
    tracemalloc.start()
    for read in (compile_mesh, load_description):
        with pytest.raises(SceneError, match=message) as error:
            read(path)
        assert str(path) in str(error.value)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # includes imports; 1e9 vertices would take 12e9


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("kind", ["obj", "ply", "serialized"])
def test_pipes_are_rejected(kind, tmp_path):
    """Reading one would wait for ever."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "it": {"type": kind, "filename": str(path)}}
    with pytest.raises(SceneError, match=r"pipe: cannot be read .it is not a regular file"):
        compile_scene(load_description(scene))


@pytest.mark.parametrize("suffix", ["stl", "glb"])
@pytest.mark.parametrize("content", [b"", b"solid x", b"glTF" + bytes(50), bytes(range(256)) * 4, bytes(84)])
def test_invalid_stl_and_glb_files_are_rejected(suffix, content, write_file):
    path = write_file(f"a.{suffix}", content)
    with pytest.raises(
        SceneError, match=r"not a readable|no triangles|ends before 'endsolid'|nor valid JSON|version 0 of GLB"
    ):
        load_description(path)


def model_triangles(description: dict) -> int:
    """Triangles, without the two of the ground."""
    return len(compile_scene(description).faces) - (2 if "ground" in description else 0)


def test_bare_meshes_get_a_camera_and_light(tmp_path):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_transform(np.array([[3, 0, 0, 100], [0, 1, 0, -20], [0, 0, 2, 5], [0, 0, 0, 1.0]]))
    for suffix in ("obj", "ply", "stl", "glb"):
        path = tmp_path / f"it.{suffix}"
        mesh.export(path, **({"include_normals": True} if suffix == "glb" else {}))
        description = load_description(path)
        scene = compile_scene(description)
        assert (scene.width, scene.height) == (512, 512)
        assert model_triangles(description) == len(mesh.faces) == 1280
        assert scene.environment_light >= 0
        assert len(scene.lights) == 1
        assert all(scene.bsdfs["flags"][scene.shapes["bsdf"][:1]] == structs.BSDF_TWOSIDED)
        smooth = scene.shapes["flags"][0] & structs.SHAPE_VERTEX_NORMALS
        assert bool(smooth) == (suffix != "stl")  # STL has neither shared vertices nor vertex normals
        assert_framed(scene, scene.vertices[scene.faces[: len(mesh.faces)]].reshape(-1, 3))


def assert_framed(scene, points):
    """Every point is in the image, and they fill 90 % of it in one direction."""
    camera = scene.camera[0]
    to_world = camera["to_world"].reshape(3, 4).astype(float)
    local = (points - to_world[:, 3]) @ to_world[:, :3]
    assert np.all(local[:, 2] > camera["near_clip"])
    assert np.all(local[:, 2] < camera["far_clip"])
    image = local[:, :2] / local[:, 2:] / camera["tan_half_fov"]
    np.testing.assert_allclose(np.abs(image).max(), 0.9, rtol=1e-3)


def test_bare_obj_uses_colours_and_emission_of_its_mtl(write_file):
    write_file("it.mtl", "newmtl red\nKd 0.8 0.1 0.1 # red\nnewmtl lamp\nKd 0 0 0\nKe 17 12 4\n")
    quad = "v {0} 0 0\nv {0} 1 0\nv {0} 1 1\nv {0} 0 1\n"
    quads = quad.format(0) + quad.format(1) + quad.format(2)
    text = f"mtllib folder/it.mtl\n{quads}f 1 2 3 4\nusemtl red\nf 5 6 7 8\nusemtl lamp\nf -4 -3 -2 -1\n"
    scene = compile_scene(load_description(write_file("it.obj", text)))
    colours = slot(scene.bsdfs, "reflectance")[scene.shapes["bsdf"]]
    np.testing.assert_allclose(colours, [[0.5] * 3, [0.8, 0.1, 0.1], [0] * 3], rtol=1e-6)
    assert len(scene.lights) == 2
    np.testing.assert_allclose(scene.lights["radiance"][0] / scene.radiance_scale, [17, 12, 4], rtol=1e-6)
    assert triangle_records(scene)["light"].tolist() == [structs.NONE] * 4 + [0, 0]


def test_bare_glb_uses_transforms_colours_and_emission(tmp_path):
    import trimesh

    scene = trimesh.Scene()
    for number, (colour, emission) in enumerate((([255, 0, 51, 255], None), ([0, 0, 0, 255], [1.0, 0.5, 0.25]))):
        box = trimesh.creation.box()
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=colour, emissiveFactor=emission)
        box.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(
            box,
            node_name=f"box {number}",
            transform=np.diag([-2.0, 1, 1, 1]) @ trimesh.transformations.translation_matrix([5 * number, 0, 0]),
        )
    path = tmp_path / "it.glb"
    scene.export(path)
    compiled = compile_scene(load_description(path))
    corners = compiled.vertices[compiled.faces[:24]].reshape(-1, 3)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-11, -0.5, -0.5], [1, 0.5, 0.5]])
    materials = compiled.bsdfs[compiled.shapes["bsdf"][:2]]
    colours = slot(materials, "base_color")
    np.testing.assert_allclose(colours, [[1, 0, 0.2], [0, 0, 0]], rtol=1e-6)
    np.testing.assert_allclose(compiled.lights["radiance"][0] / compiled.radiance_scale, [1, 0.5, 0.25], rtol=1e-6)
    for first in (0, 12):  # both boxes face outwards, although they are mirrored
        corners = compiled.vertices[compiled.faces[first : first + 12]].astype(float)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        away = corners.mean(axis=1) - corners.mean(axis=(0, 1))
        assert np.all(np.einsum("ij,ij->i", normals, away) > 0)


def test_public_meshes(public_scenes):
    # Triangle counts of Mitsuba 3.9.1; the glTF sample has 125 copies of a box.
    for name, count in (
        ("obj/spot.obj", 5856),
        ("obj/teapot.obj", 6320),
        ("mitsuba-tests/common/meshes/bunny_lowres.ply", 948),
        ("obj/CornellBox-Original.obj", 36),
        ("gltf/SimpleInstancing/SimpleInstancing.glb", 1500),
    ):
        assert model_triangles(load_description(public_scenes / name)) == count


@pytest.mark.parametrize("transform", [np.eye(4), np.diag([-1.0, 2, 1, 1])], ids=["identity", "mirrored"])
def test_vertex_normals_agree_with_mitsuba(transform, tmp_path, mitsuba):
    vertices, faces = icosphere(2)
    vertices = vertices * (1, 2, 0.5)
    rng = np.random.default_rng(5)
    obj = tmp_path / "a.obj"
    obj.write_text(obj_text(vertices, faces))
    ply = tmp_path / "b.ply"
    ply.write_bytes(ply_bytes(vertices, faces))
    seams = tmp_path / "c.obj"  # normals are not smoothed across uv seams
    lines = [f"vt {u:.3f} 0" for u in range(3)] + [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices]
    lines += [
        "f " + " ".join(f"{i + 1}/{t}" for i in f) for f, t in zip(faces, rng.integers(1, 4, len(faces)), strict=True)
    ]
    seams.write_text("\n".join(lines))
    for path in (obj, ply, seams):
        shape = {"type": path.suffix[1:], "filename": str(path)}
        theirs = mitsuba.traverse(mitsuba.load_dict({**shape, "to_world": mitsuba.ScalarTransform4f(transform)}))
        scene = compile_mesh(path, to_world=transform)
        corners = np.array(theirs["faces"]).reshape(-1, 3)
        for name, ours in (("vertex_positions", scene.vertices), ("vertex_normals", scene.vertex_normals)):
            np.testing.assert_allclose(np.array(theirs[name]).reshape(-1, 3)[corners], ours[scene.faces], atol=2e-6)


@pytest.mark.long
@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_a_million_triangles_load_in_seconds(suffix, tmp_path):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=8)
    path = tmp_path / f"it.{suffix}"
    mesh.export(path)
    start = time.perf_counter()
    description = load_description(path)
    triangles = model_triangles(description)
    assert time.perf_counter() - start < 15  # measured: 2 to 8 s on two busy cores; the first image is due after 20 s
    assert triangles == 1_310_720
