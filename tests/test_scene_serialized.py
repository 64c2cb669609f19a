"""Serialized meshes: files written here and published files, against Mitsuba; invalid files."""

import contextlib
import random
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from scalar_mitsuba import import_mitsuba

from isonoise.errors import SceneError
from isonoise.scene import compile_scene, load_description
from isonoise.scene.mesh.serialized import read_serialized

NORMALS, UVS, COLOURS, FLAT, SINGLE, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x1000, 0x2000
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.1], [1, 1, 1e-3]])
FACES = np.array([[0, 1, 2], [2, 1, 3]])
VERTEX_DATA = {
    NORMALS: np.array([[0, 0, 1], [0, 0.6, 0.8], [1, 0, 0], [0, -1, 0]]),
    UVS: np.array([[0, 0.25], [1, 0], [0.5, 0.75], [-3, 7]]),
    COLOURS: np.array([[0, 0.25, 1], [1, 0, 0.1], [0.5, 0.75, 0.2], [0.3, 0.7, 0.9]]),
}


def mesh_content(
    flags: int, vertices=VERTICES, faces=FACES, version: int = 4, counts=None, name: bytes = b"shape"
) -> bytes:
    """The uncompressed stream of one mesh; `counts` replaces the counts in its header."""
    number = "<f8" if flags & DOUBLE else "<f4"
    data = struct.pack("<I", flags) + (name + b"\0" if version == 4 else b"")
    data += struct.pack("<QQ", *(counts or (len(vertices), len(faces)))) + np.asarray(vertices, number).tobytes()
    data += b"".join(np.asarray(extra, number).tobytes() for flag, extra in VERTEX_DATA.items() if flags & flag)
    return data + np.asarray(faces, "<u4").tobytes()


def serialized_file(*bodies: bytes, version: int = 4) -> bytes:
    """A file with these meshes and the offset table."""
    parts = [struct.pack("<HH", 0x041C, version) + zlib.compress(data) for data in bodies]
    offsets = np.cumsum([0, *map(len, parts)])[:-1]
    return b"".join(parts) + offsets.astype({3: "<u4", 4: "<u8"}[version]).tobytes() + struct.pack("<I", len(parts))


@pytest.fixture
def write(write_file):
    return lambda content: write_file("a.serialized", content)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("precision", [SINGLE, DOUBLE])
@pytest.mark.parametrize("flags", [0, NORMALS, UVS, COLOURS, NORMALS | UVS | COLOURS, NORMALS | FLAT])
def test_written_meshes_are_read(flags, precision, version, write):
    moved = VERTICES + 7
    path = write(
        serialized_file(
            *(mesh_content(flags | precision, v, version=version) for v in (VERTICES, moved, VERTICES)), version=version
        )
    )
    kind = np.float32 if precision == SINGLE else np.float64
    for index, vertices in enumerate((VERTICES, moved, VERTICES)):
        mesh = read_serialized(path, index)
        np.testing.assert_array_equal(mesh.vertices, vertices.astype(kind))
        np.testing.assert_array_equal(mesh.faces, FACES)
        np.testing.assert_array_equal(
            mesh.normals, VERTEX_DATA[NORMALS].astype(kind) if flags & NORMALS else np.zeros((0, 3))
        )
        np.testing.assert_array_equal(mesh.uvs, VERTEX_DATA[UVS].astype("f4") if flags & UVS else np.zeros((0, 2)))
        assert mesh.uvs.dtype == np.float32
        assert set(mesh.attributes) == ({"vertex_color"} if flags & COLOURS else set())
        for colours in mesh.attributes.values():
            np.testing.assert_array_equal(colours, VERTEX_DATA[COLOURS].astype("f4"))


def test_a_file_with_one_mesh_needs_no_table(write):
    path = write(struct.pack("<HH", 0x041C, 4) + zlib.compress(mesh_content(SINGLE)))
    assert len(read_serialized(path).faces) == 2


def test_meshes_longer_than_a_chunk(write):
    """A mesh of many chunks, with a long name."""
    count = 20_000
    vertices = np.random.default_rng(1).random((count, 3)).astype(np.float32)
    faces = np.random.default_rng(2).integers(0, count, (2 * count, 3))
    path = write(serialized_file(mesh_content(SINGLE), mesh_content(SINGLE, vertices, faces, name=b"x" * 60_000)))
    mesh = read_serialized(path, 1)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)


def test_in_a_scene(write, scene_of):
    path = write(serialized_file(mesh_content(SINGLE), mesh_content(SINGLE | NORMALS | UVS, VERTICES + 5)))
    inside = f'<shape type="serialized"><string name="filename" value="{path}"/>{{}}</shape>'
    scene = compile_scene(scene_of(inside.format('<integer name="shape_index" value="1"/>')))
    np.testing.assert_allclose(scene.bounds, [[5, 5, 5], [6, 6, 5.1]], rtol=1e-6)
    np.testing.assert_allclose(scene.vertex_normals, VERTEX_DATA[NORMALS], rtol=1e-6)
    flat = '<boolean name="face_normals" value="true"/><boolean name="flip_normals" value="true"/>'
    scene = compile_scene(scene_of(inside.format(flat)))
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [1, 1, 0.1]], rtol=1e-6)
    assert scene.vertex_normals.shape == (0, 3)
    with pytest.raises(SceneError, match=r"'shape_index' has to be in \[0,"):
        scene_of(inside.format('<integer name="shape_index" value="-1"/>'))


def mitsuba_mesh(**shape) -> dict[str, np.ndarray]:
    mitsuba = import_mitsuba()
    parameters = mitsuba.traverse(mitsuba.load_dict({"type": "serialized", **shape}))
    sizes = {"vertex_positions": 3, "vertex_normals": 3, "vertex_texcoords": 2, "faces": 3}
    return {name: np.array(parameters[name]).reshape(-1, size) for name, size in sizes.items()}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("flags", [SINGLE, DOUBLE, 0, SINGLE | DOUBLE])
def test_against_mitsuba(flags, version, write):
    path = write(
        serialized_file(
            *(mesh_content(flags | e, version=version) for e in (0, NORMALS | UVS | COLOURS)), version=version
        )
    )
    for index in (0, 1):
        theirs = mitsuba_mesh(filename=str(path), shape_index=index)
        mesh = read_serialized(path, index)
        np.testing.assert_array_equal(mesh.faces, theirs["faces"])
        np.testing.assert_array_equal(mesh.vertices.astype(np.float32), theirs["vertex_positions"])
        np.testing.assert_array_equal(mesh.uvs, theirs["vertex_texcoords"])
        if index:
            np.testing.assert_allclose(mesh.normals, theirs["vertex_normals"], atol=1e-6)


def test_a_published_file_against_mitsuba(public_scenes):
    folder = public_scenes / "bunny-box"
    for index in range(7):
        theirs = mitsuba_mesh(filename=str(folder / "bunny_box.serialized"), shape_index=index)
        mesh = read_serialized(folder / "bunny_box.serialized", index)
        np.testing.assert_array_equal(mesh.faces, theirs["faces"])
        np.testing.assert_array_equal(mesh.vertices, theirs["vertex_positions"])
        np.testing.assert_allclose(mesh.normals, theirs["vertex_normals"], atol=1e-6)
    assert len(mesh.faces) == 14404
    scene = compile_scene(load_description(folder / "scene.xml"))
    assert len(scene.faces) == 14404 + 6 * 2
    assert len(scene.lights) == 1


VALID = serialized_file(mesh_content(SINGLE), mesh_content(SINGLE))
HEAD = struct.pack("<HH", 0x041C, 4)
INVALID_FILES = [
    (b"", 0, "not a serialized Mitsuba mesh"),
    (b"\x1c", 0, "not a serialized Mitsuba mesh"),
    (b"ply\nformat ascii 1.0\n", 0, "not a serialized Mitsuba mesh"),
    (struct.pack("<HH", 0x041C, 5) + VALID[4:], 0, "version 5 of the format is not supported"),
    (HEAD, 0, "truncated"),
    (HEAD + b"nonsense", 0, "compressed data is damaged"),
    (VALID[:40], 0, "truncated"),
    (VALID, 2, r"shape 2: the file has no such shape; it has 2"),
    (VALID, 10**9, "the file has no such shape"),
    (VALID[:-1], 1, "the offset table at its end is damaged|no such shape"),
    (VALID[:-4] + struct.pack("<I", 2**32 - 1), 1, "the offset table at its end is damaged"),
    (HEAD, 1, "the offset table at its end is damaged"),
    (VALID[:-12] + struct.pack("<QI", 2**63, 2), 1, "the offset table at its end is damaged"),
    (VALID[:-12] + struct.pack("<QI", 10, 2), 1, "compressed data is damaged"),
    (serialized_file(b""), 0, "truncated"),
    (serialized_file(struct.pack("<I", SINGLE) + b"no end of it"), 0, "truncated"),
    (HEAD + zlib.compress(struct.pack("<I", SINGLE) + b"x" * 2**26), 0, "its name is not terminated"),
    (serialized_file(mesh_content(SINGLE, counts=(10**9, 1))), 0, "states 1000000000 vertices"),
    (serialized_file(mesh_content(SINGLE, counts=(4, 10**9))), 0, "states 4 vertices and 1000000000 faces"),
    (serialized_file(mesh_content(SINGLE, counts=(2**64 - 1, 2**64 - 1))), 0, "more than the file can hold"),
    (serialized_file(mesh_content(SINGLE, counts=(5, 2))), 0, "truncated"),
    (serialized_file(mesh_content(SINGLE, counts=(2**20, 2**20))), 0, "truncated"),
    (serialized_file(mesh_content(SINGLE, np.zeros((0, 3)), np.zeros((0, 3)))), 0, "needs vertices and faces"),
    (serialized_file(mesh_content(SINGLE, np.zeros((3, 3)), np.zeros((0, 3)))), 0, "needs vertices and faces"),
    (serialized_file(mesh_content(SINGLE, np.zeros((0, 3)))), 0, "needs vertices and faces"),
    (serialized_file(mesh_content(SINGLE, VERTICES[:3])), 0, "uses a vertex that does not exist .there are 3"),
    (serialized_file(mesh_content(SINGLE, faces=[[0, 1, 2**32 - 1]])), 0, "uses a vertex that does not exist"),
    (serialized_file(mesh_content(SINGLE, VERTICES + np.array([np.nan, 0, 0]))), 0, "not a finite number"),
    (serialized_file(mesh_content(SINGLE, VERTICES + np.array([0, np.inf, 0]))), 0, "not a finite number"),
]


@pytest.mark.parametrize(("content", "index", "message"), INVALID_FILES)
def test_invalid_files_are_rejected_in_bounded_memory(content, index, message, write):
    path = write(content)
    tracemalloc.start()
    with pytest.raises(SceneError, match=message) as error:
        read_serialized(path, index)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(path) in str(error.value)
    assert peak < 1e6  # 1e9 vertices would take 12e9, the inflated bombs 1e8


@pytest.mark.parametrize("is_header_true", [False, True])
def test_zip_bombs_are_rejected_in_bounded_memory(is_header_true, write):
    """128 MB of zeros in 0.6 MB, after a header of a single triangle or of as many as there are."""
    counts = (2**23, 2**21) if is_header_true else (3, 1)
    start = struct.pack("<I", SINGLE) + b"\0" + struct.pack("<QQ", *counts)
    path = write(HEAD + zlib.compress(start + bytes(2**27), 1))
    tracemalloc.start()
    if is_header_true:
        with pytest.raises(SceneError, match="more than the file can hold"):
            read_serialized(path)
    else:
        assert len(read_serialized(path).faces) == 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6


def test_uvs_that_are_not_finite_become_zero(write, monkeypatch):
    monkeypatch.setitem(VERTEX_DATA, UVS, np.array([[np.nan, 1], [np.inf, -np.inf], [1e300, 0.5], [0, 0.25]]))
    mesh = read_serialized(write(serialized_file(mesh_content(DOUBLE | UVS))))
    np.testing.assert_array_equal(mesh.uvs, [[0, 1], [0, 0], [0, 0.5], [0, 0.25]])


def test_truncated_files(write):
    content = serialized_file(mesh_content(SINGLE | NORMALS | UVS), mesh_content(DOUBLE | COLOURS))
    table = 2 * 8 + 4
    for length in range(0, len(content) - table, 3):
        path = write(content[:length])
        with pytest.raises(SceneError):
            read_serialized(path, 1)
    second = struct.unpack("<Q", content[-12:-4])[0]
    for length in range(0, second - 4, 3):  # except the checksum at its end
        with pytest.raises(SceneError):
            read_serialized(write(content[:length]))


@pytest.mark.parametrize("inside", [False, True])
def test_random_changes_give_meshes_or_errors(inside, write):
    draw = random.Random(1)
    meshes = 0
    for _ in range(200):
        content = mesh_content(draw.choice((SINGLE, DOUBLE)) | NORMALS | UVS | COLOURS)
        changed = bytearray(content if inside else serialized_file(content, content))
        for _ in range(draw.randint(1, 3)):
            changed[draw.randrange(60 if inside and draw.random() < 0.5 else len(changed))] = draw.randrange(256)
        path = write(serialized_file(content, bytes(changed)) if inside else bytes(changed))
        with contextlib.suppress(SceneError):
            mesh = read_serialized(path, 1)
            assert np.isfinite(mesh.vertices).all()
            assert mesh.faces.max() < len(mesh.vertices)
            meshes += 1
    assert 0 < meshes < 200
