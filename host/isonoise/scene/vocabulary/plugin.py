"""What a plugin is to isonoise: its kind, its parameters with types and defaults, the objects it may hold.

The declarations are in `vocabulary`; checks, defaults and suggestions of the scene reader, `isonoise plugins` and the
tables of host/docs/plugins.md all come from them.
"""

import math
from dataclasses import dataclass

SUPPORTED, IGNORED, UNSUPPORTED = "supported", "ignored", "unsupported"


@dataclass(frozen=True)
class Parameter:
    """One parameter of a plugin, by its Mitsuba 3 name."""

    name: str
    type: str  # 'float', 'integer', 'boolean', 'string', 'vector', 'transform', 'file', 'index' or a colour type
    default: object = None  # None: absent unless given
    interval: str = ""  # numbers: admitted values, e.g. '(0, inf)'
    choices: tuple[str, ...] = ()  # strings: admitted values
    status: str = SUPPORTED  # IGNORED: read over, cannot change the image; UNSUPPORTED: Mitsuba has it, isonoise not
    required: bool = False
    texture: bool = False  # a texture may take the place of the value
    volume: bool = False  # a constvolume may
    meaning: str = ""  # one line, with the unit where there is one; IGNORED, UNSUPPORTED: why
    unset: str = ""  # what holds where it is not given, if `default` does not say it

    def admits(self, value: float) -> bool:
        """Whether a number lies in the interval."""
        if not self.interval:
            return True
        low, high = (float(end) for end in self.interval[1:-1].split(","))
        above = value >= low if self.interval[0] == "[" else value > low
        below = value <= high if self.interval[-1] == "]" else value < high
        return above and below and not math.isnan(value)


COLOURS = ("reflectance", "radiance", "unbounded")
"""Colour types: a reflectance within [0, 1], an emission (D65 is white), and a quantity without bound (eta, k)."""


@dataclass(frozen=True)
class Child:
    """Nested objects of one kind that a plugin may hold."""

    kind: str
    most: int = 1
    least: int = 0
    types: tuple[str, ...] = ()  # admitted plugins; () is all of the kind
    names: tuple[str, ...] = ()  # what each is called, if that says what it is for; it is kept under its name


@dataclass(frozen=True)
class Plugin:
    """One plugin that is read."""

    kind: str
    name: str
    parameters: tuple[Parameter, ...] = ()
    children: tuple[Child, ...] = ()
    any_parameter: bool = False  # parameters that are not declared are read over (samplers)
    status: str = SUPPORTED  # IGNORED: read over, what it adds cannot change the image
    meaning: str = ""  # one line; IGNORED: why

    def parameter(self, name: str) -> Parameter | None:
        return next((p for p in self.parameters if p.name == name), None)

    def child(self, kind: str) -> Child | None:
        return next((c for c in self.children if c.kind == kind), None)
