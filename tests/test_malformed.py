"""Malformed and malicious input: exit code 2, a message that names the file, no traceback, bounded time and memory.

The limits are far above normal use and far below what an unchecked size would take.
"""

import json
import os
import re
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
import small_files

from isonoise.cli import main
from isonoise.errors import SceneError, UserError
from isonoise.film.exr import read_reference
from isonoise.scene import compile_scene, load_description
from isonoise.scene.mesh.ply import read_ply

MAX_SECONDS = 5.0  # processor time
MAX_EXTRA_BYTES = 1 << 30  # beyond Python and the libraries

SENSOR = '<sensor type="perspective"/>'
SCENE = '<scene version="3.0.0">' + SENSOR + "{}</scene>"
SHAPE = '<shape type="{0}"><string name="filename" value="m.{0}"/></shape>'
BITMAP = '<texture type="bitmap" name="{}"><string name="filename" value="m.{}"/></texture>'
SURFACE = '<shape type="rectangle"><bsdf type="diffuse">{}</bsdf></shape>'
ENVMAP = '<emitter type="envmap"><string name="filename" value="m.{}"/></emitter>'
HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face {}\nproperty list {} int vertex_indices\nend_header\n"
HUGE_COUNT = 10**9
SIDE = 31_623  # SIDE^2 is 10^9


def exr_of(width: int, height: int) -> bytes:
    """An EXR file whose header states this size."""
    data = small_files.exr()
    window = struct.pack("<4i", 0, 0, 8, 4)
    assert data.count(window) == 2
    return data.replace(window, struct.pack("<4i", 0, 0, width - 1, height - 1))


def png_of(width: int, height: int) -> bytes:
    head = small_files.png_chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0))
    return (
        b"\x89PNG\r\n\x1a\n"
        + head
        + small_files.png_chunk(b"IDAT", zlib.compress(bytes(1000)))
        + small_files.png_chunk(b"IEND", b"")
    )


def bmp_of(width: int, height: int) -> bytes:
    data = bytearray(small_files.image_file("BMP"))
    data[18:26] = struct.pack("<2i", width, height)
    return bytes(data)


def jpeg_of(width: int, height: int) -> bytes:
    data = bytearray(small_files.image_file("JPEG"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">2H", height, width)
    return bytes(data)


def hdr_of(width: int, height: int) -> bytes:
    return small_files.hdr().replace(b"-Y 5 +X 9", b"-Y %d +X %d" % (height, width))


def serialized_of(vertices: int, faces: int) -> bytes:
    content = struct.pack("<I", 0x1000) + b"\0" + struct.pack("<2Q", vertices, faces) + bytes(100)
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(content)


def glb_of(**changes) -> bytes:
    """A GLB file in which parts of the JSON are replaced."""
    data = small_files.textured_glb()
    length = int.from_bytes(data[12:16], "little")
    text = json.dumps(json.loads(data[20 : 20 + length]) | changes).encode()
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + rest


def chain(kind: str, count: int, references: int) -> str:
    """A scene with a chain of objects, each with `references` references to the one before."""
    inner = {
        "blendbsdf": '<bsdf type="blendbsdf" id="o{}"><float name="weight" value="0.5"/>{}</bsdf>',
        "twosided": '<bsdf type="twosided" id="o{}">{}</bsdf>',
        "checkerboard": '<texture type="checkerboard" id="o{}">{}</texture>',
    }[kind]
    names = ("color0", "color1") if kind == "checkerboard" else ("", "")
    first = '<texture type="checkerboard" id="o0"/>' if kind == "checkerboard" else '<bsdf type="diffuse" id="o0"/>'
    refs_of = lambda i: "".join(f'<ref id="o{i - 1}" name="{name}"/>' for name in names[:references])  # noqa: E731
    use = f'<ref id="o{count - 1}"/>'
    if kind == "checkerboard":
        use = f'<bsdf type="diffuse"><ref name="reflectance" id="o{count - 1}"/></bsdf>'
    objects = "".join(inner.format(i, refs_of(i)) for i in range(1, count))
    return SCENE.format(f'{first}{objects}<shape type="sphere">{use}</shape>')


def nested_masks(levels: int, inside: str) -> str:
    return '<bsdf type="mask">' * levels + inside + "</bsdf>" * levels


VERTICES = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
BAD_FILES = {  # content, suffix, pattern of the error message
    "ply vertices": (
        HEAD.format("binary_little_endian", HUGE_COUNT) + FACE.format(1, "uchar") + "x" * 50,
        "ply",
        "its header states",
    ),
    "ply faces": (
        HEAD.format("ascii", 1) + FACE.format(HUGE_COUNT, "uchar") + "0 0 0\n3 0 0 0",
        "ply",
        "truncated: its header states",
    ),
    "ply list": (HEAD.format("ascii", 1) + FACE.format(1, "uint") + f"0 0 0\n{HUGE_COUNT} 0 0 0", "ply", "entries"),
    "ply half a corner": (HEAD.format("ascii", 1) + FACE.format(2, "uint") + "0 0 0\n2.5 0 0 0 0 0", "ply", "entries"),
    "ply minus": (HEAD.format("ascii", -3) + FACE.format(1, "uchar"), "ply", "invalid header line"),
    "ply wide": (
        HEAD.format("ascii", 1) + "property list uint double a\n" * 2000 + FACE.format(1, "uchar"),
        "ply",
        "prop",
    ),
    "ply nan": (HEAD.format("ascii", 1) + FACE.format(1, "uchar") + "nan 0 0\n3 0 0 0", "ply", "not a finite number"),
    "ply index": (HEAD.format("ascii", 1) + FACE.format(1, "uchar") + "0 0 0\n3 0 0 1", "ply", "does not exist"),
    "ply minus one": (HEAD.format("ascii", 1) + FACE.format(1, "uchar") + "0 0 0\n3 0 0 -1", "ply", "does not exist"),
    "obj index": (VERTICES + b"f 1 2 1000000000\n", "obj", "vertex that does not exist"),
    "obj far back": (VERTICES + b"f -1 -2 -99999999999999999999\n", "obj", "vertex that does not exist"),
    "obj nan": (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "obj", "not a finite number"),
    "obj infinite": (b"v 1e400 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "obj", "not a finite number"),
    "serialized vertices": (serialized_of(HUGE_COUNT, 1), "serialized", "more than the file can hold"),
    "serialized all": (serialized_of(2**64 - 1, 2**64 - 1), "serialized", "more than the file can hold"),
    "serialized faces": (serialized_of(3, HUGE_COUNT), "serialized", "more than the file can hold"),
    "png": (png_of(SIDE, SIDE), "png", "the limit is 2048 MiB"),
    "png of nothing": (png_of(0, 5), "png", "no pixels|cannot be read|not a supported image"),
    "jpeg": (jpeg_of(65_000, 65_000), "jpg", "pixels"),
    "jpeg of nothing": (jpeg_of(9, 0), "jpg", "no pixels|cannot be read|not a supported image"),
    "bmp": (bmp_of(SIDE, SIDE), "bmp", "pixels"),
    "bmp of nothing": (bmp_of(0, 5), "bmp", "no pixels|cannot be read|not a supported image"),
    "tga": (struct.pack("<3B5x4H2B", 0, 0, 2, 0, 0, 65_535, 65_535, 24, 0), "tga", "pixels"),
    "hdr": (hdr_of(SIDE, SIDE), "hdr", "pixels"),
    "hdr of nothing": (hdr_of(0, 5), "hdr", "no pixels"),
    "exr": (exr_of(SIDE, SIDE), "exr", "pixels"),
    "exr of nothing": (exr_of(0, 5), "exr", "no pixels|cannot be read|not a supported image"),
    "exr beyond integers": (exr_of(2**31, 2**31), "exr", "pixels|cannot be read"),
}


def scene_around(suffix: str) -> str:
    if suffix in ("ply", "obj", "serialized"):
        return SCENE.format(SHAPE.format(suffix))
    return SCENE.format(SURFACE.format(BITMAP.format("reflectance", suffix)))


HUGE_ACCESSORS = [{"componentType": 5126, "type": "VEC3", "count": HUGE_COUNT}] * 9
BAD_MESHES = {  # loaded without a scene
    "stl": (bytes(80) + struct.pack("<I", HUGE_COUNT) + bytes(500), "stl", "not a readable STL|no triangles"),
    "glb": (glb_of(accessors=HUGE_ACCESSORS), "glb", "describe"),
    "glb with a cycle": (glb_of(nodes=[{"children": [0, 1]}, {"children": [0]}]), "glb", "is a child twice"),
    "truncated glb": (small_files.textured_glb()[:300], "glb", "is truncated"),
    "obj of many libraries": (
        b"".join(b"mtllib %d\n" % i for i in range(999)) + VERTICES + b"f 1 2 3\n",
        "obj",
        "more than",
    ),
}
BAD_SCENES = {
    "references": (chain("twosided", 5000, 1), "nested more than 64 levels deep through references"),
    "nested bsdfs": (SCENE.format(nested_masks(70, '<bsdf type="diffuse"/>')), "nested more than 64 levels deep"),
    "a group that contains itself": (
        SCENE.format('<shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>'),
        "refers to itself",
    ),
    "a texture that contains itself": (
        SCENE.format(SURFACE.format('<texture type="checkerboard" id="t"><ref name="color0" id="t"/></texture>')),
        "refers to itself|cannot contain",
    ),
    "a film of gigapixels": (
        '<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"><integer name="width" value="65536"/>'
        '<integer name="height" value="65536"/></film></sensor></scene>',
        "the image has 65536 x 65536 pixels",
    ),
    "a film of nothing": (
        '<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"><integer name="height" value="0"/>'
        "</film></sensor></scene>",
        "'height' has to be in",
    ),
    "a long type": (SCENE.format(f'<bsdf type="{"d" * (1 << 20)}"/>'), "unknown bsdf 'ddd"),
    "a long element": (SCENE.format(f"<{'d' * (1 << 20)}/>"), "unknown element"),
    "a long id": (SCENE.format(f'<ref id="{"d" * (1 << 20)}"/>'), "there is no object with the id"),
    "a long name": (SCENE.format(SHAPE.format("ply").replace("m.ply", "m" * 5000)), "there is no 'mmm"),
    "a long number": (
        SCENE.format(f'<shape type="sphere"><float name="radius" value="{"1" * 100_000}"/></shape>'),
        "finite",
    ),
    "bytes of no encoding": (SCENE.format("<!-- \udcff -->").encode("utf-8", "surrogateescape"), "not well-formed XML"),
    "a folder as a mesh": (SCENE.format(SHAPE.format("ply").replace("m.ply", ".")), "cannot be read|is not a"),
    "a folder as an image": (SCENE.format(ENVMAP.format("x").replace("m.x", ".")), "cannot be read"),
    "a folder as an include": (SCENE.format('<include filename="."/>'), "cannot be read"),
    "a device as an include": (SCENE.format('<include filename="/dev/zero"/>'), "is not a regular file"),
    "a device as an image": (SCENE.format(ENVMAP.format("x").replace("m.x", "/dev/zero")), "is not a regular file"),
    "a device as a mesh": (SCENE.format(SHAPE.format("obj").replace("m.obj", "/dev/zero")), "is not a regular file"),
    "a missing image": (SCENE.format(ENVMAP.format("exr")), "there is no 'm.exr'"),
}
PIPES = {
    "mesh": SCENE.format(SHAPE.format("ply")),
    "image": SCENE.format(ENVMAP.format("ply")),
    "include": SCENE.format('<include filename="m.ply"/>'),
}


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def assert_rejected(path: Path, message: str, capsys) -> None:
    """The command line rejects the file in time, with a short message that names a file."""
    start_s = time.process_time()
    assert main(["info", str(path)]) == 2
    assert time.process_time() - start_s < MAX_SECONDS
    printed = capsys.readouterr()
    assert re.search(message, printed.err)
    assert printed.err.startswith(f"isonoise: {path.parent}")
    assert "Traceback" not in printed.err
    assert len(printed.err) < 3000


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files(case, tmp_path, capsys):
    content, suffix, message = BAD_FILES[case]
    write(tmp_path / f"m.{suffix}", content)
    assert_rejected(write(tmp_path / "scene.xml", scene_around(suffix)), message, capsys)


@pytest.mark.parametrize("case", BAD_MESHES)
def test_bad_meshes(case, tmp_path, capsys):
    content, suffix, message = BAD_MESHES[case]
    assert_rejected(write(tmp_path / f"m.{suffix}", content), message, capsys)


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scenes(case, tmp_path, capsys):
    content, message = BAD_SCENES[case]
    if "device" in case and not Path("/dev/zero").exists():
        pytest.skip("there is no /dev/zero")
    path = write(tmp_path / "scene.xml", content)
    if "device" in case:
        with pytest.raises(SceneError, match=message):
            compile_scene(load_description(path, allow_outside=True))
    else:
        assert_rejected(path, message, capsys)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("case", PIPES)
def test_pipes_without_a_writer(case, tmp_path, capsys):
    os.mkfifo(tmp_path / "m.ply")
    assert_rejected(write(tmp_path / "scene.xml", PIPES[case]), "is not a regular file", capsys)


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root and Windows can read every file")
def test_files_without_read_permission(tmp_path, capsys):
    write(tmp_path / "m.ply", small_files.ply()).chmod(0)
    assert_rejected(write(tmp_path / "scene.xml", SCENE.format(SHAPE.format("ply"))), "Permission denied", capsys)


@pytest.mark.parametrize("size", [(SIDE, SIDE), (2**31, 2**31), (0, 5)])
def test_reference_images_of_huge_size(size, tmp_path, capsys):
    """As --reference and for isonoise info."""
    path = write(tmp_path / "m.exr", exr_of(*size))
    with pytest.raises(UserError, match=r"m\.exr"):
        read_reference(path)
    if size[0]:
        assert main(["info", str(path)]) == 2
        assert "m.exr" in capsys.readouterr().err


def test_nesting_depth_across_includes(tmp_path, capsys):
    """Each file alone is within the limit."""
    for number in range(15):
        inside = nested_masks(50, f'<include filename="{number + 1}.xml"/>')
        write(
            tmp_path / f"{number}.xml",
            SCENE.format(inside) if not number else inside.replace("<bsdf ", '<bsdf version="3.0.0" ', 1),
        )
    write(tmp_path / "15.xml", '<bsdf version="3.0.0" type="diffuse"/>')
    assert_rejected(tmp_path / "0.xml", "nested more than 64 levels deep", capsys)


@pytest.mark.parametrize("kind", ["blendbsdf", "checkerboard"])
def test_references_that_double_at_every_level(kind, tmp_path):
    """Following every reference would give 2^50 materials or textures."""
    path = write(tmp_path / "scene.xml", chain(kind, 50, 2))
    start_s = time.process_time()
    scene = compile_scene(load_description(path))
    assert time.process_time() - start_s < MAX_SECONDS
    assert len(scene.bsdfs) <= 50
    assert len(scene.textures) <= 60


def test_many_parameters(tmp_path):
    """Substitution must not take time quadratic in the number of parameters."""
    defaults = "".join(f'<default name="parameter{i}" value="{i}"/>' for i in range(20_000))
    uses = "".join(f'<default name="b{i}" value="$parameter{i} $parameter{19_999 - i}"/>' for i in range(20_000))
    path = write(tmp_path / "scene.xml", SCENE.format(defaults + uses))
    start_s = time.process_time()
    load_description(path)
    assert time.process_time() - start_s < MAX_SECONDS


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_polygons_of_alternating_size(form, tmp_path):
    """The order of polygons is preserved, in seconds."""
    count = 100_000
    polygons = [(0, 1, 2), (0, 1, 2, 3), (2, 1, 0)] * (count // 3)
    pack = (
        (lambda p: struct.pack(f"<B{len(p)}i", len(p), *p))
        if form != "ascii"
        else lambda p: b"%d " % len(p) + (" ".join(map(str, p)).encode() + b"\n")
    )
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
    body = corners.tobytes() if form != "ascii" else b"0 0 0 1 0 0 1 1 0 0 1 0\n"
    head = HEAD.format(form, 4) + FACE.format(len(polygons), "uchar")
    path = write(tmp_path / "m.ply", head.encode() + body + b"".join(map(pack, polygons)))
    start_s = time.process_time()
    faces = read_ply(path).faces
    assert time.process_time() - start_s < MAX_SECONDS
    np.testing.assert_array_equal(faces.reshape(-1, 12), [[0, 1, 2, 0, 1, 2, 0, 2, 3, 2, 1, 0]] * (count // 3))


def test_many_materials_of_an_obj(tmp_path):
    faces = "".join(f"usemtl m{i}\nf 1 2 3\n" for i in range(4000))
    path = write(tmp_path / "m.obj", VERTICES + faces.encode())
    start_s = time.process_time()
    with pytest.warns(UserWarning, match="material 'm0' and 3999 more: no MTL file defines it"):
        load_description(path)
    assert time.process_time() - start_s < MAX_SECONDS


def test_truncated_files(tmp_path):
    """A file truncated anywhere loads or is rejected."""
    for name, data in {
        "ply": small_files.ply(),
        "serialized": small_files.serialized(),
        "obj": small_files.obj(),
        "hdr": small_files.hdr(),
        "png": small_files.image_file("PNG"),
    }.items():
        path = write(tmp_path / "scene.xml", scene_around(name))
        rejected = 0
        for length in range(0, len(data), 5):
            write(tmp_path / f"m.{name}", data[:length])
            try:
                compile_scene(load_description(path))
            except SceneError:
                rejected += 1
        assert rejected > 9


LIMITED = """
import resource, sys
from pathlib import Path
from isonoise.cli import main
import isonoise.scene, PIL.Image, PIL.PngImagePlugin, PIL.JpegImagePlugin, PIL.BmpImagePlugin, OpenEXR, trimesh
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[1]),) * 2)
for path in sys.argv[2:]:
    assert main(["info", path]) == 2, path
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits process memory in the way of Linux")
def test_memory_is_bounded(tmp_path):
    """All bad files in one process with a memory limit."""
    paths = []
    for number, (content, suffix, _) in enumerate([*BAD_FILES.values(), *BAD_MESHES.values()]):
        folder = tmp_path / str(number)
        folder.mkdir()
        mesh = write(folder / f"m.{suffix}", content)
        bare = number >= len(BAD_FILES)
        paths.append(str(mesh if bare else write(folder / "scene.xml", scene_around(suffix))))
    for number, (content, _) in enumerate(BAD_SCENES.values()):
        if b"/dev/" not in (content if isinstance(content, bytes) else content.encode()):
            (tmp_path / f"s{number}").mkdir()
            paths.append(str(write(tmp_path / f"s{number}" / "scene.xml", content)))
    done = subprocess.run([sys.executable, "-c", LIMITED, str(MAX_EXTRA_BYTES), *paths], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Traceback" not in done.stderr
    assert not re.search("MemoryError|enough memory", done.stderr)
    assert np.char.startswith(done.stderr.splitlines(), "isonoise: ").sum() == len(paths)
