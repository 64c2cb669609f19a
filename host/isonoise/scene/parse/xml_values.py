"""Parses the values of Mitsuba 3 XML: numbers, vectors, colours and transforms in the attributes of tags."""

import math
import re

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.parse.xml_tags import Tag

TRANSFORM_OPERATIONS = ("translate", "rotate", "scale", "lookat", "matrix")


def check_attributes(tag: Tag, required: tuple[str, ...], optional: tuple[str, ...] = ()):
    """Raise SceneError if an attribute is missing or unknown."""
    for name in required:
        if name not in tag.attributes:
            tag.raise_error(f"the attribute '{name}' is missing")
    for name in tag.attributes:
        if name not in required and name not in optional:
            known = ", ".join((*required, *optional))
            tag.raise_error(f"unexpected attribute '{name}' (known here: {known})")


def parse_number(tag: Tag, text: str) -> float:
    """A finite float; units are rejected."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        tag.raise_error(f"'{text[:60]}' is not a finite number (no units, no formulas)")
    return value


def parse_numbers(tag: Tag, text: str) -> list[float]:
    """Numbers separated by commas or white space."""
    return [parse_number(tag, part) for part in text.replace(",", " ").split()]


def parse_vector(tag: Tag, default: float | None, *others: str) -> tuple[float, float, float]:
    """A vector from `value` (one or three numbers) or from x, y, z, whose default is `default` (None: required)."""
    if "value" in tag.attributes:
        check_attributes(tag, ("value", *others))
        values = parse_numbers(tag, tag.attributes["value"])
        if len(values) not in (1, 3):
            tag.raise_error(f"'value' has to be one or three numbers, got {len(values)}")
        return tuple(values * 3 if len(values) == 1 else values)
    axes = ("x", "y", "z")
    check_attributes(tag, (*others, *axes) if default is None else others, axes)
    return tuple(parse_number(tag, tag.attributes[axis]) if axis in tag.attributes else default for axis in axes)


def _parse_integer(tag: Tag) -> int:
    text = tag.attributes["value"].strip()
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
        tag.raise_error(f"'{text[:60]}' is not a whole number")
    return int(text)


def _parse_boolean(tag: Tag) -> bool:
    text = tag.attributes["value"].strip().lower()
    if text not in ("true", "false"):
        tag.raise_error(f"'{text[:60]}' is neither true nor false")
    return text == "true"


def _parse_rgb(tag: Tag) -> dict:
    values = parse_numbers(tag, tag.attributes["value"])
    if len(values) not in (1, 3):
        tag.raise_error(f"an rgb colour is one or three numbers, got {len(values)}")
    return {"type": "rgb", "value": values}


def _parse_spectrum(tag: Tag) -> dict:
    check_attributes(tag, ("name",), ("value", "filename"))
    if "value" not in tag.attributes:
        tag.raise_error("spectra from files are not supported; give pairs of wavelength and value in 'value'")
    text = tag.attributes["value"]
    if ":" not in text:
        values = parse_numbers(tag, text)
        if len(values) != 1:
            tag.raise_error("a spectrum is one number or pairs such as 400:0.3, 500:0.7")
        return {"type": "spectrum", "value": values[0]}
    pairs = []
    for part in re.split(r"[\s,]+", text.strip()):
        wavelength, separator, value = part.partition(":")
        if part and not separator:
            tag.raise_error(f"'{part[:60]}' is not a pair of wavelength and value such as 400:0.3")
        if part:
            pairs.append((parse_number(tag, wavelength), parse_number(tag, value)))
    return {"type": "spectrum", "value": pairs}


def transform_matrix(tag: Tag) -> np.ndarray:
    """The 4x4 matrix of one element inside <transform>."""
    if tag.name == "translate":
        return transforms.translate(parse_vector(tag, 0.0))
    if tag.name == "scale":
        return transforms.scale(parse_vector(tag, 1.0))
    if tag.name == "rotate":
        axis = parse_vector(tag, 0.0, "angle")
        if not any(axis):
            tag.raise_error("the axis of a rotation cannot be zero")
        return transforms.rotate(axis, parse_number(tag, tag.attributes["angle"]))
    if tag.name == "lookat":
        return _parse_look_at(tag)
    if tag.name == "matrix":
        check_attributes(tag, ("value",))
        values = parse_numbers(tag, tag.attributes["value"])
        if len(values) not in (9, 16):
            tag.raise_error(f"a matrix has 16 or 9 numbers, got {len(values)}")
        if len(values) == 16:
            return np.array(values).reshape(4, 4)
        matrix = np.eye(4)
        matrix[:3, :3] = np.reshape(values, (3, 3))
        return matrix
    tag.raise_error(f"unknown operation; a transform consists of {', '.join(TRANSFORM_OPERATIONS)}")


def _parse_look_at(tag: Tag) -> np.ndarray:
    check_attributes(tag, ("origin", "target"), ("up",))
    vectors = [
        parse_numbers(tag, tag.attributes[name]) for name in ("origin", "target", "up") if name in tag.attributes
    ]
    if any(len(v) != 3 for v in vectors):
        tag.raise_error("origin, target and up have to be three numbers each")
    try:
        return transforms.look_at(*vectors)
    except ValueError:
        tag.raise_error("target equals origin, or up is parallel to the line between them")


def parse_value(tag: Tag):
    """The value of a property tag other than <transform>."""
    if tag.name in ("point", "vector"):
        return parse_vector(tag, None, "name")
    if tag.name == "spectrum":
        return _parse_spectrum(tag)
    check_attributes(tag, ("name", "value"))
    if tag.name == "string":
        return tag.attributes["value"]
    if tag.name == "float":
        return parse_number(tag, tag.attributes["value"].strip())
    return {"integer": _parse_integer, "boolean": _parse_boolean, "rgb": _parse_rgb}[tag.name](tag)
