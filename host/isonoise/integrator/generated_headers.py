"""Text of the headers `generated/*.h`, which kernels include: parameters, path state, kinds of BSDF and light.

They are written from `kernel_table`, `bsdf_kinds` and `light_kinds`. `device.program` puts them in place of the
`#include` lines; `#if` on features stays in the text, so that it is the same for every scene.
"""

from collections.abc import Iterable
from functools import cache

from isonoise.integrator.kernel_table import (
    ARGUMENT_FEATURES,
    BOUNCE_BUFFERS,
    BRUTE_FORCE_KERNELS,
    ELEMENT_TYPES,
    KERNELS,
    PATH_STATE,
    VALUE_TYPES,
    Kernel,
)
from isonoise.scene.light.light_kinds import light_header
from isonoise.scene.material.bsdf_kinds import bsdf_header

_VIEW_MEMBERS = (
    "triangles faces corner_normals uvs analytics shapes bsdfs instances lights projections light_cdf light_count "
    "environment_light seed media rough_transmittances textured_slots world_triangle_count"
)
SCENE_VIEW = {
    **{name: name for name in _VIEW_MEMBERS.split()},
    "textures.records": "textures",
    "textures.bytes": "texel_bytes",
    "textures.floats": "texel_floats",
    "textures.srgb": "srgb",
    "textures.attributes": "attributes",
    "textures.faces": "faces",
    "envmap.record": "environment",
    "envmap.texels": "environment_texels",
    "envmap.rows": "environment_rows",
    "envmap.guide": "environment_guide",
    "light_list.bounds": "light_bounds",
    "light_list.light_count": "light_count",
    "heterogeneous.media": "heterogeneous_media",
    "heterogeneous.grids": "grids",
    "heterogeneous.values": "grid_values",
    "heterogeneous.bounds": "extinction_bounds",
    "light_tree.nodes": "light_nodes",
    "light_tree.parents": "light_parents",
    "light_tree.cdf": "light_cdf",
    "light_tree.light_count": "light_count",
}
"""Member of the struct `SceneView` (kernels/geometry/surface.h) -> kernel argument."""

VIEW_CONDITIONS = {
    "textures": "FEATURE_TEXTURES",
    "envmap": "FEATURE_ENVIRONMENT_MAP",
    "heterogeneous": "FEATURE_HETEROGENEOUS",
    "light_list": "FEATURE_LIGHT_LIST",
    "light_tree": "FEATURE_LIGHT_TREE && !FEATURE_LIGHT_LIST",
}
"""Nested structs of `SceneView` and when they are there."""

PATH_BUFFERS = (
    "plane_stride",
    "sample_pixel",
    *PATH_STATE,
    *(name for name in BOUNCE_BUFFERS if name not in ("holes", "tests")),
    "samples",
)
"""Members of the struct `PathBuffers`: kernel arguments of the same name."""


@cache
def generated_headers() -> dict[str, str]:
    """Name of the header, as kernels include it -> its text."""
    headers = {
        "path_buffers_members": _lines(
            (_declaration(name, KERNELS["shade"]) + ";", _condition(name)) for name in PATH_BUFFERS
        ),
        "path_members": _path_members(),
        "load_path_members": _load_path_members(),
        "init_path_state": _init_path_state(),
        "move_path_state": _move_path_state(),
    }
    for suffix, table in (("", KERNELS), ("_brute_force", BRUTE_FORCE_KERNELS)):
        for name, kernel in table.items():
            headers[f"{name}{suffix}_parameters"] = _parameters(kernel)
            headers[f"{name}{suffix}_scene_view"] = _scene_view(kernel)
    for name in ("shade", "accumulate_layers"):
        headers[f"{name}_path_buffers"] = _path_buffers(KERNELS[name])
    headers |= {"bsdf_kinds": bsdf_header(), "light_kinds": light_header()}
    return {f"generated/{name}.h": text for name, text in headers.items()}


def _lines(rows: Iterable[tuple[str, str]]) -> str:
    """C lines, each with the condition under which it is there; '' is always."""
    text, current = [], ""
    for line, condition in [*rows, ("", "")]:
        if condition != current:
            text += ["#endif"] if current else []
            text += [f"#if {condition}"] if condition else []
            current = condition
        text += [line] if line else []
    return "\n".join(text)


def _condition(argument: str) -> str:
    return " || ".join(f"FEATURE_{name}" for name in ARGUMENT_FEATURES.get(argument, ()))


def _element(buffer: str) -> str:
    state = PATH_STATE.get(buffer)
    return state.element if state else ELEMENT_TYPES.get(buffer, "float")


def _declaration(argument: str, kernel: Kernel) -> str:
    if argument in kernel.values:
        return f"{VALUE_TYPES.get(argument, 'uint')} {argument}"
    return f"__global {'const ' if argument in kernel.reads else ''}{_element(argument)}* {argument}"


def _parameters(kernel: Kernel) -> str:
    separators = ["", *[", "] * len(kernel.arguments)]
    return _lines(
        (separator + _declaration(name, kernel), _condition(name))
        for separator, name in zip(separators, kernel.arguments, strict=False)
    )


def _scene_view(kernel: Kernel) -> str:
    rows = []
    for member, argument in SCENE_VIEW.items():
        if argument in kernel.arguments:
            condition = VIEW_CONDITIONS.get(member.partition(".")[0]) or _condition(argument)
            rows.append((f"scene.{member} = {argument};", condition))
    return _lines(rows)


def _path_buffers(kernel: Kernel) -> str:
    members = [name for name in PATH_BUFFERS if name in kernel.arguments]
    return _lines((f"paths.{name} = {name};", _condition(name)) for name in members)


def _members() -> dict[str, str]:
    """Members of `Path` that are loaded as they are, with their C types."""
    return {name: {1: field.element, 4: "Vec4"}[field.planes] for name, field in PATH_STATE.items() if field.default}


def _path_members() -> str:
    return "\n".join(f"{c_type} {name};" for name, c_type in _members().items())


def _load_path_members() -> str:
    rows = []
    for name in _members():
        planes = PATH_STATE[name].planes
        loaded = f"load_planes4(paths->{name}, i, plane_stride)" if planes == 4 else f"paths->{name}[i]"
        rows += [(f"p.{name} = {PATH_STATE[name].default};", ""), (f"p.{name} = {loaded};", _condition(name))]
    return _lines(rows)


def _init_path_state() -> str:
    rows = []
    for name, field in PATH_STATE.items():
        if field.initial:
            many = f"store_planes4({field.initial}, {name}, slot, plane_stride);"
            rows.append((many if field.planes == 4 else f"{name}[slot] = {field.initial};", _condition(name)))
    return _lines(rows)


def _move_path_state() -> str:
    slots = "plane_stride, source_slots, target_slots, count"
    return _lines(
        (f"move_planes({field.planes}u, (__global uint*){name}, {slots});", _condition(name))
        for name, field in PATH_STATE.items()
    )
