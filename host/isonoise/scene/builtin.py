"""The built-in scenes, and the lookup of a scene file by path or built-in name."""

import os
from importlib.resources import files
from pathlib import Path

from isonoise.errors import SceneError
from isonoise.scene.parse.elements import did_you_mean


def builtin_scenes() -> list[str]:
    """Names of the built-in scenes, sorted."""
    return sorted(entry.name[:-4] for entry in files("isonoise.scenes").iterdir() if entry.name.endswith(".xml"))


def find_scene(source: str | os.PathLike) -> Path:
    """The path of a scene file, given its path or a built-in scene's name. Raises SceneError if there is none."""
    name, names = str(source), builtin_scenes()
    path = Path(name)
    try:
        is_file, is_folder, exists = path.is_file(), path.is_dir(), path.exists()
    except (OSError, ValueError):  # not a valid file name
        is_file = is_folder = exists = False
    if is_file:
        return path.absolute()
    if name in names:
        return Path(str(files("isonoise.scenes").joinpath(f"{name}.xml")))
    if is_folder:
        raise SceneError(f"{name} is a folder; give the path of a scene file in it")
    if exists:
        raise SceneError(f"{name} is not a regular file")
    suggestion = "" if path.suffix else did_you_mean(name, names)
    raise SceneError(
        f"{name[:200]}: no such file or built-in scene{suggestion} (built-in: {', '.join(names) or 'none'})"
    )
