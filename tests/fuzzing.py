"""Runs mutated files through the readers, in a process with bounded memory.

`python tests/fuzzing.py TARGET,.. FIRST COUNT OUT.json` makes inputs number FIRST, FIRST + 1, ... of each target and
writes the outcome. An input passes if it loads, with finite numbers, or is rejected with a SceneError or UserError.
"""

import json
import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gltf_files
import gltf_material_files
import numpy as np
import pbrt_files
import small_files
from fuzz_mutations import (
    mutate_bytes,
    mutate_glb,
    mutate_json,
    mutate_pbrt,
    mutate_png,
    mutate_serialized,
    mutate_xml,
)
from fuzz_scenes import PART, SCENES, compile_damaged_dict

from isonoise.benchmark.baseline import Baseline
from isonoise.benchmark.measure import SCHEMA, SCHEMA_VERSION
from isonoise.convert.convert import convert
from isonoise.errors import UserError
from isonoise.film.exr import read_header, read_reference
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.image.image import read_image

MAX_SECONDS = 5  # processor time per input
MAX_EXTRA_BYTES = 2 << 30  # beyond the memory in use at the start; a large image file may take 2 GiB


_SPREAD = {"median": 2.0, "min": 1.0, "max": 3.0}
_IDENTITY = {"scene": "s", "scene_hash": "0f", "width": 4, "height": 3, "max_depth": 5, "samples": 12}
_KERNELS = [{"kernel": name, "time_s": _SPREAD, "time_share": 0.5} for name in ("shade", "shadow")]
BENCHMARK = json.dumps(
    {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "device": {"name": "d"},
        "scenes": [_IDENTITY | {"samples_per_s": _SPREAD, "kernels": _KERNELS}],
    }
).encode()
"""What the comparison with an earlier benchmark reads of its file."""


@dataclass(frozen=True)
class Target:
    """A kind of file: seed files, file name, reader and mutation."""

    seeds: Callable[[], list]
    name: str
    read: Callable[[Path], object]
    mutate: Callable = mutate_bytes


def compile_file(path: Path) -> None:
    """Compile a scene or a bare mesh to the arrays for the device, which have to be finite."""
    _compile(load_description(path))


def _compile(description: dict) -> None:
    scene = compile_scene(description)
    for name, array in vars(scene).items():
        if isinstance(array, np.ndarray):
            fields = [array[field] for field in array.dtype.names] if array.dtype.names else [array]
            for field in fields:
                assert field.dtype.kind != "f" or np.isfinite(field).all(), f"{name} is not finite"
    if len(scene.faces) < 10_000:
        build_scene_bvh(scene)


def compile_with_image(path: Path) -> None:
    """Read an image; if it is not large, compile scenes with it as a texture and as an environment map."""
    image = read_image(path)
    assert image.pixels.ndim == 3
    if image.pixels.size < 1 << 20:
        name = str(path)
        _compile_textured(name, {"type": "constant"})
        _compile_textured(name, {"type": "envmap", "filename": name})


def _compile_textured(name: str, sky: dict) -> None:
    surface = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": name}}
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "a": {"type": "rectangle", "bsdf": surface},
        "sky": sky,
    }
    compile_scene(load_description(scene))


def read_picture(path: Path) -> None:
    """Read an image like --reference and `isonoise info` do."""
    read_header(path)
    read_reference(path)


def compile_shape(path: Path) -> None:
    """Compile a shape that reads the mesh file."""
    kind = path.suffix[1:]
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "a": {"type": kind, "filename": str(path)}}
    if kind == "serialized":
        scene["b"] = scene["a"] | {"shape_index": 1}
    compile_scene(load_description(scene))


def compile_attributes(path: Path) -> None:
    """Compile a shape whose materials read the vertex colours and the face attribute of the mesh file."""
    names = ("vertex_color", "face_heat")
    colours = [{"type": "mesh_attribute", "name": name, "scale": 0.001} for name in names]
    shapes = {
        f"shape {number}": {"type": "ply", "filename": str(path), "bsdf": {"type": "diffuse", "reflectance": colour}}
        for number, colour in enumerate(colours)
    }
    _compile(load_description({"type": "scene", "sensor": {"type": "perspective"}, **shapes}))


def read_baseline(path: Path) -> None:
    """Compare a benchmark with the earlier one in the file."""
    baseline, now = Baseline(str(path)), json.loads(BENCHMARK)
    baseline.check_device(now)
    baseline.check_scene(_IDENTITY)
    baseline.compare(now)


def compile_volume(path: Path) -> None:
    """Compile media whose extinction, and whose albedo, are the grid in the file."""
    volume = {"type": "gridvolume", "filename": str(path)}
    for medium in (
        {"sigma_t": volume | {"use_grid_bbox": True, "wrap_mode": "repeat"}, "scale": 1e-3},
        {"albedo": volume | {"filter_type": "nearest"}},
    ):
        ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "heterogeneous", **medium}}
        scene = {"type": "scene", "integrator": {"type": "volpath"}, "sensor": {"type": "perspective"}, "ball": ball}
        compiled = compile_scene(load_description(scene)).heterogeneous
        for array in (compiled.values, compiled.extinction_bounds, compiled.grids["to_local"]):
            assert np.isfinite(array).all()


def compile_mtl(path: Path) -> None:
    compile_file(path.with_suffix(".obj"))


def convert_file(path: Path) -> None:
    """Compile a scene, convert it to Mitsuba 3 XML, and compile that."""
    description = load_description(path)
    compile_scene(description)
    converted = path.with_name("converted.xml")
    try:
        convert(path, converted)
        compile_scene(load_description(converted))
    except UserError as error:
        raise AssertionError(f"the scene is sound, but not what becomes of it: {error}") from error


def _rich_glb_files() -> list[bytes]:
    return [
        small_files.textured_glb(),
        gltf_files.rich_file().glb(),
        gltf_material_files.rich_material_file().glb(),
    ]


TARGETS = {
    "xml": Target(lambda: list(SCENES), "scene.xml", compile_file, mutate_xml),
    "dict": Target(lambda: [b"sound"], "number", compile_damaged_dict, lambda data, rng: str(rng.random()).encode()),
    "xml-bytes": Target(lambda: [text.encode() for text in SCENES], "scene.xml", compile_file),
    "obj": Target(lambda: [small_files.obj(relative=True)], "m.obj", compile_file),
    "mtl": Target(lambda: [small_files.mtl()], "a.mtl", compile_mtl),
    "ply": Target(
        lambda: [small_files.ply(), small_files.ply(binary=False), small_files.ply_textured()], "m.ply", compile_file
    ),
    "serialized": Target(
        lambda: [small_files.serialized(), small_files.serialized(version=3), small_files.serialized_uncompressed()],
        "m.serialized",
        compile_shape,
        mutate_serialized,
    ),
    "stl": Target(
        lambda: [small_files.from_trimesh("stl"), small_files.from_trimesh("stl_ascii")], "m.stl", compile_file
    ),
    "glb": Target(_rich_glb_files, "m.glb", compile_file, mutate_glb),
    "convert-glb": Target(_rich_glb_files, "m.glb", convert_file, mutate_glb),
    "convert-xml": Target(lambda: list(SCENES), "scene.xml", convert_file, mutate_xml),
    "gltf": Target(
        lambda: [gltf_files.rich_file().gltf(), gltf_material_files.rich_material_file().gltf()],
        "m.gltf",
        compile_file,
        mutate_json,
    ),
    "pbrt": Target(lambda: [pbrt_files.RICH.encode()], "m.pbrt", compile_file, mutate_pbrt),
    "png": Target(
        lambda: [small_files.image_file("PNG"), small_files.image_file("PNG", mode="P"), small_files.png_16_bit()],
        "m.png",
        compile_with_image,
        mutate_png,
    ),
    "jpeg": Target(
        lambda: [small_files.image_file("JPEG"), small_files.image_file("JPEG", mode="L")], "m.jpg", compile_with_image
    ),
    "bmp": Target(
        lambda: [small_files.image_file("BMP"), small_files.image_file("BMP", mode="P")], "m.bmp", compile_with_image
    ),
    "tga": Target(lambda: [small_files.image_file("TGA")], "m.tga", compile_with_image),
    "hdr": Target(lambda: [small_files.hdr(), small_files.hdr(packed=False)], "m.hdr", compile_with_image),
    "exr": Target(lambda: [small_files.exr(), small_files.exr(packed=False)], "m.exr", compile_with_image),
    "ply-attributes": Target(lambda: [small_files.ply(), small_files.ply(binary=False)], "m.ply", compile_attributes),
    "vol": Target(lambda: [small_files.vol(), small_files.vol(channels=3)], "m.vol", compile_volume),
    "baseline": Target(lambda: [BENCHMARK], "b.json", read_baseline, mutate_json),
    "exr-picture": Target(lambda: [small_files.exr(), small_files.exr(packed=False)], "m.exr", read_picture),
}


def write_sound_files(folder: Path) -> None:
    """Write the undamaged files that the inputs refer to."""
    for name, data in {
        "a.obj": small_files.obj(),
        "a.mtl": small_files.mtl(),
        "a.ply": small_files.ply(),
        "a.serialized": small_files.serialized(),
        "a.png": small_files.image_file("PNG"),
        "a.jpg": small_files.image_file("JPEG"),
        "a.exr": small_files.exr(),
        "a.hdr": small_files.hdr(),
        "part.xml": PART.encode(),
        "part.pbrt": pbrt_files.PART.encode(),
    }.items():
        (folder / name).write_bytes(data)


def make_input(target: str, seed: int) -> bytes:
    """The input with this number."""
    rng = random.Random(f"{target} {seed}")
    return TARGETS[target].mutate(rng.choice(TARGETS[target].seeds()), rng)


class TimeLimitExceeded(BaseException):
    """An input took longer than MAX_SECONDS. Not an Exception, so that no reader catches it."""


def _raise_time_limit(*_) -> None:
    raise TimeLimitExceeded


def run(target: str, first: int, count: int, folder: Path) -> dict:
    """Run the inputs; return how many loaded, how many were rejected, and the failures."""
    path, outcome = folder / TARGETS[target].name, {"loaded": 0, "rejected": 0, "failures": []}
    signal.signal(signal.SIGPROF, _raise_time_limit)
    for seed in range(first, first + count):
        print(target, seed, file=sys.stderr, flush=True)
        path.write_bytes(make_input(target, seed))
        signal.setitimer(signal.ITIMER_PROF, MAX_SECONDS)
        try:
            TARGETS[target].read(path)
            outcome["loaded"] += 1
        except UserError as error:
            outcome["rejected"] += 1
            if "\n" in str(error) or len(str(error)) > 3000:
                outcome["failures"].append([seed, f"unreadable message: {str(error)[:500]}"])
        except BaseException:
            outcome["failures"].append([seed, traceback.format_exc()[-1500:]])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    return outcome


def main(targets: str, first: int, count: int, result: Path) -> None:
    """Write the outcome to a file, because libraries may print to stdout; stderr gets the number of each input."""
    warnings.simplefilter("error", RuntimeWarning)  # numpy's warnings would appear on the user's screen
    warnings.simplefilter("ignore", UserWarning)
    outcomes = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_sound_files(folder)
        for target in map(TARGETS.get, targets.split(",")):
            seed = target.seeds()[0]
            (folder / target.name).write_bytes(seed.encode() if isinstance(seed, str) else seed)
            target.read(folder / target.name)  # imports all modules, before memory is limited
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MAX_EXTRA_BYTES, used + MAX_EXTRA_BYTES))
        for target in targets.split(","):
            outcomes[target] = run(target, first, count, folder)
    result.write_text(json.dumps(outcomes))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
