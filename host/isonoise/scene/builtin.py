"""Scenes that come with isonoise, by name."""

import os
from importlib.resources import files
from pathlib import Path

from isonoise.errors import SceneError
from isonoise.scene.source import nearest


def builtin_scenes() -> list[str]:
    """Names of the built-in scenes, sorted."""
    return sorted(entry.name[:-4] for entry in files("isonoise.scenes").iterdir() if entry.name.endswith(".xml"))


def find_scene(source: str | os.PathLike) -> Path:
    """The file that a path or the name of a built-in scene stands for. Raises SceneError if there is none."""
    path = Path(source)
    names = builtin_scenes()
    if str(source) in names and not path.is_file():
        return Path(str(files("isonoise.scenes").joinpath(f"{source}.xml")))
    if path.is_file():
        return path.absolute()
    if path.is_dir():
        raise SceneError(f"{path}: is a folder; name a scene file in it")
    listed = ", ".join(names) or "none"
    hint = nearest(str(source), names)
    suggestion = f"; did you mean '{hint}'?" if hint and not path.suffix else ""
    raise SceneError(f"{source}: there is no such file or built-in scene{suggestion} (built-in: {listed})")
