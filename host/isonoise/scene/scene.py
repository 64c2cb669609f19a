"""Scene: a scene whose parameters can be read and set by path. `isonoise.load` makes it, `Renderer` compiles it."""

import os
from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.arguments import check_scene_arguments
from isonoise.scene.compile import compile_scene
from isonoise.scene.compile_cache import CompileCache
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.files import note_files, record_files
from isonoise.scene.load import LoadedScene, load_scene
from isonoise.scene.parse.edit import SceneEditor
from isonoise.scene.parse.elements import Element, copy_objects, is_object
from isonoise.scene.paths import (
    Place,
    ScenePathError,
    film_parameters,
    film_value,
    find_place,
    parameter_places,
    plain_value,
)
from isonoise.scene.view import NO_VIEW, View, apply_view
from isonoise.scene.vocabulary import find_plugin
from isonoise.scene.vocabulary.plugin import COLOURS

if TYPE_CHECKING:
    from isonoise.scene.parameter_list import ParameterList

_DEFAULTS = {"film": {"type": "hdrfilm"}, "sampler": {"type": "multijitter"}}
"""What a sensor has if the file gives none, by kind."""

NO_PARAMETERS = "parameters belong to XML files; set values of a Scene by path, as in scene['film.size'] = (64, 64)"


def load(
    source: "str | os.PathLike | Mapping | Scene",
    parameters: dict[str, str] | None = None,
    allow_outside: bool = False,
    view: View | None = None,
    size: tuple[int, int] | None = None,
) -> "Scene":
    """Read a scene.

    Parameters
    ----------
    source : str, path, dict or Scene
        A Mitsuba 3 XML, glTF, OBJ, PLY, STL or pbrt file, the name of a built-in scene, or a dict as for Mitsuba's
        `load_dict`. A Scene is copied.
    parameters : dict or None
        Values for the `$name` placeholders of an XML file.
    allow_outside : bool
        Whether the files that a scene file names may be anywhere. Otherwise they have to be in its folder or below it,
        with symbolic links resolved. A dict may name any file.
    view : View or None
        Camera and environment in place of the scene's own.
    size : (width, height) or None
        Image size in pixels, for which a model is framed. None: the scene's.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        If the scene cannot be read, names a file outside its folder or uses something unsupported.

    Examples
    --------
    >>> scene = isonoise.load("cornell")
    >>> scene["integrator.max_depth"], scene["film.size"]
    (8, (256, 256))
    """
    check_scene_arguments(parameters=parameters, allow_outside=allow_outside, view=view, size=size)
    if isinstance(source, Scene):
        if parameters:
            raise SceneError(
                "parameters belong to XML files; set values of a Scene by path: scene['film.size'] = 64, 64"
            )
        return source.copy(view, size)
    with record_files() as files:
        loaded = load_scene(source, parameters, allow_outside, view, size)
    note_files(files)
    loaded.warn()
    return Scene(loaded, "a scene in Python" if isinstance(source, Mapping) else os.fspath(source), tuple(files))


class SceneObject(MutableMapping):
    """An object of a scene, such as a material: its parameters and the objects in it, by name.

    Assigned values get the same checks as those of a file. A dict, as for Mitsuba's `load_dict`, makes a new object; an
    object of the scene is shared, one of another scene is copied. `del` gives a parameter its default or removes an
    object.

    Attributes
    ----------
    path : str
        Where it is in the scene.
    kind : str
        'shape', 'bsdf', 'sensor' and so on.
    type : str
        Name of its plugin.
    """

    def __init__(self, scene: "Scene", chain: tuple[dict, ...], names: tuple[str, ...]):
        self._scene, self._chain, self._names = scene, chain, names

    @property
    def path(self) -> str:
        """Where it is in the scene."""
        return ".".join(self._names)

    @property
    def kind(self) -> str:
        """'shape', 'bsdf', 'sensor' and so on."""
        return find_plugin(self.type).kind

    @property
    def type(self) -> str:
        """Name of its plugin."""
        return self.normalised["type"]

    @property
    def normalised(self) -> dict:
        """Its dict in the description of the scene, to read."""
        return self._chain[-1]

    def is_part_of(self, scene: object) -> bool:
        """Whether it belongs to this scene."""
        return scene is self._scene

    def __getitem__(self, path: str):
        """The value of a parameter, or an object. Raises SceneError, which is a KeyError too, if there is none."""
        place = self._find(path)
        if not place.has_value:
            raise ScenePathError(_not_set(place))
        if place.is_film_value:
            return film_value(place.owner, place.key)
        value = place.owner[place.key]
        if is_object(value):
            return SceneObject(self._scene, (*place.chain, value), place.names)
        return plain_value(value)

    def __setitem__(self, path: str, value) -> None:
        """Set a parameter or replace an object. Raises SceneError if the scene cannot have it there."""
        try:
            place = self._find(path)
        except ScenePathError:
            if not isinstance(value, Mapping) or self.kind != "scene" or "." in path:
                raise
            place = Place(self._chain, (path,))  # a new object
        self._scene._assign(place, value)

    def __delitem__(self, path: str) -> None:
        place = self._find(path)
        if place.key not in place.owner:
            raise ScenePathError(_not_set(place))
        self._scene._remove(place)

    def __iter__(self) -> Iterator[str]:
        return iter(list(self.normalised))

    def __len__(self) -> int:
        return len(self.normalised)

    def __eq__(self, other: object) -> bool:
        """Whether both are the same object of a scene."""
        return isinstance(other, SceneObject) and self.normalised is other.normalised

    def __hash__(self) -> int:
        return id(self.normalised)

    def __repr__(self) -> str:
        names = ", ".join(name for name in self.normalised if name != "type")
        return f"<{self.kind} '{self.path}' of type {self.type}: {names}>"

    def _repr_html_(self) -> str:
        import html  # a render does not need it

        return f"<div>{html.escape(repr(self))}</div>{self.params()._repr_html_()}"

    def params(self) -> "ParameterList":
        """All parameters that have values, by path, with their types, shapes and meanings; prints as a table."""
        from isonoise.scene.parameter_list import ParameterList

        places = parameter_places(self._scene.description)
        inside = (place for place in places if place.names[: len(self._names)] == self._names)
        return ParameterList(inside)

    def _find(self, path: str) -> Place:
        return find_place(Place(self._chain, self._names), self._scene._editor.elements, path)


class Scene(SceneObject):
    """A scene in Mitsuba 3's vocabulary; `isonoise.load` makes it.

    Values are read and set by path: names from the outside to the inside. Levels may be left out, and the kind of an
    object may take the place of its name, as long as one parameter fits. `compile` and `Renderer` read only those
    files again whose shapes, textures or lights have changed.

    Attributes
    ----------
    name : str
        The file or built-in scene.
    files : tuple of Path
        Every file that it was read from so far, with symbolic links resolved.
    cameras : tuple of str
        Names of the cameras of the file, in its order.
    description : dict
        The scene as plain dicts, to read: changes of it are not noticed.

    Examples
    --------
    >>> scene = isonoise.load("cornell")
    >>> scene["film.size"] = (32, 24)
    >>> scene["lamp.radiance"] = (4, 4, 4)
    >>> scene["tall.bsdf"] = {"type": "conductor", "material": "Au"}
    >>> scene["lamp.emitter.radiance"]
    (4.0, 4.0, 4.0)
    """

    def __init__(self, loaded: LoadedScene, name: str, files: tuple[Path, ...] = ()):
        self.name, self.files, self.cameras = name, files, loaded.cameras
        self.report, self.format = loaded.report, loaded.format
        self._cache = CompileCache()
        self._editor = SceneEditor(loaded.description, loaded.element_by_id, self, self._forget_shapes)
        super().__init__(self, (loaded.description,), ())
        self._complete()

    def _complete(self) -> None:
        """Add objects that Mitsuba adds by default."""
        kinds = {find_plugin(part["type"]).kind for part in self.description.values() if is_object(part)}
        if "integrator" not in kinds:
            self._editor.assign([self.description], "integrator", {"type": "path"}, "integrator")
        for name, part in list(self.description.items()):
            if is_object(part) and find_plugin(part["type"]).kind == "sensor":
                for kind, default in _DEFAULTS.items():
                    if kind not in part:
                        self._editor.assign([self.description, part], kind, default, f"{name}.{kind}")

    def _forget_shapes(self) -> None:
        self._cache.forget_shapes()

    @property
    def description(self) -> dict:
        """The scene as plain dicts, to read: changes of it are not noticed."""
        return self._editor.description

    def copy(self, view: View | None = None, size: tuple[int, int] | None = None) -> "Scene":
        """A scene with the same values, to be changed on its own. Arrays, meshes and images are shared.

        Parameters
        ----------
        view : View or None
            Camera and environment in place of the scene's own.
        size : (width, height) or None
            Image size in pixels, in place of the scene's.
        """
        copies: dict[int, dict] = {}
        description = copy_objects(self.description, copies)
        elements = {}
        for name, element in self._editor.elements.items():
            part = element.normalised and copy_objects(element.normalised, copies)
            elements[name] = Element(element.location, element.kind, element.type, element.id, normalised=part)
        description = apply_view(description, view or NO_VIEW, size)
        loaded = LoadedScene(description, self.report, elements, self.cameras, self.format)
        copied = Scene(loaded, self.name, self.files)
        copied._cache = self._cache.copy()
        return copied

    def compile(
        self,
        size: tuple[int, int] | None = None,
        max_depth: int | None = None,
        sampler: str | None = None,
        view: View | None = None,
        keep_uvs: bool = False,
    ) -> CompiledScene:
        """The scene as arrays, for several renderers.

        Parameters
        ----------
        size : (width, height) or None
            Image size in pixels, in place of the scene's.
        max_depth : int or None
            Longest path in segments, in place of the integrator's; -1 has no limit.
        sampler : str or None
            `sobol` or `independent`, in place of the scene's.
        view : View or None
            Camera and environment in place of the scene's own.
        keep_uvs : bool
            Keep texture coordinates that no material reads, for the layer `uv`.

        Raises
        ------
        SceneError
            If a mesh or an image cannot be read, or numbers exceed the range of the device.
        """
        check_scene_arguments(size=size, max_depth=max_depth, sampler=sampler, view=view)
        with record_files() as files:
            description = apply_view(self.description, view or NO_VIEW, size)
            compiled = compile_scene(description, None, max_depth, sampler, keep_uvs, self._cache)
        self.files = tuple(dict.fromkeys((*self.files, *files)))
        note_files(self.files)
        return compiled

    def build_bvh(self, compiled: CompiledScene) -> Bvh:
        """The BVH of `compiled`, which `compile` has returned last; built again only if shapes have changed since."""
        return self._cache.bvh(compiled.vertices, lambda: build_scene_bvh(compiled))

    def __repr__(self) -> str:
        kinds = [find_plugin(part["type"]).kind for part in self.description.values() if is_object(part)]
        width, height = self["film.size"]
        return f"<isonoise.Scene {self.name}: {width}x{height} pixels, {kinds.count('shape')} shapes>"

    def _repr_html_(self) -> str:
        import html

        from isonoise.scene.parameter_list import count_objects
        from isonoise.tables import html_table

        width, height = self["film.size"]
        counts, parameters = html_table(count_objects(self.description)), self.params()
        return (
            f"<div><b>{html.escape(self.name)}</b>, {width}x{height} pixels</div>{counts}"
            f"<details><summary>{len(parameters)} parameters</summary>{parameters._repr_html_()}</details>"
        )

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def _assign(self, place: Place, value) -> None:
        _check_not_type(place)
        if place.is_film_value:
            self._editor.set_values(list(place.chain), film_parameters(place, value), ".".join(place.names[:-1]))
        else:
            if find_plugin(place.owner["type"]).parameter(place.key) is None and not isinstance(value, Mapping):
                raise SceneError(
                    f"{place.path}: '{place.key}' is an object: give a dict with its 'type', got {value!r}"
                )
            value = _with_colour(place, value)
            self._editor.assign(list(place.chain), place.key, value, place.path)

    def _remove(self, place: Place) -> None:
        _check_not_type(place)
        self._editor.remove(list(place.chain), place.key, place.path)


def _check_not_type(place: Place) -> None:
    if place.key == "type":
        raise SceneError(f"{place.path}: a type cannot be changed; assign a new object, a dict with its 'type'")


def _not_set(place: Place) -> str:
    parameter = find_plugin(place.owner["type"]).parameter(place.key)
    default = f" (its default: {parameter.unset})" if parameter and parameter.unset else ""
    return f"'{place.path}' is not set{default}"


def _with_colour(place: Place, value):
    """Three numbers become a colour where the parameter is one."""
    parameter = find_plugin(place.owner["type"]).parameter(place.key)
    if parameter is None or parameter.type not in (*COLOURS, "texture") or isinstance(value, (str, Mapping)):
        return value
    numbers = np.asarray(value)
    is_colour = numbers.shape == (3,) and numbers.dtype.kind in "iuf"
    return {"type": "rgb", "value": numbers.astype(float).tolist()} if is_colour else value
