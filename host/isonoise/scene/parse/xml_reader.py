"""Mitsuba XML -> Elements: includes merged, parameters substituted, values parsed, every error with its line."""

import re
from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.parse.elements import Element, Reference, closest_name, path_exists
from isonoise.scene.parse.xml_tags import DEPTH, Tag, parse_tags
from isonoise.scene.parse.xml_upgrade import is_old, upgrade_element, upgrade_tags
from isonoise.scene.parse.xml_values import OPERATIONS, check_attributes, operation, value_of
from isonoise.scene.vocabulary import kinds_of

_INCLUDES = 1000  # files read in all: two includes in each of 30 levels would be a thousand million
_INCLUDE_DEPTH = 15  # as in Mitsuba 3
_ATTRIBUTE = 1 << 20  # characters of one attribute after substitution: parameters may name parameters
_OBJECTS = ("scene", "integrator", "sensor", "film", "rfilter", "sampler", "bsdf", "shape", "emitter", "texture")
_OBJECTS += ("medium", "phase", "volume")
_VALUES = ("float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum")
_OTHERS = ("transform", "ref", "include", "alias", "default", "path")


def _meant(name: str, choices: tuple[str, ...]) -> str:
    """What an unknown element probably stands for: <sphere> is <shape type="sphere">."""
    kinds = kinds_of(name)
    return f'<{kinds[0]} type="{name}">' if kinds else f"<{closest_name(name, choices)}>"


def read_xml(path: Path, parameters: dict[str, str]) -> Element:
    """The Element tree of a scene file; `parameters` replace `$name` and win over <default>.

    Raises SceneError, naming file, line and element, for whatever is not a scene.
    """
    reader = _Reader(parameters)
    root = reader.file(path, ())
    for name in parameters:
        if name not in reader.used:
            known = ", ".join(sorted(reader.used | set(reader.parameters) - set(parameters))) or "none"
            raise SceneError(f"{path}: the scene has no parameter '{name}' (it has: {known})")
    root.aliases = reader.aliases
    return root


class _Reader:
    """What the files of one scene share."""

    def __init__(self, parameters: dict[str, str]):
        self.parameters = dict(parameters)
        self.used: set[str] = set()
        self.aliases: dict[str, str] = {}
        self.open: list[Path] = []
        self.count = 0
        self.depth = 0  # objects that stand inside of each other, through all files
        self.lengths = sorted({len(name) for name in self.parameters}, reverse=True)

    def file(self, path: Path, folders: tuple[Path, ...]) -> Element:
        self.count += 1
        if path.resolve() in self.open:
            raise SceneError(f"{path}: includes itself, directly or through others")
        if len(self.open) > _INCLUDE_DEPTH or self.count > _INCLUDES:
            raise SceneError(f"{path}: too many includes")
        self.open.append(path.resolve())
        tag = parse_tags(path)
        old = is_old(tag)
        if old:
            upgrade_tags(tag)
        root = _File(self, [path.parent, *folders], old).object(tag, root=True)
        self.open.pop()
        return root

    def set_default(self, name: str, value: str):
        """What -D has given stays."""
        self.used.add(name)
        if name not in self.parameters:
            self.parameters[name] = value
            if len(name) not in self.lengths:
                self.lengths = sorted({*self.lengths, len(name)}, reverse=True)

    def parameter_at(self, tag: Tag, text: str, start: int) -> str:
        """The parameter whose name stands there, the longest as in Mitsuba 3: $spp_max is not $spp if both exist."""
        for length in self.lengths:
            name = text[start : start + length]
            if len(name) == length and name in self.parameters:
                self.used.add(name)
                return name
        name = re.match(r"\w*", text[start:])[0]
        hint = closest_name(name, self.parameters)
        tag.location.raise_error(f"undefined parameter ${name}" + (f"; did you mean ${hint}?" if hint else ""))


class _File:
    """Turns the tags of one file into Elements; knows where its relative file names begin."""

    def __init__(self, reader: _Reader, folders: list[Path], old: bool):
        self.reader, self.folders, self.old = reader, folders, old

    def object(self, tag: Tag, root: bool = False) -> Element:
        self.reader.depth += 1
        if self.reader.depth > DEPTH:
            tag.location.raise_error(f"nested more than {DEPTH} levels deep")
        self.substitute(tag)
        if tag.name not in (*_OBJECTS, "spectrum"):
            tag.location.raise_error(f"unknown element; did you mean {_meant(tag.name, _OBJECTS)}?")
        is_scene = root and tag.name == "scene"
        check_attributes(
            tag, () if is_scene else ("type",), ("version", "id", "name", "type") if root else ("id", "name")
        )
        kind = "texture" if tag.name == "spectrum" else tag.name
        type_ = tag.attributes.get("type", "scene")
        element = Element(tag.location, kind, type_, tag.attributes.get("id", ""))
        for child in tag.children:
            self.entry(element, child, root)
        if self.old:
            upgrade_element(element)
        self.reader.depth -= 1
        return element

    def entry(self, parent: Element, tag: Tag, at_root: bool):
        """Add what one child tag says to its parent."""
        self.substitute(tag)
        name = tag.attributes.get("name", "")
        if tag.name in _OBJECTS or (tag.name == "spectrum" and "type" in tag.attributes):
            parent.entries.append((name, self.object(tag), tag.location))
        elif tag.name == "transform":
            check_attributes(tag, ("name",))
            parent.entries.append((name, self.transform(tag), tag.location))
        elif tag.name in _VALUES:
            value = value_of(tag)
            if tag.name == "string" and name == "filename":
                value = str(self.find(tag, value))
            parent.entries.append((name, value, tag.location))
            self.no_children(tag)
        elif tag.name in _OTHERS:
            getattr(self, f"_{tag.name}")(parent, tag, at_root)
            self.no_children(tag)
        elif tag.name in OPERATIONS:
            tag.location.raise_error("belongs inside a <transform>")
        else:
            tag.location.raise_error(
                f"unknown element; did you mean {_meant(tag.name, (*_OBJECTS, *_VALUES, *_OTHERS))}?"
            )

    def no_children(self, tag: Tag):
        if tag.children:
            tag.children[0].location.raise_error(f"cannot stand inside <{tag.name}>")

    def transform(self, tag: Tag) -> np.ndarray:
        """Operations apply in the order they are written: each is multiplied from the left."""
        matrix = np.eye(4)
        for child in tag.children:
            self.substitute(child)
            self.no_children(child)
            with np.errstate(all="ignore"):  # the check of the result tells
                matrix = operation(child) @ matrix
        return matrix

    def _ref(self, parent: Element, tag: Tag, at_root: bool):
        check_attributes(tag, ("id",), ("name",))
        parent.entries.append((tag.attributes.get("name", ""), Reference(tag.attributes["id"]), tag.location))

    def _include(self, parent: Element, tag: Tag, at_root: bool):
        check_attributes(tag, ("filename",), ("name",))
        included = self.reader.file(self.find(tag, tag.attributes["filename"]), tuple(self.folders))
        if included.type == "scene":
            parent.entries.extend(included.entries)
        else:
            parent.entries.append((tag.attributes.get("name", ""), included, tag.location))

    def _alias(self, parent: Element, tag: Tag, at_root: bool):
        check_attributes(tag, ("id", "as"))
        if tag.attributes["as"] in self.reader.aliases:
            tag.location.raise_error(f"the id '{tag.attributes['as']}' is taken")
        self.reader.aliases[tag.attributes["as"]] = tag.attributes["id"]

    def _default(self, parent: Element, tag: Tag, at_root: bool):
        check_attributes(tag, ("name", "value"))
        self.reader.set_default(tag.attributes["name"], tag.attributes["value"])

    def _path(self, parent: Element, tag: Tag, at_root: bool):
        check_attributes(tag, ("value",))
        if not at_root:
            tag.location.raise_error("stands only directly below the root")
        folder = self.find(tag, tag.attributes["value"])
        if not folder.is_dir():
            tag.location.raise_error(f"'{folder}' is not a folder")
        self.folders.insert(0, folder)

    def find(self, tag: Tag, name: str) -> Path:
        """The file or folder of this name in the folders where this file looks."""
        if "\0" in name or not name:
            tag.location.raise_error("a file name is needed here")
        for folder in self.folders:
            if path_exists(folder / name):
                return folder / name
        looked = ", ".join(str(folder) for folder in self.folders)
        tag.location.raise_error(f"there is no '{name}' (looked in {looked})")

    def substitute(self, tag: Tag):
        """Replace $name in the attributes; \\$ is a plain $."""
        for key, text in tag.attributes.items():
            if "$" in text:
                tag.attributes[key] = self._substituted(tag, text)

    def _substituted(self, tag: Tag, text: str) -> str:
        pieces, position, size = [], 0, 0
        while (dollar := text.find("$", position)) >= 0:
            escaped = dollar > position and text[dollar - 1] == "\\"
            name = "" if escaped else self.reader.parameter_at(tag, text, dollar + 1)
            pieces += [text[position : dollar - escaped], "$" if escaped else self.reader.parameters[name]]
            position = dollar + 1 + len(name)
            size += len(pieces[-1])
            if size > _ATTRIBUTE:
                tag.location.raise_error("an attribute grows beyond a million characters by its parameters")
        return "".join([*pieces, text[position:]])
