"""Loads and compiles a scene in one call, for `Renderer`; a scene that is compiled already stays as it is."""

import os
from collections.abc import Mapping
from dataclasses import replace

from isonoise.errors import SceneError
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load
from isonoise.scene.view import View


def load_compiled(
    source: str | os.PathLike | Mapping | CompiledScene,
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: View | None = None,
    size: tuple[int, int] | None = None,
    max_depth: int | None = None,
    sampler: str | None = None,
) -> CompiledScene:
    """`compile_scene` of what `load` returns.

    Of a CompiledScene only the sampler can be replaced. Raises SceneError, also if the caller tries to replace more.
    """
    if not isinstance(source, CompiledScene):
        return compile_scene(load(source, parameters, allow_outside, view, size), size, max_depth, sampler)
    if parameters or view or size or max_depth is not None:
        raise SceneError("a compiled scene has its size, depth, view and parameters already: give none")
    return replace(source, sampler=sampler or source.sampler)


def source_name(source: str | os.PathLike | Mapping | CompiledScene) -> str:
    """Name of a scene in messages and file headers."""
    if isinstance(source, CompiledScene):
        return "a compiled scene"
    return "a scene in Python" if isinstance(source, Mapping) else os.fspath(source)
