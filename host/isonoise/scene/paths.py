"""Finds parameters and objects of a normalised scene by path, such as 'sensor.film.width'. Called by `Scene`.

A path is a list of names from the outside to the inside. Levels may be left out, and the kind of an object may take the
place of its name, as long as one parameter fits: 'film.width', 'lamp.radiance'.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.parse.elements import Element, is_object
from isonoise.scene.view import sensors_of
from isonoise.scene.vocabulary import find_plugin
from isonoise.scene.vocabulary.plugin import SUPPORTED
from isonoise.suggestions import closest_name

_CROP = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
FILM_VALUES = {
    "size": (("width", "height"), "width and height, pixels"),
    "crop": (_CROP, "crop window: left, top, width and height, pixels"),
}
"""Values of a film that stand for several parameters, and their meaning. A new size removes the crop window."""
_MAX_LISTED = 6


class ScenePathError(SceneError, KeyError):
    """A path names nothing in a scene, or several things. The message says what there is instead."""

    __str__ = Exception.__str__  # that of KeyError adds quotes


@dataclass(frozen=True)
class Place:
    """Where a parameter or an object is, or may be."""

    chain: tuple[dict, ...]  # the objects around it, from the scene to the one that holds it
    names: tuple[str, ...]  # of these objects without the scene, and its own

    @property
    def owner(self) -> dict:
        return self.chain[-1]

    @property
    def key(self) -> str:
        return self.names[-1]

    @property
    def path(self) -> str:
        return ".".join(self.names)

    @property
    def has_value(self) -> bool:
        return self.key in self.owner or self.is_film_value

    @property
    def is_film_value(self) -> bool:
        """Whether it is one of FILM_VALUES."""
        return _is_film_value(self.owner, self.key)


def _is_film_value(owner: dict, key: str) -> bool:
    return key in FILM_VALUES and find_plugin(owner["type"]).kind == "film"


def film_value(film: dict, key: str) -> tuple[int, ...]:
    """One of FILM_VALUES."""
    defaults = {"crop_offset_x": 0, "crop_offset_y": 0, "crop_width": film["width"], "crop_height": film["height"]}
    return tuple((defaults | film)[name] for name in FILM_VALUES[key][0])


def film_parameters(place: Place, value: object) -> dict[str, object]:
    """The parameters that one of FILM_VALUES sets; None for those that it removes. Raises SceneError."""
    names, meaning = FILM_VALUES[place.key]
    numbers = np.asarray(value)
    if numbers.shape != (len(names),) or numbers.dtype.kind not in "iu":
        raise SceneError(f"{place.path}: it is a tuple of whole numbers, {meaning}; got {value!r}")
    removed = dict.fromkeys(_CROP) if place.key == "size" else {}
    return removed | dict(zip(names, numbers.tolist(), strict=True))


def plain_value(value: object) -> object:
    """A value of the description as users see it: a colour as three numbers, an array read-only."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if isinstance(value, dict):
        if value.get("type") == "rgb":
            return tuple(value["value"])
        return MappingProxyType({name: plain_value(part) for name, part in value.items()})
    return value


def find_place(inside: Place, elements: Mapping[str, Element], path: str) -> Place:
    """The place of a path from the object `inside.chain[-1]` on.

    It has no value if a parameter or an object is possible there, but not given. `elements` are the scene's objects
    by id. Raises ScenePathError unless one place fits.
    """
    if not isinstance(path, str):
        raise ScenePathError(f"a path is a text such as 'film.width', got {path!r}")
    segments = path.split(".")
    start, rest = _walk(inside, segments)
    if rest and not inside.names:
        by_id, rest_of_id = _find_id(inside, elements, segments)
        if len(rest_of_id) < len(rest):
            start, rest = _walk(by_id, rest_of_id)
    if not rest:
        return start
    found = list(_search(start, rest))
    given = [place for place in found if place.has_value]
    candidates = given or found
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        listed = ", ".join(f"'{place.path}'" for place in candidates[:_MAX_LISTED])
        more = f" and {len(candidates) - _MAX_LISTED} more" if len(candidates) > _MAX_LISTED else ""
        raise ScenePathError(f"'{path}' is ambiguous: it may be {listed}{more}")
    raise ScenePathError(_unknown(start, rest, path))


def parameter_places(description: dict) -> Iterator[Place]:
    """The places of all parameters that have values. What several objects share comes once, by its shortest path."""
    at_top = {id(part) for part in description.values() if is_object(part)}
    visited: set[int] = set()

    def visit(chain: tuple[dict, ...], names: tuple[str, ...]) -> Iterator[Place]:
        part = chain[-1]
        visited.add(id(part))
        if find_plugin(part["type"]).kind == "film":
            yield from (Place(chain, (*names, key)) for key in FILM_VALUES)
        for key, value in part.items():
            if not is_object(value) and key != "type":
                yield Place(chain, (*names, key))
            elif is_object(value) and id(value) not in visited and (len(chain) == 1 or id(value) not in at_top):
                yield from visit((*chain, value), (*names, key))

    return visit((description,), ())


def _walk(start: Place, rest: Sequence[str]) -> tuple[Place, Sequence[str]]:
    """Follow the names from `start.chain[-1]` on, as far as they are given in full. Names may contain dots."""
    while rest:
        owner, whole = start.chain[-1], ".".join(rest)
        if whole in owner or _accepts(owner, whole):
            return Place(start.chain, (*start.names, whole)), ()
        keys = (".".join(rest[:count]) for count in range(len(rest) - 1, 0, -1))
        key = next((key for key in keys if is_object(owner.get(key))), None)
        if key is None:
            break
        start, rest = Place((*start.chain, owner[key]), (*start.names, key)), rest[key.count(".") + 1 :]
    return start, rest


def _find_id(scene: Place, elements: Mapping[str, Element], rest: Sequence[str]) -> tuple[Place, Sequence[str]]:
    """The object whose id the path begins with, as a start for `_walk`; the scene if there is none."""
    for count in range(len(rest), 0, -1):
        element = elements.get(".".join(rest[:count]))
        if element is not None and element.normalised is not None:
            for chain, names in _objects(scene.chain, ()):
                if chain[-1] is element.normalised:
                    return (Place(chain[:-1], names), ()) if count == len(rest) else (Place(chain, names), rest[count:])
    return scene, rest


def _accepts(owner: dict, key: str) -> bool:
    """Whether an object may have a parameter or a nested object of this name."""
    plugin = find_plugin(owner["type"])
    if plugin.kind == "scene":
        return False
    parameter = plugin.parameter(key)
    if parameter is not None:
        return parameter.status == SUPPORTED
    return _is_film_value(owner, key) or any(key in (child.names or (child.kind,)) for child in plugin.children)


def _objects(chain: tuple[dict, ...], names: tuple[str, ...]) -> Iterator[tuple[tuple[dict, ...], tuple[str, ...]]]:
    """All objects inside one, each once, those nearer to it first. Of several cameras only the one in use counts."""
    used = next(iter(sensors_of(chain[0])), None)
    visited, queue = {id(chain[-1])}, [(chain, names)]
    for chain, names in queue:
        for key, part in chain[-1].items():
            is_unused = (
                len(chain) == 1 and key != used and is_object(part) and find_plugin(part["type"]).kind == "sensor"
            )
            if is_object(part) and id(part) not in visited and not is_unused:
                visited.add(id(part))
                queue.append(((*chain, part), (*names, key)))
                yield queue[-1]


def _search(start: Place, rest: Sequence[str]) -> Iterator[Place]:
    """The places inside an object whose path has the names in `rest`, in this order, the last one at its end."""
    depth, (*outer, last) = len(start.names), rest
    for chain, names in _objects(start.chain, start.names):
        kinds = [find_plugin(part["type"]).kind for part in chain[depth + 1 :]]
        levels = list(zip(names[depth:], kinds, strict=True))
        if last in levels[-1] and _in_order(outer, levels[:-1]):
            yield Place(chain[:-1], names)
        elif ((last in chain[-1] and last != "type") or _accepts(chain[-1], last)) and _in_order(outer, levels):
            yield Place(chain, (*names, last))


def _in_order(names: Sequence[str], levels: Sequence[tuple[str, str]]) -> bool:
    """Whether the names occur in this order among the levels, each a name and a kind."""
    remaining = iter(levels)
    return all(any(name in level for level in remaining) for name in names)


def _unknown(start: Place, rest: Sequence[str], path: str) -> str:
    """The error for a path that names nothing."""
    missing = ".".join(rest)
    if not start.names:
        choices = {".".join(place.names[-count:]) for place in parameter_places(start.chain[0]) for count in (2, 3, 4)}
        choices |= {name for name, part in start.chain[0].items() if is_object(part)}
        return f"the scene has no '{path}'{_hint(closest_name(path, choices))}; Scene.params() lists what it has"
    owner = start.chain[-1]
    names = _names_in(owner)
    inside = {name for chain, _ in _objects(start.chain, start.names) for name in _names_in(chain[-1])}
    hint = closest_name(missing, {*names, *inside})
    plugin = find_plugin(owner["type"])
    return f"{plugin.kind} '{start.path}' has no '{missing}'{_hint(hint)} (it has: {', '.join(names)})"


def _names_in(owner: dict) -> list[str]:
    """The parameters that an object may have, and the objects in it."""
    names = [parameter.name for parameter in find_plugin(owner["type"]).parameters if parameter.status == SUPPORTED]
    names += [key for key in FILM_VALUES if _is_film_value(owner, key)]
    return names + [name for name, part in owner.items() if is_object(part) and name not in names]


def _hint(name: str) -> str:
    return f"; did you mean '{name}'?" if name else ""
