"""Changes a normalised scene: a new value or object gets the same checks as in a file. Called by `Scene`."""

from collections.abc import Callable, Iterator, Mapping

from isonoise.errors import SceneError
from isonoise.scene.parse.constraints import check_constraints
from isonoise.scene.parse.dict_reader import read_value
from isonoise.scene.parse.elements import Element, Location, SourceLocation, is_object
from isonoise.scene.parse.validate import SceneNormaliser
from isonoise.scene.parse.xml_tags import MAX_DEPTH
from isonoise.scene.vocabulary import find_plugin

_OF_MATERIALS = ("bsdf", "emitter", "interior", "exterior")
"""Names of what a shape has besides its surface."""
Chain = list[dict]
"""The objects on a path, from the scene down to the one that is changed."""


class SceneEditor:
    """Changes the normalised description of a scene. A change that is refused leaves it as it was.

    Parameters
    ----------
    description : dict
        As of `load_description`.
    elements : dict
        Its objects by id.
    scene : object
        The scene to which the description belongs: objects of it are shared, those of others are copied.
    on_shapes : callable
        Called when a change has another effect on shapes than on their materials, lights and media.
    """

    def __init__(self, description: dict, elements: dict[str, Element], scene: object, on_shapes: Callable[[], None]):
        self.description, self.elements, self._scene, self._on_shapes = description, elements, scene, on_shapes

    def assign(self, chain: Chain, key: str, value: object, path: str) -> None:
        """Give the last object of the chain a value, or an object as a dict, by its name.

        Raises SceneError, which begins with the path.
        """
        owner, location, old = chain[-1], SourceLocation(element=path), chain[-1].get(key)
        normaliser = SceneNormaliser()
        entry = read_value(value, path, self._scene)
        normaliser.element_by_id = self._elements_without(old, entry, path)
        others = {name: part for name, part in owner.items() if name != key}
        changed = normaliser.add_to(others, [(key, entry, location)], location)
        for name in changed.keys() - others.keys():
            if is_object(changed[name]):
                self._check_nesting(chain, changed[name], location)
        merged = {name: changed.get(name, part) for name, part in owner.items()} | changed
        if owner is self.description and is_object(old):
            self._replace_everywhere(old, changed[key], location)
            normaliser.element_by_id.setdefault(key, Element(location, "", "", key, normalised=changed[key]))
        self._commit(chain, merged, location)
        self.elements = normaliser.element_by_id

    def _replace_everywhere(self, old: dict, new: dict, location: Location) -> None:
        """Let all objects that use an object of the scene use another one."""
        kind = find_plugin(new["type"]).kind
        inside = {id(part) for part in _objects_in(new)}  # a new object may wrap the old one
        inside.add(id(self.description))
        parts = (part for part in _objects_in(self.description) if id(part) not in inside)
        holders = [part for part in parts if any(value is old for value in part.values())]
        for part in holders:
            plugin = find_plugin(part["type"])
            child = plugin.child(kind)
            if kind != find_plugin(old["type"]).kind or (child and child.types and new["type"] not in child.types):
                location.raise_error(
                    f"a {plugin.kind} '{part['type']}' uses it, which cannot contain a '{new['type']}'"
                )
        _swap(holders, old, new)
        try:
            for part in _containers(self.description, new):
                check_constraints(find_plugin(part["type"]).kind, part, location)
        except SceneError:
            _swap(holders, new, old)
            raise

    def set_values(self, chain: Chain, values: Mapping[str, object], path: str) -> None:
        """Set several parameters of the last object of the chain at once; None removes one."""
        location = SourceLocation(element=path)
        others = {name: part for name, part in chain[-1].items() if name not in values}
        entries = [(name, value, SourceLocation(element=f"{path}.{name}")) for name, value in values.items()]
        given = [entry for entry in entries if entry[1] is not None]
        self._commit(chain, SceneNormaliser().add_to(others, given, location), location)

    def remove(self, chain: Chain, key: str, path: str) -> None:
        """Remove a value or an object; a parameter gets its default. Raises SceneError if it is required."""
        owner, location = chain[-1], SourceLocation(element=path)
        others = {name: part for name, part in owner.items() if name != key}
        self._commit(chain, SceneNormaliser().add_to(others, [], location), location)

    def _elements_without(self, old: object, entry: object, path: str) -> dict[str, Element]:
        """The objects by id, without those that the new entry replaces."""
        replaced, visited, queue = {path}, set(), [entry]
        while queue:
            part = queue.pop()
            if isinstance(part, Element) and id(part) not in visited:
                visited.add(id(part))
                replaced |= {part.id} if part.id.startswith(f"{path}.") else set()
                queue += [value for _, value, _ in part.entries]
        if isinstance(entry, Element) and entry.id in self.elements and self.elements[entry.id].normalised is old:
            replaced.add(entry.id)
        return {name: element for name, element in self.elements.items() if name not in replaced}

    def _check_nesting(self, chain: Chain, new: dict, location: Location) -> None:
        inside = list(_objects_in(new))
        if any(part is owner for part in inside for owner in chain):
            location.raise_error("refers to itself, directly or through other objects")
        if len(chain) + _height(new) > MAX_DEPTH:
            location.raise_error(f"nested more than {MAX_DEPTH} levels deep")

    def _commit(self, chain: Chain, changed: dict, location: Location) -> None:
        """Replace the content of the last object, if all objects that contain it accept the change."""
        owner, before = chain[-1], dict(chain[-1])
        _replace(owner, changed)
        try:
            if len(chain) > 1:
                for part in _containers(self.description, owner):
                    check_constraints(find_plugin(part["type"]).kind, part, location)
        except SceneError:
            _replace(owner, before)
            raise
        if _changes_shapes(before, owner):
            self._on_shapes()


def _changes_shapes(before: dict, after: dict) -> bool:
    """Whether an object's change is one of shapes, apart from their materials, lights and media."""
    names = [name for name in {*before, *after} if before.get(name) is not after.get(name)]
    if find_plugin(after["type"]).kind == "shape":
        return any(name not in _OF_MATERIALS for name in names)
    parts = (part.get(name) for name in names for part in (before, after))
    return any(is_object(part) and find_plugin(part["type"]).kind == "shape" for part in parts)


def _replace(part: dict, content: dict) -> None:
    part.clear()
    part.update(content)


def _swap(holders: list[dict], old: dict, new: dict) -> None:
    """Replace an object by another one where it is used."""
    for part in holders:
        part.update({name: new for name, value in part.items() if value is old})


def _objects_in(part: dict) -> Iterator[dict]:
    """An object and all objects in it, each once."""
    visited, queue = set(), [part]
    while queue:
        part = queue.pop()
        if id(part) not in visited:
            visited.add(id(part))
            queue += [value for value in part.values() if is_object(value)]
            yield part


def _height(part: dict) -> int:
    """Levels of nested objects in an object, including its own."""
    heights: dict[int, int] = {}

    def height(part: dict) -> int:
        if id(part) not in heights:
            heights[id(part)] = 1 + max((height(value) for value in part.values() if is_object(value)), default=0)
        return heights[id(part)]

    return height(part)


def _containers(description: dict, target: dict) -> list[dict]:
    """All objects that contain `target`, directly or not, without the scene itself."""
    contains: dict[int, bool] = {}
    found = []

    def visit(part: dict) -> bool:
        if id(part) not in contains:
            parts = [visit(value) for value in part.values() if is_object(value)]
            contains[id(part)] = part is target or any(parts)
            if any(parts):
                found.append(part)
        return contains[id(part)]

    for value in description.values():
        if is_object(value):
            visit(value)
    return found
