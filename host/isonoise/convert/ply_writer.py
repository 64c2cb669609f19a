"""Encodes a mesh of the scene description as binary PLY with 32-bit floats. Called by `scene_files.py`."""

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.mesh.ply_attributes import find_attributes
from isonoise.scene.mesh.surfaces import make_surfaces

_MAX_DISTANCE = 2.0**4
"""Distance from the origin, in sizes of the mesh, up to which its vertices stay where they are: 32-bit floats then
round them to 2^-20 of its size."""
_MAX_VERTICES = 1 << 31  # indices are 32-bit integers


def mesh_center(vertices: np.ndarray) -> np.ndarray:
    """What to subtract from the vertices so that 32-bit floats resolve them: zeros if they do so already."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    is_near = np.abs(vertices).max() <= _MAX_DISTANCE * (high - low).max()
    return np.zeros(3) if is_near or (vertices == vertices.astype(np.float32)).all() else 0.5 * (low + high)


def encode_ply(shape: dict, center: np.ndarray) -> bytes:
    """The PLY file of a shape of type `mesh`, with its vertices relative to `center`.

    Mitsuba 3 and isonoise read the same attributes from it. Raises SceneError if it cannot hold them.
    """
    vertices, faces = shape["vertices"], shape["faces"]
    if len(vertices) >= _MAX_VERTICES:
        raise SceneError(f"a mesh with {len(vertices):,} vertices is too large for PLY; split it")
    columns = dict(zip("xyz", (vertices - center).T, strict=True))
    if "normals" in shape:
        columns |= zip(("nx", "ny", "nz"), _complete_normals(shape).T, strict=True)
    if "texcoords" in shape:
        columns |= zip("uv", shape["texcoords"].T, strict=True)
    columns |= _attribute_columns(shape, "vertex")
    vertex_records = np.empty(len(vertices), [(name, "<f4") for name in columns])
    _fill(vertex_records, columns)
    face_columns = _attribute_columns(shape, "face")
    layout = [("corners", "u1"), ("indices", "<i4", 3), *((name, "<f4") for name in face_columns)]
    face_records = np.empty(len(faces), layout)
    _fill(face_records, {"corners": 3, "indices": faces, **face_columns})
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in columns),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *(f"property float {name}" for name in face_columns),
        "end_header\n",
    ]
    return b"".join(["\n".join(header).encode(), vertex_records.tobytes(), face_records.tobytes()])


def _fill(records: np.ndarray, columns: dict) -> None:
    for name, values in columns.items():
        records[name] = values


def _complete_normals(shape: dict) -> np.ndarray:
    """The normals of a mesh. Vertices without one get what `make_surfaces` computes, because Mitsuba computes none."""
    normals = shape["normals"]
    is_missing = ~normals.any(axis=1)
    if is_missing.any() and not shape["face_normals"]:
        (surface,) = make_surfaces([shape | {"flip_normals": False}], 0, str)
        linear = shape.get("to_world", np.eye(4))[:3, :3]
        normals = np.where(is_missing[:, None], surface.normals[0] @ linear, normals)  # see `transform_normals`
    return normals


def _attribute_columns(shape: dict, element: str) -> dict[str, np.ndarray]:
    """The attributes of an element, 'vertex' or 'face', by names of PLY properties."""
    attributes = {k: v for k, v in shape.get("attributes", {}).items() if k.startswith(f"{element}_")}
    columns = {}
    for name, values in attributes.items():
        base = name.removeprefix(f"{element}_")
        letters = "rgb" if base.endswith("_color") else "xyz"
        names = [f"{base.removesuffix('_color')}_{letter}" for letter in letters]
        if base == "color" and values.shape[1] == 3:
            names = ["r", "g", "b"]
        columns |= zip(names[: values.shape[1]], values.T, strict=True)
    if set(find_attributes(list(columns), element)) != set(attributes):
        raise SceneError(f"PLY cannot hold the mesh attributes {', '.join(attributes)} together; rename them")
    return columns
