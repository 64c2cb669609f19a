"""Converts a scene to Mitsuba 3 XML. Called by `commands/convert.py`."""

import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from isonoise import __version__
from isonoise.convert.scaling import SCALING_REASON, scale_up
from isonoise.convert.scene_files import SceneFiles
from isonoise.convert.xml_writer import write_scene
from isonoise.errors import UserError
from isonoise.film.files import check_no_input, check_writable, write_atomically
from isonoise.scene.files import record_files
from isonoise.scene.load import load_scene

if TYPE_CHECKING:
    from isonoise.scene.formats.report import ImportReport
    from isonoise.scene.view import View

_FOLDER_SUFFIX = "_files"


@dataclass(frozen=True)
class ConvertedScene:
    """What `convert` has written."""

    files: list[Path]  # meshes and images, in the folder beside the XML file
    scale: float  # factor on lengths
    report: "ImportReport | None"  # of a scene in another format than Mitsuba 3's


def convert(
    source: str | os.PathLike | Mapping,
    output: str | os.PathLike,
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: "View | None" = None,
    size: tuple[int, int] | None = None,
) -> ConvertedScene:
    """Write a scene as a Mitsuba 3 XML file, and its meshes and images to the folder `NAME_files` beside it.

    All files are complete before the first one appears at its place. Existing files with the same names are replaced.
    Small scenes of other formats than Mitsuba's are scaled up: see `scaling.py`.

    Parameters
    ----------
    source, parameters, allow_outside, view
        As of `load`.
    size : (width, height) or None
        Image size in pixels in place of the scene's.
    output : path
        The XML file.

    Returns
    -------
    ConvertedScene
        What was written, the factor on lengths, and what the source lost.

    Raises
    ------
    SceneError
        If the scene cannot be read.
    UserError
        If a file cannot be written or would replace a file of the scene.
    """
    if Path(output).suffix.lower() != ".xml":
        raise UserError(f"cannot write '{output}': the output is Mitsuba 3 XML; give it a name that ends in .xml")
    path = check_writable(output)
    folder = path.with_name(path.stem + _FOLDER_SUFFIX)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"cannot write the folder '{folder}': a file has this name")
    with record_files() as inputs, _temporary_folder(path.parent) as temporary:
        scene = load_scene(source, parameters, allow_outside, view, size)
        files = SceneFiles(temporary, folder.name)
        description, ids, scale = scene.description, dict(scene.ids), 1.0
        if scene.report:
            description, scale = scale_up(description, ids)
        comment = _comment(source, scene.report, scale)

        def write(temporary_file: Path) -> None:
            with open(temporary_file, "w", encoding="utf-8") as text:
                write_scene(text, description, files, ids, comment)
            check_no_input([path, *(folder / name for name in files.names)], inputs)
            _move_files(temporary, folder)

        write_atomically(path, write)
    return ConvertedScene([folder / name for name in files.names], scale, scene.report)


def _comment(source: str | os.PathLike | Mapping, report: "ImportReport | None", scale: float) -> list[str]:
    """Lines about the origin of a scene, and about what it has lost."""
    name = "a dict" if isinstance(source, Mapping) else Path(source).name
    lines = [f"Converted by isonoise {__version__} from {name}"]
    if scale != 1:
        lines.append(f"Lengths are those of the source times {scale:g}: {SCALING_REASON}")
    losses = report.loss_texts() if report else []
    return lines + ["Not converted exactly:"] * bool(losses) + [f"  {text}" for text in losses]


@contextmanager
def _temporary_folder(parent: Path) -> Iterator[Path]:
    """A new folder, which is removed at the end unless it has been renamed."""
    folder = parent / f".{secrets.token_hex(6)}.tmp"
    try:
        folder.mkdir()
        yield folder
    except OSError as error:
        raise UserError(f"cannot write to '{parent}': {error.strerror or error}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _move_files(source: Path, target: Path) -> None:
    """Move the files of a folder to another one, which may exist. Nothing is made for an empty folder."""
    names = sorted(os.listdir(source))
    if names and not target.exists():
        os.rename(source, target)
        return
    for name in names:
        os.replace(source / name, target / name)
