"""A glTF file: its JSON objects and the bytes that it contains or names. Called by all modules of this package.

Format: Khronos Group, "glTF 2.0 Specification", version 2.0.1, sections 3 (JSON) and 4 (GLB).
"""

import base64
import binascii
import struct
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote_to_bytes

from isonoise.errors import SceneError
from isonoise.input_files import parse_json
from isonoise.scene.files import is_inside, outside_message, read_bytes
from isonoise.scene.formats.gltf.json_objects import JsonObject
from isonoise.scene.parse.elements import path_exists

_MAGIC, _JSON_CHUNK, _BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
_MAX_URI_CHARS = 1000  # of a file name
_KINDS = (
    *("accessors", "animations", "buffers", "bufferViews", "cameras", "images", "materials", "meshes", "nodes"),
    *("samplers", "scenes", "skins", "textures"),
)


class Document:
    """The content of a file. Methods raise SceneError for whatever is missing or out of range."""

    def __init__(self, path: Path, folder: Path | None):
        """Read the file. Files that it names have to be inside `folder`, unless that is None."""
        self.path, self.folder = path, folder
        data = read_bytes(path)
        self.size_bytes = len(data)  # of the file and of all buffers that were read
        text, self._binary_chunk = _split_glb(path, data) if data[:4] == _MAGIC else (data, None)
        try:
            content = parse_json(text.removeprefix(b"\xef\xbb\xbf"))
        except ValueError as error:
            raise SceneError(f"{path}: it is neither a GLB file nor valid JSON ({error})") from None
        if not isinstance(content, dict):
            raise SceneError(f"{path}: it is not a glTF file: its JSON is no object")
        self.root = JsonObject(str(path), "", content)
        _check_version(self.root)
        self._tables = {kind: self.root.objects(kind) for kind in _KINDS}
        self._buffers: dict[int, memoryview] = {}

    def all(self, kind: str) -> list[JsonObject]:
        """All objects of a kind, such as 'nodes'."""
        return self._tables[kind]

    def get(self, kind: str, index: int, owner: JsonObject, name: str) -> JsonObject:
        """The object of a kind with an index that `owner` states as its value `name`."""
        table = self._tables[kind]
        if not 0 <= index < len(table):
            owner.fail(name, f"there is no {kind}[{index}]; the file has {len(table)}")
        return table[index]

    def referenced(self, owner: JsonObject, name: str, kind: str) -> JsonObject | None:
        """The object of a kind whose index is `owner`'s value `name`; None if the value is missing."""
        index = owner.integer(name, None)
        return None if index is None else self.get(kind, index, owner, name)

    def buffer_view(self, owner: JsonObject, name: str = "bufferView") -> tuple[memoryview, int]:
        """(bytes, stride in bytes or 0) of the buffer view whose index is `owner`'s value `name`."""
        view = self.get("bufferViews", owner.integer(name), owner, name)
        data = self._buffer(view.integer("buffer"), view)
        begin, length = view.integer("byteOffset", 0), view.integer("byteLength")
        if begin + length > len(data):
            view.fail("byteLength", f"the view ends at byte {begin + length} of a buffer of {len(data)} bytes")
        return data[begin : begin + length], view.integer("byteStride", 0, high=1 << 16)

    def image_bytes(self, image: JsonObject) -> bytes:
        """The encoded content of an image: from a buffer view, a data URI or a file."""
        if "bufferView" in image:
            return bytes(self.buffer_view(image)[0])
        return self._uri_bytes(image)

    def _buffer(self, index: int, view: JsonObject) -> memoryview:
        buffer = self.get("buffers", index, view, "buffer")
        if index not in self._buffers:
            if "uri" in buffer:
                data = memoryview(self._uri_bytes(buffer))
                self.size_bytes += len(data)
            elif index == 0 and self._binary_chunk is not None:
                data = self._binary_chunk
            elif buffer.extension("EXT_meshopt_compression"):
                buffer.fail("", "meshopt compression is not supported; export the model without it")
            else:
                buffer.fail("uri", "it is missing, and the file has no binary chunk for it")
            length = buffer.integer("byteLength")
            if length > len(data):
                buffer.fail("byteLength", f"{length} bytes are stated, but there are only {len(data)}")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _uri_bytes(self, owner: JsonObject) -> bytes:
        """The bytes that a `uri` contains or names."""
        uri = owner.string("uri")
        if uri[:5].lower() == "data:":
            return _decode_data_uri(uri, owner)
        file = self._named_file(uri, owner)
        if not path_exists(file):
            owner.fail("uri", f"the file '{file}' does not exist")
        if not is_inside(file, self.folder):
            owner.fail("uri", outside_message(file, self.folder))
        return read_bytes(file)

    def _named_file(self, uri: str, owner: JsonObject) -> Path:
        if len(uri) > _MAX_URI_CHARS or "\0" in uri or not uri:
            owner.fail("uri", f"it is no file name, but has {len(uri)} characters")
        scheme = uri.split(":", 1)[0] if ":" in uri.split("/", 1)[0] else ""
        if len(scheme) > 1:  # one letter is a drive
            owner.fail(
                "uri", f"'{scheme}:' is not supported; save the file beside the scene and give its relative path"
            )
        plain = self.path.parent / uri
        if path_exists(plain):  # some exporters do not escape '%'
            return plain
        try:
            file = self.path.parent / unquote_to_bytes(uri).decode("utf-8")
        except UnicodeDecodeError:
            return plain
        with_slashes = Path(str(file).replace("\\", "/"))
        return with_slashes if path_exists(with_slashes) else file


def _check_version(root: JsonObject) -> None:
    asset = root.object("asset")
    if asset is None:
        root.fail("asset", "it is missing: this is not a glTF 2.0 file")
    version = asset.string("minVersion", None) or asset.string("version")
    if version != "2.0" and not (version.startswith("2.") and "minVersion" not in asset):
        asset.fail("version", f"glTF {version[:20]} is not supported; export the model as glTF 2.0")


def _split_glb(path: Path, data: bytes) -> tuple[bytes, memoryview | None]:
    """(JSON text, binary chunk or None) of a GLB file."""
    if len(data) < 20:
        raise SceneError(f"{path}: the GLB file is truncated: it has {len(data)} bytes")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise SceneError(f"{path}: version {version} of GLB is not supported; export the model as glTF 2.0")
    if length > len(data):
        raise SceneError(f"{path}: the GLB file is truncated: its header states {length} bytes, it has {len(data)}")
    chunks = dict(reversed(list(_glb_chunks(path, memoryview(data)[:length]))))  # the first one of a type counts
    if _JSON_CHUNK not in chunks:
        raise SceneError(f"{path}: the GLB file has no JSON chunk")
    return bytes(chunks[_JSON_CHUNK]).rstrip(b"\0"), chunks.get(_BINARY_CHUNK)


def _glb_chunks(path: Path, data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    position = 12
    while position + 8 <= len(data):
        length, type_ = struct.unpack_from("<I4s", data, position)
        begin = position + 8
        if begin + length > len(data):
            raise SceneError(f"{path}: a chunk at byte {position} of the GLB file states {length} bytes, past its end")
        yield type_, data[begin : begin + length]
        position = begin + length


def _decode_data_uri(uri: str, owner: JsonObject) -> bytes:
    header, comma, content = uri.partition(",")
    if not comma:
        owner.fail("uri", "the data URI has no comma before its data")
    if not header.lower().endswith(";base64"):
        return unquote_to_bytes(content)
    try:
        return base64.b64decode(unquote_to_bytes(content) if "%" in content else content, validate=True)
    except (binascii.Error, ValueError):
        owner.fail("uri", "the data URI is not valid base64")
