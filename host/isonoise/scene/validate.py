"""Elements as read -> the normalised scene description, checked against the registry.

Every check of names, types and ranges is here, so that XML files and Python dicts go through the same ones.
"""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from isonoise.scene import vocabulary
from isonoise.scene.materials import conductors, refractive_indices
from isonoise.scene.registry import COLOURS, IGNORED, UNSUPPORTED, Parameter, Plugin
from isonoise.scene.source import Element, Place, Reference, nearest

_SEVERAL = ("scene",)  # kinds whose children keep their names; elsewhere a child is named by its kind


def normalise(root: Element) -> dict:
    """The description: plain dicts with defaults filled in, references replaced by what they refer to (one dict each).

    Raises SceneError for whatever is outside the vocabulary.
    """
    if root.type != "scene":
        root.place.fail(f"the root of a scene is of type 'scene', not '{root.type}'")
    return _Normaliser(root).object(root, "scene")


class _Normaliser:
    """One pass over the Elements; keeps what is done, so that an object that is referred to twice is one dict."""

    def __init__(self, root: Element):
        self.ids: dict[str, Element] = {}
        self.done: dict[int, dict] = {}
        self.active: set[int] = set()
        self._collect_ids(root)
        for alias, name in root.aliases.items():
            if name not in self.ids or alias in self.ids:
                problem = "is taken" if alias in self.ids else f"stands for '{name}', which does not exist"
                root.place.fail(f"the alias '{alias}' {problem}")
            self.ids[alias] = self.ids[name]

    def _collect_ids(self, root: Element):
        queue = [root]
        while queue:
            element = queue.pop()
            if element.id and self.ids.setdefault(element.id, element) is not element and element.kind != "":
                element.place.fail(f"the id '{element.id}' is taken by {self.ids[element.id].place}")
            queue.extend(value for _, value, _ in element.entries if isinstance(value, Element))

    def object(self, element: Element, *kinds: str) -> dict:
        """The normalised dict of an Element that may be of one of these kinds."""
        if id(element) in self.done:
            return self.done[id(element)]
        if id(element) in self.active:
            element.place.fail("refers to itself, directly or through others")
        self.active.add(id(element))
        plugin = self.plugin(element, kinds)
        result = {"type": plugin.name}
        if element.id and plugin.kind != "scene":
            result["id"] = element.id
        for name, value, place in element.entries:
            if isinstance(value, (Element, Reference)):
                self.child(plugin, result, name, value, place)
            else:
                self.parameter(plugin, result, name, value, place)
        self.complete(plugin, result, element.place)
        self.active.discard(id(element))
        self.done[id(element)] = result
        return result

    def plugin(self, element: Element, kinds: tuple[str, ...]) -> Plugin:
        kind = self.kind(element, kinds)
        supported = vocabulary.plugins_of(kind)
        if element.type in supported:
            return supported[element.type]
        if element.type in vocabulary.ELSEWHERE.get(kind, ()):
            if not supported:
                element.place.fail(f"{kind} '{element.type}' is not supported (Mitsuba 3 has it); give a plain value")
            listed = ", ".join(sorted(supported))
            hint = nearest(element.type, supported)
            element.place.fail(
                f"{kind} '{element.type}' is not supported (Mitsuba 3 has it); nearest: '{hint}' (supported: {listed})"
            )
        listed = ", ".join(sorted(supported)) or "none"
        hint = nearest(element.type, supported)
        element.place.fail(f"unknown {kind} '{element.type}'; did you mean '{hint}'? (supported: {listed})")

    def kind(self, element: Element, kinds: tuple[str, ...]) -> str:
        """The kind of an Element: its tag's; for dicts one that has a plugin of this name, best of `kinds`."""
        if element.kind:
            return element.kind
        known = vocabulary.kinds_of(element.type)
        fitting = [kind for kind in known if kind in kinds] or list(known)
        if fitting:
            return fitting[0]
        names = [p.name for p in vocabulary.PLUGINS if p.kind in kinds]
        element.place.fail(f"unknown type '{element.type}'; did you mean '{nearest(element.type, names)}'?")

    def child(self, plugin: Plugin, result: dict, name: str, value, place: Place):
        """Enter a nested object, or the one that a reference names, into its parent."""
        element = value
        if isinstance(value, Reference):
            element = self.ids.get(value.id)
            if element is None:
                hint = nearest(value.id, self.ids)
                place.fail(f"nothing has the id '{value.id}'" + (f"; did you mean '{hint}'?" if hint else ""))
        kinds = tuple(child.kind for child in plugin.children)
        kind = self.kind(element, kinds)
        child = plugin.child(kind)
        parameter = plugin.parameter(name)
        if parameter is not None and parameter.status == IGNORED:
            return
        if child is None:
            if kind in ("texture", "medium", "phase", "volume") or not kinds:
                self.plugin(element, (kind,))
            listed = ", ".join(kinds) or "no objects"
            place.fail(f"a {plugin.kind} '{plugin.name}' cannot hold a {kind} (it may hold: {listed})")
        nested = self.object(element, *kinds)
        if child.types and nested["type"] not in child.types:
            place.fail(f"{plugin.name} cannot hold a {kind} '{nested['type']}' (it may hold: {', '.join(child.types)})")
        self.enter(plugin, child, result, name, nested, place)

    def enter(self, plugin: Plugin, child, result: dict, name: str, nested: dict, place: Place):
        held = [v for v in result.values() if isinstance(v, dict) and self.is_kind(v, child.kind)]
        if plugin.kind == "scene":
            key = nested.get("id") or name or child.kind
            if len(held) >= child.most:
                place.fail(f"a scene has only one {child.kind}")
            while key in result:
                key = f"{child.kind}_{len(result)}"
            result[key] = nested
        elif plugin.name == "twosided" and held and held[0] is not nested and held[0] != nested:
            place.fail("different materials on the two sides are not supported; give one nested bsdf")
        elif len(held) >= child.most:
            place.fail(f"{plugin.name} may hold only one {child.kind}")
        else:
            result[child.kind] = nested

    @staticmethod
    def is_kind(nested: dict, kind: str) -> bool:
        return nested.get("type") in vocabulary.plugins_of(kind)

    def parameter(self, plugin: Plugin, result: dict, name: str, value, place: Place):
        parameter = plugin.parameter(name)
        if parameter is None:
            if plugin.any_parameter:
                return
            names = [p.name for p in plugin.parameters if p.status != UNSUPPORTED] + [c.kind for c in plugin.children]
            hint = nearest(name, names)
            does = f"; did you mean '{hint}'?" if hint else ""
            listed = f" (known: {', '.join(names)})" if names else " (it has none)"
            place.fail(f"{plugin.kind} '{plugin.name}' has no parameter '{name}'{does}{listed}")
        if parameter.status == UNSUPPORTED:
            place.fail(f"parameter '{name}' of {plugin.kind} '{plugin.name}' is not supported (Mitsuba 3 has it)")
        if parameter.status == IGNORED:
            return
        if name in result:
            place.fail(f"'{name}' is given twice")
        result[name] = check_value(parameter, value, place)

    def complete(self, plugin: Plugin, result: dict, place: Place):
        """Fill in defaults; complain about what is required and about combinations that exclude each other."""
        for parameter in plugin.parameters:
            if parameter.name in result or parameter.status != "supported":
                continue
            if parameter.required:
                place.fail(f"{plugin.kind} '{plugin.name}' needs a '{parameter.name}'")
            if parameter.default is not None:
                result[parameter.name] = parameter.default
        for child in plugin.children:
            if sum(1 for v in result.values() if isinstance(v, dict) and self.is_kind(v, child.kind)) < child.least:
                place.fail(f"{plugin.kind} '{plugin.name}' needs a nested {child.kind}")
        for first, second in _EXCLUSIVE.get(plugin.name, ()):
            if first in result and second in result:
                place.fail(f"give '{first}' or '{second}', not both")
        if plugin.name == "perspective" and result["near_clip"] >= result["far_clip"]:
            place.fail("near_clip has to be smaller than far_clip")
        if plugin.name == "conductor" and "material" in result and result["material"] not in conductors():
            hint = nearest(result["material"], conductors())
            place.fail(f"unknown conductor '{result['material']}'; did you mean '{hint}'?")
        if plugin.name == "mesh":
            count = len(result["vertices"])
            if len(result.get("normals", result["vertices"])) != count:
                place.fail("there have to be as many normals as vertices")
            if not len(result["faces"]) or result["faces"].min() < 0 or result["faces"].max() >= count:
                place.fail(f"there are no faces, or one names a vertex that does not exist (there are {count})")
        if plugin.name in ("moment", "aov"):
            inner = result["integrator"]
            result.clear()
            result.update(inner)


_EXCLUSIVE = {
    "perspective": (("fov", "focal_length"),),
    "conductor": (("material", "eta"), ("material", "k")),
    "point": (("position", "to_world"),),
    "directional": (("direction", "to_world"),),
}


def check_value(parameter: Parameter, value, place: Place):
    """The value as the parameter's Python type. Raises SceneError where it is not of that type or out of range."""
    type_ = parameter.type
    if type_ in COLOURS:
        return _colour(type_, value, place)
    if type_ == "index":
        return _index(value, place)
    check = _CHECKS[type_]
    result = check(value)
    if result is None:
        place.fail(f"'{parameter.name}' is {_MEANING[type_]}, got {_shown(value)}")
    if parameter.interval and not parameter.admits(result):
        place.fail(f"'{parameter.name}' has to lie in {parameter.interval}, got {_shown(value)}")
    if parameter.choices and result not in parameter.choices:
        hint = nearest(result, parameter.choices)
        place.fail(
            f"'{parameter.name}' is one of {', '.join(parameter.choices)}; got '{result}', did you mean '{hint}'?"
        )
    return result


def _float(value) -> float | None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number and math.isfinite(value) else None


def _vector(value) -> tuple[float, float, float] | None:
    if not isinstance(value, tuple) or len(value) != 3 or any(_float(v) is None for v in value):
        return None
    return tuple(float(v) for v in value)


def _transform(value) -> np.ndarray | None:
    good = isinstance(value, np.ndarray) and value.shape == (4, 4) and np.isfinite(value).all()
    return value.astype(np.float64) if good else None


def _integer(value) -> int | None:
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def _positions(value) -> np.ndarray | None:
    good = isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 3 and np.isfinite(value).all()
    return value.astype(np.float64) if good else None


def _indices(value) -> np.ndarray | None:
    good = isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] == 3 and value.dtype.kind in "iu"
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
}
_MEANING = {
    "float": "a finite number",
    "integer": "a whole number",
    "boolean": "true or false",
    "string": "a string",
    "file": "a file name",
    "vector": "three finite numbers",
    "transform": "a transform of finite numbers",
    "positions": "an array of n x 3 finite numbers",
    "indices": "an array of n x 3 whole numbers",
}


def _index(value, place: Place) -> float:
    """An index of refraction, by number or by name."""
    named = refractive_indices()
    if isinstance(value, str):
        if value.lower() not in named:
            place.fail(f"unknown material '{value}'; did you mean '{nearest(value, named)}'? (or give a number)")
        return named[value.lower()]
    number = _float(value)
    if number is None or number <= 0:
        place.fail(f"an index of refraction is a positive number or a material's name, got {_shown(value)}")
    return number


def _colour(kind: str, value, place: Place):
    """A float, or a dict of type 'rgb' (three floats) or 'spectrum' (one float, or pairs of wavelength and value)."""
    if isinstance(value, dict) and value["type"] == "spectrum":
        return {"type": "spectrum", "value": _spectrum(kind, value, place)}
    if isinstance(value, dict):
        given = value.get("value")
        given = tuple(np.atleast_1d(np.asarray(given, dtype=object)).tolist()) if given is not None else ()
        channels = given * 3 if len(given) == 1 else given
        if _vector(channels) is None:
            place.fail(f"an rgb colour is one or three finite numbers, got {_shown(value.get('value'))}")
        _bounds(kind, channels, place)
        return {"type": "rgb", "value": [float(v) for v in channels]}
    number = _float(value)
    if number is None:
        place.fail(f"a colour is a number, an rgb value or a spectrum, got {_shown(value)}")
    _bounds(kind, (number,), place)
    return number


def _spectrum(kind: str, value: dict, place: Place):
    given = value.get("value")
    number = _float(given)
    if number is not None:
        _bounds(kind, (number,), place)
        return number
    try:
        pairs = [(float(w), float(v)) for w, v in given]
    except (TypeError, ValueError):
        place.fail(f"a spectrum is one number or pairs of wavelength and value, got {_shown(given)}")
    if len(pairs) < 2 or not np.isfinite(pairs).all():
        place.fail("a spectrum needs two or more pairs of finite numbers")
    if any(b[0] <= a[0] for a, b in pairwise(pairs)):
        place.fail("the wavelengths of a spectrum have to increase")
    _bounds("unbounded", [v for _, v in pairs], place)
    return pairs


def _bounds(kind: str, channels, place: Place):
    if min(channels) < 0:
        place.fail(f"a {'colour' if kind == 'unbounded' else kind} is not negative, got {_shown(channels)}")
    if kind == "reflectance" and max(channels) > 1:
        place.fail(f"a reflectance is at most 1, got {_shown(channels)}")


def _shown(value) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
