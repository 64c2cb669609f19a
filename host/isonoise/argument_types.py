"""Conversion of command-line texts to values; raises ArgumentTypeError with a message for the user."""

import argparse
import math
import re

from isonoise.limits import MAX_DEPTH, MAX_PIXELS, MAX_STOP, MIN_STOP


def finite_number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def integer(text: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,1000}", text):
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number")
    return int(text)


def positive(text: str) -> float:
    value = finite_number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} must be more than 0")
    if not MIN_STOP <= value <= MAX_STOP:
        raise argparse.ArgumentTypeError(f"{text} must be from {MIN_STOP:g} to {MAX_STOP:g}")
    return value


def relative_error(text: str) -> float:
    if text.endswith("%"):
        return positive(text[:-1]) / 100
    value = positive(text)
    if value > 1:
        raise argparse.ArgumentTypeError(f"{text} would be {100 * value:g} %; write {text}% or {value / 100:g}")
    return value


def interval(text: str) -> float:
    value = finite_number(text)
    if value < 0.1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 0.1 seconds")
    return value


def positives(text: str) -> list[float]:
    values = [positive(item) for item in text.split(",")]
    if len(set(values)) < len(values):
        raise argparse.ArgumentTypeError(f"{text} has a number twice")
    return values


def address(text: str) -> tuple[str, int]:
    """Host and port."""
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isascii() and port.isdecimal() and 0 < int(port) < 2**16):
        raise argparse.ArgumentTypeError(f"'{text}' is no address HOST:PORT, such as 127.0.0.1:14158")
    return host.strip("[]"), int(port)


def count(text: str) -> int:
    value = integer(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} must be 1 or more")
    return value


def quantile(text: str) -> float:
    value = finite_number(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text} must lie between 0 and 1, as in 0.99")
    return value


def confidence(text: str) -> float:
    value = finite_number(text)
    if not 0.5 <= value < 1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 0.5 and below 1, as in 0.95")
    return value


def seed(text: str) -> int:
    value = integer(text)
    if not 0 <= value < 1 << 64:
        raise argparse.ArgumentTypeError(f"{text} must be from 0 to {(1 << 64) - 1}")
    return value


def max_depth(text: str) -> int:
    value = integer(text)
    if not 1 <= value <= MAX_DEPTH and value != -1:
        raise argparse.ArgumentTypeError(f"{text} must be from 1 to {MAX_DEPTH}, or -1 for no limit")
    return value


def size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,1000})[xX]([0-9]{1,1000})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"'{text}' is not a size: write WIDTHxHEIGHT, as in 640x480")
    width, height = map(int, match.groups())
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"{text} has no pixels: width and height must be 1 or more")
    if width * height > MAX_PIXELS:
        raise argparse.ArgumentTypeError(f"{text} has more than {MAX_PIXELS:,} pixels")
    return width, height


def stops(text: str) -> float:
    value = finite_number(text)
    if not -64 <= value <= 64:
        raise argparse.ArgumentTypeError(f"{text} must be from -64 to 64 stops")
    return value


def names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def crop_window(text: str) -> tuple[int, int, int, int]:
    match = re.fullmatch(r"([0-9]{1,5}),([0-9]{1,5}),([0-9]{1,5})[xX]([0-9]{1,5})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"'{text}' is not a window: write LEFT,TOP,WIDTHxHEIGHT, as in 100,50,64x48")
    left, top, width, height = map(int, match.groups())
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"{text} has no pixels: width and height must be 1 or more")
    return left, top, width, height


def angle_of_view(text: str) -> float:
    value = finite_number(text)
    if not 0 < value < 180:
        raise argparse.ArgumentTypeError(f"{text} must be more than 0 and less than 180 degrees")
    return value


def point(text: str) -> tuple[float, ...]:
    numbers = text.split(",")
    if len(numbers) != 3:
        raise argparse.ArgumentTypeError(f"'{text}' is not a point: write x,y,z, as in 0,1.5,4")
    return tuple(map(finite_number, numbers))


def look_at(text: str) -> tuple[tuple[float, ...], ...]:
    points = text.split(":")
    if len(points) > 2:
        raise argparse.ArgumentTypeError(f"'{text}' has more than two points: write POSITION:TARGET, or TARGET alone")
    return tuple(map(point, points))


def direction(text: str) -> tuple[float, ...]:
    match = re.fullmatch(r"([+-]?)([xyz])", text, re.IGNORECASE)
    if match:
        return tuple((-1.0 if match[1] == "-" else 1.0) * (axis == match[2].lower()) for axis in "xyz")
    value = point(text)
    if not any(value):
        raise argparse.ArgumentTypeError(f"{text} is no direction")
    return value


def port(text: str) -> int:
    number = int(text) if re.fullmatch("[0-9]{1,5}", text) else -1
    if not 1 <= number <= 65535:
        raise argparse.ArgumentTypeError(f"'{text}' is not a port: write a number from 1 to 65535")
    return number


def memory_size(text: str) -> int:
    match = re.fullmatch(r"([0-9]{1,12}(?:\.[0-9]{1,12})?)([KMGT]?)(?:i?B)?", text, re.IGNORECASE)
    size = int(float(match[1]) * 2 ** (10 * " KMGT".index(match[2].upper() or " "))) if match else 0
    if size < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a size of memory: write 4G or 512M")
    return size


def definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form name=value")
    return name, value
