"""Small pbrt files for tests."""

from pathlib import Path

from isonoise.scene.formats.pbrt.read import read
from isonoise.scene.formats.pbrt.support import SUPPORT
from isonoise.scene.formats.report import ImportReport

TRIANGLE = 'Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "integer indices" [0 1 2]\n'


def read_text(tmp_path: Path, text: str) -> tuple[dict, ImportReport]:
    """The scene dict and the report of a whole file."""
    path = tmp_path / "scene.pbrt"
    path.write_text(text, "utf-8")
    report = ImportReport(path.name, SUPPORT)
    return read(path, tmp_path.resolve(), report), report


def read_world(tmp_path: Path, world: str, options: str = "") -> tuple[dict, ImportReport]:
    """The same of a file with the given text before and after WorldBegin."""
    return read_text(tmp_path, f"{options}\nWorldBegin\n{world}\n")


def objects(scene: dict, type_: str) -> list[dict]:
    """The objects of a type in a scene dict."""
    return [value for value in scene.values() if isinstance(value, dict) and value["type"] == type_]


def only(scene: dict, type_: str) -> dict:
    """The only object of a type."""
    (found,) = objects(scene, type_)
    return found


def material(tmp_path: Path, text: str, before: str = "") -> tuple[dict, ImportReport]:
    """The BSDF of a triangle under the given directive."""
    scene, report = read_world(tmp_path, f"{before}\n{text}\n{TRIANGLE}")
    return only(scene, "mesh")["bsdf"], report
