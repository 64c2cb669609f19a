"""The folder with the meshes and images of a converted scene. Called by `xml_writer.py`, made by `convert.py`."""

import hashlib
import re
import shutil
from pathlib import Path

import numpy as np

from isonoise.convert.image_writer import encode_png, write_float_exr
from isonoise.convert.ply_writer import encode_ply, mesh_center
from isonoise.errors import SceneError
from isonoise.scene import transforms
from isonoise.scene.files import open_regular_file
from isonoise.scene.image.image import Image
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.unique_names import UniqueNames
from isonoise.scene.volume.grid_file import VolumeGrid, check_grid, write_vol

_MAX_NAME_CHARS = 60


class SceneFiles:
    """Writes files to `folder`, each content once. Methods return file names relative to the XML file.

    Parameters
    ----------
    folder : Path
        Where they are written; it exists and is empty.
    prefix : str
        The folder's name beside the XML file, as it will be.
    """

    def __init__(self, folder: Path, prefix: str):
        self.folder, self.prefix = folder, prefix
        self.names: list[str] = []
        self._unique_names = UniqueNames(ignore_case=True)
        self._name_of_source: dict[Path, str] = {}
        self._name_of_content: dict[bytes, str] = {}
        self._image_names: dict[int, tuple[Image, str]] = {}  # by id(), with the image, so that it stays alive

    def mesh(self, shape: dict, name: str) -> dict:
        """A shape of type `ply` with the file of a shape of type `mesh`."""
        center = mesh_center(shape["vertices"])
        arrays = ("vertices", "faces", "normals", "texcoords", "attributes")
        result = {key: value for key, value in shape.items() if key not in arrays}
        if center.any():
            result["to_world"] = shape.get("to_world", np.eye(4)) @ transforms.translate(center)
        return result | {"type": "ply", "filename": self._content(encode_ply(shape, center), name, ".ply")}

    def image(self, image: Image, name: str) -> str:
        """The file of an image in memory."""
        if id(image) not in self._image_names:
            if image.pixels.dtype == np.float32:
                file = self._new_name(name, ".exr")
                write_float_exr(self.folder / file, image.pixels)
                file = f"{self.prefix}/{file}"
            else:
                file = self._content(encode_png(image.pixels), name, ".png")
            self._image_names[id(image)] = image, file
        return self._image_names[id(image)][1]

    def grid(self, grid: VolumeGrid | np.ndarray, name: str) -> str:
        """The file of a grid in memory."""
        if isinstance(grid, np.ndarray):
            grid = VolumeGrid(check_grid(grid, SourceLocation(element=name)))
        file = self._new_name(name, ".vol")
        write_vol(self.folder / file, grid)
        return f"{self.prefix}/{file}"

    def copy(self, path: str) -> str:
        """A copy of a file that the scene names."""
        source = Path(path).resolve()
        if source not in self._name_of_source:
            name = self._new_name(source.stem, source.suffix)
            try:
                with open_regular_file(source) as file, open(self.folder / name, "xb") as copy:
                    shutil.copyfileobj(file, copy)
            except OSError as error:
                raise SceneError(f"{path}: cannot be copied ({error.strerror})") from None
            self._name_of_source[source] = f"{self.prefix}/{name}"
        return self._name_of_source[source]

    def _content(self, data: bytes, name: str, suffix: str) -> str:
        digest = hashlib.blake2b(data, digest_size=16).digest()
        if digest not in self._name_of_content:
            file = self._new_name(name, suffix)
            (self.folder / file).write_bytes(data)
            self._name_of_content[digest] = f"{self.prefix}/{file}"
        return self._name_of_content[digest]

    def _new_name(self, name: str, suffix: str) -> str:
        """An unused file name that every file system accepts."""
        unused = self._unique_names.add(plain_name(name)[:_MAX_NAME_CHARS], suffix)
        self.names.append(unused)
        return unused


def plain_name(text: str) -> str:
    """A name of letters, digits, '_' and '-', as ids of Mitsuba 3 and names of files can be."""
    return re.sub(r"[^\w-]+", "_", text, flags=re.ASCII).strip("_") or "unnamed"
