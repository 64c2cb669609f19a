"""Reads a pbrt file as a scene. Called by `formats/registry.py`.

`directives.py` parses the text, `scene_builder.py` runs the directives; the other modules map what they define.
"""

from pathlib import Path

from isonoise.errors import SceneError
from isonoise.scene.formats.pbrt.directives import read_directives
from isonoise.scene.formats.pbrt.scene_builder import SceneBuilder
from isonoise.scene.formats.report import ImportReport


def read(path: Path, folder: Path | None, report: ImportReport) -> dict:
    """The scene dict of a file. Raises SceneError with file, line and column where it is invalid."""
    builder = SceneBuilder(path.parent, folder, report)
    first = None
    for directive in read_directives(path, folder):
        if first is None:
            first = directive
            builder.start(first)
        builder.run(directive)
    if first is None or not builder.is_complete:
        raise SceneError(f"{path}: it has no WorldBegin, so it is no scene of its own; read the file that includes it")
    if builder.open_blocks:
        raise SceneError(f"{path}: not all blocks, such as AttributeBegin, have an end ({builder.open_blocks} too few)")
    return builder.finish()
