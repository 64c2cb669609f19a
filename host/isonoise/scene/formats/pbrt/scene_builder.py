"""Runs the directives of a pbrt file and collects the scene. Called by `read.py`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from isonoise.scene.formats.pbrt import cameras
from isonoise.scene.formats.pbrt.colours import COLOUR_SPACES, Colours
from isonoise.scene.formats.pbrt.directives import Directive
from isonoise.scene.formats.pbrt.graphics_state import StateStack, transform_of
from isonoise.scene.formats.pbrt.lights import Lights, sum_of_environments
from isonoise.scene.formats.pbrt.material_table import MaterialTable
from isonoise.scene.formats.pbrt.materials import NULL, MaterialContext
from isonoise.scene.formats.pbrt.media import make_medium
from isonoise.scene.formats.pbrt.parameters import Parameters
from isonoise.scene.formats.pbrt.shape_dicts import make_shapes
from isonoise.scene.formats.pbrt.shapes import ShapeReader
from isonoise.scene.formats.pbrt.textures import Textures
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.unique_names import UniqueNames

_BEFORE_WORLD = ("Camera", "Film", "Integrator", "SurfaceIntegrator", "PixelFilter", "Sampler")
_IN_WORLD = ("Shape", "LightSource", "AreaLightSource", "ObjectBegin", "ObjectEnd", "ObjectInstance")
_TRANSFORMS = ("Translate", "Scale", "Rotate", "LookAt", "ConcatTransform")
_IGNORED = ("Accelerator", "VolumeIntegrator", "Renderer", "WorldEnd", "TransformTimes")
_OPTIONS_THAT_CHANGE_THE_IMAGE = ("forcediffuse", "disablepixeljitter", "disabletexturefiltering")


class SceneBuilder:
    """The scene of one file, directive by directive."""

    def __init__(self, base: Path, folder: Path | None, report: ImportReport):
        self._report = report
        self._state = StateStack()
        self._colours = Colours(base, folder, report)
        self._textures = Textures(base, folder, self._colours, report)
        self._materials = MaterialTable(MaterialContext(self._textures, self._colours, report))
        self._lights = Lights(self._colours, self._textures, report)
        self._shape_reader = ShapeReader(base, folder, report)
        self._camera = cameras.CameraSettings(report)
        self._media: dict[str, dict | None] = {}
        self._objects: dict[str, dict] = {}  # shapegroups by name
        self._object: dict | None = None  # the one between ObjectBegin and ObjectEnd
        self._shapes: dict[str, dict] = {}
        self._environment_key = ""
        self._unique_keys = UniqueNames()
        self._in_world = False
        self._has_volumes = False

    def run(self, directive: Directive) -> None:
        """Process one directive. Raises SceneError where it is invalid."""
        name = directive.name
        if name in _BEFORE_WORLD and self._in_world:
            directive.position.raise_error(f"{name} has to be before WorldBegin")
        if name in _IN_WORLD and not self._in_world:
            directive.position.raise_error(f"{name} has to be after WorldBegin")
        if name in _TRANSFORMS:
            self._state.apply(transform_of(directive))
        elif name in _BEFORE_WORLD:
            self._configure(directive)
        elif name.endswith(("Begin", "End")) and name not in ("WorldBegin", "WorldEnd"):
            self._run_block(directive)
        elif name not in _IGNORED:
            _HANDLERS[name](self, directive)

    def finish(self) -> dict:
        """The scene dict."""
        empty = Parameters((), self._first_position)
        sensor = cameras.make_sensor(self._camera, empty)
        integrator = cameras.make_integrator(self._camera, empty, self._has_volumes)
        for directive, setting in self._camera.settings.items():
            self._report_unused(setting.parameters, directive)
        return {"type": "scene", "integrator": integrator, "sensor": sensor, **self._shapes}

    def start(self, directive: Directive) -> None:
        """Note where the file begins, before its first directive."""
        self._first_position = directive.position

    @property
    def is_complete(self) -> bool:
        """Whether the file has a world."""
        return self._in_world

    @property
    def open_blocks(self) -> int:
        """Blocks that have begun and not ended."""
        return self._state.open_blocks

    def _configure(self, directive: Directive) -> None:
        self._camera.settings[directive.name] = cameras.Setting(directive.arguments[0], directive.parameters)
        if directive.name == "Camera":
            try:
                self._camera.to_world = np.linalg.inv(self._state.current.to_world)
            except np.linalg.LinAlgError:
                directive.position.raise_error("the transform of the camera cannot be inverted")
            self._state.coordinate_systems["camera"] = self._camera.to_world
            self._camera.medium = self._medium(self._state.current.media[1], directive)

    def _run_block(self, directive: Directive) -> None:
        kind = directive.name.removesuffix("Begin").removesuffix("End")
        if directive.name.endswith("Begin"):
            if kind == "Object":
                self._begin_object(directive)
            self._state.begin(kind, directive)
            return
        self._state.end(kind, directive)
        self._colours.colour_space = self._state.current.colour_space
        if kind == "Object":
            self._object = None

    def _begin_object(self, directive: Directive) -> None:
        if self._object is not None:
            directive.position.raise_error("objects cannot be nested")
        self._object = self._objects[directive.arguments[0]] = {"type": "shapegroup"}

    def _run_world_begin(self, directive: Directive) -> None:
        if self._in_world:
            directive.position.raise_error("there is a second WorldBegin")
        self._in_world = True
        self._state.change(to_world=np.eye(4), active_transforms="All")
        self._state.coordinate_systems["world"] = np.eye(4)
        empty = Parameters((), directive.position)
        camera, film = (self._camera.get(name, "", empty) for name in ("Camera", "Film"))
        self._lights.exposure = cameras.exposure(camera.parameters, film)

    def _run_identity(self, directive: Directive) -> None:
        self._state.set_transform(np.eye(4))

    def _run_transform(self, directive: Directive) -> None:
        self._state.set_transform(transform_of(directive))

    def _run_coordinate_system(self, directive: Directive) -> None:
        self._state.coordinate_systems[directive.arguments[0]] = self._state.current.to_world

    def _run_coord_sys_transform(self, directive: Directive) -> None:
        self._state.set_transform(self._state.find_coordinate_system(directive))

    def _run_active_transform(self, directive: Directive) -> None:
        which = directive.arguments[0]
        if which not in ("StartTime", "EndTime", "All"):
            directive.position.raise_error(f"ActiveTransform is StartTime, EndTime or All, got '{which[:40]}'")
        if which != "All":
            problem = "nothing moves: everything is where it is at the start of the exposure"
            self._report.limit("animation", problem, directive.position.place)
        self._state.change(active_transforms=which)

    def _run_reverse_orientation(self, directive: Directive) -> None:
        self._state.change(reverse_orientation=not self._state.current.reverse_orientation)

    def _run_attribute(self, directive: Directive) -> None:
        self._state.add_defaults(directive)

    def _run_color_space(self, directive: Directive) -> None:
        name = directive.arguments[0]
        if name not in COLOUR_SPACES:
            directive.position.raise_unknown("unknown colour space", name, COLOUR_SPACES)
        self._state.change(colour_space=name)
        self._colours.colour_space = name

    def _run_option(self, directive: Directive) -> None:
        for value in directive.parameters.unused():
            if value.name in _OPTIONS_THAT_CHANGE_THE_IMAGE and value.values[0] == "true":
                self._report.limit("film", f"the option '{value.name}' is ignored", value.position.place)

    def _run_texture(self, directive: Directive) -> None:
        parameters = self._state.with_defaults("texture", directive.parameters)
        self._textures.define(directive._replace(parameters=parameters))
        self._report_unused(parameters, f"the texture '{directive.arguments[2]}'")

    def _run_material(self, directive: Directive) -> None:
        parameters = self._state.with_defaults("material", directive.parameters)
        self._state.change(material=self._materials.make(directive.arguments[0], parameters))
        self._report_unused(parameters, f"the material '{directive.arguments[0]}'")

    def _run_make_named_material(self, directive: Directive) -> None:
        parameters = self._state.with_defaults("material", directive.parameters)
        self._materials.define(directive.arguments[0], parameters)
        self._report.count("materials")
        self._report_unused(parameters, f"the material '{parameters.text('type', '')}'")

    def _run_named_material(self, directive: Directive) -> None:
        self._state.change(material=self._materials.find(directive.arguments[0], directive.position))

    def _run_make_named_medium(self, directive: Directive) -> None:
        parameters = self._state.with_defaults("medium", directive.parameters)
        medium = make_medium(parameters, self._state.current.to_world, self._colours, self._report)
        self._media[directive.arguments[0]] = medium
        self._report_unused(parameters, "a medium")

    def _run_medium_interface(self, directive: Directive) -> None:
        self._state.change(media=(directive.arguments[0], directive.arguments[1]))

    def _run_area_light_source(self, directive: Directive) -> None:
        if directive.arguments[0] not in ("diffuse", "area"):
            directive.position.raise_error(f"unknown area light '{directive.arguments[0][:40]}': use 'diffuse'")
        self._state.change(area_light=self._state.with_defaults("light", directive.parameters))

    def _run_light_source(self, directive: Directive) -> None:
        parameters = self._state.with_defaults("light", directive.parameters)
        kind = directive.arguments[0]
        emitters = self._lights.make(kind, parameters, self._state.current.to_world)
        self._report_unused(parameters, f"the light '{kind}'")
        for emitter in emitters:
            key = self._key(emitter["type"], directive)
            if emitter["type"] in ("constant", "envmap"):
                emitter = self._with_earlier_environment(emitter, directive)
                self._environment_key = key
            self._shapes[key] = emitter

    def _with_earlier_environment(self, emitter: dict, directive: Directive) -> dict:
        """The emitter that stands for this and the earlier environment, which is removed: a scene has one."""
        earlier = self._shapes.pop(self._environment_key, None)
        combined = emitter if earlier is None else sum_of_environments(earlier, emitter)
        if combined is None:
            problem = "of several environment maps only the last one is used"
            self._report.limit("environment", problem, directive.position.place)
        return combined or emitter

    def _run_shape(self, directive: Directive) -> None:
        kind, state = directive.arguments[0], self._state.current
        parameters = self._state.with_defaults("shape", directive.parameters)
        bsdf = state.material or self._materials.default
        shapes = make_shapes(
            kind, parameters, state, bsdf, self._shape_reader, self._textures, self._lights, self._object is not None
        )
        self._report_unused(parameters, f"the shape '{kind}'")
        if state.area_light is not None:
            self._report_unused(state.area_light, "an area light")
        media = self._interface(directive)
        self._has_volumes |= any(shape["bsdf"] is NULL or shape["bsdf"]["type"] == "mask" for shape in shapes)
        target = self._shapes if self._object is None else self._object
        for shape in shapes:
            target[self._key(kind, directive)] = shape | media

    def _interface(self, directive: Directive) -> dict:
        """The inner and outer medium of a shape, where they differ."""
        names = self._state.current.media
        if names[0] == names[1] or cameras.ignores_media(self._camera):
            if names[0] != names[1]:
                self._report.limit("media", "the file's integrator renders no media: they are left out")
            return {}
        media = {
            side: self._medium(name, directive) for side, name in zip(("interior", "exterior"), names, strict=True)
        }
        self._has_volumes |= any(media.values())
        return {side: medium for side, medium in media.items() if medium is not None}

    def _medium(self, name: str, directive: Directive) -> dict | None:
        if not name or cameras.ignores_media(self._camera):
            return None
        if name not in self._media:
            directive.position.raise_unknown("there is no medium named", name, self._media)
        return self._media[name]

    def _run_object_instance(self, directive: Directive) -> None:
        name = directive.arguments[0]
        if self._object is not None:
            directive.position.raise_error("ObjectInstance cannot be inside ObjectBegin and ObjectEnd")
        if name not in self._objects:
            directive.position.raise_unknown("there is no object named", name, self._objects)
        self._report.use("instances")
        self._report.count("instances")
        group = self._objects[name]
        if len(group) > 1:  # more than its type: it has shapes
            instance = {"type": "instance", "group": group, "to_world": self._state.current.to_world}
            self._shapes[self._key("instance", directive)] = instance

    def _key(self, kind: str, directive: Directive) -> str:
        """A key that is not yet used; errors and converted files show it."""
        return self._unique_keys.add(f"{kind}_line_{directive.position.line}")

    def _report_unused(self, parameters: Parameters, what: str) -> None:
        for value in parameters.unused():
            problem = f"the parameter '{value.name[:60]}' of {what} is unknown and ignored"
            self._report.limit("extensions", problem, value.position.place)


_HANDLERS: dict[str, Callable[[SceneBuilder, Directive], None]] = {
    "WorldBegin": SceneBuilder._run_world_begin,
    "Identity": SceneBuilder._run_identity,
    "Transform": SceneBuilder._run_transform,
    "CoordinateSystem": SceneBuilder._run_coordinate_system,
    "CoordSysTransform": SceneBuilder._run_coord_sys_transform,
    "ActiveTransform": SceneBuilder._run_active_transform,
    "ReverseOrientation": SceneBuilder._run_reverse_orientation,
    "Attribute": SceneBuilder._run_attribute,
    "ColorSpace": SceneBuilder._run_color_space,
    "Option": SceneBuilder._run_option,
    "Texture": SceneBuilder._run_texture,
    "Material": SceneBuilder._run_material,
    "MakeNamedMaterial": SceneBuilder._run_make_named_material,
    "NamedMaterial": SceneBuilder._run_named_material,
    "MakeNamedMedium": SceneBuilder._run_make_named_medium,
    "MediumInterface": SceneBuilder._run_medium_interface,
    "AreaLightSource": SceneBuilder._run_area_light_source,
    "LightSource": SceneBuilder._run_light_source,
    "Shape": SceneBuilder._run_shape,
    "ObjectInstance": SceneBuilder._run_object_instance,
}
"""By directive; blocks, transforms and what precedes WorldBegin are not among them."""
