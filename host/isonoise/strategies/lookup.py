"""Finds strategies, measures and allocation rules by name, and names those that are objects.

A name is built-in, or an entry point of an installed package, or `module:name` on Python's path or in the current
directory.
"""

import importlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from isonoise.errors import UserError
from isonoise.suggestions import suggestion

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


@dataclass(frozen=True)
class Kind:
    """A kind of pieces that users can add.

    Attributes
    ----------
    noun : str
        What messages call one.
    entry_point_group : str
        Entry points of installed packages that are of this kind.
    built_in : mapping of str to str
        Name -> module:name, in the order of listings. Only what a render uses is imported.
    """

    noun: str
    entry_point_group: str
    built_in: Mapping[str, str]

    def names(self) -> list[str]:
        """The built-in names, then those of entry points, sorted."""
        installed = {entry.name for entry in entry_points(self.entry_point_group)}
        return [*self.built_in, *sorted(installed - set(self.built_in))]

    def find(self, name: str) -> object:
        """What a name stands for. Raises UserError if there is no such name, or importing it fails."""
        if ":" in name:
            return self._import(name, name)
        if name in self.built_in:
            return self._import(name, self.built_in[name])
        for entry in entry_points(self.entry_point_group):
            if entry.name == name:
                return self._import(name, entry.value)
        known = self.names()
        raise UserError(
            f"there is no {self.noun} '{name}'{suggestion(name, known)}; known are {', '.join(known)}; "
            "name your own as module:name"
        )

    def name_of(self, piece: object) -> str:
        """The name of a class or function: the built-in one or `module:name`."""
        named = piece if hasattr(piece, "__qualname__") else type(piece)
        path = f"{named.__module__}:{named.__qualname__}"
        return next((name for name, built_in in self.built_in.items() if built_in == path), path)

    def _import(self, name: str, path: str) -> object:
        module_name, _, attributes = path.partition(":")
        if "" not in sys.path:
            sys.path.append("")  # the current directory, as `python -m` has it
        try:
            found = module = importlib.import_module(module_name)
        except Exception as error:  # whatever the module raises
            raise UserError(f"{self.noun} '{name}': cannot import '{module_name}': {error}") from error
        for attribute in attributes.split("."):
            if not hasattr(found, attribute):
                names = [name for name, value in vars(module).items() if callable(value)]
                raise UserError(
                    f"{self.noun} '{name}': '{module_name}' has no '{attributes}'{suggestion(attributes, names)}"
                )
            found = getattr(found, attribute)
        return found


STRATEGIES = Kind(
    "strategy",
    "isonoise.strategies",
    {
        "uniform": "isonoise.strategies.uniform:Uniform",
        "pooled": "isonoise.strategies.adaptive:Pooled",
        "relative-median": "isonoise.strategies.adaptive:RelativeMedian",
        "relative-mean": "isonoise.strategies.adaptive:RelativeMean",
        "absolute": "isonoise.strategies.adaptive:Absolute",
        "tsallis": "isonoise.strategies.adaptive:Tsallis",
        "oracle": "isonoise.strategies.oracle:Oracle",
        "adaptive": "isonoise.strategies.adaptive:Adaptive",
        "purgathofer": "isonoise.strategies.purgathofer:Purgathofer",
        "dammertz": "isonoise.strategies.dammertz:Dammertz",
        "cycles": "isonoise.strategies.cycles:Cycles",
        "tungsten": "isonoise.strategies.tungsten:Tungsten",
        "luxcore": "isonoise.strategies.luxcore:LuxCore",
    },
)
MEASURES = Kind(
    "measure",
    "isonoise.measures",
    {
        "relative-mean": "isonoise.strategies.measures:relative_mean",
        "relative-median": "isonoise.strategies.measures:relative_median",
        "absolute": "isonoise.strategies.measures:standard_error",
        "half-buffer": "isonoise.strategies.measures:half_buffer",
    },
)
RULES = Kind(
    "allocation rule",
    "isonoise.allocation_rules",
    {
        "deficit": "isonoise.strategies.allocation:deficit",
        "sqrt": "isonoise.strategies.allocation:deficit_of_sqrt",
        "proportional": "isonoise.strategies.allocation:proportional_to_error",
    },
)


def entry_points(group: str) -> "Iterable[EntryPoint]":
    """Entry points of installed packages. Slow to import: as much time as all other modules of the package."""
    from importlib.metadata import entry_points

    return entry_points(group=group)
