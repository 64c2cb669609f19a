"""Feeds damaged files to the loaders: `python tests/fuzzing.py TARGET,.. FIRST COUNT OUT.json` runs that many inputs of
each target, made from the numbers FIRST, FIRST + 1, ..., in a process whose memory is bounded, and writes what became
of them. An input passes if it loads, into finite numbers, or is refused with a SceneError or UserError.
"""

import json
import math
import random
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import small_files

from isonoise.errors import UserError
from isonoise.film.exr import read_header, read_reference
from isonoise.scene import compile_scene, load
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.image.image import read_image
from isonoise.scene.parse import plugin_tables
from isonoise.scene.vocabulary import PLUGINS, UNSUPPORTED_PLUGINS

SECONDS = 5  # of the processor, for one input
MEMORY = 2 << 30  # bytes beyond what the process has before; images may take 2 GiB where a file is large enough

HEAD = '<scene version="{version}"><default name="n" value="4"/>'
SENSOR = """<integrator type="volpath"><integer name="max_depth" value="$n"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0, 1, 5" target="0 0 0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="9"/><integer name="height" value="7"/><rfilter type="tent"/></film>
<sampler type="independent"><integer name="sample_count" value="8"/></sampler></sensor>"""
SCENES = (
    HEAD.format(version="3.0.0")
    + SENSOR
    + """<bsdf type="twosided" id="a"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.2, 0.1"/></bsdf></bsdf>
<bsdf type="blendbsdf" id="b"><float name="weight" value="0.3"/><ref id="a"/><bsdf type="roughconductor">
<string name="material" value="Au"/><float name="alpha" value="0.2"/><string name="distribution" value="ggx"/>
</bsdf></bsdf>
<texture type="bitmap" id="t"><string name="filename" value="a.png"/><string name="wrap_mode" value="mirror"/>
<transform name="to_uv"><scale x="2" y="3"/><rotate z="1" angle="30"/></transform></texture>
<bsdf type="mask" id="m"><ref name="opacity" id="t"/><bsdf type="bumpmap"><ref id="t"/><float name="scale" value="2"/>
<bsdf type="plastic"><string name="int_ior" value="water"/><ref name="diffuse_reflectance" id="t"/></bsdf></bsdf>
</bsdf>
<shape type="ply"><string name="filename" value="a.ply"/><ref id="m"/></shape>
<shape type="obj"><string name="filename" value="a.obj"/><bsdf type="principled">
<texture type="checkerboard" name="base_color">
<ref name="color0" id="t"/></texture><float name="spec_trans" value="0.5"/></bsdf></shape>
<shape type="serialized"><string name="filename" value="a.serialized"/><integer name="shape_index" value="1"/>
<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/>
</texture>
</bsdf></shape><emitter type="envmap"><string name="filename" value="a.hdr"/><float name="scale" value="2"/>
</emitter></scene>""",
    HEAD.format(version="2.1.0")
    + SENSOR
    + """<include filename="part.xml"/><alias id="g" as="h"/><shape type="shapegroup" id="g"><shape type="sphere">
<point name="center" value="0 1 0"/><float name="radius" value="0.5"/></shape><shape type="cube"/></shape>
<shape type="instance"><ref id="h"/><transform name="to_world"><translate x="1"/><scale value="2 -1 1"/></transform>
</shape>
<shape type="cylinder"><point name="p1" x="0" y="0" z="2"/><bsdf type="null"/>
<medium type="homogeneous" name="interior">
<float name="sigma_t" value="2"/><rgb name="albedo" value="0.5 0.6 0.7"/><phase type="hg">
<float name="g" value="0.3"/></phase>
</medium></shape><shape type="rectangle"><emitter type="area">
<spectrum name="radiance" value="400:1, 500:2, 700:3"/></emitter>
<transform name="to_world"><matrix value="1 0 0 0 0 1 0 0 0 0 1 3 0 0 0 1"/></transform></shape>
<emitter type="spot"><float name="cutoff_angle" value="30"/></emitter><emitter type="point">
<point name="position" value="1"/>
</emitter><emitter type="directional"><vector name="direction" x="1" y="0" z="0"/>
<spectrum name="irradiance" value="2"/>
</emitter></scene>""",
    HEAD.format(version="0.5.0")
    + """<integrator type="path"><integer name="maxDepth" value="$n"/></integrator><sensor type="thinlens">
<float name="apertureRadius" value="0.1"/><float name="focusDistance" value="5"/>
<string name="fovAxis" value="smaller"/>
<transform name="toWorld"><lookAt origin="0 1 5" target="0 0 0" up="0 1 0"/></transform></sensor>
<bsdf type="roughplastic" id="p"><float name="intIOR" value="1.5"/><texture type="bitmap" name="diffuseReflectance">
<string name="filename" value="a.jpg"/><float name="uscale" value="2"/><float name="voffset" value="0.5"/></texture>
</bsdf>
<shape type="disk"><ref id="p"/><boolean name="flipNormals" value="true"/></shape>
<emitter type="constant"><rgb name="radiance" value="1"/></emitter></scene>""",
)
PART = '<scene version="3.0.0"><shape type="sphere"><bsdf type="dielectric"/></shape></scene>'

NASTY = ["", "nan", "inf", "-1", "0", "1e400", "-1e38", "3.5e38", "1e-45", "99999999999999999999", "4294967296"]
NASTY += [
    "x" * 100_000,
    "$n",
    "$",
    "\\$n",
    "$$",
    "../..",
    ".",
    "/dev/zero",
    "none.ply",
    "a" * 300,
    "0 0 0",
    "1,2",
    "1 2 3 4",
]
NASTY += [
    "true",
    "False",
    "a.ply",
    "a.png",
    "a.exr",
    "scene.xml",
    "part.xml",
    "a.mtl",
    "\u212b\U0001f600",
    "a",
    "b",
    "t",
    "g",
]
NASTY += [":", "400:1", "400:1,400:2", "1e30", "-0.0", "0x10", "1_0", "65536", "1" * 400, "0 0 0 0 0 0 0 0 0"]
EXTREMES = ["0", "1", "-1", "0.5", "1e-30", "1e30", "1e17", "-1e18", "3e38", "1e-38", "89.9999", "2", "1e-6", "1e6"]
TAGS = ["float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum", "transform", "ref", "include"]
TAGS += ["alias", "default", "path", "lookat", "matrix", "translate", "rotate", "scale", "scene", *plugin_tables.KINDS]
NAMES = sorted({parameter.name for plugin in PLUGINS for parameter in plugin.parameters} | {"interior", "exterior", ""})
TYPES = sorted({plugin.name for plugin in PLUGINS} | {name for names in UNSUPPORTED_PLUGINS.values() for name in names})
NUMBERS = [
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"1e400",
    b"-1e300",
    b"1e39",
    b"4294967296",
    b"1000000000",
    b"999999999999999",
    b"3.5",
    b"x",
]
INTEGERS = [
    0,
    1,
    -1,
    2**31 - 1,
    2**31,
    2**32 - 1,
    10**9,
    65535,
    65536,
    2**63,
    2**64 - 1,
    0x7FC00000,
    0x7F800000,
    0x7F7FFFFF,
]


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """One to four damages such as files suffer, and such as somebody would think of."""
    result = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        size = len(result)
        at = rng.randrange(size + 1)
        length = min(int(rng.expovariate(1 / 8)) + 1, size)
        match rng.randrange(9):
            case 0:
                del result[at:]
            case 1:
                del result[at : at + length]
            case 2:
                result[at:at] = result[max(at - length, 0) : at] * rng.choice((1, 2, 50))
            case 3:
                result[at : at + length] = rng.randbytes(length)
            case 4:
                result[at:at] = rng.randbytes(length)
            case 5 if size:
                result[at % size] ^= 1 << rng.randrange(8)
            case 6:
                width = rng.choice((1, 2, 4, 8))
                number = rng.choice(INTEGERS) % (1 << (8 * width))
                result[at : at + width] = number.to_bytes(width, rng.choice(("little", "big")))
            case 7:
                words = [(m.start(), m.end()) for m in small_files.NUMBER.finditer(bytes(result[:4096]))]
                if words:
                    begin, end = rng.choice(words)
                    result[begin:end] = rng.choice(NUMBERS)
            case 8:
                other = rng.randrange(size + 1)
                piece = bytes(result[other : other + length])
                result[at : at + len(piece)] = piece
    return bytes(result)


def mutate_png(data: bytes, rng: random.Random) -> bytes:
    """Also within the chunks, whose checksums are right then."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    chunks, position = [], 8
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        chunks.append((data[position + 4 : position + 8], data[position + 8 : position + 8 + length]))
        position += 12 + length
    changed = rng.randrange(len(chunks))
    for number, (name, content) in enumerate(chunks):
        if number == changed:
            content = _inflated(content, rng) if name == b"IDAT" and rng.random() < 0.5 else mutate_bytes(content, rng)
        chunks[number] = small_files.chunk(name, content)
    rng.random() < 0.1 and rng.shuffle(chunks)
    return data[:8] + b"".join(chunks)


def mutate_serialized(data: bytes, rng: random.Random) -> bytes:
    """Also what is deflated."""
    if rng.random() < 0.5:
        return mutate_bytes(data, rng)
    return data[:4] + _inflated(data[4:-20], rng) + data[-20:]


def _inflated(data: bytes, rng: random.Random) -> bytes:
    """Deflated data, damaged before it was deflated."""
    inflater = zlib.decompressobj()
    return zlib.compress(mutate_bytes(inflater.decompress(data), rng)) + inflater.unused_data


def mutate_glb(data: bytes, rng: random.Random) -> bytes:
    """Also the values of its JSON."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    length = int.from_bytes(data[12:16], "little")
    header, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    for _ in range(rng.choice((1, 1, 2, 4))):
        holders = [header]
        for holder in holders:
            inner = holder.values() if isinstance(holder, dict) else holder
            holders += [value for value in inner if isinstance(value, (dict, list)) and value]
        holder = rng.choice(holders)
        key = rng.choice(sorted(holder)) if isinstance(holder, dict) else rng.randrange(len(holder))
        if rng.random() < 0.2:
            del holder[key]
        else:
            holder[key] = rng.choice(
                [*INTEGERS, 2, 3, 4, 0.5, -1e300, "", "x", "VEC3", "MAT4", [], {}, [0, 0, 0], None, True]
            )
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    return (
        data[:8]
        + (20 + len(text) + len(rest)).to_bytes(4, "little")
        + len(text).to_bytes(4, "little")
        + data[16:20]
        + text
        + rest
    )


def mutate_xml(text: str, rng: random.Random) -> bytes:
    """Changes of names, values and structure; the file stays well-formed, most of the time."""
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 3, 5))):
        if len(list(root.iter())) > 1000:
            break
        nodes = list(root.iter())
        node, other = rng.choice(nodes), rng.choice(nodes)
        match rng.randrange(16):
            case 0 | 1 | 2 if node.attrib:
                node.set(rng.choice(sorted(node.attrib)), rng.choice(NASTY))
            case 3 if node.attrib:
                del node.attrib[rng.choice(sorted(node.attrib))]
            case 4:
                node.set(rng.choice(("id", "name", "type", "value", "x", "version", "foo")), rng.choice(NASTY + NAMES))
            case 5:
                node.tag = rng.choice(TAGS)
            case 6 if "type" in node.attrib:
                node.set("type", rng.choice(TYPES))
            case 7 if "name" in node.attrib:
                node.set("name", rng.choice(NAMES))
            case 8 if len(node):
                node.remove(rng.choice(list(node)))
            case 9:
                copy = ElementTree.fromstring(ElementTree.tostring(other))
                node.insert(rng.randrange(len(node) + 1), copy)
            case 10:
                identifier = rng.choice([n.get("id") for n in nodes if n.get("id")] or ["a"])
                ElementTree.SubElement(node, "ref", id=identifier, name=rng.choice(NAMES))
            case 12 | 13 | 14 | 15 if node.tag not in ("string", "scene"):
                for key in set(node.attrib) & {"value", "x", "y", "z", "angle", "origin"}:
                    node.set(
                        key,
                        re.sub(r"[-+.\de]+", lambda _: rng.choice(EXTREMES), node.get(key), count=rng.choice((0, 1))),
                    )
            case 11:
                inner = ElementTree.fromstring(ElementTree.tostring(node))
                for _ in range(rng.choice((1, 3, 70, 300))):
                    outer = ElementTree.Element(node.tag, dict(node.attrib))
                    outer.append(inner)
                    inner = outer
                node[:] = [inner]
    try:
        data = ElementTree.tostring(root)
    except RecursionError:  # deeper than Python can write; what it can is as deep as matters
        return b"<a>" * 5000
    return mutate_bytes(data, rng) if rng.random() < 0.1 else data


@dataclass(frozen=True)
class Target:
    """A kind of file: its seeds, its name on disk, how it is damaged and what reads it."""

    seeds: Callable[[], list]
    name: str
    read: Callable[[Path], object]
    mutate: Callable = mutate_bytes


def compiled(path: Path) -> None:
    """A scene or bare mesh, all the way to what the device gets."""
    scene = compile_scene(load(path))
    for name, array in vars(scene).items():
        if isinstance(array, np.ndarray):
            fields = [array[field] for field in array.dtype.names] if array.dtype.names else [array]
            for field in fields:
                assert field.dtype.kind != "f" or np.isfinite(field).all(), f"{name} is not finite"
    if len(scene.faces) < 10_000:
        build_scene_bvh(scene)


def textured(path: Path) -> None:
    """An image, on a surface and around it; wide images are read alone, to save time."""
    image = read_image(path)
    assert image.pixels.ndim == 3
    if image.pixels.size < 1 << 20:
        name = str(path)
        compiled_dict(name, {"type": "constant"})
        compiled_dict(name, {"type": "envmap", "filename": name})


def compiled_dict(name: str, sky: dict) -> None:
    surface = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": name}}
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "a": {"type": "rectangle", "bsdf": surface},
        "sky": sky,
    }
    compile_scene(load(scene))


def dictionary(path: Path) -> None:
    """A scene as a dict with some values of another kind; the file holds the number from which they are made."""
    rng = random.Random(path.read_text())
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 5},
        "sensor": {
            "type": "thinlens",
            "aperture_radius": 0.1,
            "to_world": np.eye(4),
            "film": {"type": "hdrfilm", "width": 9},
        },
        "mesh": {
            "type": "mesh",
            "vertices": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]),
            "faces": np.array([[0, 1, 2]]),
            "bsdf": {"type": "diffuse", "id": "matt", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
        },
        "ball": {"type": "sphere", "center": [0, 1, 2], "radius": 2.0, "paint": {"type": "ref", "id": "matt"}},
        "fog": {"type": "cube", "interior": {"type": "homogeneous", "sigma_t": 0.5, "phase": {"type": "hg", "g": 0.1}}},
        "lamp": {"type": "spot", "intensity": {"type": "spectrum", "value": [(400, 1.0), (700, 2.0)]}},
    }
    for _ in range(0 if path.read_text() == "sound" else rng.choice((1, 1, 2, 4))):
        holders = [scene]
        for holder in holders:
            holders += [value for value in holder.values() if isinstance(value, dict)] if len(holders) < 40 else []
        holder = rng.choice(holders)
        key = rng.choice([*map(str, holder), rng.choice(NAMES)])
        holder[key] = rng.choice(ODD)() if rng.random() < 0.9 else rng.choice(holders)
    compile_scene(load(scene))


ODD = [
    *(
        lambda value=value: value
        for value in (None, True, -1, 0, 1, 10**400, 2**63, math.nan, -math.inf, 1e39, 1e30, 1e-40)
    ),
    *(
        lambda value=value: value
        for value in ("", "x", "rgb", "nan", b"bytes", 1j, (), (1,), (1, 2, 3), (math.nan, 0, 0))
    ),
    *(
        lambda shape=shape: np.full(shape, 0.5)
        for shape in ((), (0,), (3,), (4,), (3, 3), (4, 4), (0, 3), (5, 3), (2, 2, 2))
    ),
    *(lambda type_=type_: np.ones((3, 3), type_) for type_ in ("i8", "f2", "u1", "c8", "U1", "O", "M8[s]", "?")),
    *(lambda value=value: np.full((4, 4), value) for value in (math.nan, 1e300, -1e38, 1e-300)),
    *(
        lambda: [],
        dict,
        object,
        set,
        lambda: [None],
        lambda: {"type": None},
        lambda: {"type": "sphere"},
        lambda: iter(()),
    ),
    *(
        lambda type_=type_: {"type": type_, "value": [1, "x"]}
        for type_ in ("rgb", "spectrum", "ref", "scene", "diffuse")
    ),
    *(
        lambda value=value: {"type": "rgb", "value": value}
        for value in (None, [], [[1, 2, 3]], np.ones(3), "1 2 3", {}, 1e39)
    ),
    lambda: {"type": "spectrum", "value": [(1,), (2, 3)]},
    lambda: np.float32(0.5),
    lambda: np.int64(3),
    lambda: Path("a.png"),
]


def picture(path: Path) -> None:
    """A picture as --reference and `isonoise info` take it."""
    read_header(path)
    read_reference(path)


def within_shape(path: Path) -> None:
    """A mesh that a shape names."""
    kind = path.suffix[1:]
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "a": {"type": kind, "filename": str(path)}}
    if kind == "serialized":
        scene["b"] = scene["a"] | {"shape_index": 1}
    compile_scene(load(scene))


def _materials(path: Path) -> None:
    compiled(path.with_suffix(".obj"))


TARGETS = {
    "xml": Target(lambda: list(SCENES), "scene.xml", compiled, mutate_xml),
    "dict": Target(lambda: [b"sound"], "number", dictionary, lambda data, rng: str(rng.random()).encode()),
    "xml-bytes": Target(lambda: [text.encode() for text in SCENES], "scene.xml", compiled),
    "obj": Target(lambda: [small_files.obj(relative=True)], "m.obj", compiled),
    "mtl": Target(lambda: [small_files.mtl()], "a.mtl", _materials),
    "ply": Target(lambda: [small_files.ply(), small_files.ply(binary=False)], "m.ply", compiled),
    "serialized": Target(
        lambda: [small_files.serialized(), small_files.serialized(version=3), small_files.serialized_head()],
        "m.serialized",
        within_shape,
        mutate_serialized,
    ),
    "stl": Target(lambda: [small_files.foreign("stl"), small_files.foreign("stl_ascii")], "m.stl", compiled),
    "glb": Target(lambda: [small_files.foreign("glb"), small_files.textured_glb()], "m.glb", compiled, mutate_glb),
    "png": Target(
        lambda: [small_files.encoded("PNG"), small_files.encoded("PNG", mode="P"), small_files.deep_png()],
        "m.png",
        textured,
        mutate_png,
    ),
    "jpeg": Target(lambda: [small_files.encoded("JPEG"), small_files.encoded("JPEG", mode="L")], "m.jpg", textured),
    "bmp": Target(lambda: [small_files.encoded("BMP"), small_files.encoded("BMP", mode="P")], "m.bmp", textured),
    "tga": Target(lambda: [small_files.encoded("TGA")], "m.tga", textured),
    "hdr": Target(lambda: [small_files.hdr(), small_files.hdr(packed=False)], "m.hdr", textured),
    "exr": Target(lambda: [small_files.exr(), small_files.exr(packed=False)], "m.exr", textured),
    "exr-picture": Target(lambda: [small_files.exr(), small_files.exr(packed=False)], "m.exr", picture),
}


def prepare(folder: Path) -> None:
    """Sound files, for what is damaged to name."""
    for name, data in {
        "a.obj": small_files.obj(),
        "a.mtl": small_files.mtl(),
        "a.ply": small_files.ply(),
        "a.serialized": small_files.serialized(),
        "a.png": small_files.encoded("PNG"),
        "a.jpg": small_files.encoded("JPEG"),
        "a.exr": small_files.exr(),
        "a.hdr": small_files.hdr(),
        "part.xml": PART.encode(),
    }.items():
        (folder / name).write_bytes(data)


def damaged(target: str, seed: int) -> bytes:
    """The input of this number."""
    rng = random.Random(f"{target} {seed}")
    return TARGETS[target].mutate(rng.choice(TARGETS[target].seeds()), rng)


class OutOfTime(BaseException):
    """An input took longer than SECONDS. No Exception: nothing on the way may take it for an error of the file's."""


def _stop(*_) -> None:
    raise OutOfTime


def run(target: str, first: int, count: int, folder: Path) -> dict:
    """What became of the inputs: how many loaded, how many were refused, and what went wrong."""
    path, outcome = folder / TARGETS[target].name, {"loaded": 0, "refused": 0, "failures": []}
    signal.signal(signal.SIGPROF, _stop)
    for seed in range(first, first + count):
        print(target, seed, file=sys.stderr, flush=True)
        path.write_bytes(damaged(target, seed))
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            TARGETS[target].read(path)
            outcome["loaded"] += 1
        except UserError as error:
            outcome["refused"] += 1
            if "\n" in str(error) or len(str(error)) > 3000:
                outcome["failures"].append([seed, f"unreadable message: {str(error)[:500]}"])
        except BaseException:
            outcome["failures"].append([seed, traceback.format_exc()[-1500:]])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    return outcome


def main(targets: str, first: int, count: int, result: Path) -> None:
    """Libraries print what they like: the outcome goes to a file, the number of the input in hand to stderr."""
    warnings.simplefilter("error", RuntimeWarning)  # of numpy: they would stand on the user's screen
    warnings.simplefilter("ignore", UserWarning)
    outcomes = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for target in map(TARGETS.get, targets.split(",")):
            seed = target.seeds()[0]
            (folder / target.name).write_bytes(seed.encode() if isinstance(seed, str) else seed)
            target.read(folder / target.name)  # sound; and everything is imported
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        for target in targets.split(","):
            outcomes[target] = run(target, first, count, folder)
    result.write_text(json.dumps(outcomes))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
