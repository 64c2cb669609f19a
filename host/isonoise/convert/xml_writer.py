"""Writes a scene description as Mitsuba 3 XML. Called by `convert.py`.

What the vocabulary has as default is left out. An object that is used several times is written once, with an id, and
referenced.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TextIO
from xml.sax.saxutils import quoteattr

import numpy as np

from isonoise.convert.scene_files import SceneFiles, plain_name
from isonoise.errors import SceneError
from isonoise.scene.parse.elements import SourceLocation
from isonoise.scene.parse.parameter_values import check_value
from isonoise.scene.unique_names import UniqueNames
from isonoise.scene.vocabulary import plugins_of
from isonoise.scene.vocabulary.plugin import Parameter, Plugin

_Nested = tuple[str, str, dict]  # (kind, key, object) of an object in another one
_INDENT = "    "
_INVALID = re.compile("[^\t -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # characters that XML 1.0 does not allow
_FORMAT_VERSION = "3.0.0"
_KINDS = ("integrator", "sensor", "shape", "emitter")
"""Kinds of objects in a scene, in the order of the file; before them come shared objects."""
_SHARED_KINDS = ("texture", "volume", "medium", "bsdf")
"""Kinds of objects that several others may reference in Mitsuba 3; shape groups may be, too."""
_COLOUR_TYPES = ("rgb", "spectrum")
_NO_OBJECTS = (*_COLOUR_TYPES, None)  # None: mesh attributes
_OWN_PARAMETERS = ("exposure",)
"""Parameters that Mitsuba 3 does not have and would refuse."""
_IN_MEMORY = ("image", "grid")
"""Types of parameters that become files."""
_MIN_ENTRY = 2.0**-40
"""Of a matrix, relative to the largest of its row and its column: smaller ones are rounding errors of rotations."""
_MAX_CHANGE = 2.0**-10  # of a determinant, relative: beyond it, numbers keep the precision of 64 bits
_MAX_DISTANCE = 2.0**8
"""Translation, relative to the scale, up to which the numbers of a matrix are written with the precision of 32 bits."""


def write_scene(file: TextIO, description: dict, files: SceneFiles, ids: Mapping[int, str], comment: list[str]) -> None:
    """Write a scene.

    Parameters
    ----------
    file : TextIO
        The XML file.
    description : dict
        The scene, as `load` returns it.
    files : SceneFiles
        Takes the meshes and images.
    ids : mapping
        Ids of objects by id() of their dicts; others get new ones if they need one.
    comment : list of str
        Lines of the comment at the top.
    """
    file.write(f'<?xml version="1.0" encoding="utf-8"?>\n<scene version="{_FORMAT_VERSION}">\n')
    if comment:
        text = "\n         ".join(_INVALID.sub("?", line).replace("--", "- -") for line in comment)
        file.write(f"    <!-- {text} -->\n")
    _Writer(file, files, ids, description).write_all()
    file.write("</scene>\n")


class _Writer:
    def __init__(self, file: TextIO, files: SceneFiles, ids: Mapping[int, str], description: dict):
        self.file, self.files, self.ids, self.description = file, files, ids, description
        self.use_counts: Counter[int] = Counter()  # by id() of objects
        self.id_of_written: dict[int, str] = {}  # by id() of the objects at the top that may be referenced
        self.unique_ids = UniqueNames()
        self.last_kind = ""

    def write_all(self) -> None:
        """Write the objects of the scene by kind, and shared ones before all that use them."""
        objects = list(_nested("scene", self.description))
        self.count_uses(objects)
        for kind in _KINDS:
            same_kind = [nested for nested in objects if nested[0] == kind and nested[2]["type"] != "shapegroup"]
            for _, key, value in same_kind:
                for nested in _nested(kind, value):
                    self.write_shared(*nested, self.name(kind, key, value))
            for _, key, value in same_kind:
                self.write_top(kind, self.name(kind, key, value), value)

    def count_uses(self, objects: Iterable[_Nested]) -> None:
        """Count how often each object is nested in another one."""
        visited: set[int] = set()
        queue = list(objects)
        while queue:
            kind, _, value = queue.pop()
            if id(value) not in visited:
                visited.add(id(value))
                for nested in _nested(kind, value):
                    self.use_counts[id(nested[2])] += 1
                    queue.append(nested)

    def name(self, kind: str, key: str, value: dict, parent: str = "") -> str:
        """What to call an object: its id, unless that is a path of keys, else the name of its parent and its key."""
        id_ = self.ids.get(id(value), "")
        if id_ and ("." not in id_ or not parent):
            return id_
        is_only_child = key.startswith((kind, "shape"))
        return (parent if is_only_child else f"{parent}_{key}") if parent else key

    def write_top(self, kind: str, name: str, value: dict) -> None:
        """Write an object of the scene."""
        if kind != self.last_kind:
            self.file.write("\n")
            self.last_kind = kind
        id_ = ""
        if kind in _SHARED_KINDS or value["type"] == "shapegroup":
            self.id_of_written[id(value)] = id_ = self.unique_ids.add(plain_name(name))
        elif self.ids.get(id(value), kind) != kind:
            id_ = self.unique_ids.add(plain_name(name))
        self.write_object(kind, name, value, 1, id_=id_)

    def write_shared(self, kind: str, key: str, value: dict, parent: str) -> None:
        """Write an object at the top if several use it, and before it those inside it. `parent` is a name."""
        if id(value) in self.id_of_written:
            return
        name = self.name(kind, key, value, parent)
        for nested in _nested(kind, value):
            self.write_shared(*nested, name)
        is_used_again = self.use_counts[id(value)] > 1 and kind in _SHARED_KINDS
        if is_used_again or value["type"] == "shapegroup":
            self.write_top(kind, name, value)

    def write_object(self, kind: str, name: str, value: dict, depth: int, role: str = "", id_: str = "") -> None:
        """Write an object with all that it contains. `name` is for its files, `role` its name in its parent."""
        nested, value = list(_nested(kind, value)), self.with_files(kind, value, name)
        plugin = plugins_of(kind)[value["type"]]
        lines = [line for parameter in plugin.parameters if (line := _parameter_line(parameter, value))]
        indent = _INDENT * depth
        attributes = _attributes(type=value["type"], name=role, id=id_)
        if not lines and not nested:
            self.file.write(f"{indent}<{kind}{attributes}/>\n")
            return
        self.file.write(f"{indent}<{kind}{attributes}>\n")
        self.file.writelines(f"{indent}{_INDENT}{line}\n" for line in lines)
        for nested_kind, key, part in nested:
            parameter, child = plugin.parameter(key), plugin.child(nested_kind)
            nested_role = key if parameter is not None or (child and key in child.names) else ""
            if id(part) in self.id_of_written:
                reference = _attributes(name=nested_role, id=self.id_of_written[id(part)])
                self.file.write(f"{indent}{_INDENT}<ref{reference}/>\n")
            else:
                self.write_object(nested_kind, self.name(nested_kind, key, part, name), part, depth + 1, nested_role)
        self.file.write(f"{indent}</{kind}>\n")

    def with_files(self, kind: str, value: dict, name: str) -> dict:
        """The object with names of files in the scene's folder in place of arrays and other files."""
        if value["type"] == "mesh":
            return self.files.mesh(value, name)
        changes = {}
        for parameter in plugins_of(kind)[value["type"]].parameters:
            content = value.get(parameter.name)
            if content is None:
                continue
            if parameter.type == "file":
                changes["filename"] = self.files.copy(content)
            elif parameter.type == "image":
                changes["filename"] = self.files.image(content, name)
            elif parameter.type == "grid":
                changes["filename"] = self.files.grid(content, name)
        return value | changes


def _nested(kind: str, value: dict) -> Iterator[_Nested]:
    """All objects directly in an object of the description."""
    plugin = plugins_of(kind)[value["type"]]
    for key, part in value.items():
        if isinstance(part, dict) and part.get("type") not in _NO_OBJECTS:
            yield _nested_kind(plugin, key, part), key, part


def _nested_kind(plugin: Plugin, key: str, part: dict) -> str:
    parameter = plugin.parameter(key)
    if parameter is not None:
        return "volume" if parameter.volume else "texture"
    return next(kind for kind in plugin.child_kinds if part["type"] in plugins_of(kind))


def _parameter_line(parameter: Parameter, value: dict) -> str:
    """The element of a parameter; "" if it is absent, has its default, or is an object."""
    content = value.get(parameter.name)
    if (
        content is None
        or parameter.type in _IN_MEMORY
        or parameter.name in _OWN_PARAMETERS
        or _is_default(parameter, content)
    ):
        return ""
    name = parameter.name
    if isinstance(content, dict):
        return _colour_line(name, content)
    if parameter.type == "transform":
        matrix = "" if (content == np.eye(4)).all() else f'<matrix value="{_format_matrix(content)}"/>'
        return matrix and f'<transform name="{name}">{matrix}</transform>'
    if parameter.type == "vector":
        tag = "vector" if name == "direction" else "point"
        return f"<{tag}{_attributes(name=name, value=', '.join(map(_format_number, content)))}/>"
    if isinstance(content, bool):
        return f'<boolean name="{name}" value="{str(content).lower()}"/>'
    if isinstance(content, str):
        return f"<string{_attributes(name=name, value=content)}/>"
    if isinstance(content, float):
        return f'<float name="{name}" value="{_format_number(content)}"/>'
    return f'<integer name="{name}" value="{content}"/>'


def _is_default(parameter: Parameter, content) -> bool:
    if parameter.default is None or isinstance(content, np.ndarray):
        return False
    return content == check_value(parameter, parameter.default, SourceLocation(element=parameter.name))


def _colour_line(name: str, colour: dict) -> str:
    """The element of an rgb colour or a spectrum; "" for other objects."""
    content = colour["value"] if colour["type"] in _COLOUR_TYPES else None
    if content is None:
        return ""
    if colour["type"] == "rgb":
        text = ", ".join(map(_format_number, content if len(set(content)) > 1 else content[:1]))
    elif isinstance(content, float):
        text = _format_number(content)
    else:
        text = ", ".join(f"{_format_number(wavelength)}:{_format_number(v)}" for wavelength, v in content)
    return f'<{colour["type"]} name="{name}" value="{text}"/>'


def _format_number(value: float) -> str:
    """The shortest decimal that gives the same 32-bit float."""
    return str(np.float32(value)).removesuffix(".0")


def _format_matrix(matrix: np.ndarray) -> str:
    """16 numbers, row by row, in the precision of 32 bits where that is enough."""
    linear, rounded = matrix[:3, :3], matrix.copy()
    size = np.abs(linear)
    row_sizes, column_sizes = size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True)
    rounded[:3, :3] = np.where(size < _MIN_ENTRY * np.minimum(row_sizes, column_sizes), 0, linear.astype(np.float32))
    with np.errstate(all="ignore"):  # of extreme transforms
        determinant = np.linalg.det(linear)
        change = np.linalg.det(rounded[:3, :3]) - determinant
    if not abs(change) <= _MAX_CHANGE * abs(determinant):
        rows = [list(map(_format_double, row)) for row in matrix.tolist()]  # it is nearly singular
    else:
        rows = [list(map(_format_number, row)) for row in rounded]
    if np.abs(matrix[:3, 3]).max() > _MAX_DISTANCE * size.max():
        for row, number in zip(rows, matrix[:3, 3].tolist(), strict=False):
            row[3] = _format_double(number)
    return ", ".join(map(" ".join, rows))


def _format_double(value: float) -> str:
    return repr(value).removesuffix(".0")


def _attributes(**values: str) -> str:
    """Attributes of a tag, without those that are empty."""
    for value in values.values():
        if _INVALID.search(value):
            raise SceneError(f"{value[:100]!r} has a character that XML does not allow; use another name")
    return "".join(f" {name.strip('_')}={quoteattr(value)}" for name, value in values.items() if value)
