"""The types of the vocabulary: Plugin, its Parameters with types and defaults, and its Children.

The scene reader's checks, defaults and suggestions, `isonoise plugins` and the tables of host/docs/plugins.md are all
derived from these declarations.
"""

import math
from dataclasses import dataclass
from functools import cached_property

SUPPORTED, IGNORED, UNSUPPORTED = "supported", "ignored", "unsupported"


@dataclass(frozen=True)
class Parameter:
    """One parameter of a plugin, by its Mitsuba 3 name."""

    name: str
    type: str  # 'float', 'integer', 'boolean', 'string', 'vector', 'transform', 'file', 'index' or a colour type
    default: object = None  # None: the parameter is absent unless given
    interval: str = ""  # numbers: allowed values, e.g. '(0, inf)'
    choices: tuple[str, ...] = ()  # strings: allowed values
    status: str = SUPPORTED  # IGNORED: does not change the image; UNSUPPORTED: only Mitsuba has it
    required: bool = False
    texture: bool = False  # a texture is allowed instead of a value
    volume: tuple[str, ...] = ()  # volumes that are allowed instead of a value
    meaning: str = ""  # one line, with the unit; IGNORED, UNSUPPORTED: the reason
    unset: str = ""  # the default in words, if `default` is None

    def admits(self, value: float) -> bool:
        """Whether a number lies in the interval."""
        if not self.interval:
            return True
        low, high = self._ends
        above = value >= low if self.interval[0] == "[" else value > low
        below = value <= high if self.interval[-1] == "]" else value < high
        return above and below and not math.isnan(value)

    @cached_property
    def _ends(self) -> tuple[float, float]:
        low, high = self.interval[1:-1].split(",")
        return float(low), float(high)


COLOURS = ("reflectance", "radiance", "unbounded")
"""Colour types: reflectance in [0, 1], emission (D65 is white), and unbounded quantities (eta, k)."""


@dataclass(frozen=True)
class Child:
    """The nested objects of one kind that a plugin can contain."""

    kind: str
    max_count: int = 1
    min_count: int = 0
    types: tuple[str, ...] = ()  # allowed plugins; (): all of the kind
    names: tuple[str, ...] = ()  # allowed names, if the name tells the purpose
    referenced_only: tuple[str, ...] = ()  # plugins that take effect only where a reference names their id


@dataclass(frozen=True)
class Plugin:
    """One supported plugin."""

    kind: str
    name: str
    parameters: tuple[Parameter, ...] = ()
    children: tuple[Child, ...] = ()
    any_parameter: bool = False  # undeclared parameters are ignored (samplers)
    status: str = SUPPORTED  # IGNORED: it does not change the image
    meaning: str = ""  # one line; IGNORED: the reason

    @cached_property
    def _parameters(self) -> dict[str, Parameter]:
        return {parameter.name: parameter for parameter in reversed(self.parameters)}

    @cached_property
    def _children(self) -> dict[str, Child]:
        return {child.kind: child for child in reversed(self.children)}

    @cached_property
    def child_kinds(self) -> tuple[str, ...]:
        return tuple(child.kind for child in self.children)

    @cached_property
    def completed_parameters(self) -> tuple[Parameter, ...]:
        """Those that are required or have a default."""
        supported = [parameter for parameter in self.parameters if parameter.status == SUPPORTED]
        return tuple(parameter for parameter in supported if parameter.required or parameter.default is not None)

    @cached_property
    def required_children(self) -> tuple[Child, ...]:
        return tuple(child for child in self.children if child.min_count)

    def parameter(self, name: str) -> Parameter | None:
        return self._parameters.get(name)

    def child(self, kind: str) -> Child | None:
        return self._children.get(kind)
