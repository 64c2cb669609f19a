"""Reads the values of a glTF file's JSON objects. Every error names the file and the place of the value.

Used by all modules of this package.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

from isonoise.errors import SceneError

_MAX_INTEGER = 2**53  # numbers in JSON are exact up to here
_MAX_SHOWN_CHARS = 60
_NO_DEFAULT = object()


@dataclass(frozen=True, slots=True)
class JsonObject:
    """An object of the file, such as a node. Methods raise SceneError if a value has another type than they return.

    A value of null is taken as missing, as some exporters write it.
    """

    file: str
    place: str  # such as 'meshes[3].primitives[0]'; '' for the whole file
    values: dict

    def __contains__(self, name: str) -> bool:
        return self.values.get(name) is not None

    def place_of(self, name: str) -> str:
        """The place of one of its values, for errors and warnings."""
        return f"{self.place}.{name}" if self.place else name

    def fail(self, name: str, problem: str) -> NoReturn:
        """Raise a SceneError about one of its values, or about the object itself if `name` is ''."""
        place = self.place_of(name) if name else self.place
        raise SceneError(f"{self.file}: {place}: {problem}" if place else f"{self.file}: {problem}")

    def object(self, name: str) -> "JsonObject | None":
        """The object of this name; None if there is none."""
        value = self.values.get(name)
        return None if value is None else as_object(self.file, self.place_of(name), value)

    def objects(self, name: str) -> "list[JsonObject]":
        """The objects of an array; none if the array is missing."""
        return [as_object(self.file, place, value) for place, value in self._items(name)]

    def _items(self, name: str) -> Iterator[tuple[str, object]]:
        values, place = self.values[name] if name in self else [], self.place_of(name)
        if not isinstance(values, list):
            self.fail(name, f"it has to be an array, got {shorten(values)}")
        return ((f"{place}[{number}]", value) for number, value in enumerate(values))

    def extension(self, name: str) -> "JsonObject | None":
        """What an extension adds to this object."""
        extensions = self.object("extensions")
        return extensions.object(name) if extensions else None

    def integer(self, name: str, default=_NO_DEFAULT, low: int = 0, high: int = _MAX_INTEGER) -> int:
        """A whole number in [low, high]; JSON may write it with a fraction of zero."""
        value = self._value(name, default)
        if value is default:
            return value
        if not (_is_whole(value) and low <= value <= high):
            expected = f"a whole number from {low}" + (f" to {high}" if high < _MAX_INTEGER else "")
            self.fail(name, f"it has to be {expected}, got {shorten(value)}")
        return int(value)

    def number(self, name: str, default=_NO_DEFAULT, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number in [low, high]."""
        value = self._value(name, default)
        if value is default:
            return value
        if not (_is_finite(value) and low <= value <= high):
            ends = "" if low == -math.inf else f" of at least {low:g}"
            ends += "" if high == math.inf else f" up to {high:g}"
            self.fail(name, f"it has to be a finite number{ends}, got {shorten(value)}")
        return float(value)

    def numbers(self, name: str, count: int | None, default=_NO_DEFAULT) -> tuple[float, ...]:
        """Finite numbers, `count` of them unless that is None."""
        value = self._value(name, default)
        if value is default:
            return value
        is_valid = isinstance(value, list) and all(map(_is_finite, value)) and count in (None, len(value))
        if not is_valid:
            self.fail(name, f"it has to be {'' if count is None else f'{count} '}finite numbers, got {shorten(value)}")
        return tuple(map(float, value))

    def integers(self, name: str) -> list[int]:
        """Whole numbers from 0 on; none if the array is missing."""
        items = list(self._items(name))
        for place, value in items:
            if not (_is_whole(value) and 0 <= value <= _MAX_INTEGER):
                raise SceneError(f"{self.file}: {place}: it has to be a whole number from 0, got {shorten(value)}")
        return [int(value) for _, value in items]

    def strings(self, name: str) -> list[str]:
        """Strings; none if the array is missing."""
        items = list(self._items(name))
        for place, value in items:
            if not isinstance(value, str):
                raise SceneError(f"{self.file}: {place}: it has to be a string, got {shorten(value)}")
        return [value for _, value in items]

    def string(self, name: str, default=_NO_DEFAULT, choices: tuple[str, ...] = ()) -> str:
        """A string, one of the choices if there are any."""
        value = self._value(name, default)
        if value is default:
            return value
        if not isinstance(value, str):
            self.fail(name, f"it has to be a string, got {shorten(value)}")
        if choices and value not in choices:
            self.fail(name, f"it has to be one of {', '.join(choices)}, got {shorten(value)}")
        return value

    def boolean(self, name: str, default=_NO_DEFAULT) -> bool:
        """True or false."""
        value = self._value(name, default)
        if not isinstance(value, bool):
            self.fail(name, f"it has to be true or false, got {shorten(value)}")
        return value

    def _value(self, name: str, default):
        if name in self:
            return self.values[name]
        if default is _NO_DEFAULT:
            self.fail(name, "it is missing")
        return default


def as_object(file: str, place: str, value) -> JsonObject:
    """A value of the file as an object. Raises SceneError if it is none."""
    if not isinstance(value, dict):
        raise SceneError(f"{file}: {place}: it has to be an object, got {shorten(value)}")
    return JsonObject(file, place, value)


def shorten(value) -> str:
    """A value of the file for an error message."""
    text = " ".join(repr(value)[: 4 * _MAX_SHOWN_CHARS].split())
    return text if len(text) <= _MAX_SHOWN_CHARS else text[: _MAX_SHOWN_CHARS - 3] + "..."


def _is_whole(value) -> bool:
    return (isinstance(value, int) and not isinstance(value, bool)) or (isinstance(value, float) and value.is_integer())


def _is_finite(value) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= 1e300  # also false for NaN and for whole numbers that no float can hold
