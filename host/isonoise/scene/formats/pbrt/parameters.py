"""The parameters of a pbrt directive: typed values by name, read with checks. Made by `directives.py`."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from isonoise.scene.formats.pbrt.tokens import Position

_NUMBERS_OF_TYPE = {"point2": 2, "vector2": 2, "point3": 3, "vector3": 3, "normal3": 3, "normal": 3, "point": 3}
_NUMBERS_OF_TYPE |= {"vector": 3, "rgb": 3, "color": 3, "xyz": 3}
SPECTRUM_TYPES = ("rgb", "color", "xyz", "blackbody", "spectrum")
TYPES = frozenset({*_NUMBERS_OF_TYPE, *SPECTRUM_TYPES, "float", "integer", "bool", "string", "texture"})
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
_MAX_INTEGER = 2**31 - 1


@dataclass
class Value:
    """One parameter: numbers as an array, or texts as a list."""

    type: str
    name: str
    values: np.ndarray | list[str]
    position: Position

    @property
    def is_texts(self) -> bool:
        """Whether the values are texts: strings, names of textures, spectra or files, or booleans."""
        return isinstance(self.values, list)


def check_value(value: Value) -> None:
    """Raise SceneError if the values do not fit the type."""
    if value.type in ("string", "texture", "bool") and not value.is_texts:
        value.position.raise_error(f"'{value.name}' needs a text in quotes, such as \"name\"")
    if value.type == "bool" and any(text not in ("true", "false") for text in value.values):
        value.position.raise_error(f"'{value.name}' is true or false, got '{value.values[0][:40]}'")
    if value.is_texts:
        if value.type not in ("string", "texture", "bool", "spectrum"):
            value.position.raise_error(f"'{value.name}' needs numbers, as its type is '{value.type}'")
        return
    size = _NUMBERS_OF_TYPE.get(value.type, 1)
    if len(value.values) % size:
        value.position.raise_error(
            f"'{value.name}' has {len(value.values)} numbers, which is no multiple of {size} ({value.type})"
        )
    if not (np.abs(value.values) <= _MAX_FLOAT32).all():  # False for NaN
        value.position.raise_error(f"'{value.name}' has a number that is not finite or exceeds 3.4e38")
    if value.type == "integer" and (value.values != np.rint(value.values)).any():
        value.position.raise_error(f"'{value.name}' has to be whole numbers")
    if value.type == "integer" and (np.abs(value.values) > _MAX_INTEGER).any():
        value.position.raise_error(f"'{value.name}' has a number that exceeds 32 bits")


class Parameters:
    """The parameters of one directive. Each read marks its parameter as used."""

    def __init__(self, values: Iterable[Value], position: Position):
        self.position = position  # of the directive
        self._values = {value.name: value for value in values}
        self._used: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._values

    @property
    def names(self) -> Iterable[str]:
        """The names of all parameters."""
        return self._values.keys()

    def with_defaults(self, defaults: Iterable[Value]) -> "Parameters":
        """These parameters, and the given ones where they are absent (pbrt's `Attribute`), which need no use."""
        values = {value.name: value for value in defaults} | self._values
        combined = Parameters(values.values(), self.position)
        combined.ignore(*(values.keys() - self._values.keys()))
        return combined

    def unused(self) -> list[Value]:
        """The parameters that have not been read."""
        return [value for name, value in self._values.items() if name not in self._used]

    def ignore(self, *names: str) -> None:
        """Mark parameters that do not change the image as used."""
        self._used.update(names)

    def find(self, name: str, *types: str) -> Value | None:
        """A parameter of one of the given types, or None. Raises SceneError if it has another type or is empty."""
        value = self._values.get(name)
        if value is None:
            return None
        self._used.add(name)
        if types and value.type not in types:
            value.position.raise_error(f"'{name}' has the type '{value.type}' and needs {' or '.join(types)}")
        if not len(value.values):
            value.position.raise_error(f"'{name}' has no value")
        return value

    def has_type(self, name: str, *types: str) -> bool:
        """Whether a parameter exists and has one of the types."""
        return name in self._values and self._values[name].type in types

    def position_of(self, name: str) -> Position:
        """Where a parameter is, or the directive if it is absent."""
        return self._values[name].position if name in self._values else self.position

    def number(self, name: str, default: float | None) -> float | None:
        """A number, or `default`."""
        value = self.find(name, "float", "integer")
        return default if value is None else float(self._single(value))

    def integer(self, name: str, default: int | None) -> int | None:
        """A whole number, or `default`."""
        value = self.find(name, "integer")
        return default if value is None else int(self._single(value))

    def text(self, name: str, default: str | None = None) -> str | None:
        """A string, or `default`."""
        value = self.find(name, "string")
        return default if value is None else self._single(value)

    def boolean(self, name: str, default: bool) -> bool:
        """True or false."""
        value = self.find(name, "bool")
        return default if value is None else self._single(value) == "true"

    def texts(self, name: str) -> list[str]:
        """All strings of a parameter; none if it is absent."""
        value = self.find(name, "string")
        return [] if value is None else value.values

    def array(self, name: str, types: tuple[str, ...]) -> np.ndarray | None:
        """The numbers (n, size of the type), or (n,) for single numbers; None if the parameter is absent."""
        value = self.find(name, *types)
        if value is None:
            return None
        size = _NUMBERS_OF_TYPE.get(value.type, 1)
        return value.values.reshape(-1, size) if size > 1 else value.values

    def vector(self, name: str, default: tuple[float, ...], *types: str) -> np.ndarray:
        """One vector or point."""
        values = self.array(name, types or ("point3", "point", "vector3", "vector"))
        return np.array(default, float) if values is None else values[0]

    def _single(self, value: Value):
        if len(value.values) != 1:
            value.position.raise_error(f"'{value.name}' needs one value, got {len(value.values)}")
        return value.values[0]
