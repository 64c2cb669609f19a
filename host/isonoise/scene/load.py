"""From what the user names to the normalised scene description."""

import gc
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from isonoise.errors import SceneError
from isonoise.scene.builtin import find_scene
from isonoise.scene.camera import check_size
from isonoise.scene.files import scene_folder
from isonoise.scene.parse.dict_reader import read_dict
from isonoise.scene.parse.elements import Element
from isonoise.scene.parse.validate import SceneNormaliser
from isonoise.scene.parse.xml_reader import read_xml
from isonoise.scene.view import NO_VIEW, View, apply_view, sensors_of

if TYPE_CHECKING:
    import numpy as np

    from isonoise.scene.formats.registry import Format
    from isonoise.scene.formats.report import ImportReport


@dataclass(frozen=True)
class LoadedScene:
    """What `load_scene` returns."""

    description: dict  # as of `load_description`
    report: "ImportReport | None"  # of a file in another format than Mitsuba 3's; None for those
    element_by_id: dict[str, Element]  # of all objects of the file that have an id
    cameras: tuple[str, ...] = ()  # names of all cameras of the file; the description has one of them
    format: str = "Mitsuba 3"
    added: tuple[str, ...] = ()  # what a model got that its file lacks, for people
    model_bounds: "np.ndarray | None" = None  # (2, 3): of a model, without what it got

    @cached_property
    def ids(self) -> dict[int, str]:
        """The ids of the file's objects, by id() of their dicts in the description."""
        return {id(element.normalised): name for name, element in self.element_by_id.items() if element.normalised}

    def warn(self) -> None:
        """Warn of what the description lacks of the file."""
        for text in self.report.warnings() if self.report else ():
            warnings.warn(text, stacklevel=3)


def load_description(
    source: str | os.PathLike | Mapping,
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: View | None = None,
    size: tuple[int, int] | None = None,
) -> dict:
    """The normalised description of a scene, as plain dicts. Parameters, warnings and errors are those of `load`.

    It is in Mitsuba 3's vocabulary: defaults are filled in, references resolved, transforms (4, 4) float64, file names
    absolute.
    """
    scene = load_scene(source, parameters, allow_outside, view, size)
    scene.warn()
    return scene.description


def load_scene(
    source: str | os.PathLike | Mapping,
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: View | None = None,
    size: tuple[int, int] | None = None,
) -> LoadedScene:
    """A scene, with the report of what it has lost. The parameters are those of `load`; there are no warnings."""
    if size is not None:
        check_size(size)
    parameters, view = {name: str(value) for name, value in (parameters or {}).items()}, view or NO_VIEW
    if isinstance(source, Mapping):
        if parameters:
            raise SceneError("parameters belong to XML scenes; change the dict itself")
        return _with_view(_normalise_dict(source), view, size)
    path = find_scene(source)
    folder = scene_folder(path, allow_outside)
    if path.suffix.lower() != ".xml":
        from isonoise.scene.formats.registry import find_format

        if format_ := find_format(path):
            if parameters:
                raise SceneError(f"{path}: parameters belong to Mitsuba's XML scenes, this is {format_.title}")
            return _import_scene(path, format_, folder, view, size)
        from isonoise.scene.other_files import refuse_other_files

        refuse_other_files(path)
    scene = SceneNormaliser()
    with _paused_garbage_collection():
        description = scene.finish(read_xml(path, parameters, folder, scene.add))
    return _with_view(LoadedScene(description, None, scene.element_by_id), view, size)


def _with_view(scene: LoadedScene, view: View, size: tuple[int, int] | None) -> LoadedScene:
    cameras = tuple(sensors_of(scene.description))
    return replace(scene, description=apply_view(scene.description, view, size), cameras=cameras)


def _import_scene(
    path: Path, format_: "Format", folder: Path | None, view: View, size: tuple[int, int] | None
) -> LoadedScene:
    """The scene of a file in another format, completed if it is a model."""
    from isonoise.scene.formats.registry import read_scene

    scene, report = read_scene(path, format_, folder)
    if not format_.is_model:
        return replace(_with_view(_normalise_dict(scene, report), view, size), format=format_.title)
    from isonoise.scene.formats.staging import stage

    staged, cameras = stage(scene, str(path), view, size, format_.up), tuple(sensors_of(scene))
    loaded = _normalise_dict(staged.scene, report)
    if view.crop is not None:
        loaded = replace(loaded, description=apply_view(loaded.description, View(crop=view.crop), None))
    return replace(loaded, cameras=cameras, format=format_.title, added=tuple(staged.added), model_bounds=staged.bounds)


def _normalise_dict(source: Mapping, report: "ImportReport | None" = None) -> LoadedScene:
    scene, root = SceneNormaliser(), read_dict(source)
    for entry in root.entries:
        scene.add(*entry)
    return LoadedScene(scene.finish(root), report, scene.element_by_id)


@contextmanager
def _paused_garbage_collection() -> Iterator[None]:
    """Objects of a scene hold no cycles: to look for some takes a third of the time of reading a million shapes."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
