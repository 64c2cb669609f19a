"""Sends the image of a render to the viewer tev (https://github.com/Tom94/tev) over its TCP protocol.

A packet is its length in bytes, the length's own 4 included, a byte for its type, and a body. All numbers are
little-endian, texts are UTF-8 and end with a zero byte (tev's `Ipc.h` and `Ipc.cpp`):

- CloseImage (2): image
- CreateImage (4): grab focus (1 byte), image, int32 width, height, number of channels, their names
- UpdateImageV3 (6): grab focus, image, int32 number of channels, their names, int32 x, y, width, height of the tile,
  int64 offset of every channel, int64 stride of every channel, float32 values
"""

import logging
import socket
import struct
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from isonoise.errors import UserError
from isonoise.film.exr import image_channels
from isonoise.film.output import image_layers
from isonoise.loop import Periodic, RenderLoop
from isonoise.outcome import Outcome

TIMEOUT_S = 5.0
"""A viewer that takes no bytes for so long is given up."""
INTERVAL_S = 0.5
"""Shortest time between two images."""
MAX_SHARE = 0.02
"""Share of the time that images may take: later ones come less often."""
MAX_TILE_BYTES = 1 << 20
"""Most bytes of the pixels in a packet."""

logger = logging.getLogger("isonoise.live")

_CLOSE, _CREATE, _UPDATE = 2, 4, 6


def close_packet(image: str) -> bytes:
    """The packet CloseImage."""
    return _packet(_CLOSE, _text(image))


def create_packet(image: str, size: tuple[int, int], channels: Sequence[str], grab_focus: bool = True) -> bytes:
    """The packet CreateImage: an image of this size (width, height), whose pixels are 0."""
    body = bytes([grab_focus]) + _text(image) + struct.pack("<iii", *size, len(channels))
    return _packet(_CREATE, body + b"".join(map(_text, channels)))


def update_packet(image: str, channels: Mapping[str, np.ndarray], x: int = 0, y: int = 0) -> bytes:
    """The packet UpdateImageV3: the values of a tile whose upper left pixel is (x, y).

    Parameters
    ----------
    channels : mapping of str to array
        Name -> (height, width) values; all of one size. They are sent one after the other.
    """
    height, width = next(iter(channels.values())).shape
    number = len(channels)
    offsets = [index * width * height for index in range(number)]
    head = bytes([False]) + _text(image) + struct.pack("<i", number) + b"".join(map(_text, channels))
    layout = struct.pack(f"<4i{2 * number}q", x, y, width, height, *offsets, *[1] * number)
    values = (np.ascontiguousarray(plane, "<f4").tobytes() for plane in channels.values())
    return _packet(_UPDATE, head + layout + b"".join(values))


def update_packets(image: str, channels: Mapping[str, np.ndarray]) -> Iterator[bytes]:
    """Packets that together update the whole image: strips of rows, each of one row or at most `MAX_TILE_BYTES`."""
    height, width = next(iter(channels.values())).shape
    rows = max(MAX_TILE_BYTES // (4 * width * len(channels)), 1)
    for y in range(0, height, rows):
        yield update_packet(image, {name: plane[y : y + rows] for name, plane in channels.items()}, y=y)


def _packet(kind: int, body: bytes) -> bytes:
    return struct.pack("<IB", 5 + len(body), kind) + body


def _text(text: str) -> bytes:
    return text.replace("\0", "").encode("utf-8", "replace") + b"\0"


class TevViewer:
    """The image of one render in a running tev: the layers of the EXR file, which it sends again and again.

    A viewer that is closed, or takes no bytes, ends the preview with a warning; the render goes on.

    Parameters
    ----------
    image : str
        Name of the image in tev. An image of this name is replaced.
    address : (host, port)
        Where tev listens.

    Raises
    ------
    UserError
        If nothing listens there.
    """

    def __init__(self, image: str, address: tuple[str, int]):
        self._image = image
        self._channels: tuple[str, ...] = ()
        self._next_at = 0.0
        try:
            self._socket: socket.socket | None = socket.create_connection(address, TIMEOUT_S)
        except OSError as error:
            host, port = address
            raise UserError(
                f"--preview: no tev listens at {host}:{port} ({error.strerror or error}); start tev first, or name the "
                "address of its option --host"
            ) from error

    def periodic(self) -> Periodic:
        """What shows the image during a render: for `RenderLoop`."""
        return Periodic(INTERVAL_S, self._show_progress, self._is_wanted)

    def show(self, outcome: Outcome) -> None:
        """Send the image of an outcome."""
        if self._socket is None or not outcome.statistics.samples:
            return
        channels = image_channels(image_layers(outcome.statistics, outcome.floor))
        try:
            if self._channels != tuple(channels):  # some layers come with the first adaptive wave
                height, width = outcome.statistics.shape
                self._socket.sendall(close_packet(self._image))
                self._socket.sendall(create_packet(self._image, (width, height), tuple(channels)))
                self._channels = tuple(channels)
            for packet in update_packets(self._image, channels):
                self._socket.sendall(packet)
        except OSError as error:
            logger.warning(f"tev no longer shows the render: {error.strerror or error}")
            self.close()

    def close(self) -> None:
        """End the connection. The image stays in tev."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _is_wanted(self) -> bool:
        """Whether a wave should stop for an image."""
        return self._socket is not None and time.perf_counter() >= self._next_at

    def _show_progress(self, loop: RenderLoop) -> None:
        start = time.perf_counter()
        self.show(loop.outcome_so_far("unfinished"))
        end = time.perf_counter()
        self._next_at = end + (end - start) / MAX_SHARE
