"""Compiles the scenes of a comparison with the settings of an experiment; called by `planning` and `run_inputs`."""

import os
from collections.abc import Mapping

from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.request import PLACEHOLDER, SceneRequest
from isonoise.errors import SceneError, UserError
from isonoise.scene import CompiledScene
from isonoise.scene.scene import load

OBJECT = "python:"
"""`SceneEntry.source` of a scene object begins with this; the object's name follows."""


def is_object(source: object) -> bool:
    """Whether a scene is an object of a Python program, not the name of a file or built-in scene."""
    return not isinstance(source, str | os.PathLike)


def compile_request(scene: SceneRequest, allow_outside: bool) -> CompiledScene:
    """The scene with its settings. Raises SceneError, which says where the scene is asked for."""
    try:
        return _compile(scene, allow_outside)
    except SceneError as error:
        raise SceneError(f"{scene.origin}: {error}" if scene.origin else str(error)) from error


def _compile(scene: SceneRequest, allow_outside: bool) -> CompiledScene:
    if isinstance(scene.source, CompiledScene):
        if scene.settings or scene.size or scene.max_depth is not None:
            raise SceneError("a compiled scene has its size, depth and parameters already: give none")
        return scene.source
    values = {name[1:]: value for name, value in scene.settings.items() if name.startswith(PLACEHOLDER)}
    loaded = load(scene.source, values or None, allow_outside=allow_outside, size=scene.size)  # copies a Scene
    paths = {path: value for path, value in scene.settings.items() if not path.startswith(PLACEHOLDER)}
    for path, value in paths.items():
        loaded[path] = value
    return loaded.compile(scene.size, scene.max_depth)


def compile_entry(entry: SceneEntry, objects: Mapping[str, object], allow_outside: bool) -> CompiledScene:
    """A scene of the plan; `objects` are the scene objects by their source. Raises SceneError or UserError."""
    source: object = entry.source
    if entry.source.startswith(OBJECT):
        if entry.source not in objects:
            raise UserError(
                f"the scene '{entry.name}' was an object of a Python program: resume the comparison there, by "
                "isonoise.compare with the same object"
            )
        source = objects[entry.source]
    return compile_request(SceneRequest(source, entry.settings, entry.size, entry.max_depth), allow_outside)
