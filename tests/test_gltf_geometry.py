"""glTF: containers, accessors, primitives, morph targets and skins. Files are built in memory; values are exact."""

import base64
import json
import math
import struct
import warnings

import numpy as np
import pytest
from gltf_files import (
    QUAD,
    TRIANGLE,
    Gltf,
    corners_of,
    one_mesh,
    only_mesh,
    pack_glb,
    read,
    read_file,
    rich_file,
    shapes_of,
)

import isonoise
from isonoise.errors import SceneError

# Containers


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_both_containers(name, tmp_path):
    scene, _ = read(one_mesh(attributes={"TEXCOORD_0": TRIANGLE[:, :2]}).write(tmp_path, name))
    (mesh,) = shapes_of(scene)
    np.testing.assert_array_equal(corners_of(mesh)[0], TRIANGLE)
    np.testing.assert_array_equal(mesh["texcoords"], TRIANGLE[:, :2])
    assert mesh["face_normals"]  # it has no normals


def test_buffers_in_files(tmp_path):
    """Names are percent-encoded, or not."""
    file = one_mesh()
    (tmp_path / "sub").mkdir()
    for name, uri in (
        ("a b.bin", "a%20b.bin"),
        ("ü.bin", "ü.bin"),
        ("100%.bin", "100%.bin"),
        ("sub/c.bin", "sub/c.bin"),
    ):
        (tmp_path / name).write_bytes(file.data)
        path = tmp_path / "a.gltf"
        path.write_bytes(file._json(uri))
        assert len(shapes_of(read(path)[0])) == 1


BAD_CONTAINERS = {
    "no JSON": (b"{", "neither a GLB file nor valid JSON"),
    "a list": (b"[]", "JSON is no object"),
    "no asset": (b"{}", "asset: it is missing"),
    "glTF 1": (b'{"asset": {"version": "1.0"}}', "asset.version: glTF 1.0 is not supported"),
    "GLB 1": (pack_glb(b'{"asset": {"version": "2.0"}}', None, version=1), "version 1 of GLB"),
    "short GLB": (pack_glb(b"{}" + b" " * 80, None)[:-4], "truncated"),
    "no triangles": (b'{"asset": {"version": "2.0"}}', "has no triangles"),
    "Draco": (
        b'{"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}',
        r"extensionsRequired\[0\]: the extension 'KHR_draco_.*' is not supported; export .* without Draco",
    ),
}


@pytest.mark.parametrize("name", BAD_CONTAINERS)
def test_bad_containers(name, tmp_path):
    content, message = BAD_CONTAINERS[name]
    path = tmp_path / "a.gltf"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message):
        read(path)


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../far.bin", r"buffers\[0\].uri: .*is outside the scene's folder"),
        ("https://example.org/a.bin", "'https:' is not supported"),
        ("gone.bin", "does not exist"),
        ("data:application/octet-stream;base64,###", "not valid base64"),
        ("data:application/octet-stream;base64,AAAA", "36 bytes are stated, but there are only 3"),
    ],
)
def test_bad_buffers(uri, message, tmp_path):
    (tmp_path / "far.bin").write_bytes(bytes(100))
    folder = tmp_path / "scene"
    folder.mkdir()
    path = folder / "a.gltf"
    path.write_bytes(one_mesh()._json(uri))
    with pytest.raises(SceneError, match=message):
        read(path)


def test_errors_name_the_place(tmp_path):
    file = one_mesh()
    file.content["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 7
    with pytest.raises(SceneError, match=r"a.glb: meshes\[0\].primitives\[0\].attributes.POSITION: there is no acc"):
        read_file(file, tmp_path)
    file.content["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = "x"
    with pytest.raises(SceneError, match=r"primitives\[0\].attributes.POSITION: it has to be a whole number"):
        read_file(file, tmp_path)


def test_extensions(tmp_path):
    """Unknown optional ones give one warning, known ones none."""
    file = one_mesh()
    file.content["extensionsUsed"] = ["KHR_xmp_json_ld", "ACME_a", "KHR_node_visibility", "ACME_b"]
    _, report = read_file(file, tmp_path)
    assert report.warnings() == ["a.glb: other extensions: ACME_a, ACME_b are unknown and ignored"]
    file.content["extensionsRequired"] = ["EXT_texture_webp", "KHR_materials_unlit"]
    read_file(file, tmp_path)
    file.content["extensionsRequired"] += ["ACME_b"]
    with pytest.raises(SceneError, match="the extension 'ACME_b' is not supported"):
        read_file(file, tmp_path)


def test_features_without_losses_are_reported(tmp_path):
    file = Gltf(extensionsUsed=["KHR_mesh_quantization"])
    file.node(mesh=file.mesh(attributes={"TANGENT": np.tile(np.array([[1, 0, 0, 1]], "f4"), (3, 1))}))
    _, report = read(file.write(tmp_path, "a.gltf"))
    assert {"compression", "includes", "tangents"} <= report.used.keys()
    assert report.warnings() == []


# Accessors


@pytest.mark.parametrize("code", ["i1", "u1", "i2", "u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_component_types(code, normalized, tmp_path):
    """KHR_mesh_quantization: integers are numbers, or fractions of the largest one, at least -1."""
    info = np.iinfo(code)
    stored = np.array([[info.min, 0, 1], [info.max, 3, 0], [5, info.max, 7]], code)
    file = Gltf(extensionsRequired=["KHR_mesh_quantization"])
    file.node(mesh=file.mesh(file.accessor(stored, normalized=normalized)))
    expected = np.maximum(stored / float(info.max), -1) if normalized else stored
    np.testing.assert_allclose(only_mesh(file, tmp_path)["vertices"], expected, rtol=1e-6)


def test_interleaved_attributes(tmp_path):
    rows = np.zeros(3, [("position", "<f4", 3), ("uv", "<u2", 2), ("normal", "i1", 3), ("pad", "u1")])
    rows["position"], rows["uv"], rows["normal"] = TRIANGLE, [[0, 65535], [65535, 0], [13107, 0]], [0, 0, 127]
    file = Gltf()
    view = file.view(rows.tobytes(), byteStride=20)
    shared = {"bufferView": view, "count": 3}
    positions = file.add("accessors", **shared, componentType=5126, type="VEC3")
    uvs = file.add("accessors", **shared, byteOffset=12, componentType=5123, normalized=True, type="VEC2")
    normals = file.add("accessors", **shared, byteOffset=16, componentType=5120, normalized=True, type="VEC3")
    file.node(mesh=file.mesh(positions, attributes={"TEXCOORD_0": uvs, "NORMAL": normals}))
    mesh = only_mesh(file, tmp_path)
    np.testing.assert_array_equal(mesh["vertices"], TRIANGLE)
    np.testing.assert_allclose(mesh["texcoords"], [[0, 1], [1, 0], [0.2, 0]], rtol=1e-6)
    np.testing.assert_array_equal(mesh["normals"], [[0, 0, 1]] * 3)
    assert not mesh["face_normals"]


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_accessors(has_base, tmp_path):
    """With and without a buffer view; without one, values are zeros."""
    file = Gltf()
    places = {"bufferView": file.view(struct.pack("<2B", 1, 2)), "componentType": 5121}
    values = {"bufferView": file.view(np.array([[4, 0, 0], [0, 5, 1]], "<f4").tobytes())}
    sparse = {"count": 2, "indices": places, "values": values}
    base = np.array([[1, 1, 1], [2, 2, 2], [3, 3, 3]], "f4")
    if has_base:
        positions = file.accessor(base, sparse=sparse)
    else:
        positions = file.add("accessors", componentType=5126, type="VEC3", count=3, sparse=sparse)
    file.node(mesh=file.mesh(positions))
    first = base[0] if has_base else (0, 0, 0)
    np.testing.assert_array_equal(only_mesh(file, tmp_path)["vertices"], [first, [4, 0, 0], [0, 5, 1]])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 4}, r"accessors\[0\].bufferView: 4 elements end at byte 48 of a buffer view of 36 bytes"),
        ({"count": 10**9}, "elements end at byte"),
        ({"count": -1}, r"accessors\[0\].count: it has to be a whole number"),
        ({"byteOffset": 4}, "elements end at byte 40"),
        ({"componentType": 5124}, "5124 is none of 5120"),
        ({"type": "VEC2"}, "type: it has to be one of VEC3, got 'VEC2'"),
        ({"bufferView": 3}, r"there is no bufferViews\[3\]; the file has 1"),
    ],
)
def test_bad_accessors(changes, message, tmp_path):
    file = one_mesh()
    file.content["accessors"][0] |= changes
    with pytest.raises(SceneError, match=message):
        read_file(file, tmp_path)


def test_claims_of_zeros_are_limited(tmp_path):
    file = Gltf()
    file.node(mesh=file.mesh(file.add("accessors", componentType=5126, type="VEC3", count=10**7)))
    with pytest.raises(SceneError, match=r"accessors\[0\].count: .*much more data than the file holds"):
        read_file(file, tmp_path)


# Primitives

FIVE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], "f4")


@pytest.mark.parametrize(
    ("mode", "faces"),
    [(4, [[0, 1, 2]]), (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])],
)
@pytest.mark.parametrize("is_indexed", [False, True])
def test_modes(mode, faces, is_indexed, tmp_path):
    """The triangles of the specification, in its order of corners."""
    indices = {"indices": [0, 1, 2, 3, 4]} if is_indexed else {}
    scene, report = read_file(one_mesh(positions=FIVE, mode=mode, **indices), tmp_path)
    np.testing.assert_array_equal(corners_of(shapes_of(scene)[0]), FIVE[np.array(faces)])
    problems = report.warnings()
    if mode == 4:  # two corners are left over
        assert len(problems) == 1
        assert "make no whole triangle" in problems[0]
    else:
        assert problems == []


def test_strips_may_repeat_corners(tmp_path):
    mesh = only_mesh(one_mesh(positions=FIVE, indices=[0, 1, 2, 2, 3, 3, 1, 4], mode=5), tmp_path)
    assert len(mesh["faces"]) == 2


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_points_and_lines_are_reported(mode, tmp_path):
    file = one_mesh()
    file.node(mesh=file.mesh(mode=mode))
    scene, report = read_file(file, tmp_path)
    assert len(shapes_of(scene)) == 1
    (text,) = report.warnings()
    assert text.startswith("a.glb: lines and points of meshes[1].primitives[0]")
    with pytest.raises(SceneError, match="no triangles, only lines and points"):
        read_file(one_mesh(mode=mode), tmp_path)


def test_index_out_of_range(tmp_path):
    with pytest.raises(SceneError, match=r"primitives\[0\].indices: index 3 is out of range; there are 3 positions"):
        read_file(one_mesh(indices=[0, 1, 3]), tmp_path)


def test_shared_vertices_are_not_copied(tmp_path):
    """Primitives often index one large array."""
    mesh = only_mesh(one_mesh(positions=np.repeat(TRIANGLE, 100, axis=0), indices=[299, 0, 100]), tmp_path)
    assert len(mesh["vertices"]) == 3
    np.testing.assert_array_equal(corners_of(mesh)[0], TRIANGLE[[2, 0, 1]])


def test_texture_coordinates_of_sets_and_infinite_values(tmp_path):
    uvs = np.array([[np.nan, 0], [1, np.inf], [0.5, 2]], "f4")
    scene, report = read_file(one_mesh(attributes={"TEXCOORD_0": uvs, "TEXCOORD_1": uvs}), tmp_path)
    np.testing.assert_array_equal(shapes_of(scene)[0]["texcoords"], [[0, 0], [1, 0], [0.5, 2]])
    assert report.used["uv_sets"] == 1


def test_attributes_of_other_lengths_are_refused(tmp_path):
    with pytest.raises(SceneError, match="TEXCOORD_0: it has 4 elements, but there are 3 positions"):
        read_file(one_mesh(attributes={"TEXCOORD_0": QUAD[:, :2].copy()}), tmp_path)


# Morph targets and skins


@pytest.mark.parametrize("place", ["mesh", "node", "neither"])
def test_default_weights_of_morph_targets(place, tmp_path):
    """A node's weights replace those of its mesh; without any, targets have no effect."""
    file = Gltf()
    index = file.mesh(QUAD, [0, 1, 2, 0, 2, 3], attributes={"NORMAL": np.tile(np.array([0, 0, 1], "f4"), (4, 1))})
    first, second = np.tile(np.array([[0, 0, 2]], "f4"), (4, 1)), np.tile(np.array([[8, 0, 0]], "f4"), (4, 1))
    targets = [{"POSITION": file.accessor(first)}, {"POSITION": file.accessor(second), "NORMAL": file.accessor(second)}]
    file.content["meshes"][index]["primitives"][0]["targets"] = targets
    if place != "neither":
        file.content["meshes"][index]["weights"] = [0.5, 0.25]
    file.node(mesh=index, **({"weights": [1.0, 0.0]} if place == "node" else {}))
    shift, normal = {
        "mesh": ((2, 0, 1), (2, 0, 1)),
        "node": ((0, 0, 2), (0, 0, 1)),
        "neither": ((0, 0, 0), (0, 0, 1)),
    }[place]
    mesh = only_mesh(file, tmp_path)
    np.testing.assert_allclose(mesh["vertices"], QUAD + np.array(shift, float))
    np.testing.assert_allclose(mesh["normals"], [normal] * 4)


def test_skins_in_rest_pose(tmp_path):
    """Joint transforms times inverse bind matrices, weighted; the node of the mesh does not matter."""
    file = Gltf(scenes=[{"nodes": [0, 2]}])
    attributes = {
        "JOINTS_0": np.array([[0, 1, 0, 0]] * 3, "u1"),
        "WEIGHTS_0": np.array([[255, 0, 0, 0], [0, 255, 0, 0], [51, 204, 0, 0]], "u1"),
        "NORMAL": np.array([[0, 0, 1], [1, 0, 0], [0, 0, 1]], "f4"),
    }
    attributes["WEIGHTS_0"] = file.accessor(attributes["WEIGHTS_0"], normalized=True)
    mesh = file.mesh(attributes=attributes)
    inverse_bind = np.stack([np.eye(4), np.eye(4)])
    inverse_bind[1, 0, 3] = -1.0
    file.add("skins", joints=[0, 1], inverseBindMatrices=file.accessor(inverse_bind.transpose(0, 2, 1).astype("f4")))
    file.node(children=[1], translation=[0, 0, 10])
    quarter_turn = [0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)]  # about z
    file.node(rotation=quarter_turn, scale=[2, 2, 2])
    file.node(mesh=mesh, skin=0, translation=[5, 5, 5])
    (shape,) = shapes_of(read_file(file, tmp_path)[0])
    # the second vertex is at the origin of its joint; the third is moved to (0, 1, 10) and (-2, -2, 10)
    third = 0.2 * np.array([0, 1, 10]) + 0.8 * np.array([-2, -2, 10])
    np.testing.assert_allclose(shape["vertices"], [[0, 0, 10], [0, 0, 10], third], atol=1e-6)
    np.testing.assert_allclose(shape["normals"][:2], [[0, 0, 1], [0, 1, 0]], atol=1e-6)


# Whole files


def test_everything_together(tmp_path):
    """The file from which damaged inputs are made loads, and every number is finite."""
    scene, report = read_file(rich_file(), tmp_path)
    assert report.counts["triangles"] == 2 * 5
    assert len(shapes_of(scene)) == 3
    for name in ("vertex_color", "vertex_alpha"):
        assert all(np.isfinite(mesh.get("attributes", {}).get(name, 0)).all() for mesh in shapes_of(scene))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = isonoise.load(tmp_path / "a.glb")
    assert scene.compile().faces.shape[1] == 3


def test_public_files(public_scenes):
    """Triangles of the Khronos samples: 125 boxes, 1.04 million triangles, two cameras before a square."""
    counts, sensors = {}, {}
    for name in ("SimpleInstancing.glb", "MetalRoughSpheresNoTextures.glb", "Cameras.gltf"):
        _, report = read(public_scenes / "gltf" / name.split(".")[0] / name)
        counts[name], sensors[name] = report.counts["triangles"], report.counts.get("cameras", 0)
        assert report.warnings() == []
    assert list(counts.values()) == [125 * 12, 1_040_409, 2]
    assert list(sensors.values()) == [0, 0, 2]


def test_data_uris_with_escapes(tmp_path):
    file = one_mesh()
    content = json.loads(file.gltf())
    content["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(file.data).decode().replace("=", "%3D")
    path = tmp_path / "a.gltf"
    path.write_bytes(json.dumps(content).encode())
    assert len(shapes_of(read(path)[0])) == 1
