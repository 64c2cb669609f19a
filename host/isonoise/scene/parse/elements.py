"""Where things stand in the user's files, so that every error can say it."""

from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import NoReturn

from isonoise.errors import SceneError

_MESSAGE = 2000  # characters; files may hold names of any length
_WORD, _CHOICES = 60, 1000  # what is compared to find the nearest name: its time grows with the square


@dataclass(frozen=True)
class SourceLocation:
    """A spot in the scene: a file and a line, or a path of keys inside a Python dict."""

    file: str = ""
    line: int = 0
    element: str = ""

    def __str__(self) -> str:
        spot = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (spot, self.element) if part)

    def raise_error(self, message: str) -> NoReturn:
        """Raise a SceneError that begins with this place."""
        prefix = str(self)
        text = (f"{prefix}: {message}" if prefix else message).replace("\n", " ")
        raise SceneError(text if len(text) <= _MESSAGE else text[:_MESSAGE] + " ...")


@dataclass
class Element:
    """One object of the scene as it was read, before any check: XML elements and Python dicts both become this."""

    location: SourceLocation
    kind: str  # the XML tag ('bsdf', 'shape', ...); '' where it has to follow from the type (Python dicts)
    type: str
    id: str
    entries: list[tuple[str, object, SourceLocation]] = field(default_factory=list)
    """(name, value, place): nested Elements and References under their name ('' if they have none), else values."""
    aliases: dict[str, str] = field(default_factory=dict)  # root only: further ids, by the id they stand for


@dataclass(frozen=True)
class Reference:
    """Stands for the object with this id."""

    id: str


def with_article(noun: str) -> str:
    """The noun with its indefinite article."""
    return f"an {noun}" if noun[:1] in "aeiou" else f"a {noun}"


def closest_name(name: str, choices) -> str:
    """The one of `choices` that `name` is most likely meant to be ('' if there are none at all, or too many)."""
    ordered = sorted(choices) if len(choices) <= _CHOICES else ()
    lowered = {choice[:_WORD].lower(): choice for choice in ordered}
    match = get_close_matches(name[:_WORD].lower(), list(lowered), n=1, cutoff=0.0)
    return lowered[match[0]] if match else ""


def path_exists(path: Path) -> bool:
    """Whether there is a file or folder of this name; False for names that none can have."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False
