"""`isonoise info`: what a scene holds and compiles to, or what an image says about how it was made."""

import argparse
from pathlib import Path

import numpy as np

from isonoise.commands import EXIT_DONE
from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light.light_kinds import KINDS as LIGHT_KINDS
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.material import textures
from isonoise.scene.material.bsdf_kinds import KINDS as BSDF_KINDS
from isonoise.scene.material.bsdf_kinds import bsdf_bits

SHAPES = {structs.ANALYTIC_SPHERE: "spheres", structs.ANALYTIC_DISK: "disks", structs.ANALYTIC_CYLINDER: "cylinders"}
MATERIALS = {bsdf_bits(name): kind.plugin or kind.description for name, kind in BSDF_KINDS.items()}
TEXTURES = {
    textures.TEXTURE_COLOUR: "plain",
    textures.TEXTURE_BITMAP: "bitmap",
    textures.TEXTURE_CHECKERBOARD: "checkerboard",
    textures.TEXTURE_MESH_ATTRIBUTE: "mesh_attribute",
}
LIGHTS = {light_bits(name): f"{name}s" if kind.is_area else kind.plugin for name, kind in LIGHT_KINDS.items()}


def run(options: argparse.Namespace) -> int:
    """Print what there is to say about a scene or an .exr file. Raises UserError if it cannot be read."""
    if Path(options.source).suffix.lower() == ".exr":
        _image(options.source)
    else:
        _scene(options.source, dict(options.parameters))
    return EXIT_DONE


def _image(path: str) -> None:
    from isonoise.film.exr import read_header

    channels, (width, height), header = read_header(path)
    print(f"size      {width}x{height}")
    print(f"channels  {', '.join(channels)}")
    for name, value in sorted(header.items()):
        print(f"{name:24}  {value}")


def _scene(source: str, parameters: dict[str, str]) -> None:
    from isonoise.integrator.feature_costs import cost
    from isonoise.integrator.features import FEATURES, features
    from isonoise.integrator.kernel_table import path_bytes
    from isonoise.scene import compile_scene, load
    from isonoise.strategies import DEFAULT_STRATEGY, make_strategy

    scene = compile_scene(load(source, parameters))
    for name, value in facts(scene).items():
        print(f"{name:12} {value}")
    used = features(scene, make_strategy(DEFAULT_STRATEGY).needs)
    width = max(map(len, used))

    def line(name: str) -> str:
        return f"  {name:{width}}  {FEATURES[name].meaning}: {cost(name, used)}"

    state = sum(path_bytes(used).values())
    print(f"\nin, with the strategy {DEFAULT_STRATEGY}; a path in flight has {state} bytes of state:")
    print(*(line(name) for name, on in used.items() if on), sep="\n")
    print("\nleft out, because the scene or the strategy has no use for it, with what that saves:")
    print(*(line(name) for name, on in used.items() if not on), sep="\n")


def facts(scene: CompiledScene) -> dict[str, str]:
    """What a person wants to know about a scene, line by line."""
    depth = "no end" if scene.max_depth < 0 else str(scene.max_depth)
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
    found = zip(*np.unique(kinds, return_counts=True), strict=True)
    return ", ".join(f"{number:,} {names[kind]}" for kind, number in found) or "none"
