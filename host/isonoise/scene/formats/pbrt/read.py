"""Reads a pbrt file as a scene. Called by `formats/registry.py`."""

from pathlib import Path

from isonoise.errors import SceneError
from isonoise.scene.formats.report import ImportReport


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError where it is invalid."""
    raise SceneError(f"{path}: pbrt files are not read yet")
