"""`isonoise info`: contents and compiled features of a scene, layers and settings of an image, or a checkpoint."""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from isonoise.commands import EXIT_DONE
from isonoise.errors import DeviceError
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.material import textures
from isonoise.scene.material.bsdf_kinds import KINDS as BSDF_KINDS
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.scene.view import view_of
from isonoise.state.describe import describe_checkpoint, is_checkpoint
from isonoise.statistics import Needs
from isonoise.tables import label_lines

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
        _print_image(options.source)
    elif is_checkpoint(options.source):
        print(label_lines(describe_checkpoint(options.source)))
    else:
        _print_scene(options)
    return EXIT_DONE


def _print_image(path: str) -> None:
    from isonoise.film.exr import read_header

    channels, (width, height), header = read_header(path)
    print(label_lines([("size", f"{width}x{height}"), ("channels", ", ".join(channels)), *sorted(header.items())]))


def _print_scene(options: argparse.Namespace) -> None:
    from isonoise.integrator.feature_costs import cost
    from isonoise.integrator.features import FEATURES, features
    from isonoise.integrator.kernel_table import path_bytes
    from isonoise.scene import compile_scene
    from isonoise.scene.load import load_scene
    from isonoise.strategies import DEFAULT_STRATEGY, make_strategy

    parameters, view = dict(options.parameters), view_of(options)
    loaded = load_scene(options.source, parameters, options.allow_outside, view, options.size)
    if loaded.report:
        print(label_lines(loaded.report.rows(), wrap=shutil.get_terminal_size((120, 24)).columns) + "\n")
    scene = compile_scene(loaded.description, options.size)
    print(label_lines(describe_scene(scene).items()))
    needs = make_strategy(DEFAULT_STRATEGY).needs.with_sampler(scene.sampler)
    used = features(scene, needs)
    name_width = max(map(len, used))

    def print_features(is_on: bool) -> None:
        rows = [
            (name, f"{FEATURES[name].description}: {cost(name, used)}")
            for name, value in used.items()
            if value == is_on
        ]
        print(label_lines(rows, indent="  ", min_width=name_width))

    _print_memory(scene, needs, options.device)
    state = sum(path_bytes(used).values())
    print(f"\ncompiled in (strategy {DEFAULT_STRATEGY}); a path in flight has {state} bytes of state:")
    print_features(True)
    print("\nleft out, because neither scene nor strategy uses it, with the saving:")
    print_features(False)


def _print_memory(scene: CompiledScene, needs: Needs, device_choice: str | None) -> None:
    """What a render takes; without an OpenCL device only that there is none."""
    from isonoise.device.opencl import Device
    from isonoise.integrator.memory_plan import fit_pool, format_bytes
    from isonoise.integrator.wavefront import plan_memory
    from isonoise.strategies import DEFAULT_STRATEGY

    try:
        device = Device(device_choice)
        plan = plan_memory(device, scene, needs)
        plan = fit_pool(lambda pool_size: replace(plan, pool_size=pool_size), plan.pool_size, device)
    except DeviceError as error:
        print(f"\nmemory: {error}")
        return
    total = plan.shared if device.shares_memory else plan.device
    print(f"\nmemory of a render (strategy {DEFAULT_STRATEGY}, {plan.pool_size:,} paths) on {device.name}:")
    rows = [(name, format_bytes(size)) for name, size in plan.rows()]
    where = "at a time, for device and host" if device.shares_memory else "on the device"
    print(label_lines([*rows, ("total", f"{format_bytes(total)} {where}")], indent="  "))


def describe_scene(scene: CompiledScene) -> dict[str, str]:
    """Contents of a scene as text, by label."""
    depth = "unlimited" if scene.max_depth < 0 else str(scene.max_depth)
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in scene.bounds)
    return {
        "size": f"{scene.width}x{scene.height}, {scene.sample_count} samples per pixel, filter {scene.filter}",
        "paths": f"max_depth {depth}, russian roulette from depth {scene.rr_depth}",
        "triangles": f"{len(scene.faces):,} with {len(scene.vertices):,} vertices",
        "analytic": _counts(SHAPES, scene.analytics["kind"]),
        "instances": f"{len(scene.instances):,} of {len(scene.group_offsets) - 1} groups"
        if len(scene.instances)
        else "none",
        "materials": _counts(MATERIALS, scene.bsdfs["kind"]),
        "textures": _counts(TEXTURES, scene.textures["kind"]),
        "media": f"{len(scene.media):,}" if len(scene.media) else "none",
        "lights": _counts(LIGHTS, scene.lights["kind"]),
        "bounds": f"({low}) to ({high})",
        "hash": scene.hash,
    }


def _counts(names: dict[int, str], kinds: np.ndarray) -> str:
    counts = zip(*np.unique(kinds, return_counts=True), strict=True)
    return ", ".join(f"{number:,} {names[kind]}" for kind, number in counts) or "none"
