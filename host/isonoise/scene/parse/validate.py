"""Elements as read -> the normalised scene description, checked against the registry.

Every check of names, types and ranges is here, so that XML files and Python dicts go through the same ones.
"""

from collections import Counter

from isonoise.scene import vocabulary
from isonoise.scene.parse.constraints import check_constraints
from isonoise.scene.parse.elements import Element, Reference, SourceLocation, closest_name, with_article
from isonoise.scene.parse.parameter_values import check_value
from isonoise.scene.parse.xml_tags import DEPTH
from isonoise.scene.vocabulary.plugin import IGNORED, SUPPORTED, UNSUPPORTED, Child, Parameter, Plugin


def normalise(root: Element) -> dict:
    """The description: plain dicts with defaults filled in, references replaced by what they refer to (one dict each).

    Raises SceneError for whatever is outside the vocabulary.
    """
    if root.type != "scene":
        root.location.raise_error(f"the root of a scene is of type 'scene', not '{root.type}'")
    return _Normaliser(root).object(root, "scene")


class _Normaliser:
    """One pass over the Elements; keeps what is done, so that an object that is referred to twice is one dict."""

    def __init__(self, root: Element):
        self.ids: dict[str, Element] = {}
        self.done: dict[int, dict] = {}
        self.heights: dict[int, int] = {}  # levels of objects in those that are done, their own included
        self.active: set[int] = set()
        self._collect_ids(root)
        for alias, name in root.aliases.items():
            if name not in self.ids or alias in self.ids:
                problem = "is taken" if alias in self.ids else f"stands for '{name}', which does not exist"
                root.location.raise_error(f"the alias '{alias}' {problem}")
            self.ids[alias] = self.ids[name]

    def _collect_ids(self, root: Element):
        queue = [root]
        while queue:
            element = queue.pop()
            if element.id and self.ids.setdefault(element.id, element) is not element:
                element.location.raise_error(f"the id '{element.id}' is taken by {self.ids[element.id].location}")
            queue.extend(value for _, value, _ in element.entries if isinstance(value, Element))

    def object(self, element: Element, *kinds: str) -> dict:
        """The normalised dict of an Element that may be of one of these kinds."""
        if id(element) in self.done:
            return self.done[id(element)]
        if id(element) in self.active:
            element.location.raise_error("refers to itself, directly or through others")
        self.active.add(id(element))
        plugin = self.plugin(element, kinds)
        result = {"type": plugin.name}
        held: Counter[str] = Counter()  # nested objects by kind
        height = 1
        for name, value, location in element.entries:
            if isinstance(value, (Element, Reference)):
                self.check_depth(len(self.active), location)  # on the way down, and on the way up where much is done
                self.child(plugin, result, held, name, value, location)
                height = max(height, 1 + self.heights.get(id(self.target(value)), 0))
                self.check_depth(height, location)
            else:
                self.parameter(plugin, result, name, value, location)
        self.complete(plugin, result, held, element.location)
        self.active.discard(id(element))
        self.done[id(element)] = result
        self.heights[id(element)] = height
        return result

    @staticmethod
    def check_depth(levels: int, location: SourceLocation):
        if levels > DEPTH:
            location.raise_error(f"nested more than {DEPTH} levels deep through references")

    def plugin(self, element: Element, kinds: tuple[str, ...]) -> Plugin:
        kind = self.kind(element, kinds)
        supported = vocabulary.plugins_of(kind)
        if element.type in supported:
            return supported[element.type]
        listed = ", ".join(sorted(supported))
        hint = closest_name(element.type, supported)
        reason = vocabulary.UNSUPPORTED_PLUGINS.get(kind, {}).get(element.type)
        if reason and supported:
            element.location.raise_error(
                f"{kind} '{element.type}' is not supported (Mitsuba 3 has it): {reason}; "
                f"nearest: '{hint}' (supported: {listed})"
            )
        if reason:
            element.location.raise_error(f"{kind} '{element.type}' is not supported (Mitsuba 3 has it): {reason}")
        if not supported:
            element.location.raise_error(f"unknown {kind} '{element.type}'; none is supported")
        element.location.raise_error(f"unknown {kind} '{element.type}'; did you mean '{hint}'? (supported: {listed})")

    def kind(self, element: Element, kinds: tuple[str, ...]) -> str:
        """The kind of an Element: its tag's; for dicts one that has a plugin of this name, best of `kinds`."""
        if element.kind:
            return element.kind
        known = vocabulary.kinds_of(element.type)
        fitting = [kind for kind in known if kind in kinds] or list(known)
        if fitting:
            return fitting[0]
        names = [p.name for p in vocabulary.PLUGINS if p.kind in kinds]
        element.location.raise_error(
            f"unknown type '{element.type}'; did you mean '{closest_name(element.type, names)}'?"
        )

    def target(self, value: Element | Reference) -> Element | None:
        """The object itself, or the one that a reference names."""
        return self.ids.get(value.id) if isinstance(value, Reference) else value

    def child(self, plugin: Plugin, result: dict, held: Counter[str], name: str, value, location: SourceLocation):
        """Enter a nested object, or the one that a reference names, into its parent."""
        element = self.target(value)
        if element is None:
            hint = closest_name(value.id, self.ids)
            location.raise_error(f"nothing has the id '{value.id}'" + (f"; did you mean '{hint}'?" if hint else ""))
        kinds = tuple(child.kind for child in plugin.children)
        kind = self.kind(element, kinds)
        child = plugin.child(kind)
        parameter = plugin.parameter(name)
        if parameter is not None and parameter.status == IGNORED:
            return
        self.check_supported(plugin, parameter, location)
        if parameter is not None and parameter.texture and kind == "texture":
            if name in result:
                location.raise_error(f"'{name}' is given twice")
            result[name] = self.object(element, kind)
            return
        if parameter is not None and parameter.volume and kind == "volume":
            self.parameter(plugin, result, name, self.object(element, kind)["value"], location)
            return
        if child is None:
            if kind in ("texture", "medium", "phase", "volume") or not kinds:
                self.plugin(element, (kind,))
            listed = ", ".join(kinds) or "no objects"
            location.raise_error(
                f"{with_article(plugin.kind)} '{plugin.name}' cannot hold {with_article(kind)} (it may hold: {listed})"
            )
        nested = self.object(element, *kinds)
        if child.types and nested["type"] not in child.types:
            location.raise_error(
                f"{plugin.name} cannot hold {with_article(kind)} '{nested['type']}' (it may hold: {', '.join(child.types)})"  # noqa: E501
            )
        self.enter(plugin, child, result, held[kind], name or element.id, nested, location)
        held[kind] += 1

    def enter(
        self, plugin: Plugin, child: Child, result: dict, held: int, name: str, nested: dict, location: SourceLocation
    ):
        if plugin.kind == "scene":
            key = name or child.kind
            if held >= child.most:
                location.raise_error(f"a scene has only one {child.kind}")
            while key in result:
                key = f"{child.kind}_{len(result)}"
            result[key] = nested
        elif held >= child.most:
            number = "one" if child.most == 1 else str(child.most)
            location.raise_error(f"{plugin.name} may hold only {number} {child.kind}{'s' if child.most > 1 else ''}")
        elif child.names:
            if name not in child.names:
                location.raise_error(
                    f"{with_article(child.kind)} of {with_article(plugin.kind)} is named {' or '.join(child.names)}, got '{name}'"  # noqa: E501
                )
            if name in result:
                location.raise_error(f"'{name}' is given twice")
            result[name] = nested
        else:
            result[child.kind if not held else f"{child.kind}_{held}"] = nested

    def parameter(self, plugin: Plugin, result: dict, name: str, value, location: SourceLocation):
        parameter = plugin.parameter(name)
        if parameter is None:
            if plugin.any_parameter:
                return
            names = [p.name for p in plugin.parameters if p.status != UNSUPPORTED] + [c.kind for c in plugin.children]
            hint = closest_name(name, names)
            does = f"; did you mean '{hint}'?" if hint else ""
            listed = f" (known: {', '.join(names)})" if names else " (it has none)"
            location.raise_error(f"{plugin.kind} '{plugin.name}' has no parameter '{name}'{does}{listed}")
        self.check_supported(plugin, parameter, location)
        if parameter.status == IGNORED:
            return
        if name in result:
            location.raise_error(f"'{name}' is given twice")
        result[name] = check_value(parameter, value, location)

    @staticmethod
    def check_supported(plugin: Plugin, parameter: Parameter | None, location: SourceLocation):
        if parameter is not None and parameter.status == UNSUPPORTED:
            location.raise_error(
                f"parameter '{parameter.name}' of {plugin.kind} '{plugin.name}' is not supported (Mitsuba 3 has it): "
                + parameter.meaning
            )

    def complete(self, plugin: Plugin, result: dict, held: Counter[str], location: SourceLocation):
        """Fill in defaults; complain about what is required and about combinations that exclude each other."""
        for parameter in plugin.parameters:
            if parameter.name in result or parameter.status != SUPPORTED:
                continue
            if parameter.required:
                location.raise_error(f"{plugin.kind} '{plugin.name}' needs a '{parameter.name}'")
            if parameter.default is not None:
                result[parameter.name] = check_value(parameter, parameter.default, location)
        for child in plugin.children:
            if held[child.kind] < child.least:
                number = "a" if child.least == 1 else str(child.least)
                nested = child.types[0] if len(child.types) == 1 else child.kind
                location.raise_error(
                    f"{plugin.kind} '{plugin.name}' needs {number} nested {nested}{'s' if child.least > 1 else ''}"
                )
        check_constraints(plugin.kind, result, location)
        if plugin.name in ("moment", "aov"):
            inner = result["integrator"]
            result.clear()
            result.update(inner)
