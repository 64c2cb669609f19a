"""Builds small glTF files in memory for tests, and reads them."""

import base64
import json
import struct
from pathlib import Path

import numpy as np

from isonoise.scene.formats.registry import find_format, read_scene
from isonoise.scene.formats.report import ImportReport

_CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "f4")
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "f4")


class Gltf:
    """A file whose JSON objects are the dict `content`. Methods add objects and return their indices."""

    def __init__(self, **content):
        self.content = {"asset": {"version": "2.0"}, **content}
        self.data = bytearray()

    def add(self, kind: str, **values) -> int:
        table = self.content.setdefault(kind, [])
        table.append(values)
        return len(table) - 1

    def view(self, data: bytes, **values) -> int:
        self.data += bytes(-len(self.data) % 4)
        offset = len(self.data)
        self.data += data
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **values)

    def accessor(self, array: np.ndarray, **values) -> int:
        """An accessor of the rows of an array, in its own type."""
        array = np.asarray(array)
        rows = array.reshape(len(array), -1)
        dtype = array.dtype.newbyteorder("<")
        described = {"componentType": _CODES[dtype.str[1:]], "count": len(rows), "type": _TYPES[rows.shape[1]]}
        return self.add("accessors", bufferView=self.view(rows.astype(dtype).tobytes()), **described | values)

    def mesh(self, positions=TRIANGLE, indices=None, **primitive) -> int:
        """A mesh of one primitive. Arrays among the attributes become accessors."""
        attributes = {"POSITION": positions, **primitive.pop("attributes", {})}
        accessors = {name: self.accessor(v) if isinstance(v, np.ndarray) else v for name, v in attributes.items()}
        if indices is not None:
            primitive["indices"] = self.accessor(np.asarray(indices, "u2"))
        return self.add("meshes", primitives=[{"attributes": accessors, **primitive}])

    def node(self, **values) -> int:
        return self.add("nodes", **values)

    def _json(self, uri: str | None) -> bytes:
        buffer = {"byteLength": len(self.data)} | ({"uri": uri} if uri else {})
        return json.dumps(self.content | ({"buffers": [buffer]} if self.data else {})).encode()

    def glb(self) -> bytes:
        text = self._json(None)
        return pack_glb(text + b" " * (-len(text) % 4), bytes(self.data))

    def gltf(self) -> bytes:
        """A text file with its buffer in a data URI."""
        return self._json("data:application/octet-stream;base64," + base64.b64encode(self.data).decode())

    def write(self, folder: Path, name: str = "a.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb() if name.endswith(".glb") else self.gltf())
        return path


def pack_glb(text: bytes, data: bytes | None, version: int = 2) -> bytes:
    """A GLB file of JSON and a binary chunk."""
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if data is not None:
        data += bytes(-len(data) % 4)
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", version, 12 + len(chunks)) + chunks


def read(path) -> tuple[dict, ImportReport]:
    return read_scene(path, find_format(path), path.parent.resolve())


def read_file(file: Gltf, folder) -> tuple[dict, ImportReport]:
    return read(file.write(folder))


def shapes_of(scene: dict, kind: str = "mesh") -> list[dict]:
    return [one for one in scene.values() if isinstance(one, dict) and one["type"] == kind]


def only_mesh(file: Gltf, folder) -> dict:
    scene, report = read_file(file, folder)
    assert report.warnings() == []
    (mesh,) = shapes_of(scene)
    return mesh


def corners_of(mesh: dict) -> np.ndarray:
    return mesh["vertices"][mesh["faces"]]


def one_mesh(**primitive) -> Gltf:
    file = Gltf()
    file.node(mesh=file.mesh(**primitive))
    return file


def rich_file() -> Gltf:
    """A file with one of everything that the reader knows, for damaged inputs."""
    file = Gltf(scene=0, scenes=[{"nodes": [0, 6]}], extensionsUsed=["KHR_lights_punctual", "EXT_mesh_gpu_instancing"])
    normals, uvs = np.tile(np.array([[0, 0, 1]], "i1"), (4, 1)), np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "f4")
    colours = np.array([[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 0], [9, 9, 9, 9]], "u1")
    material = file.add("materials", pbrMetallicRoughness={"baseColorFactor": [0.5, 0.2, 0.1, 1]})
    lamp = file.add("materials", emissiveFactor=[1, 0.5, 0])
    attributes = {
        "NORMAL": file.accessor(normals, normalized=True),
        "TEXCOORD_0": uvs,
        "COLOR_0": file.accessor(colours, normalized=True),
    }
    plain = file.mesh(QUAD, [0, 1, 2, 0, 2, 3], attributes=attributes, material=material)
    strip = file.mesh(QUAD[[0, 1, 3, 2]], mode=5, material=lamp)
    file.content["meshes"][strip] |= {"weights": [0.5]}
    places = {"bufferView": file.view(struct.pack("<2H", 1, 3)), "componentType": 5123}
    values = {"bufferView": file.view(struct.pack("<6f", 0, 0, 1, 0, 0, 2))}
    sparse = {"count": 2, "indices": places, "values": values}
    target = file.add("accessors", componentType=5126, type="VEC3", count=4, sparse=sparse)
    file.content["meshes"][strip]["primitives"][0]["targets"] = [{"POSITION": target}]
    skin_attributes = {
        "JOINTS_0": np.array([[0, 1, 0, 0]] * 4, "u1"),
        "WEIGHTS_0": np.array([[0.5, 0.5, 0, 0]] * 4, "f4"),
    }
    skinned = file.mesh(QUAD, [0, 1, 2, 0, 2, 3], attributes=skin_attributes)
    inverse = file.accessor(np.tile(np.eye(4, dtype="f4").ravel(), (2, 1)))
    file.add("skins", joints=[0, 1], inverseBindMatrices=inverse)
    offsets = file.accessor(np.array([[0, 0, 0], [3, 0, 0]], "f4"))
    file.content["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 5, "spot": {"innerConeAngle": 0.1}}]}
    }
    file.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5})
    file.add("cameras", type="orthographic", orthographic={"xmag": 2, "ymag": 1, "znear": 0.1, "zfar": 10})
    file.node(children=[1, 2, 3], translation=[0, 1, 0], rotation=[0, 0.6, 0, 0.8], scale=[1, -2, 1])
    file.node(mesh=plain, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1])
    file.node(mesh=strip, camera=0, weights=[0.25], name="b")
    file.node(children=[4, 5])
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": offsets}}}
    file.node(mesh=plain, extensions=instancing)
    file.node(mesh=skinned, skin=0)
    file.node(camera=1, extensions={"KHR_lights_punctual": {"light": 0}})
    return file
