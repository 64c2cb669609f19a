"""Values of parameters, checked against the type, range and choices that the registry declares."""

from itertools import pairwise
from pathlib import Path

import numpy as np

from isonoise.scene.material.presets import refractive_indices
from isonoise.scene.parse.elements import SourceLocation, closest_name
from isonoise.scene.vocabulary.plugin import COLOURS, Parameter

_LARGEST = float(np.finfo(np.float32).max)


def check_value(parameter: Parameter, value, location: SourceLocation):
    """The value as the parameter's Python type. Raises SceneError where it is not of that type or out of range."""
    type_ = parameter.type
    if type_ in COLOURS:
        return _colour(type_, value, location)
    if type_ == "index":
        return _index(value, location)
    check = _CHECKS[type_]
    result = check(value)
    if result is None:
        location.raise_error(f"'{parameter.name}' is {_MEANING[type_]}, got {_shown(value)}")
    if parameter.interval and not parameter.admits(result):
        location.raise_error(f"'{parameter.name}' has to lie in {parameter.interval}, got {_shown(value)}")
    if parameter.choices and result not in parameter.choices:
        hint = closest_name(result, parameter.choices)
        location.raise_error(
            f"'{parameter.name}' is one of {', '.join(parameter.choices)}; got '{result}', did you mean '{hint}'?"
        )
    return result


def _float(value) -> float | None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number and abs(value) <= _LARGEST else None  # NaN compares false


def _vector(value) -> tuple[float, float, float] | None:
    if not isinstance(value, tuple) or len(value) != 3 or any(_float(v) is None for v in value):
        return None
    return tuple(float(v) for v in value)


def _transform(value) -> np.ndarray | None:
    good = isinstance(value, np.ndarray) and value.shape == (4, 4) and value.dtype.kind in "iuf"
    good = good and bool((np.abs(value) <= _LARGEST).all())
    return value.astype(np.float64) if good else None


def _integer(value) -> int | None:
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def _is_table(value) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 3


def _positions(value) -> np.ndarray | None:
    good = _is_table(value) and value.dtype.kind in "iuf" and np.isfinite(value).all()
    return value.astype(np.float64) if good else None


def _indices(value) -> np.ndarray | None:
    good = _is_table(value) and value.dtype.kind in "iu"
    return value.astype(np.int64) if good else None


_CHECKS = {
    "float": _float,
    "integer": _integer,
    "boolean": lambda value: value if isinstance(value, bool) else None,
    "string": lambda value: value if isinstance(value, str) else None,
    "file": lambda value: str(Path(value).absolute()) if isinstance(value, str) and value else None,
    "vector": _vector,
    "transform": _transform,
    "positions": _positions,
    "indices": _indices,
    "texture": lambda value: None,
}
_MEANING = {
    "float": "a finite number within 3.4e38",
    "integer": "a whole number",
    "boolean": "true or false",
    "string": "a string",
    "file": "a file name",
    "vector": "three finite numbers within 3.4e38",
    "transform": "a transform of finite numbers within 3.4e38",
    "positions": "an array of n x 3 finite numbers",
    "indices": "an array of n x 3 whole numbers",
    "texture": "a nested texture",
}


def _index(value, location: SourceLocation) -> float:
    """An index of refraction, by number or by name."""
    named = refractive_indices()
    if isinstance(value, str):
        if value.lower() not in named:
            location.raise_error(
                f"unknown material '{value}'; did you mean '{closest_name(value, named)}'? (or give a number)"
            )
        return named[value.lower()]
    number = _float(value)
    if number is None or number <= 0:
        location.raise_error(f"an index of refraction is a positive number or a material's name, got {_shown(value)}")
    return number


def _colour(kind: str, value, location: SourceLocation):
    """A float, or a dict of type 'rgb' (three floats) or 'spectrum' (one float, or pairs of wavelength and value)."""
    if isinstance(value, dict) and value["type"] == "spectrum":
        return {"type": "spectrum", "value": _spectrum(kind, value, location)}
    if isinstance(value, dict):
        given = value.get("value")
        given = tuple(np.atleast_1d(np.asarray(given, dtype=object)).tolist()) if given is not None else ()
        channels = given * 3 if len(given) == 1 else given
        if _vector(channels) is None:
            location.raise_error(f"an rgb colour is one or three finite numbers, got {_shown(value.get('value'))}")
        _bounds(kind, channels, location)
        return {"type": "rgb", "value": [float(v) for v in channels]}
    number = _float(value)
    if number is None:
        location.raise_error(f"a colour is a number, an rgb value or a spectrum, got {_shown(value)}")
    _bounds(kind, (number,), location)
    return number


def _spectrum(kind: str, value: dict, location: SourceLocation):
    given = value.get("value")
    number = _float(given)
    if number is not None:
        _bounds(kind, (number,), location)
        return number
    try:
        pairs = [(float(w), float(v)) for w, v in given]
    except (TypeError, ValueError):
        location.raise_error(f"a spectrum is one number or pairs of wavelength and value, got {_shown(given)}")
    if len(pairs) < 2 or not np.isfinite(pairs).all():
        location.raise_error("a spectrum needs two or more pairs of finite numbers")
    if any(b[0] <= a[0] for a, b in pairwise(pairs)):
        location.raise_error("the wavelengths of a spectrum have to increase")
    _bounds("unbounded", [v for _, v in pairs], location)
    return pairs


def _bounds(kind: str, channels, location: SourceLocation):
    if min(channels) < 0:
        location.raise_error(f"a {'colour' if kind == 'unbounded' else kind} is not negative, got {_shown(channels)}")
    if kind == "reflectance" and max(channels) > 1:
        location.raise_error(f"a reflectance is at most 1, got {_shown(channels)}")


def _shown(value) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
