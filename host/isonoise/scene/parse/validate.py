"""Checks Elements against the vocabulary and turns them into the normalised scene description. Called by `load`.

All checks of names, types and ranges are here, so XML files and Python dicts get the same ones.
"""

from collections import Counter

from isonoise.scene import vocabulary
from isonoise.scene.parse.constraints import check_constraints
from isonoise.scene.parse.elements import Element, Location, Reference, did_you_mean, is_object, with_article
from isonoise.scene.parse.parameter_values import check_value, constant_of
from isonoise.scene.parse.xml_tags import MAX_DEPTH
from isonoise.scene.vocabulary.plugin import COLOURS, IGNORED, UNSUPPORTED, Child, Parameter, Plugin
from isonoise.scene.vocabulary.textures import CONSTANT_TEXTURES


class SceneNormaliser:
    """Checks the entries of a scene one by one, in order, so that their Elements can be dropped.

    `finish` returns the description: plain dicts with defaults filled in. A reference becomes the dict of the object
    that it refers to, one dict for all references. Anything outside the vocabulary raises SceneError.
    From the first entry on that refers to an object further below, entries wait until the scene is complete.
    """

    def __init__(self):
        self.plugin = vocabulary.plugins_of("scene")["scene"]
        self.scene: dict = {"type": "scene"}
        self.child_counts: dict[str, int] = {}
        self.waiting: list[tuple[str, object, Location]] = []
        self.element_by_id: dict[str, Element] = {}
        self.active: set[int] = {0}  # by id() of Elements, and the scene

    def add(self, name: str, value, location: Location) -> None:
        """Add an entry of the scene: see `Element.entries`."""
        is_complete = self._collect_ids(value)
        if self.waiting or not is_complete:
            self.waiting.append((name, value, location))
            return
        self._add_entry(self.plugin, self.scene, self.child_counts, name, value, location)
        if isinstance(value, Element) and value.id:  # keep what a reference or an error needs
            value.entries = ()
            value.location = value.location.without_element()

    def finish(self, root: Element) -> dict:
        """The description of the scene. `root` has its location and its aliases."""
        if root.type != "scene":
            root.location.raise_error(f"the root of a scene has to be of type 'scene', not '{root.type}'")
        for alias, target in (root.aliases or {}).items():
            if target not in self.element_by_id or alias in self.element_by_id:
                problem = (
                    "already exists" if alias in self.element_by_id else f"refers to '{target}', which does not exist"
                )
                root.location.raise_error(f"the alias '{alias}' {problem}")
            self.element_by_id[alias] = self.element_by_id[target]
        for entry in self.waiting:
            self._add_entry(self.plugin, self.scene, self.child_counts, *entry)
        _complete(self.plugin, self.scene, self.child_counts, root.location)
        return self.scene

    def add_to(self, part: dict, entries: list[tuple[str, object, Location]], location: Location) -> dict:
        """A copy of a normalised object with more entries, and with defaults for all that is missing."""
        plugin, result = vocabulary.find_plugin(part["type"]), dict(part)
        nested = (value["type"] for value in part.values() if is_object(value))
        child_counts = Counter(vocabulary.find_plugin(type_).kind for type_ in nested)
        for entry in entries:
            self._collect_ids(entry[1])
            self._add_entry(plugin, result, child_counts, *entry)
        _complete(plugin, result, child_counts, location)
        return result

    def _collect_ids(self, value) -> bool:
        """Store the ids of an object and of all inside it. Whether all that it refers to is normalised."""
        is_complete, queue = True, [value]
        while queue:
            part = queue.pop()
            if isinstance(part, Element):
                if part.id and self.element_by_id.setdefault(part.id, part) is not part:
                    first = self.element_by_id[part.id].location
                    part.location.raise_error(f"the id '{part.id}' is already used by {first}")
                queue.extend(entry[1] for entry in part.entries)
                is_complete &= part.prototype is None or part.prototype.normalised is not None
            elif isinstance(part, Reference):
                target = self.element_by_id.get(part.id)
                is_complete &= target is not None and target.normalised is not None
        return is_complete

    def _normalise_object(self, element: Element, *kinds: str) -> dict:
        """The normalised dict of an Element of one of the given kinds."""
        if element.normalised is not None:
            return element.normalised
        if id(element) in self.active:
            element.location.raise_error("refers to itself, directly or through other objects")
        if element.prototype is not None:
            return self._normalise_similar(element)
        self.active.add(id(element))
        plugin = self._find_plugin(element, kinds)
        result, child_counts = {"type": plugin.name}, {}
        for entry in element.entries:
            element.height = max(element.height, self._add_entry(plugin, result, child_counts, *entry))
        _complete(plugin, result, child_counts, element.location)
        self.active.discard(id(element))
        element.normalised = result
        return result

    def _normalise_similar(self, element: Element) -> dict:
        """The dict of its prototype with the element's own numbers."""
        plugin = self._find_plugin(element, ())
        result = element.prototype.normalised.copy()
        for name, value, location in element.entries:
            if name in result:  # else the parameter is ignored
                result[name] = check_value(plugin.parameter(name), value, location)
        check_constraints(plugin.kind, result, element.location)
        element.height, element.normalised = element.prototype.height, result
        return result

    def _add_entry(
        self, plugin: Plugin, result: dict, child_counts: dict[str, int], name: str, value, location: Location
    ) -> int:
        """Add a parameter or an object to its parent. Returns the levels of objects that the parent has with it."""
        if not isinstance(value, (Element, Reference)):
            _add_parameter(plugin, result, name, value, location)
            return 1
        _check_depth(len(self.active), location)  # before descending; below, for objects done earlier
        self._add_object(plugin, result, child_counts, name, value, location)
        height = 1 + self._resolve(value).height
        _check_depth(height, location)
        return height

    def _find_plugin(self, element: Element, kinds: tuple[str, ...]) -> Plugin:
        kind = self._find_kind(element, kinds)
        supported = vocabulary.plugins_of(kind)
        if element.type in supported:
            return supported[element.type]
        listed = f" (supported: {', '.join(sorted(supported))})" if supported else ""
        reason = vocabulary.UNSUPPORTED_PLUGINS.get(kind, {}).get(element.type)
        if reason:
            element.location.raise_error(
                f"{kind} '{element.type}' is not supported (Mitsuba 3 has it): {reason}{listed}"
            )
        if not supported:
            element.location.raise_error(f"unknown {kind} '{element.type}'; isonoise supports none")
        element.location.raise_error(f"unknown {kind} '{element.type}'{did_you_mean(element.type, supported)}{listed}")

    def _find_kind(self, element: Element, kinds: tuple[str, ...]) -> str:
        """The kind of an Element: its XML tag. For dicts a kind with a plugin of this name, preferably in `kinds`."""
        if element.kind:
            return element.kind
        known = vocabulary.kinds_of(element.type)
        candidates = [kind for kind in known if kind in kinds] or list(known)
        if candidates:
            return candidates[0]
        names = [plugin.name for plugin in vocabulary.PLUGINS if plugin.kind in kinds]
        element.location.raise_error(f"unknown type '{element.type}'{did_you_mean(element.type, names)}")

    def _resolve(self, value: Element | Reference) -> Element | None:
        return self.element_by_id.get(value.id) if isinstance(value, Reference) else value

    def _add_object(
        self, plugin: Plugin, result: dict, child_counts: dict[str, int], name: str, value, location: Location
    ):
        """Add a nested or referenced object to its parent: as a parameter or as a child."""
        element = self._resolve(value)
        if element is None:
            hint = did_you_mean(value.id, self.element_by_id)
            location.raise_error(f"there is no object with the id '{value.id}'{hint}")
        kinds = plugin.child_kinds
        kind = self._find_kind(element, kinds)
        parameter = plugin.parameter(name)
        if parameter is not None and parameter.status == IGNORED:
            return
        _check_supported(plugin, parameter, location)
        if kind == "texture" and element.type in CONSTANT_TEXTURES and _takes_constants(parameter):
            _check_not_given(result, name, location)
            result[name] = constant_of(parameter, self._normalise_object(element, kind), location)
            return
        if parameter is not None and parameter.texture and kind == "texture":
            _check_not_given(result, name, location)
            result[name] = self._normalise_object(element, kind)
            return
        if parameter is not None and parameter.volume and kind == "volume":
            self._add_volume(plugin, result, name, element, location)
            return
        child = plugin.child(kind)
        if child is None:
            if kind in ("texture", "medium", "phase", "volume") or not kinds:
                self._find_plugin(element, (kind,))  # an unsupported plugin is the better error
            parent = f"{with_article(plugin.kind)} '{plugin.name}'"
            allowed = ", ".join(kinds) or "no objects"
            location.raise_error(f"{parent} cannot contain {with_article(kind)} (allowed: {allowed})")
        nested = self._normalise_object(element, *kinds)
        if child.types and nested["type"] not in child.types:
            location.raise_error(
                f"{plugin.name} cannot contain {with_article(kind)} '{nested['type']}' "
                f"(allowed: {', '.join(child.types)})"
            )
        if nested["type"] in child.referenced_only:
            _check_has_id(element, kind)
            return
        _add_child(plugin, child, result, child_counts.get(kind, 0), name or element.id, nested, location)
        child_counts[kind] = child_counts.get(kind, 0) + 1

    def _add_volume(self, plugin: Plugin, result: dict, name: str, element: Element, location: Location):
        """Add a volume as a parameter; a constant one that has no place of its own as its value."""
        allowed, kind = plugin.parameter(name).volume, self._find_plugin(element, ("volume",)).name
        if kind not in allowed:
            location.raise_error(
                f"'{name}' of {with_article(plugin.kind)} '{plugin.name}' cannot be a {kind} "
                f"(allowed: {', '.join(allowed)}); that of a medium 'heterogeneous' can"
            )
        volume = self._normalise_object(element, "volume")
        if volume["type"] == "constvolume":  # checks the value
            _add_parameter(plugin, result, name, volume["value"], location)
            if plugin.name != "heterogeneous" or "to_world" not in volume:
                return
        else:
            _check_not_given(result, name, location)
        result[name] = volume


def _takes_constants(parameter: Parameter | None) -> bool:
    return parameter is not None and (parameter.texture or parameter.type in COLOURS)


def _check_depth(levels: int, location: Location):
    if levels > MAX_DEPTH:
        location.raise_error(f"nested more than {MAX_DEPTH} levels deep through references")


def _check_has_id(element: Element, kind: str):
    if not element.id:
        parent = {"emitter": "shape", "rfilter": "film"}.get(kind, "sensor")
        element.location.raise_error(
            f"{with_article(kind)} '{element.type}' of the scene itself has no effect: "
            f"move it into a {parent}, or give it an id and refer to it there"
        )


def _check_not_given(result: dict, name: str, location: Location):
    if name in result:
        location.raise_error(f"'{name}' is given twice")


def _check_supported(plugin: Plugin, parameter: Parameter | None, location: Location):
    if parameter is not None and parameter.status == UNSUPPORTED:
        location.raise_error(
            f"parameter '{parameter.name}' of {plugin.kind} '{plugin.name}' is not supported (Mitsuba 3 has it): "
            + parameter.meaning
        )


def _add_child(plugin: Plugin, child: Child, result: dict, count: int, name: str, nested: dict, location: Location):
    """Add a nested object under its key. `count`: how many of its kind the parent already has."""
    if plugin.kind == "scene":
        if count >= child.max_count:
            location.raise_error(f"a scene can have only one {child.kind}")
        key = name or child.kind
        while key in result:
            key = f"{child.kind}_{len(result)}"
    elif count >= child.max_count:
        limit = f"one {child.kind}" if child.max_count == 1 else f"{child.max_count} {child.kind}s"
        location.raise_error(f"{plugin.name} can contain only {limit}")
    elif child.names:
        if name not in child.names:
            names = " or ".join(child.names)
            location.raise_error(
                f"{with_article(child.kind)} of {with_article(plugin.kind)} has to be named {names}, got '{name}'"
            )
        _check_not_given(result, name, location)
        key = name
    else:
        key = f"{child.kind}_{count}" if count else child.kind
        if key in result:  # an earlier one was replaced
            key = next(
                key for key in (child.kind, *map(f"{child.kind}_{{}}".format, range(1, count))) if key not in result
            )
    result[key] = nested


def _add_parameter(plugin: Plugin, result: dict, name: str, value, location: Location):
    parameter = plugin.parameter(name)
    if parameter is None:
        if plugin.any_parameter:
            return
        names = [p.name for p in plugin.parameters if p.status != UNSUPPORTED] + [c.kind for c in plugin.children]
        known = f" (known: {', '.join(names)})" if names else " (it has none)"
        location.raise_error(
            f"{plugin.kind} '{plugin.name}' has no parameter '{name}'{did_you_mean(name, names)}{known}"
        )
    _check_supported(plugin, parameter, location)
    if parameter.status == IGNORED:
        return
    _check_not_given(result, name, location)
    result[name] = check_value(parameter, value, location)


def _complete(plugin: Plugin, result: dict, child_counts: dict[str, int], location: Location):
    """Fill in defaults, then check that nothing is missing and that the parameters fit together."""
    for parameter in plugin.completed_parameters:
        if parameter.name in result:
            continue
        if parameter.required:
            location.raise_error(f"{plugin.kind} '{plugin.name}' needs a '{parameter.name}'")
        result[parameter.name] = check_value(parameter, parameter.default, location)
    for child in plugin.required_children:
        if child_counts.get(child.kind, 0) < child.min_count:
            noun = child.types[0] if len(child.types) == 1 else child.kind
            required = f"a nested {noun}" if child.min_count == 1 else f"{child.min_count} nested {noun}s"
            location.raise_error(f"{plugin.kind} '{plugin.name}' needs {required}")
    check_constraints(plugin.kind, result, location)
    if plugin.name in ("moment", "aov"):  # replaced by the integrator inside
        inner = result["integrator"]
        result.clear()
        result.update(inner)
