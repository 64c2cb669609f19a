"""Scenes: reads files and dicts in Mitsuba 3's vocabulary and compiles them to flat arrays for the device."""

from isonoise.scene.builtin import builtin_scenes
from isonoise.scene.compile import compile_scene
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.load import load_description

__all__ = ["CompiledScene", "builtin_scenes", "compile_scene", "load_description"]
