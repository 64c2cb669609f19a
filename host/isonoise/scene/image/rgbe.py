"""Reads Radiance pictures (.hdr, .pic) with numpy: RGBE, uncompressed or with either run-length encoding.

The format is that of G. Ward, "Real Pixels", Graphics Gems II, 1991, and of Radiance's document on file formats. A
pixel is three mantissas and a common exponent: mantissa * 2^(exponent - 136), as in Mitsuba 3. EXPOSURE is ignored, as
there.
"""

import re

import numpy as np

from isonoise.scene.parse.elements import SourceLocation

_MAX_HEADER_BYTES = 1 << 16
_RESOLUTION = re.compile(rb"([-+])Y +(\d{1,12}) +([-+])X +(\d{1,12})[ \t\r]*\n")
_MAX_RUN = 127  # longest run of one packet
_CHUNK_BYTES = 1 << 18  # bytes that are unpacked at once
_SCALE = np.ldexp(np.float32(1), np.arange(256) - 136).astype(np.float32)  # by exponent
_SCALE[0] = 0.0
_TRUNCATED = "it is truncated"
_DAMAGED = "its run-length encoding is damaged"


def is_rgbe(data: bytes) -> bool:
    """Whether a file begins like a Radiance picture."""
    return data[:2] == b"#?"


def rgbe_size(data: bytes, location: SourceLocation) -> tuple[int, int]:
    """(width, height) in the header. Raises SceneError if the header is invalid."""
    match = _parse_header(data, location)
    return int(match[4]), int(match[2])


def read_rgbe(data: bytes, location: SourceLocation) -> np.ndarray:
    """Linear RGB (height, width, 3) float32, top row first. Raises SceneError if the file is damaged or truncated."""
    match = _parse_header(data, location)
    height, width = int(match[2]), int(match[4])
    body = np.frombuffer(data, np.uint8, offset=match.end())
    pixels = np.empty((height, width, 3), np.float32)
    if _has_planar_lines(body, width):
        _decode_planar_lines(body, pixels, location)
    else:
        _rgbe_to_float(_expand_repeated_pixels(body, width * height, location).reshape(height, width, 4), pixels)
    return pixels[:: 1 if match[1] == b"-" else -1, :: 1 if match[3] == b"+" else -1]


def _parse_header(data: bytes, location: SourceLocation) -> re.Match:
    """The match of the resolution line, the last line of the header."""
    end = re.search(rb"\n\r?\n", data[:_MAX_HEADER_BYTES])
    if not is_rgbe(data) or end is None:
        location.raise_error("its header is not that of a Radiance picture")
    format_ = re.search(rb"^FORMAT *= *([^\s]+)", data[: end.start()], re.MULTILINE)
    if format_ and format_[1] != b"32-bit_rle_rgbe":
        name = format_[1].decode("ascii", "replace")[:40]
        location.raise_error(f"its format is '{name}'; only 32-bit_rle_rgbe is supported")
    match = _RESOLUTION.match(data, end.end())
    if match is None:
        location.raise_error("its header has no size '-Y height +X width' (column order is not supported)")
    return match


def _has_planar_lines(body: np.ndarray, width: int) -> bool:
    """Whether lines are run-length encoded channel by channel, which only some widths allow."""
    return 8 <= width <= 0x7FFF and len(body) >= 4 and body[0] == 2 and body[1] == 2 and body[2] < 128


def _rgbe_to_float(rgbe: np.ndarray, out: np.ndarray) -> None:
    np.multiply(rgbe[..., :3], _SCALE[rgbe[..., 3:]], out=out)


def _decode_planar_lines(body: np.ndarray, pixels: np.ndarray, location: SourceLocation) -> None:
    """Decode lines of four channels, each a sequence of packets.

    A packet is a count above 128 and a byte to repeat, or a count and as many bytes. Only the heads of the packets are
    found in a Python loop.
    """
    height, width, _ = pixels.shape
    if len(body) < height * (4 + 8 * -(-width // _MAX_RUN)):
        location.raise_error(_TRUNCATED)
    data, position, chunk_rows = body.tobytes(), 0, max(_CHUNK_BYTES // (4 * width), 1)
    for row in range(0, height, chunk_rows):
        count = min(chunk_rows, height - row)
        heads, position = _find_packets(data, position, width, count, location)
        planes = _expand_packets(body, heads, width, location).reshape(count, 4, width)
        _rgbe_to_float(planes.transpose(0, 2, 1), pixels[row : row + count])


def _find_packets(data: bytes, position: int, width: int, rows: int, location: SourceLocation) -> tuple[list[int], int]:
    """(offsets of the packets of the next rows, offset after them)."""
    row_marker, heads = bytes([2, 2, width >> 8, width & 255]), []
    for _ in range(rows):
        if data[position : position + 4] != row_marker:
            location.raise_error(_TRUNCATED if position + 4 > len(data) else _DAMAGED)
        position += 4
        missing = 4 * width
        try:
            while missing > 0:
                count = data[position]
                heads.append(position)
                if count > 128:
                    missing -= count - 128
                    position += 2
                else:
                    missing -= count
                    position += count + 1
        except IndexError:
            location.raise_error(_TRUNCATED)
    if position > len(data):
        location.raise_error(_TRUNCATED)
    return heads, position


def _expand_packets(body: np.ndarray, heads: list[int], width: int, location: SourceLocation) -> np.ndarray:
    """The bytes of all packets; a packet must not be empty or cross the border between two channels."""
    head = np.array(heads) - heads[0]
    body = body[heads[0] : heads[-1] + _MAX_RUN + 2]
    count = body[head].astype(np.int32)
    step = (count <= 128).astype(np.int32)  # 0: one byte is repeated
    count = np.where(step, count, count - 128)
    end = np.cumsum(count, dtype=np.int32)
    borders = np.arange(width, end[-1] + 1, width)
    if count.min() == 0 or end[-1] % width or not np.array_equal(end[np.searchsorted(end, borders)], borders):
        location.raise_error(_DAMAGED)
    start = (head + 1 - step * (end - count)).astype(np.int32)
    return body[np.repeat(start, count) + np.arange(end[-1], dtype=np.int32) * np.repeat(step, count)]


def _expand_repeated_pixels(body: np.ndarray, total: int, location: SourceLocation) -> np.ndarray:
    """Pixels (total, 4) of the older encoding.

    A pixel with mantissas (1, 1, 1) repeats the pixel before it; its exponent is the count. Consecutive ones are the
    higher bytes of the count.
    """
    records = body[: len(body) // 4 * 4].reshape(-1, 4)[:total]
    is_repeat = (records[:, :3] == 1).all(axis=1)
    if not is_repeat.any():
        if len(records) < total:
            location.raise_error(_TRUNCATED)
        return records
    index = np.arange(len(records))
    last_pixel = np.maximum.accumulate(np.where(is_repeat, -1, index))
    if last_pixel[0] < 0:
        location.raise_error(_DAMAGED)
    digit = np.minimum(index - last_pixel - 1, 4)  # 4: longer than any picture
    count = np.where(is_repeat, records[:, 3].astype(np.int64) << (8 * digit), 1)
    end = np.cumsum(np.minimum(count, total))
    if end[-1] < total:
        location.raise_error(_TRUNCATED)
    last = np.searchsorted(end, total)
    count[last] = total - (end[last - 1] if last else 0)
    return records[np.repeat(last_pixel[: last + 1], count[: last + 1])]
