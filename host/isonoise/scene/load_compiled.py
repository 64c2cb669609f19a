"""Loads and compiles a scene in one call, for `Renderer`; a scene that is compiled already stays as it is."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeAlias

from isonoise.errors import SceneError
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load_description
from isonoise.scene.scene import NO_PARAMETERS, Scene
from isonoise.scene.view import View

SceneSource: TypeAlias = str | os.PathLike[str] | Mapping[str, object] | Scene | CompiledScene
"""What a renderer takes as its scene."""


def load_compiled(
    source: SceneSource,
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: View | None = None,
    size: tuple[int, int] | None = None,
    max_depth: int | None = None,
    sampler: str | None = None,
    keep_uvs: bool = False,
) -> CompiledScene:
    """`compile_scene` of what `load_description` returns.

    Of a CompiledScene only the sampler can be replaced, and its texture coordinates stay as they are. Raises
    SceneError, also if the caller tries to replace more.
    """
    if isinstance(source, Scene):
        if parameters:
            raise SceneError(NO_PARAMETERS)
        return source.compile(size, max_depth, sampler, view, keep_uvs)
    if not isinstance(source, CompiledScene):
        description = load_description(source, parameters, allow_outside, view, size)
        return compile_scene(description, None, max_depth, sampler, keep_uvs)  # `load_description` has set the size
    if parameters or view or size or max_depth is not None:
        raise SceneError("a compiled scene has its size, depth, view and parameters already: give none")
    return replace(source, sampler=sampler or source.sampler)


def bvh_builder(source: SceneSource) -> Callable[[CompiledScene], Bvh]:
    """What builds the BVH of a scene that comes from `source`: a Scene keeps its own."""
    return source.build_bvh if isinstance(source, Scene) else build_scene_bvh


def source_name(source: SceneSource) -> str:
    """Name of a scene in messages and file headers. Raises SceneError if it is none."""
    if isinstance(source, Scene):
        return source.name
    if isinstance(source, CompiledScene):
        return "a compiled scene"
    if isinstance(source, (str, os.PathLike)):
        return os.fspath(source)
    if isinstance(source, Mapping):
        return "a scene in Python"
    raise SceneError(f"scene = {source!r} is no scene: it has to be a file's path, a built-in scene's name, or a dict")
