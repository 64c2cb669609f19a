"""Input that is broken, or made to break things: exit code 2, a message that names the file, no traceback, no hang, and
memory bounded. Seconds and bytes here are far above what a sound machine takes and far below what a mistake would."""

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
from isonoise.scene import compile_scene, load
from isonoise.scene.mesh.ply import read_ply

SECONDS = 5.0  # of the processor
MEMORY = 1 << 30  # bytes beyond what Python and the libraries take

SENSOR = '<sensor type="perspective"/>'
SCENE = '<scene version="3.0.0">' + SENSOR + "{}</scene>"
SHAPE = '<shape type="{0}"><string name="filename" value="m.{0}"/></shape>'
BITMAP = '<texture type="bitmap" name="{}"><string name="filename" value="m.{}"/></texture>'
SURFACE = '<shape type="rectangle"><bsdf type="diffuse">{}</bsdf></shape>'
ENVMAP = '<emitter type="envmap"><string name="filename" value="m.{}"/></emitter>'
HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face {}\nproperty list {} int vertex_indices\nend_header\n"
GIANT = 10**9
SIDE = 31_623  # squared it is 10^9


def exr_of(width: int, height: int) -> bytes:
    """Its header claims another size."""
    data = small_files.exr()
    window = struct.pack("<4i", 0, 0, 8, 4)
    assert data.count(window) == 2
    return data.replace(window, struct.pack("<4i", 0, 0, width - 1, height - 1))


def png_of(width: int, height: int) -> bytes:
    head = small_files.chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0))
    return (
        b"\x89PNG\r\n\x1a\n"
        + head
        + small_files.chunk(b"IDAT", zlib.compress(bytes(1000)))
        + small_files.chunk(b"IEND", b"")
    )


def bmp_of(width: int, height: int) -> bytes:
    data = bytearray(small_files.encoded("BMP"))
    data[18:26] = struct.pack("<2i", width, height)
    return bytes(data)


def jpeg_of(width: int, height: int) -> bytes:
    data = bytearray(small_files.encoded("JPEG"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">2H", height, width)
    return bytes(data)


def hdr_of(width: int, height: int) -> bytes:
    return small_files.hdr().replace(b"-Y 5 +X 9", b"-Y %d +X %d" % (height, width))


def serialized_of(vertices: int, faces: int) -> bytes:
    content = struct.pack("<I", 0x1000) + b"\0" + struct.pack("<2Q", vertices, faces) + bytes(100)
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(content)


def glb_of(**changes) -> bytes:
    """Parts of its JSON replaced."""
    data = small_files.textured_glb()
    length = int.from_bytes(data[12:16], "little")
    text = json.dumps(json.loads(data[20 : 20 + length]) | changes).encode()
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + rest


def chain(kind: str, count: int, again: int) -> str:
    """Objects of which each refers `again` times to the one before it."""
    inner = {
        "blendbsdf": '<bsdf type="blendbsdf" id="o{}"><float name="weight" value="0.5"/>{}</bsdf>',
        "twosided": '<bsdf type="twosided" id="o{}">{}</bsdf>',
        "checkerboard": '<texture type="checkerboard" id="o{}">{}</texture>',
    }[kind]
    names = ("color0", "color1") if kind == "checkerboard" else ("", "")
    first = '<texture type="checkerboard" id="o0"/>' if kind == "checkerboard" else '<bsdf type="diffuse" id="o0"/>'
    references = lambda i: "".join(f'<ref id="o{i - 1}" name="{name}"/>' for name in names[:again])  # noqa: E731
    use = f'<ref id="o{count - 1}"/>'
    if kind == "checkerboard":
        use = f'<bsdf type="diffuse"><ref name="reflectance" id="o{count - 1}"/></bsdf>'
    objects = "".join(inner.format(i, references(i)) for i in range(1, count))
    return SCENE.format(f'{first}{objects}<shape type="sphere">{use}</shape>')


def deep(levels: int, inside: str) -> str:
    return '<bsdf type="mask">' * levels + inside + "</bsdf>" * levels


VERTICES = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
CLAIMS = {  # a file, what it is called, and what is said of it
    "ply vertices": (
        HEAD.format("binary_little_endian", GIANT) + FACE.format(1, "uchar") + "x" * 50,
        "ply",
        "its header states",
    ),
    "ply faces": (
        HEAD.format("ascii", 1) + FACE.format(GIANT, "uchar") + "0 0 0\n3 0 0 0",
        "ply",
        "truncated: its header states",
    ),
    "ply list": (HEAD.format("ascii", 1) + FACE.format(1, "uint") + f"0 0 0\n{GIANT} 0 0 0", "ply", "entries"),
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
    "serialized vertices": (serialized_of(GIANT, 1), "serialized", "more than the file can hold"),
    "serialized all": (serialized_of(2**64 - 1, 2**64 - 1), "serialized", "more than the file can hold"),
    "serialized faces": (serialized_of(3, GIANT), "serialized", "more than the file can hold"),
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


MESHES = {  # bare meshes
    "stl": (bytes(80) + struct.pack("<I", GIANT) + bytes(500), "stl", "not a readable STL|no triangles"),
    "glb": (glb_of(accessors=[{"componentType": 5126, "type": "VEC3", "count": GIANT}] * 9), "glb", "describe"),
    "glb that holds itself": (
        glb_of(nodes=[{"children": [0, 1]}, {"children": [0]}]),
        "glb",
        "not a readable GLB|no tri",
    ),
    "glb cut off": (small_files.textured_glb()[:300], "glb", "not a readable GLB"),
    "obj of many libraries": (
        b"".join(b"mtllib %d\n" % i for i in range(999)) + VERTICES + b"f 1 2 3\n",
        "obj",
        "more than",
    ),
}
SCENES = {
    "references": (chain("twosided", 5000, 1), "nested more than 64 levels deep through references"),
    "nested bsdfs": (SCENE.format(deep(70, '<bsdf type="diffuse"/>')), "nested more than 64 levels deep"),
    "a group in itself": (
        SCENE.format('<shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>'),
        "refers to itself",
    ),
    "a texture in itself": (
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


def assert_refused(path: Path, message: str, capsys) -> None:
    """By the command line, within the seconds, in a short message that names a file."""
    began = time.process_time()
    assert main(["info", str(path)]) == 2
    assert time.process_time() - began < SECONDS
    printed = capsys.readouterr()
    assert re.search(message, printed.err)
    assert printed.err.startswith(f"isonoise: {path.parent}")
    assert "Traceback" not in printed.err
    assert len(printed.err) < 3000


@pytest.mark.parametrize("case", CLAIMS)
def test_claims_and_damage(case, tmp_path, capsys):
    content, suffix, message = CLAIMS[case]
    write(tmp_path / f"m.{suffix}", content)
    assert_refused(write(tmp_path / "scene.xml", scene_around(suffix)), message, capsys)


@pytest.mark.parametrize("case", MESHES)
def test_bare_meshes(case, tmp_path, capsys):
    content, suffix, message = MESHES[case]
    assert_refused(write(tmp_path / f"m.{suffix}", content), message, capsys)


@pytest.mark.parametrize("case", SCENES)
def test_scenes(case, tmp_path, capsys):
    content, message = SCENES[case]
    if "device" in case and not Path("/dev/zero").exists():
        pytest.skip("there is no /dev/zero")
    path = write(tmp_path / "scene.xml", content)
    if "device" in case:
        with pytest.raises(SceneError, match=message):
            compile_scene(load(path))
    else:
        assert_refused(path, message, capsys)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("case", PIPES)
def test_pipes_that_nobody_writes_to(case, tmp_path, capsys):
    os.mkfifo(tmp_path / "m.ply")
    assert_refused(write(tmp_path / "scene.xml", PIPES[case]), "is not a regular file", capsys)


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root, and Windows, may read everything")
def test_files_that_may_not_be_read(tmp_path, capsys):
    write(tmp_path / "m.ply", small_files.ply()).chmod(0)
    assert_refused(write(tmp_path / "scene.xml", SCENE.format(SHAPE.format("ply"))), "Permission denied", capsys)


@pytest.mark.parametrize("size", [(SIDE, SIDE), (2**31, 2**31), (0, 5)])
def test_pictures_that_claim_too_much(size, tmp_path, capsys):
    """As --reference, and for isonoise info."""
    path = write(tmp_path / "m.exr", exr_of(*size))
    with pytest.raises(UserError, match=r"m\.exr"):
        read_reference(path)
    if size[0]:
        assert main(["info", str(path)]) == 2
        assert "m.exr" in capsys.readouterr().err


def test_includes_inside_of_objects(tmp_path, capsys):
    """No file alone is deep."""
    for number in range(15):
        inside = deep(50, f'<include filename="{number + 1}.xml"/>')
        write(
            tmp_path / f"{number}.xml",
            SCENE.format(inside) if not number else inside.replace("<bsdf ", '<bsdf version="3.0.0" ', 1),
        )
    write(tmp_path / "15.xml", '<bsdf version="3.0.0" type="diffuse"/>')
    assert_refused(tmp_path / "0.xml", "nested more than 64 levels deep", capsys)


@pytest.mark.parametrize("kind", ["blendbsdf", "checkerboard"])
def test_references_that_double_on_every_level(kind, tmp_path):
    """2^50 materials or textures, if each reference were followed."""
    path = write(tmp_path / "scene.xml", chain(kind, 50, 2))
    began = time.process_time()
    scene = compile_scene(load(path))
    assert time.process_time() - began < SECONDS
    assert len(scene.bsdfs) <= 50
    assert len(scene.textures) <= 60


def test_many_parameters(tmp_path):
    """Each of them is looked up in all."""
    defaults = "".join(f'<default name="parameter{i}" value="{i}"/>' for i in range(20_000))
    uses = "".join(f'<default name="b{i}" value="$parameter{i} $parameter{19_999 - i}"/>' for i in range(20_000))
    path = write(tmp_path / "scene.xml", SCENE.format(defaults + uses))
    began = time.process_time()
    load(path)
    assert time.process_time() - began < SECONDS


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_polygons_whose_size_changes_all_the_time(form, tmp_path):
    """Their order stays; a mesh of a million takes seconds, not minutes."""
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
    began = time.process_time()
    faces = read_ply(path).faces
    assert time.process_time() - began < SECONDS
    np.testing.assert_array_equal(faces.reshape(-1, 12), [[0, 1, 2, 0, 1, 2, 0, 2, 3, 2, 1, 0]] * (count // 3))


def test_many_materials_of_an_obj(tmp_path):
    faces = "".join(f"usemtl m{i}\nf 1 2 3\n" for i in range(4000))
    path = write(tmp_path / "m.obj", VERTICES + faces.encode())
    began = time.process_time()
    load(path)
    assert time.process_time() - began < SECONDS


def test_every_cut_of_small_files(tmp_path):
    """Cut off anywhere, a file loads or is refused."""
    for name, data in {
        "ply": small_files.ply(),
        "serialized": small_files.serialized(),
        "obj": small_files.obj(),
        "hdr": small_files.hdr(),
        "png": small_files.encoded("PNG"),
    }.items():
        path = write(tmp_path / "scene.xml", scene_around(name))
        refused = 0
        for length in range(0, len(data), 5):
            write(tmp_path / f"m.{name}", data[:length])
            try:
                compile_scene(load(path))
            except SceneError:
                refused += 1
        assert refused > 9


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


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory of a process as Linux does")
def test_memory_is_bounded(tmp_path):
    """All claims in one process that may take little more than it has."""
    paths = []
    for number, (content, suffix, _) in enumerate([*CLAIMS.values(), *MESHES.values()]):
        folder = tmp_path / str(number)
        folder.mkdir()
        mesh = write(folder / f"m.{suffix}", content)
        bare = number >= len(CLAIMS)
        paths.append(str(mesh if bare else write(folder / "scene.xml", scene_around(suffix))))
    for number, (content, _) in enumerate(SCENES.values()):
        if b"/dev/" not in (content if isinstance(content, bytes) else content.encode()):
            (tmp_path / f"s{number}").mkdir()
            paths.append(str(write(tmp_path / f"s{number}" / "scene.xml", content)))
    done = subprocess.run([sys.executable, "-c", LIMITED, str(MEMORY), *paths], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Traceback" not in done.stderr
    assert not re.search("MemoryError|enough memory", done.stderr)
    assert np.char.startswith(done.stderr.splitlines(), "isonoise: ").sum() == len(paths)
