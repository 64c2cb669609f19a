"""Reads Python dicts in the vocabulary of Mitsuba 3's load_dict into Elements. Called by `load`."""

from collections.abc import Mapping

import numpy as np

from isonoise.scene.parse.elements import Element, Reference, SourceLocation, copy_objects
from isonoise.scene.parse.foreign_values import is_trimesh, plain_value, trimesh_arrays, with_mesh

_MAX_DEPTH = 64  # nested dicts; also ends the recursion of a dict that contains itself


def read_dict(source: Mapping) -> Element:
    """The Element tree of a scene dict. Raises SceneError with the path of keys if it is invalid.

    A dict that is in several places becomes one Element.
    """
    return _DictReader().read_element(source, "", 0)


def read_value(value: object, path: str, scene: object) -> object:
    """A value, which may be a dict, for the place `path` of a scene that is loaded already: see `Element.entries`."""
    return _DictReader(scene).read_value(value, path, 0)


class _DictReader:
    """Reads each dict once. Objects of `scene`, if it is given, stay the same objects; those of others are copied."""

    def __init__(self, scene: object = None):
        self.scene = scene
        self.elements: dict[int, Element] = {}  # by id() of the dict

    def read_element(self, source: Mapping, path: str, depth: int) -> Element:
        if id(source) in self.elements:
            return self.elements[id(source)]
        type_ = source.get("type")
        location = SourceLocation(element=path or "scene")
        if depth > _MAX_DEPTH:
            location.raise_error(f"nested more than {_MAX_DEPTH} levels deep")
        if not isinstance(type_, str):
            location.raise_error("a scene object is a dict with a 'type' entry, such as {'type': 'sphere'}")
        identifier = source.get("id", path)  # as in Mitsuba 3, the default id is the path of keys: 'floor.bsdf'
        if not isinstance(identifier, str):
            location.raise_error(f"'id' has to be a string, got {identifier!r}")
        given, source = source, with_mesh(source, location) if type_ == "mesh" and "mesh" in source else source
        element = Element(location, "scene" if type_ == "scene" else "", type_, identifier)
        for name, value in source.items():
            if not isinstance(name, str):
                location.raise_error(f"the keys of a scene object have to be strings, got {name!r}")
            if name in ("type", "id"):
                continue
            value_path = f"{path}.{name}" if path else name
            entry = (name, self.read_value(value, value_path, depth), SourceLocation(element=value_path))
            element.entries.append(entry)
        self.elements[id(given)] = element
        return element

    def read_value(self, value, path: str, depth: int):
        if hasattr(value, "is_part_of"):
            shared = value.is_part_of(self.scene)
            checked = value.normalised if shared else copy_objects(value.normalised)
            return Element(SourceLocation(element=path), "", checked["type"], "", normalised=checked)
        if isinstance(value, Mapping):
            type_ = value.get("type")
            type_ = type_ if isinstance(type_, str) else None
            if type_ in ("rgb", "spectrum"):
                return dict(value)
            if type_ == "ref":
                if not isinstance(value.get("id"), str):
                    SourceLocation(element=path).raise_error("a reference needs the 'id' of an object")
                return Reference(value["id"])
            if type_ is None and value and all(isinstance(array, np.ndarray) for array in value.values()):
                return dict(value)
            return self.read_element(value, path, depth + 1)
        if isinstance(value, (bool, int, float, str)) or value is None:
            return value
        location = SourceLocation(element=path)
        if is_trimesh(value):
            return self.read_element({"type": "mesh", **trimesh_arrays(value)}, path, depth + 1)
        return plain_value(value, location)
