"""Elements: the objects of a scene as they were read, with the location that every error names."""

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, Protocol

from isonoise.errors import SceneError
from isonoise.suggestions import closest_name

_MAX_MESSAGE_CHARS = 2000  # files may contain names of any length


class Location:
    """A place in the scene that errors name, as its text."""

    __slots__ = ()

    def without_element(self) -> "Location":
        """A location that takes less memory, and names no element if it has a line."""
        return self

    def raise_error(self, message: str) -> NoReturn:
        """Raise a SceneError whose message begins with this location."""
        prefix = str(self)
        text = (f"{prefix}: {message}" if prefix else message).replace("\n", " ")
        raise SceneError(text if len(text) <= _MAX_MESSAGE_CHARS else text[:_MAX_MESSAGE_CHARS] + " ...")


@dataclass(frozen=True, slots=True)
class SourceLocation(Location):
    """A file and a line, or a path of keys in a Python dict."""

    file: str = ""
    line: int = 0
    element: str = ""

    def __str__(self) -> str:
        file = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (file, self.element) if part)


@dataclass(slots=True)
class Element:
    """One unchecked object of the scene, from an XML element or a Python dict."""

    location: Location
    kind: str  # the XML tag ('bsdf', 'shape', ...); '' for Python dicts, where it follows from the type
    type: str
    id: str
    entries: list[tuple[str, object, Location]] = field(default_factory=list)
    """(name, value, location): a value is an Element, a Reference or plain data. The name of an object may be ''."""
    aliases: dict[str, str] | None = None  # of the root: alias -> id
    prototype: "Element | None" = None  # an earlier object that differs only in the numbers that `entries` has
    normalised: dict | None = None  # set by `validate.py`: the checked object
    height: int = 1  # levels of nested objects in it, including its own; known once it is normalised


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference to the object with this id."""

    id: str


class CheckedObject(Protocol):
    """An object of a loaded scene, such as a material, that is used in a dict again."""

    @property
    def normalised(self) -> dict:
        """The normalised object."""
        ...

    def is_part_of(self, scene: object) -> bool:
        """Whether it belongs to this scene, which then shares it."""
        ...


def copy_objects(part: dict, copies: dict[int, dict] | None = None) -> dict:
    """A copy of a normalised object and all in it: shared objects stay shared, arrays and images are not copied.

    `copies` gets the new dicts by the id() of the old ones.
    """
    copies = {} if copies is None else copies
    if id(part) not in copies:
        copies[id(part)] = result = {}
        result.update((k, copy_objects(v, copies) if is_object(v) else v) for k, v in part.items())
    return copies[id(part)]


def is_object(value: object) -> bool:
    """Whether a value of a normalised object is an object itself: no number, colour, array or dict of arrays."""
    return isinstance(value, dict) and value.get("type") not in (None, "rgb", "spectrum")


def with_article(noun: str) -> str:
    """The noun with its indefinite article."""
    return f"an {noun}" if noun[:1] in "aeiou" else f"a {noun}"


def did_you_mean(name: str, choices: Collection[str]) -> str:
    """The end of an error about an unknown name: '; did you mean ...?', or '' if no choice is similar."""
    hint = closest_name(name, choices)
    return f"; did you mean '{hint}'?" if hint else ""


def path_exists(path: Path) -> bool:
    """Whether a file or folder exists; False for invalid names."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False
