"""Public entry `isonoise.load`: turns a file, a built-in scene's name or a dict into a normalised scene description."""

import os
from collections.abc import Mapping

from isonoise.errors import SceneError
from isonoise.scene.builtin import find_scene
from isonoise.scene.parse.dict_reader import read_dict
from isonoise.scene.parse.validate import normalise
from isonoise.scene.parse.xml_reader import read_xml

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb")


def load(source: str | os.PathLike | Mapping, parameters: dict[str, str] | None = None) -> dict:
    """Load a scene and check it.

    Parameters
    ----------
    source
        A Mitsuba 3 XML file, a mesh (OBJ, PLY, STL, GLB), the name of a built-in scene, or a dict in the vocabulary of
        Mitsuba 3's ``load_dict``. A mesh gets a camera, and a light if it has none.
    parameters
        Values that replace ``$name`` in an XML scene.

    Returns
    -------
    dict
        The scene description in Mitsuba 3's vocabulary. Defaults are filled in, and a reference is replaced by the
        object it refers to. Transforms are float64 arrays of shape (4, 4), file names are absolute.

    Raises
    ------
    SceneError
        If the scene cannot be read, or uses something that isonoise does not support.
    """
    parameters = {name: str(value) for name, value in (parameters or {}).items()}
    if isinstance(source, Mapping):
        if parameters:
            raise SceneError("parameters apply to XML scenes only; change the values in the dict instead")
        return normalise(read_dict(source))
    path = find_scene(source)
    if path.suffix.lower() in MESH_SUFFIXES:
        from isonoise.scene.default_scene import default_scene

        if parameters:
            raise SceneError(f"{path}: parameters apply to XML scenes only, this is a mesh")
        return normalise(read_dict(default_scene(path)))
    return normalise(read_xml(path, parameters))
