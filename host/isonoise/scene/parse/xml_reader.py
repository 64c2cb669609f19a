"""Reads Mitsuba XML files into Elements: merges includes, substitutes parameters and parses values.

Called by `load`. Every error names the file and the line.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import is_inside, outside_message
from isonoise.scene.parse.elements import Element, Location, Reference, did_you_mean, path_exists
from isonoise.scene.parse.xml_tags import MAX_DEPTH, Tag, iterate_tags
from isonoise.scene.parse.xml_upgrade import needs_upgrade, upgrade_element, upgrade_tag
from isonoise.scene.parse.xml_values import TRANSFORM_OPERATIONS, check_attributes, parse_value, transform_matrix
from isonoise.scene.vocabulary import kinds_of
from isonoise.suggestions import closest_name

_MAX_FILES = 1000  # in total: two includes in each of 30 levels would be 10^9
_MAX_INCLUDE_DEPTH = 15  # as in Mitsuba 3
_MAX_ATTRIBUTE_CHARS = 1 << 20  # after substitution: parameters can contain parameters
_OBJECTS = ("scene", "integrator", "sensor", "film", "rfilter", "sampler", "bsdf", "shape", "emitter", "texture")
_OBJECTS += ("medium", "phase", "volume")
_OBJECT_SET = frozenset(_OBJECTS)
_VALUES = ("float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum")
_NUMBERS, _CONSTANTS = frozenset(("float", "point", "vector")), frozenset(("ref", "boolean", "string", "integer"))
_MAX_PROTOTYPES = 10_000  # bounds their memory where every object has another structure
_DIRECTIVES = ("ref", "include", "alias", "default", "path")

Sink = Callable[[str, object, Location], None]
"""Takes an entry of the scene: see `Element.entries`."""


def read_xml(path: Path, parameters: dict[str, str], folder: Path | None = None, sink: Sink | None = None) -> Element:
    """The Element tree of a scene file; `parameters` replace `$name` and override <default>.

    With a `sink`, the entries of the scene go there as soon as they are read, and not into the root Element. Files
    that it names have to be inside `folder`, unless that is None. Raises SceneError, with file, line and element, if
    the scene is invalid.
    """
    reader = _SceneReader(parameters, folder, sink)
    with np.errstate(all="ignore"):  # check_value rejects what is not finite
        root = reader.read_file(path, (), is_scene=True)
    for name in parameters:
        if name not in reader.used:
            known = ", ".join(sorted(reader.used | set(reader.parameters) - set(parameters))) or "none"
            raise SceneError(f"{path}: the scene has no parameter '{name}' (it has: {known})")
    root.aliases = reader.aliases
    return root


def _suggestion(name: str, choices: tuple[str, ...]) -> str:
    """The end of an error about an unknown element: what it probably means. <sphere> means <shape type="sphere">."""
    kinds, hint = kinds_of(name), closest_name(name, choices)
    meant = f'{kinds[0]} type="{name}"' if kinds else hint
    return f"; did you mean <{meant}>?" if meant else f" (known: {', '.join(choices)})"


def _structure(tag: Tag) -> tuple | None:
    """All of an object but its id and its numbers; None if it contains objects, file names or parameters."""
    parts: list = [tag.name, *((key, value) for key, value in tag.attributes.items() if key != "id")]
    for child in tag.children:
        attributes = child.attributes
        parts += (child.name, len(child.children), attributes.get("name"), *attributes)
        if child.name == "transform":
            for operation in child.children:
                parts += (operation.name, *operation.attributes)
                if operation.children or "$" in "".join(operation.attributes.values()):
                    return None
        elif child.name not in _NUMBERS:
            if child.name not in _CONSTANTS or attributes.get("name") == "filename":
                return None
            parts += attributes.values()
        if "$" in "".join(attributes.values()):
            return None
    return tuple(parts)


class _SceneReader:
    """State that all files of one scene share."""

    def __init__(self, parameters: dict[str, str], folder: Path | None, sink: Sink | None):
        self.parameters = dict(parameters)
        self.folder = folder  # all files have to be inside it, unless it is None
        self.sink = sink
        self.used: set[str] = set()  # names of parameters
        self.aliases: dict[str, str] = {}
        self.prototypes: dict[tuple, Element] = {}  # by structure
        self.open_files: list[Path] = []
        self.file_count = 0
        self.depth = 0  # of nested objects, across files
        self.name_lengths = sorted({len(name) for name in self.parameters}, reverse=True)

    def read_file(self, path: Path, folders: tuple[Path, ...], is_scene: bool) -> Element:
        """The root Element of a file. Its entries go to the sink if it `is_scene`: the scene itself or a part of it."""
        self.file_count += 1
        if path.resolve() in self.open_files:
            raise SceneError(f"{path}: includes itself, directly or through other files")
        if len(self.open_files) > _MAX_INCLUDE_DEPTH or self.file_count > _MAX_FILES:
            raise SceneError(f"{path}: too many includes")
        self.open_files.append(path.resolve())
        tags = iterate_tags(path)
        tag = next(tags)
        is_old = needs_upgrade(tag)
        file = _FileReader(self, [path.parent, *folders], is_old, self.sink if is_scene else None)
        root = file.read_object(tag, tags)
        self.open_files.pop()
        return root

    def set_default(self, name: str, value: str):
        """Set a parameter unless it has a value, as from the command line."""
        self.used.add(name)
        if name not in self.parameters:
            self.parameters[name] = value
            if len(name) not in self.name_lengths:
                self.name_lengths = sorted({*self.name_lengths, len(name)}, reverse=True)

    def parameter_at(self, tag: Tag, text: str, start: int) -> str:
        """The longest parameter name at this position, as in Mitsuba 3: $spp_max is not $spp if both exist."""
        for length in self.name_lengths:
            name = text[start : start + length]
            if len(name) == length and name in self.parameters:
                self.used.add(name)
                return name
        name = re.match(r"\w*", text[start:])[0]
        tag.raise_error(f"undefined parameter ${name}{did_you_mean(name, self.parameters)}")


class _FileReader:
    """Turns the tags of one file into Elements. Relative file names are searched in `folders`."""

    def __init__(self, scene: _SceneReader, folders: list[Path], is_old: bool, sink: Sink | None):
        self.scene, self.folders, self.is_old, self.sink = scene, folders, is_old, sink

    def read_object(self, tag: Tag, root_children: Iterator[Tag] | None = None) -> Element:
        """The Element of a tag. That of the root gets its children by an iterator."""
        self.scene.depth += 1
        if self.scene.depth > MAX_DEPTH:
            tag.raise_error(f"nested more than {MAX_DEPTH} levels deep")
        is_root = root_children is not None
        if is_root:
            self.prepare(tag)
        if tag.name not in _OBJECT_SET and tag.name != "spectrum":
            tag.raise_error(f"unknown element{_suggestion(tag.name, _OBJECTS)}")
        required = () if is_root and tag.name == "scene" else ("type",)
        check_attributes(tag, required, ("version", "id", "name", "type") if is_root else ("id", "name"))
        kind = "texture" if tag.name == "spectrum" else tag.name
        element = Element(tag, kind, tag.attributes.get("type", "scene"), tag.attributes.get("id", ""))
        sink = self.sink if is_root and element.type == "scene" else None
        for child in root_children if is_root else tag.children:
            self.read_entry(element, child, is_root)
            if sink:
                self.finish(element)
                for entry in element.entries:
                    sink(*entry)
                element.entries.clear()
        self.finish(element)
        self.scene.depth -= 1
        return element

    def read_similar_object(self, tag: Tag) -> Element:
        """The Element of a tag. If an earlier one differs from it in numbers only, all else need not be read again."""
        structure = _structure(tag) if self.sink and not self.is_old else None
        prototype = self.scene.prototypes.get(structure) if structure else None
        if prototype is None:
            element = self.read_object(tag)
            if structure and len(self.scene.prototypes) < _MAX_PROTOTYPES:
                self.scene.prototypes[structure] = element
            return element
        entries = []
        for child in tag.children:
            if child.name == "transform":
                entries.append((child.attributes["name"], self.read_transform(child), child))
            elif child.name in _NUMBERS:
                entries.append((child.attributes["name"], parse_value(child), child))
        return Element(tag, prototype.kind, prototype.type, tag.attributes.get("id", ""), entries, prototype=prototype)

    def prepare(self, tag: Tag):
        """Bring a tag to its present form: of an old file its name, of all files the values of parameters."""
        if self.is_old:
            upgrade_tag(tag)
        for key, text in tag.attributes.items():
            if "$" in text:
                tag.attributes[key] = self._substituted(tag, text)

    def finish(self, element: Element):
        if self.is_old:
            upgrade_element(element)

    def read_entry(self, parent: Element, tag: Tag, is_in_root: bool):
        """Add the content of a child tag to its parent."""
        self.prepare(tag)
        name = tag.attributes.get("name", "")
        if tag.name in _OBJECT_SET or (tag.name == "spectrum" and "type" in tag.attributes):
            parent.entries.append((name, self.read_similar_object(tag) if is_in_root else self.read_object(tag), tag))
        elif tag.name == "transform":
            check_attributes(tag, ("name",))
            parent.entries.append((name, self.read_transform(tag), tag))
        elif tag.name in _VALUES:
            value = parse_value(tag)
            if tag.name == "string" and name == "filename":
                value = str(self.find_path(tag, value))
            parent.entries.append((name, value, tag))
            self.check_no_children(tag)
        elif tag.name in _DIRECTIVES:
            getattr(self, f"read_{tag.name}")(parent, tag, is_in_root)
            self.check_no_children(tag)
        elif tag.name in TRANSFORM_OPERATIONS:
            tag.raise_error("has to be inside a <transform>")
        else:
            choices = (*_OBJECTS, *_VALUES, "transform", *_DIRECTIVES)
            tag.raise_error(f"unknown element{_suggestion(tag.name, choices)}")

    def check_no_children(self, tag: Tag):
        if tag.children:
            tag.children[0].raise_error(f"cannot be inside <{tag.name}>")

    def read_transform(self, tag: Tag) -> np.ndarray:
        """Operations apply in the order in which they are written: each is multiplied from the left."""
        matrix = np.eye(4)
        for child in tag.children:
            self.prepare(child)
            self.check_no_children(child)
            matrix = transform_matrix(child) @ matrix
        return matrix

    def read_ref(self, parent: Element, tag: Tag, is_in_root: bool):
        check_attributes(tag, ("id",), ("name",))
        parent.entries.append((tag.attributes.get("name", ""), Reference(tag.attributes["id"]), tag))

    def read_include(self, parent: Element, tag: Tag, is_in_root: bool):
        check_attributes(tag, ("filename",), ("name",))
        path = self.find_path(tag, tag.attributes["filename"])
        included = self.scene.read_file(path, tuple(self.folders), is_scene=is_in_root and self.sink is not None)
        if included.type == "scene":
            parent.entries.extend(included.entries)
        else:
            parent.entries.append((tag.attributes.get("name", ""), included, tag))

    def read_alias(self, parent: Element, tag: Tag, is_in_root: bool):
        check_attributes(tag, ("id", "as"))
        if tag.attributes["as"] in self.scene.aliases:
            tag.raise_error(f"the id '{tag.attributes['as']}' already exists")
        self.scene.aliases[tag.attributes["as"]] = tag.attributes["id"]

    def read_default(self, parent: Element, tag: Tag, is_in_root: bool):
        check_attributes(tag, ("name", "value"))
        self.scene.set_default(tag.attributes["name"], tag.attributes["value"])

    def read_path(self, parent: Element, tag: Tag, is_in_root: bool):
        check_attributes(tag, ("value",))
        if not is_in_root:
            tag.raise_error("has to be directly below the root")
        folder = self.find_path(tag, tag.attributes["value"])
        if not folder.is_dir():
            tag.raise_error(f"'{folder}' is not a folder")
        self.folders.insert(0, folder)

    def find_path(self, tag: Tag, name: str) -> Path:
        """The file or folder of this name in the first folder that has it."""
        if "\0" in name or not name:
            tag.raise_error("a file name is missing")
        for path in (folder / name for folder in self.folders):
            if path_exists(path):
                if not is_inside(path, self.scene.folder):
                    tag.raise_error(outside_message(path, self.scene.folder))
                return path
        searched = ", ".join(str(folder) for folder in self.folders)
        tag.raise_error(f"there is no '{name}' (searched in {searched})")

    def _substituted(self, tag: Tag, text: str) -> str:
        pieces, position, size = [], 0, 0
        while (dollar := text.find("$", position)) >= 0:
            is_escaped = dollar > position and text[dollar - 1] == "\\"
            name = "" if is_escaped else self.scene.parameter_at(tag, text, dollar + 1)
            pieces += [text[position : dollar - is_escaped], "$" if is_escaped else self.scene.parameters[name]]
            position = dollar + 1 + len(name)
            size += len(pieces[-1])
            if size > _MAX_ATTRIBUTE_CHARS:
                tag.raise_error("an attribute exceeds a million characters after parameter substitution")
        return "".join([*pieces, text[position:]])
