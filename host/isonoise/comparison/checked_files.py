"""Files with a SHA-256 of their content that say what they are: npz archives and EXR images.

`runner`, `references` and `results` read and write the files of a comparison with these functions. What a file is, its
`identity`, is a dict of JSON values; `identity.py` makes them.
"""

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isonoise.comparison.identity import find_mismatch
from isonoise.errors import UserError
from isonoise.film.exr import image_channels, read_exr, write_exr
from isonoise.film.files import write_atomically
from isonoise.input_files import open_regular_file, read_regular_file

_DIGEST_LENGTH = 64
_NO_DIGEST = "it is damaged, or an earlier version wrote it"


class InvalidFileError(UserError):
    """A file is damaged or not the expected one; `reason` says which, such as 'its seed is 3 instead of 1'."""

    def __init__(self, path: Path, reason: str):
        super().__init__(f"cannot use '{path}': {reason}")
        self.reason = reason


def pack_npz(arrays: Mapping[str, np.ndarray], identity: Mapping, compressed: bool = True) -> bytes:
    """The content of an npz file with arrays and identity (as JSON text, the array `identity`).

    Its last 64 bytes are the SHA-256 of all bytes before them. They are the comment of the zip archive, so `numpy.load`
    reads the file as any other.
    """
    buffer = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(buffer, **arrays, identity=np.array(json.dumps(identity)))
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.comment = bytes(_DIGEST_LENGTH)
    body = buffer.getbuffer()[:-_DIGEST_LENGTH]
    return bytes(body) + hashlib.sha256(body).hexdigest().encode()


def write_packed(path: Path, content: bytes) -> None:
    """Write what `pack_npz` has returned atomically. Raises UserError if that fails."""
    _remove_link(path)
    write_atomically(path, lambda temporary: _write_bytes(temporary, content))


def packed_digest(content: bytes) -> str:
    """SHA-256 of what `pack_npz` has returned, as its end says."""
    return content[-_DIGEST_LENGTH:].decode("ascii", "replace")


def file_digest(path: Path) -> str:
    """`packed_digest` of a file. Raises OSError if it cannot be read."""
    with open_regular_file(path) as file:
        file.seek(-_DIGEST_LENGTH, os.SEEK_END)
        return packed_digest(file.read(_DIGEST_LENGTH))


def read_npz(path: Path, identity: Mapping) -> Mapping[str, np.ndarray]:
    """`unpack_npz` of a file. Raises InvalidFileError also if it cannot be read."""
    try:
        content = read_regular_file(path)
    except OSError as error:
        raise InvalidFileError(path, f"it cannot be read ({error.strerror})") from error
    return unpack_npz(content, path, identity)


def unpack_npz(content: bytes, path: Path, identity: Mapping) -> Mapping[str, np.ndarray]:
    """The arrays of `pack_npz`, decompressed when they are used.

    Raises InvalidFileError, which names `path`, if the content does not agree with its SHA-256, or has another
    identity.
    """
    body = memoryview(content)[:-_DIGEST_LENGTH]
    if hashlib.sha256(body).hexdigest().encode() != content[-_DIGEST_LENGTH:]:
        raise InvalidFileError(path, _NO_DIGEST)
    try:
        file = np.load(io.BytesIO(content))
        text = str(file["identity"])
    except (KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InvalidFileError(path, _NO_DIGEST) from error
    _check_identity(path, text, identity)
    return file


def write_image(path: Path, layers: Mapping[str, np.ndarray], header: Mapping, identity: Mapping) -> None:
    """Write an EXR file as `write_exr` does, with its identity and a SHA-256 of identity and pixels in the header.

    The SHA-256 does not cover the other attributes of the header, such as the time: if the same image is rendered
    again, it has the same SHA-256. Raises UserError if the file cannot be written.
    """
    channels = image_channels(layers)
    text = json.dumps(identity)
    attributes = {"isonoise.identity": text, "isonoise.sha256": _image_digest(channels, text)}
    _remove_link(path)
    write_exr(path, channels, {**header, **attributes})


def read_image(path: Path, identity: Mapping) -> tuple[dict[str, np.ndarray], str]:
    """Channels and SHA-256 of a file of `write_image`. Raises InvalidFileError as `read_npz` does."""
    try:
        channels, header = read_exr(path)
    except UserError as error:
        raise InvalidFileError(path, _NO_DIGEST) from error
    text, digest = header.get("isonoise.identity"), header.get("isonoise.sha256")
    if not isinstance(text, str) or digest != _image_digest(channels, text):
        raise InvalidFileError(path, _NO_DIGEST)
    _check_identity(path, text, identity)
    return channels, digest


def is_valid_image(path: Path, identity: Mapping) -> bool:
    """Whether `read_image` reads the file."""
    try:
        read_image(path, identity)
    except InvalidFileError:
        return False
    return True


def make_folder(path: Path) -> None:
    """Create the folder and its parents. Raises UserError if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder '{path}': {error.strerror}") from error


def _check_identity(path: Path, text: str, expected: Mapping) -> None:
    reason = find_mismatch(json.loads(text), expected)
    if reason:
        raise InvalidFileError(path, reason)


def _image_digest(channels: Mapping[str, np.ndarray], identity: str) -> str:
    digest = hashlib.sha256(identity.encode())
    for name, plane in sorted(channels.items()):
        digest.update(f"{name} {plane.dtype} {plane.shape}".encode())
        digest.update(np.ascontiguousarray(plane))
    return digest.hexdigest()


def _write_bytes(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)


def _remove_link(path: Path) -> None:
    """A symbolic link would be followed, and the file that it names replaced."""
    try:
        if path.is_symlink():
            path.unlink()
    except OSError as error:
        raise UserError(f"cannot write '{path}': {error.strerror}") from error
