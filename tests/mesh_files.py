"""Writes meshes as OBJ, PLY and Mitsuba's serialized files. Used by random_shapes.py."""

import random
import struct
import zlib
from pathlib import Path

import numpy as np


def vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns unit normals of the points, averaged over the adjacent faces, across seams too."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    same = np.unique(np.round(points, 6), axis=0, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((same.max() + 1, 3))
    for i in range(3):
        np.add.at(sums, same[faces[:, i]], np.cross(b - a, c - a))
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return (sums / np.where(lengths > 0, lengths, 1))[same]


def obj_text(points, normals, uvs, faces, quads: bool) -> str:
    lines = ["v " + " ".join(f"{x:.6g}" for x in point) for point in points]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in (() if uvs is None else uvs)]
    lines += ["vn " + " ".join(f"{x:.6g}" for x in normal) for normal in (() if normals is None else normals)]
    # the first half of the triangles and the second pair up to the cells of the grid, where none is left out
    half = len(faces) // 2
    paired = quads and len(faces) % 2 == 0 and (faces[:half, 2] == faces[half:, 1]).all()
    polygons = np.column_stack([faces[:half], faces[half:, 2]]) if paired else faces
    for polygon in polygons + 1:
        corners = (f"{i}/{'' if uvs is None else i}/{'' if normals is None else i}".rstrip("/") for i in polygon)
        lines.append("f " + " ".join(corners))
    return "\n".join(lines) + "\n"


def write_ply(path: Path, points, normals, uvs, faces, attribute: str, values, binary: bool):
    columns = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
    if normals is not None:
        columns |= {"nx": normals[:, 0], "ny": normals[:, 1], "nz": normals[:, 2]}
    if uvs is not None:
        columns |= {"u": uvs[:, 0], "v": uvs[:, 1]}
    if attribute == "vertex_color":
        columns |= {"r": values[:, 0], "g": values[:, 1], "b": values[:, 2]}
    heat = attribute == "face_heat"
    head = ["ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0", f"element vertex {len(points)}"]
    head += [f"property float {name}" for name in columns]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head += ["property float heat_x"] if heat else []
    head += ["end_header", ""]
    if binary:
        vertices = np.stack(list(columns.values()), axis=1).astype("<f4").tobytes()
        record = np.zeros(len(faces), [("n", "u1"), ("i", "<i4", 3), *([("heat", "<f4")] if heat else [])])
        record["n"], record["i"] = 3, faces
        if heat:
            record["heat"] = values[:, 0]
        body = vertices + record.tobytes()
    else:
        lines = [" ".join(f"{x:.6g}" for x in row) for row in zip(*columns.values(), strict=True)]
        tails = [f" {x:.6g}" for x in values[:, 0]] if heat else [""] * len(faces)
        lines += [f"3 {a} {b} {c}{tail}" for (a, b, c), tail in zip(faces, tails, strict=True)]
        body = ("\n".join(lines) + "\n").encode()
    path.write_bytes("\n".join(head).encode() + body)


def write_serialized(path: Path, points, normals, uvs, faces, r: random.Random) -> int:
    """Writes a file of two meshes; returns the index of this one. The other is a single triangle."""
    double = r.random() < 0.5
    type_ = "<f8" if double else "<f4"

    def stream(points, normals, uvs, faces) -> bytes:
        flags = (0x2000 if double else 0x1000) | (0x1 if normals is not None else 0) | (0x2 if uvs is not None else 0)
        data = struct.pack("<I", flags) + b"mesh\0" + struct.pack("<QQ", len(points), len(faces))
        data += b"".join(np.asarray(a, type_).tobytes() for a in (points, normals, uvs) if a is not None)
        return struct.pack("<HH", 0x041C, 4) + zlib.compress(data + np.asarray(faces, "<u4").tobytes())

    index = r.randint(0, 1)
    other = np.eye(3), None, None, [[0, 1, 2]]
    meshes = [stream(*other), stream(*other)]
    meshes[index] = stream(points, normals, uvs, faces)
    table = struct.pack("<QQI", 0, len(meshes[0]), 2)
    path.write_bytes(meshes[0] + meshes[1] + table)
    return index
