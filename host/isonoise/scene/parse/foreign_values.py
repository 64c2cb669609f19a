"""Values of other Python packages as numbers, arrays and images: Mitsuba 3, Dr.Jit, trimesh, numpy.

They are recognised by the names of their types and of their packages, which are not imported. Called by `dict_reader`.
"""

import sys
from collections.abc import Mapping

import numpy as np

from isonoise.scene.image.image import Image
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.spectra import srgb_to_linear


def plain_value(value: object, location: SourceLocation) -> object:
    """Numbers, tuples, arrays and images stay or become that; other objects stay as they are."""
    package = type(value).__module__.split(".")[0]
    if package in ("mitsuba", "drjit"):
        return _from_mitsuba(value, location)
    if isinstance(value, Image):
        return value
    try:
        return _plain(np.asarray(value), value)
    except (TypeError, ValueError):
        return value  # rejected when the parameter's type is checked


def _from_mitsuba(value: object, location: SourceLocation) -> object:
    name = type(value).__name__
    if "Transform" in name:
        matrix = np.asarray(value.matrix, np.float64)
        if matrix.ndim == 3 and matrix.shape[2] != 1:
            location.raise_error(f"a transform is one matrix, got {matrix.shape[2]} of them")
        return _of_space(matrix.reshape(matrix.shape[:2]))
    if name == "Bitmap":
        return _image(np.array(value), value.srgb_gamma())
    if name == "VolumeGrid":
        return np.array(value)
    if hasattr(value, "class_name"):
        location.raise_error(
            f"Mitsuba has loaded this {name} already, and isonoise cannot read it; give the dict that it was made of"
        )
    array = np.asarray(value)
    if name.startswith("Tensor"):
        return array
    if array.ndim > 1 and array.shape[-1] == 1:
        array = array[..., 0]
    if "Color" in name or "Spectrum" in name:
        return {"type": "rgb", "value": array.ravel().tolist()}
    return _plain(array, value, single=True)


def _of_space(matrix: np.ndarray) -> np.ndarray:
    """The (4, 4) matrix of a transform; one of the plane, (3, 3), keeps z."""
    if matrix.shape != (3, 3):
        return matrix
    result = np.eye(4)
    result[np.ix_((0, 1, 3), (0, 1, 3))] = matrix
    return result


def _plain(array: np.ndarray, value: object, single: bool = False) -> object:
    """A number, a tuple of numbers or an array; `single`: an array of one number is that number."""
    if array.dtype.kind not in "biuf":
        return value
    if array.ndim == 0 or (single and array.shape == (1,)):
        return array.item()
    return tuple(array.tolist()) if array.ndim == 1 else array


def _image(pixels: np.ndarray, is_encoded: bool) -> Image:
    """The image of a Mitsuba Bitmap. `is_encoded`: its values are sRGB, not linear."""
    image = array_image(pixels)
    if image.pixels.dtype == np.float32:
        return Image(srgb_to_linear(image.pixels).astype(np.float32)) if is_encoded else image
    return image if is_encoded else Image((image.pixels / np.iinfo(image.pixels.dtype).max).astype(np.float32))


def array_image(array: np.ndarray) -> Image | None:
    """The image of an array (h, w) or (h, w, c). Bytes and 16-bit numbers are sRGB, floats linear; alpha is dropped."""
    pixels = array[..., np.newaxis] if array.ndim == 2 else array
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 2, 3, 4) or not pixels.size:
        return None
    pixels = pixels[..., : 1 if pixels.shape[2] < 3 else 3]
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32)
    return Image(np.ascontiguousarray(pixels)) if pixels.dtype in (np.uint8, np.uint16, np.float32) else None


def is_trimesh(value: object) -> bool:
    """Whether a value is a mesh of the package trimesh."""
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(value, trimesh.Trimesh)


def trimesh_arrays(mesh) -> dict[str, np.ndarray]:
    """The parameters of a shape of type `mesh` with what a trimesh.Trimesh has; v = 0 is the top row of an image."""
    arrays = {"vertices": np.asarray(mesh.vertices), "faces": np.asarray(mesh.faces)}
    uv = getattr(mesh.visual, "uv", None)
    if uv is not None and len(uv) == len(mesh.vertices):
        arrays["texcoords"] = np.asarray(uv) * (1, -1) + (0, 1)
    return arrays


def with_mesh(source: Mapping, location: SourceLocation) -> Mapping:
    """A dict of type `mesh` whose `mesh` is a trimesh.Trimesh, with the arrays of it instead."""
    if not is_trimesh(source["mesh"]):
        location.raise_error(f"'mesh' has to be a trimesh.Trimesh, got {type(source['mesh']).__name__}")
    arrays = trimesh_arrays(source["mesh"])
    given = sorted(arrays.keys() & source.keys())
    if given:
        location.raise_error(f"give 'mesh' or '{given[0]}', not both")
    return {name: value for name, value in source.items() if name != "mesh"} | arrays
