"""Radiance pictures (.hdr, .pic): RGBE, plain or run-length encoded in either way, read with numpy.

The format is that of G. Ward, "Real Pixels", Graphics Gems II, 1991, and of Radiance's document on file formats. A
pixel is three mantissas and a common exponent: mantissa * 2^(exponent - 136), as Mitsuba 3 decodes it. EXPOSURE is left
alone, as there.
"""

import re

import numpy as np

from isonoise.scene.parse.elements import SourceLocation

_HEADER = 1 << 16  # bytes in which a header has to end
_RESOLUTION = re.compile(rb"([-+])Y +(\d{1,12}) +([-+])X +(\d{1,12})[ \t\r]*\n")
_RUN = 127  # longest run of one packet
_CHUNK = 1 << 18  # bytes that are unpacked at once
_SCALE = np.ldexp(np.float32(1), np.arange(256) - 136).astype(np.float32)
_SCALE[0] = 0.0


def is_rgbe(data: bytes) -> bool:
    """Whether a file begins like a Radiance picture."""
    return data[:2] == b"#?"


def rgbe_size(data: bytes, location: SourceLocation) -> tuple[int, int]:
    """(width, height) by the header. Raises SceneError where there is no such header."""
    match = _resolution(data, location)
    return int(match[4]), int(match[2])


def read_rgbe(data: bytes, location: SourceLocation) -> np.ndarray:
    """Linear RGB (height, width, 3) float32, the first row on top. Raises SceneError where it is damaged or cut off."""
    match = _resolution(data, location)
    height, width = int(match[2]), int(match[4])
    body = np.frombuffer(data, np.uint8, offset=match.end())
    pixels = np.empty((height, width, 3), np.float32)
    if _is_packed(body, width):
        _unpack_lines(body, pixels, location)
    else:
        _decode(_unpack_repeats(body, width * height, location).reshape(height, width, 4), pixels)
    return pixels[:: 1 if match[1] == b"-" else -1, :: 1 if match[3] == b"+" else -1]


def _resolution(data: bytes, location: SourceLocation) -> re.Match:
    end = re.search(rb"\n\r?\n", data[:_HEADER])
    if not is_rgbe(data) or end is None:
        location.raise_error("its header is not that of a Radiance picture")
    format_ = re.search(rb"^FORMAT *= *([^\s]+)", data[: end.start()], re.MULTILINE)
    if format_ and format_[1] != b"32-bit_rle_rgbe":
        location.raise_error(
            f"its format is '{format_[1].decode('ascii', 'replace')[:40]}'; only 32-bit_rle_rgbe can be read"
        )
    match = _RESOLUTION.match(data, end.end())
    if match is None:
        location.raise_error(
            "its header gives no size '-Y height +X width' (pictures that go by columns are not supported)"
        )
    return match


def _is_packed(body: np.ndarray, width: int) -> bool:
    """Whether the first line is run-length encoded a channel at a time; lines of other widths never are."""
    return 8 <= width <= 0x7FFF and len(body) >= 4 and body[0] == 2 and body[1] == 2 and body[2] < 128


def _decode(rgbe: np.ndarray, out: np.ndarray) -> None:
    np.multiply(rgbe[..., :3], _SCALE[rgbe[..., 3:]], out=out)


def _unpack_lines(body: np.ndarray, pixels: np.ndarray, location: SourceLocation) -> None:
    """Lines of four channels one after the other, each of packets: a count above 128 and a byte to repeat, or a count
    and as many bytes. Only the heads of the packets are walked through in a loop."""
    height, width, _ = pixels.shape
    if len(body) < height * (4 + 8 * -(-width // _RUN)):
        location.raise_error("it is cut off")
    data, position, rows = body.tobytes(), 0, max(_CHUNK // (4 * width), 1)
    for row in range(0, height, rows):
        count = min(rows, height - row)
        heads, position = _packets(data, position, width, count, location)
        planes = _expand(body, heads, width, location).reshape(count, 4, width)
        _decode(planes.transpose(0, 2, 1), pixels[row : row + count])


def _packets(data: bytes, position: int, width: int, rows: int, location: SourceLocation) -> tuple[list[int], int]:
    """Where the packets of the next rows begin, and where those after them do."""
    mark, heads = bytes([2, 2, width >> 8, width & 255]), []
    for _ in range(rows):
        if data[position : position + 4] != mark:
            location.raise_error("it is cut off" if position + 4 > len(data) else "its run-length encoding is damaged")
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
            location.raise_error("it is cut off")
    if position > len(data):
        location.raise_error("it is cut off")
    return heads, position


def _expand(body: np.ndarray, heads: list[int], width: int, location: SourceLocation) -> np.ndarray:
    """The bytes of all packets; no packet may be empty or reach from one channel into the next."""
    head = np.array(heads) - heads[0]
    body = body[heads[0] : heads[-1] + _RUN + 2]
    count = body[head].astype(np.int32)
    step = (count <= 128).astype(np.int32)  # 0: one byte is repeated
    count = np.where(step, count, count - 128)
    end = np.cumsum(count, dtype=np.int32)
    borders = np.arange(width, end[-1] + 1, width)
    if count.min() == 0 or end[-1] % width or not np.array_equal(end[np.searchsorted(end, borders)], borders):
        location.raise_error("its run-length encoding is damaged")
    start = (head + 1 - step * (end - count)).astype(np.int32)
    return body[np.repeat(start, count) + np.arange(end[-1], dtype=np.int32) * np.repeat(step, count)]


def _unpack_repeats(body: np.ndarray, total: int, location: SourceLocation) -> np.ndarray:
    """Whole pixels (total, 4); one with the mantissas (1, 1, 1) repeats the pixel before it as often as its exponent
    says, and more of them in a row give the higher bytes of that number."""
    records = body[: len(body) // 4 * 4].reshape(-1, 4)[:total]
    repeats = (records[:, :3] == 1).all(axis=1)
    if not repeats.any():
        if len(records) < total:
            location.raise_error("it is cut off")
        return records
    index = np.arange(len(records))
    latest = np.maximum.accumulate(np.where(repeats, -1, index))
    if latest[0] < 0:
        location.raise_error("its run-length encoding is damaged")
    digit = np.minimum(index - latest - 1, 4)  # 4: a repetition beyond any picture
    count = np.where(repeats, records[:, 3].astype(np.int64) << (8 * digit), 1)
    end = np.cumsum(np.minimum(count, total))
    if end[-1] < total:
        location.raise_error("it is cut off")
    last = np.searchsorted(end, total)
    count[last] = total - (end[last - 1] if last else 0)
    return records[np.repeat(latest[: last + 1], count[: last + 1])]
