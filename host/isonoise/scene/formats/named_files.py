"""Finds the files that OBJ, MTL and PLY files name. Called by the readers of these formats."""

from pathlib import Path

from isonoise.errors import SceneError
from isonoise.scene.files import is_inside, outside_message
from isonoise.scene.parse.elements import path_exists


def find_file(source: Path, name: str, folder: Path | None) -> Path | None:
    """The file that `source` names, or one of that name beside it; None if there is neither.

    Names may have backslashes and another case, as from Windows. Raises SceneError if the only files of this name are
    outside `folder`.
    """
    relative = Path(name.strip().strip('"').replace("\\", "/"))
    places = [source.parent / relative, source.parent / relative.name]
    candidates = [place for place in places if _is_file(place)]
    candidates = candidates or [file for place in places if (file := _find_in_any_case(place))]
    found = next((file for file in candidates if is_inside(file, folder)), None)
    if candidates and not found:
        raise SceneError(f"{source}: {outside_message(candidates[0], folder)}")
    return found


def _is_file(path: Path) -> bool:
    try:
        return path_exists(path) and not path.is_dir()
    except (OSError, ValueError):
        return False


def _find_in_any_case(path: Path) -> Path | None:
    """A file whose name differs from the given one only in the case of letters."""
    try:
        names = sorted(entry.name for entry in path.parent.iterdir() if entry.name.lower() == path.name.lower())
    except (OSError, ValueError):
        return None
    return next((path.parent / name for name in names if _is_file(path.parent / name)), None)
