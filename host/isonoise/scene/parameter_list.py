"""ParameterList: what `Scene.params()` returns; a mapping that prints as a table."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.scene.parse.elements import is_object
from isonoise.scene.parse.plugin_tables import parameter_info
from isonoise.scene.paths import FILM_VALUES, Place, film_value, plain_value
from isonoise.scene.vocabulary import find_plugin
from isonoise.tables import LEFT, Column, Table, columns, html_table, text_table

_MAX_SHOWN_NUMBERS = 4
_MAX_SHOWN_CHARS = 48


@dataclass(frozen=True)
class SceneParameter:
    """A parameter of a scene."""

    path: str
    type: str  # 'number', 'colour', 'transform' and so on
    shape: tuple[int, ...]  # of the value; () if it is a single one
    value: object
    meaning: str  # one line, with the unit


class ParameterList(Mapping[str, object]):
    """The parameters of a scene that have values: path -> value. Prints as a table of paths, types, shapes and values.

    Attributes
    ----------
    parameters : list of SceneParameter
        With types, shapes and meanings.
    """

    def __init__(self, places: Iterable[Place]):
        self.parameters = [_describe(place) for place in places]
        self._values = {parameter.path: parameter.value for parameter in self.parameters}

    def __getitem__(self, path: str) -> object:
        return self._values[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def table(self) -> Table:
        """Path, type, shape and value of each parameter as text."""
        rows = [
            (parameter.path, parameter.type, "x".join(map(str, parameter.shape)), _shown(parameter.value))
            for parameter in self.parameters
        ]
        return Table([Column(head, LEFT) for head in ("path", "type", "shape", "value")], rows)

    def __repr__(self) -> str:
        return text_table(self.table(), indent="")

    def _repr_html_(self) -> str:
        return html_table(self.table())


def count_objects(description: dict) -> Table:
    """How many objects of each type a scene has, grouped by kind; one with several users counts once."""
    found, waiting = {}, [description]
    while waiting:
        part = waiting.pop()
        if id(part) not in found:
            found[id(part)] = part
            waiting += reversed([value for value in part.values() if is_object(value)])
    types = Counter(part["type"] for part in found.values() if part is not description)
    kinds = [find_plugin(name).kind for name in types]
    rows = [(kind, name, str(number)) for kind, (name, number) in zip(kinds, types.items(), strict=True)]
    rows.sort(key=lambda row: kinds.index(row[0]))
    return Table(columns("kind", "type", "number", left=(0, 1)), rows)


def _describe(place: Place) -> SceneParameter:
    if place.is_film_value:
        numbers = film_value(place.owner, place.key)
        return SceneParameter(place.path, "whole numbers", (len(numbers),), numbers, FILM_VALUES[place.key][1])
    value = plain_value(place.owner[place.key])
    parameter = find_plugin(place.owner["type"]).parameter(place.key)
    info = parameter_info(parameter)
    shape = np.shape(getattr(value, "pixels", () if isinstance(value, Mapping) else value))
    return SceneParameter(place.path, info["type"], shape, value, info["meaning"])


def _shown(value: object) -> str:
    """A value in a cell of the table."""
    if isinstance(value, Mapping):
        text = ", ".join(value) if "type" not in value else str(dict(value))
    elif isinstance(value, (np.ndarray, tuple)):
        numbers = np.asarray(value).ravel()
        text = ", ".join(f"{number:g}" for number in numbers[:_MAX_SHOWN_NUMBERS].tolist())
        text += ", ..." * (len(numbers) > _MAX_SHOWN_NUMBERS)
    else:
        text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _MAX_SHOWN_CHARS else "..." + text[3 - _MAX_SHOWN_CHARS :]
