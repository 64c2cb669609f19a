"""`isonoise info`: a scene with the memory of a render, an image with its settings, or a checkpoint."""

import argparse
import shutil
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.command_output import print_json
from isonoise.commands import EXIT_DONE
from isonoise.errors import DeviceError
from isonoise.progress import format_number, shorten_numbers
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.material import textures
from isonoise.scene.material.bsdf_kinds import KINDS as BSDF_KINDS
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.scene.view import sensors_of, view_of
from isonoise.state.describe import describe_checkpoint, is_checkpoint
from isonoise.statistics import Needs
from isonoise.tables import label_lines

if TYPE_CHECKING:
    from isonoise.scene.load import LoadedScene

SHAPES = {structs.ANALYTIC_SPHERE: "spheres", structs.ANALYTIC_DISK: "disks", structs.ANALYTIC_CYLINDER: "cylinders"}
MATERIALS = {bsdf_bits(name): kind.plugin or kind.description for name, kind in BSDF_KINDS.items()}
TEXTURES = {
    textures.TEXTURE_COLOUR: "colour",
    textures.TEXTURE_BITMAP: "bitmap",
    textures.TEXTURE_CHECKERBOARD: "checkerboard",
    textures.TEXTURE_MESH_ATTRIBUTE: "mesh_attribute",
}
LIGHTS = {light_bits(name): f"{name}s" if kind.is_area else kind.plugin for name, kind in LIGHT_KINDS.items()}


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises UserError if the file cannot be read."""
    if Path(options.source).suffix.lower() == ".exr":
        _print_image(options.source, options.json)
    elif is_checkpoint(options.source):
        rows = describe_checkpoint(options.source)
        if options.json:
            print_json(dict(rows))
        else:
            print(label_lines(rows))
    else:
        _print_scene(options)
    return EXIT_DONE


def _print_image(path: str, as_json: bool) -> None:
    from isonoise.film.exr import read_header

    channels, (width, height), header = read_header(path)
    if as_json:
        fields = {name: str(value) for name, value in header.items()}
        print_json({"width": width, "height": height, "channels": channels, "header": fields})
        return
    fields = ((name, shorten_numbers(text)) for name, text in sorted(header.items()))
    print(label_lines([("size", f"{width}x{height}"), ("channels", ", ".join(channels)), *fields]))


def _print_scene(options: argparse.Namespace) -> None:
    from isonoise.integrator.features import features
    from isonoise.scene import compile_scene
    from isonoise.scene.load import load_scene
    from isonoise.strategies import DEFAULT_STRATEGY, make_strategy

    parameters, view = dict(options.parameters), view_of(options)
    loaded = load_scene(options.source, parameters, options.allow_outside, view, options.size)
    scene = compile_scene(loaded.description)
    width = shutil.get_terminal_size((120, 24)).columns
    contents = describe_scene(scene)
    if loaded.model_bounds is not None:
        contents["bounds"] = f"{_corners(loaded.model_bounds)}, of the model"
    needs = make_strategy(DEFAULT_STRATEGY).needs.with_sampler(scene.sampler)
    memory, used = _memory(scene, needs, options.device), features(scene, needs)
    if options.json:
        file = dict(describe_file(options.source, loaded))
        print_json({"file": file, "scene": contents, "memory": memory, "features": used})
        return
    print(label_lines([*describe_file(options.source, loaded), *contents.items()], wrap=width))
    _print_memory(memory)
    if options.features:
        _print_features(used)
    else:
        count = sum(used.values())
        print(f"\nkernels: {count} of {len(used)} features are compiled in; --features lists them")


def _print_features(used: Mapping[str, bool]) -> None:
    """Print what is compiled in and what is left out, with the cost of each."""
    from isonoise.integrator.feature_costs import cost
    from isonoise.integrator.features import FEATURES
    from isonoise.integrator.kernel_table import path_bytes
    from isonoise.strategies import DEFAULT_STRATEGY

    name_width, state = max(map(len, used)), sum(path_bytes(used).values())
    titles = {
        True: f"compiled in (strategy {DEFAULT_STRATEGY}); a path in flight has {state} bytes of state:",
        False: "left out, because neither scene nor strategy uses it, with the saving:",
    }
    for is_on, title in titles.items():
        rows = [(name, f"{FEATURES[name].description}: {cost(name, used)}") for name in used if used[name] == is_on]
        print(f"\n{title}\n{label_lines(rows, indent='  ', min_width=name_width)}")


def _memory(scene: CompiledScene, needs: Needs, device_choice: str | None) -> dict[str, object]:
    """What a render takes, in bytes; without an OpenCL device only the `error` that there is none."""
    from isonoise.device.opencl import Device
    from isonoise.integrator.memory_plan import fit_pool
    from isonoise.integrator.wavefront import plan_memory
    from isonoise.strategies import DEFAULT_STRATEGY

    try:
        device = Device(device_choice)
        plan = plan_memory(device, scene, needs)
        plan = fit_pool(lambda pool_size: replace(plan, pool_size=pool_size), plan.pool_size, device)
    except DeviceError as error:
        return {"error": str(error)}
    return {
        "strategy": DEFAULT_STRATEGY,
        "pool_size": plan.pool_size,
        "device": device.name,
        "shares_memory": device.shares_memory,
        "bytes": dict(plan.rows()),
        "total_bytes": plan.shared if device.shares_memory else plan.device,
    }


def _print_memory(memory: Mapping) -> None:
    from isonoise.integrator.memory_plan import format_bytes

    if "error" in memory:
        print(f"\nmemory: {memory['error']}")
        return
    paths = f"{memory['pool_size']:,} paths"
    print(f"\nmemory of a render (strategy {memory['strategy']}, {paths}) on {memory['device']}:")
    rows = [(name, format_bytes(size)) for name, size in memory["bytes"].items()]
    where = "at a time, for device and host" if memory["shares_memory"] else "on the device"
    print(label_lines([*rows, ("total", f"{format_bytes(memory['total_bytes'])} {where}")], indent="  "))


def describe_file(source: str, loaded: "LoadedScene") -> list[tuple[str, str]]:
    """What a file has, what becomes of it and what it lacks, as text, by label."""
    rows = [("file", f"{Path(source).name}, {loaded.format}")]
    if loaded.report:
        rows += loaded.report.rows()
    if loaded.added:
        rows.append(("added", ", ".join(loaded.added)))
    used = next(iter(sensors_of(loaded.description)))
    names = [f"{number} '{name}'{' (used)' * (name == used)}" for number, name in enumerate(loaded.cameras)]
    return [*rows, ("cameras", ", ".join(names) or "none")]


def describe_scene(scene: CompiledScene) -> dict[str, str]:
    """Contents of a scene as text, by label."""
    depth = "unlimited" if scene.max_depth < 0 else str(scene.max_depth)
    instances = f"{len(scene.instances):,} of {len(scene.group_offsets) - 1} groups"
    return {
        "image": f"{scene.width}x{scene.height}, {scene.sample_count} samples per pixel, filter {scene.filter}",
        "camera": _camera(scene.camera[0]),
        "lights": _counts(LIGHTS, scene.lights["kind"]),
        "materials": _counts(MATERIALS, scene.bsdfs["kind"]),
        "textures": _counts(TEXTURES, scene.textures["kind"]),
        "media": _describe_media(scene),
        "triangles": f"{len(scene.faces):,} with {len(scene.vertices):,} vertices",
        "analytic": _counts(SHAPES, scene.analytics["kind"]),
        "instances": instances if len(scene.instances) else "none",
        "bounds": _corners(scene.bounds),
        "paths": f"max_depth {depth}, russian roulette from depth {scene.rr_depth}",
        "hash": scene.hash,
    }


def _corners(bounds: np.ndarray) -> str:
    low, high = (", ".join(format_number(float(x), 4) for x in corner) for corner in bounds)
    return f"({low}) to ({high})"


def _camera(camera: np.void) -> str:
    """Kind, angles of view, position and direction."""
    matrix = camera["to_world"].reshape(3, 4).astype(float)
    position, direction = (
        ", ".join(format_number(float(x)) for x in vector)
        for vector in (matrix[:, 3], matrix[:, 2] / np.linalg.norm(matrix[:, 2]))
    )
    if camera["kind"] == structs.CAMERA_ORTHOGRAPHIC:
        view = "orthographic"
    else:
        angles = 2 * np.degrees(np.arctan(camera["tan_half_fov"].astype(float)))
        view = f"{'thin lens' if camera['kind'] == structs.CAMERA_THIN_LENS else 'pinhole'}, "
        view += " x ".join(format_number(float(angle)) for angle in angles) + " degrees"
    return f"{view}, at ({position}), looks along ({direction})"


def _describe_media(scene: CompiledScene) -> str:
    text = f"{len(scene.media):,}" if len(scene.media) else "none"
    if scene.heterogeneous is None:
        return text
    varying = np.count_nonzero(scene.heterogeneous.records["sigma_t"] != structs.NONE)
    return f"{text}, {varying:,} of them heterogeneous; grids of {scene.heterogeneous.values.size:,} values"


def _counts(names: dict[int, str], kinds: np.ndarray) -> str:
    """How many objects have each name, which several kinds may share."""
    counts = Counter(names[kind] for kind in np.sort(kinds).tolist())
    return ", ".join(f"{n:,} {name.removesuffix('s') if n == 1 else name}" for name, n in counts.items()) or "none"
