"""The formats that isonoise reads besides Mitsuba 3 XML, found by the suffix of a file."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from isonoise.scene.formats.report import ImportReport
from isonoise.scene.formats.support import Support


@dataclass(frozen=True)
class Format:
    """A format. Its package has `read.read(path, folder, report) -> dict` and `support.SUPPORT`."""

    title: str
    suffixes: tuple[str, ...]
    package: str
    is_model: bool = True  # what a file lacks (camera, lights) is added
    up: tuple[float, float, float] = (0, 1, 0)  # of a model

    @property
    def support(self) -> Mapping[str, Support]:
        """How far each feature of the format is supported; features that the format does not have are absent."""
        return import_module(f"isonoise.scene.formats.{self.package}.support").SUPPORT


FORMATS = (
    Format("glTF 2.0", (".glb", ".gltf"), "gltf"),
    Format("OBJ and MTL", (".obj",), "obj"),
    Format("PLY", (".ply",), "ply"),
    Format("STL", (".stl",), "stl", up=(0, 0, 1)),
    Format("pbrt", (".pbrt",), "pbrt", is_model=False),
)


def find_format(path: Path) -> Format | None:
    """The format of a file by its suffix; None for Mitsuba 3 XML and anything else."""
    suffix = path.suffix.lower()
    return next((format_ for format_ in FORMATS if suffix in format_.suffixes), None)


def read_scene(path: Path, format_: Format, folder: Path | None) -> tuple[dict, ImportReport]:
    """Read a file of a format.

    Parameters
    ----------
    path : the file
    format_ : what `find_format` returned for it
    folder : files that it names have to be inside; None: they may be anywhere

    Returns
    -------
    tuple of dict and ImportReport
        A scene dict for `read_dict`, in which a camera, lights or an integrator may be missing, and what of the file is
        in it.

    Raises
    ------
    SceneError
        The file is invalid, or cannot be read.
    """
    report = ImportReport(path.name, format_.support)
    reader = import_module(f"isonoise.scene.formats.{format_.package}.read")
    return reader.read(path, folder, report), report
