"""Python dicts in Mitsuba 3's load_dict vocabulary -> Elements."""

from collections.abc import Mapping

import numpy as np

from isonoise.scene.parse.elements import Element, Reference, SourceLocation

_DEPTH = 64  # nesting nobody needs; a dict that holds itself ends here


def read_dict(source: Mapping) -> Element:
    """The Element tree of a scene dict. Raises SceneError with the path of keys where it cannot be one."""
    return _element(source, "", 0)


def _element(source: Mapping, path: str, depth: int) -> Element:
    type_ = source.get("type")
    location = SourceLocation(element=path or "scene")
    if depth > _DEPTH:
        location.raise_error(f"nested more than {_DEPTH} levels deep")
    if not isinstance(type_, str):
        location.raise_error("a scene object is a dict with a 'type' entry, such as {'type': 'sphere'}")
    identifier = source.get("id", path)  # as in Mitsuba 3, what has no id goes by its keys: 'floor.bsdf'
    if not isinstance(identifier, str):
        location.raise_error(f"'id' is a string, got {identifier!r}")
    element = Element(location, "scene" if type_ == "scene" else "", type_, identifier)
    for name, value in source.items():
        if not isinstance(name, str):
            location.raise_error(f"the keys of a scene object are strings, got {name!r}")
        if name in ("type", "id"):
            continue
        below = f"{path}.{name}" if path else name
        element.entries.append((name, _value(value, below, depth), SourceLocation(element=below)))
    return element


def _value(value, path: str, depth: int):
    if isinstance(value, Mapping):
        kind = value.get("type")
        kind = kind if isinstance(kind, str) else None
        if kind in ("rgb", "spectrum"):
            return dict(value)
        if kind == "ref":
            if not isinstance(value.get("id"), str):
                SourceLocation(element=path).raise_error("a reference needs the 'id' of what it refers to")
            return Reference(value["id"])
        return _element(value, path, depth + 1)
    if isinstance(value, (bool, int, float, str)) or value is None:
        return value
    try:
        array = np.asarray(getattr(value, "matrix", value))
    except (TypeError, ValueError):
        array = np.asarray(None)
    if array.dtype.kind not in "biuf":
        return value  # the check against the parameter's type names it
    if array.ndim == 0:
        return array.item()
    return tuple(array.tolist()) if array.ndim == 1 else array
