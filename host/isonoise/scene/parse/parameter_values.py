"""Checks the values of parameters against the type, interval and choices in the vocabulary. Called by `validate.py`."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from isonoise.scene.image.image import Image
from isonoise.scene.material.presets import refractive_indices
from isonoise.scene.parse.elements import Location, did_you_mean
from isonoise.scene.parse.foreign_values import array_image
from isonoise.scene.spectra import colour_to_rgb
from isonoise.scene.vocabulary.plugin import COLOURS, Parameter

_MAX_FLOAT32 = float(np.finfo(np.float32).max)


def check_value(parameter: Parameter, value, location: Location):
    """The value as the parameter's Python type. Raises SceneError if it has another type or is out of range."""
    type_ = parameter.type
    if type_ in COLOURS:
        return _check_colour(type_, value, location)
    if type_ == "texture" and isinstance(value, (int, float, dict)):  # a colour is a texture, as in Mitsuba 3
        colour = _check_colour("reflectance", value, location)
        return {"type": "rgb", "value": colour_to_rgb(colour, "reflectance").tolist()}
    if type_ == "index":
        return _check_index(value, location)
    convert, expected = _TYPES[type_]
    result = convert(value)
    if result is None:
        location.raise_error(f"'{parameter.name}' has to be {expected}, got {_shortened(value)}")
    if parameter.interval and not parameter.admits(result):
        location.raise_error(f"'{parameter.name}' has to be in {parameter.interval}, got {_shortened(value)}")
    if parameter.choices and result not in parameter.choices:
        choices, hint = ", ".join(parameter.choices), did_you_mean(result, parameter.choices)
        location.raise_error(f"'{parameter.name}' is one of {choices}; got '{result}'{hint}")
    return result


def _to_float(value) -> float | None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and abs(value) <= _MAX_FLOAT32 else None  # False for NaN


def _to_vector(value) -> tuple[float, float, float] | None:
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    x, y, z = map(_to_float, value)
    return None if x is None or y is None or z is None else (x, y, z)


def _to_transform(value) -> np.ndarray | None:
    is_valid = isinstance(value, np.ndarray) and value.shape == (4, 4) and value.dtype.kind in "iuf"
    if not is_valid:
        return None
    numbers = value.ravel().tolist()  # faster than numpy for 16 of them
    is_finite = math.isfinite(sum(numbers)) and min(numbers) >= -_MAX_FLOAT32 and max(numbers) <= _MAX_FLOAT32
    return value.astype(np.float64) if is_finite else None


def _to_integer(value) -> int | None:
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def _is_n_by_3(value) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 3


def _to_positions(value) -> np.ndarray | None:
    is_valid = _is_n_by_3(value) and value.dtype.kind in "iuf" and np.isfinite(value).all()
    return value.astype(np.float64) if is_valid else None


def _to_indices(value) -> np.ndarray | None:
    is_valid = _is_n_by_3(value) and value.dtype.kind in "iu"
    return value.astype(np.int64) if is_valid else None


def _to_uvs(value) -> np.ndarray | None:
    is_valid = isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 2 and value.dtype.kind in "iuf"
    return value.astype(np.float32) if is_valid and np.isfinite(value).all() else None


def _to_grid(value):
    """A VolumeGrid or an array."""
    from isonoise.scene.volume.grid_file import VolumeGrid  # imported only where it is used

    is_array = isinstance(value, np.ndarray) and value.ndim in (3, 4) and value.dtype.kind in "iuf"
    return value if is_array or isinstance(value, VolumeGrid) else None


def _to_image(value) -> Image | None:
    return array_image(value) if isinstance(value, np.ndarray) else value if isinstance(value, Image) else None


def _to_attributes(value) -> dict[str, np.ndarray] | None:
    is_valid = isinstance(value, dict) and all(
        name.startswith(("vertex_", "face_")) and array.ndim == 2 and array.shape[1] in (1, 3)
        for name, array in value.items()
    )
    return {name: array.astype(np.float32) for name, array in value.items()} if is_valid else None


# type -> (conversion that returns None for an invalid value, the expected value for errors)
_TYPES = {
    "float": (_to_float, "a finite number within 3.4e38"),
    "integer": (_to_integer, "a whole number"),
    "boolean": (lambda value: value if isinstance(value, bool) else None, "true or false"),
    "string": (lambda value: value if isinstance(value, str) else None, "a string"),
    "file": (lambda value: str(Path(value).absolute()) if isinstance(value, str) and value else None, "a file name"),
    "vector": (_to_vector, "three finite numbers within 3.4e38"),
    "transform": (_to_transform, "a transform of finite numbers within 3.4e38"),
    "positions": (_to_positions, "an array of n x 3 finite numbers"),
    "uvs": (_to_uvs, "an array of n x 2 finite numbers"),
    "attributes": (_to_attributes, "a dict of arrays n x 1 or n x 3 by names that begin with vertex_ or face_"),
    "image": (_to_image, "an array (height, width) or (height, width, channels) of numbers, or an Image"),
    "grid": (_to_grid, "an array of numbers with 3 or 4 dimensions, or a VolumeGrid"),
    "indices": (_to_indices, "an array of n x 3 whole numbers"),
    "texture": (lambda value: None, "a nested texture"),
    "raw": (lambda value: _to_vector(value) or _to_float(value), "a finite number or a vector of three"),
}


def constant_of(parameter: Parameter, texture: dict, location: Location):
    """The value that a parameter gets from one of the CONSTANT_TEXTURES: a number or a colour.

    As in Mitsuba 3, a number is the mean of a colour, and `rawconstant` with three values is no number.
    """
    value = texture["value"] if "value" in texture else texture.get("color", 1.0)
    if texture["type"] == "rawconstant" and parameter.type == "float" and isinstance(value, tuple):
        location.raise_error(f"'{parameter.name}' has to be a number, and this rawconstant has three")
    kind = "reflectance" if texture["type"] == "srgb" else "radiance"
    rgb = colour_to_rgb({"type": "rgb", "value": value} if isinstance(value, tuple) else value, kind)
    rgb *= texture.get("scale", 1.0)
    if parameter.type == "texture":
        return {"type": "rgb", "value": rgb.tolist()}
    is_number = parameter.type == "float" or not isinstance(value, (dict, tuple))
    return check_value(parameter, float(rgb.mean()) if is_number else {"type": "rgb", "value": rgb.tolist()}, location)


def _check_index(value, location: Location) -> float:
    """An index of refraction, given by number or by name."""
    by_name = refractive_indices()
    if isinstance(value, str):
        if value.lower() not in by_name:
            location.raise_error(f"unknown material '{value}'{did_you_mean(value, by_name)} (or give a number)")
        return by_name[value.lower()]
    number = _to_float(value)
    if number is None or number <= 0:
        location.raise_error(f"an index of refraction is a positive number or a material name, got {_shortened(value)}")
    return number


def _check_colour(kind: str, value, location: Location):
    """A float, or a dict of type 'rgb' (three floats) or 'spectrum' (one float, or pairs of wavelength and value)."""
    if isinstance(value, dict) and value["type"] == "spectrum":
        return {"type": "spectrum", "value": _check_spectrum(kind, value, location)}
    if isinstance(value, dict):
        values = value.get("value")
        values = tuple(np.atleast_1d(np.asarray(values, dtype=object)).tolist()) if values is not None else ()
        channels = values * 3 if len(values) == 1 else values
        if _to_vector(channels) is None:
            location.raise_error(f"an rgb colour is one or three finite numbers, got {_shortened(value.get('value'))}")
        _check_colour_range(kind, channels, location)
        return {"type": "rgb", "value": [float(v) for v in channels]}
    number = _to_float(value)
    if number is None:
        location.raise_error(f"a colour is a number, an rgb value or a spectrum, got {_shortened(value)}")
    _check_colour_range(kind, (number,), location)
    return number


def _check_spectrum(kind: str, value: dict, location: Location):
    values = value.get("value")
    number = _to_float(values)
    if number is not None:
        _check_colour_range(kind, (number,), location)
        return number
    try:
        pairs = [(float(wavelength), float(v)) for wavelength, v in values]
    except (TypeError, ValueError):
        location.raise_error(f"a spectrum is one number or pairs of wavelength and value, got {_shortened(values)}")
    if len(pairs) < 2 or not np.isfinite(pairs).all():
        location.raise_error("a spectrum needs at least two pairs of finite numbers")
    if any(b[0] <= a[0] for a, b in pairwise(pairs)):
        location.raise_error("the wavelengths of a spectrum have to increase")
    _check_colour_range("unbounded", [v for _, v in pairs], location)
    return pairs


def _check_colour_range(kind: str, channels, location: Location):
    if min(channels) < 0:
        noun = "colour" if kind == "unbounded" else kind
        location.raise_error(f"a {noun} cannot be negative, got {_shortened(channels)}")
    if kind == "reflectance" and max(channels) > 1:
        location.raise_error(f"a reflectance is at most 1, got {_shortened(channels)}")


def _shortened(value) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
