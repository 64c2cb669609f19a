"""The graphics state of a pbrt file: the current transform, material, light and media. Used by `scene_builder.py`."""

from dataclasses import dataclass, field, replace

import numpy as np

from isonoise.scene import transforms
from isonoise.scene.formats.pbrt.directives import Directive
from isonoise.scene.formats.pbrt.parameters import Parameters, Value

TARGETS = ("shape", "light", "material", "medium", "texture")
_MAX_DEPTH = 10_000  # nested AttributeBegin


@dataclass(frozen=True)
class GraphicsState:
    """What AttributeBegin saves and AttributeEnd restores."""

    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    reverse_orientation: bool = False
    material: dict | None = None  # a BSDF; None: pbrt's default
    area_light: Parameters | None = None
    media: tuple[str, str] = ("", "")  # names of the inner and outer one
    colour_space: str = "srgb"
    defaults: dict[str, tuple[Value, ...]] = field(default_factory=dict)  # by target, of the directive Attribute
    active_transforms: str = "All"  # at the start or the end of the exposure


class StateStack:
    """The current graphics state, the saved ones, and the named coordinate systems."""

    def __init__(self):
        self.current = GraphicsState()
        self.coordinate_systems: dict[str, np.ndarray] = {}
        self._saved: list[tuple[str, GraphicsState]] = []  # with the kind of block

    def begin(self, kind: str, directive: Directive) -> None:
        """Save the state at AttributeBegin, TransformBegin or ObjectBegin; `kind` is the word before Begin."""
        if len(self._saved) >= _MAX_DEPTH:
            directive.position.raise_error(f"blocks are nested more than {_MAX_DEPTH:,} levels deep")
        self._saved.append((kind, self.current))

    def end(self, kind: str, directive: Directive) -> None:
        """Restore the state at the end of a block."""
        if not self._saved or self._saved[-1][0] != kind:
            inside = f"; {self._saved[-1][0]}Begin is open" if self._saved else ""
            directive.position.raise_error(f"{directive.name} without {kind}Begin{inside}")
        _, saved = self._saved.pop()
        if kind == "Transform":
            self.change(to_world=saved.to_world, active_transforms=saved.active_transforms)
        else:
            self.current = saved

    @property
    def open_blocks(self) -> int:
        """Blocks that have not ended."""
        return len(self._saved)

    def change(self, **fields) -> None:
        """Set fields of the current state."""
        self.current = replace(self.current, **fields)

    def set_transform(self, matrix: np.ndarray) -> None:
        """Replace the current transform, unless only that at the end of the exposure is meant."""
        if self.current.active_transforms != "EndTime":
            self.change(to_world=matrix)

    def apply(self, matrix: np.ndarray) -> None:
        """Multiply the current transform by a matrix from the right."""
        with np.errstate(over="ignore", invalid="ignore"):  # the users of the transform check it
            self.set_transform(self.current.to_world @ matrix)

    def with_defaults(self, target: str, parameters: Parameters) -> Parameters:
        """Parameters with those that Attribute gives for a target."""
        defaults = self.current.defaults.get(target, ())
        return parameters.with_defaults(defaults) if defaults else parameters

    def add_defaults(self, directive: Directive) -> None:
        """The directive Attribute."""
        target = directive.arguments[0]
        if target not in TARGETS:
            directive.position.raise_unknown("Attribute has no target", target, TARGETS)
        added = (*self.current.defaults.get(target, ()), *directive.parameters.unused())
        by_name = {value.name: value for value in added}  # the last one of a name counts
        self.change(defaults=self.current.defaults | {target: tuple(by_name.values())})

    def find_coordinate_system(self, directive: Directive) -> np.ndarray:
        """The transform that CoordinateSystem named."""
        name = directive.arguments[0]
        if name not in self.coordinate_systems:
            directive.position.raise_unknown("there is no coordinate system", name, self.coordinate_systems)
        return self.coordinate_systems[name]


def transform_of(directive: Directive) -> np.ndarray:
    """The matrix of Translate, Scale, Rotate, LookAt, Transform or ConcatTransform."""
    numbers = directive.numbers
    if directive.name == "Translate":
        return transforms.translate(numbers)
    if directive.name == "Scale":
        return transforms.scale(numbers)
    if directive.name == "Rotate":
        length = np.linalg.norm(numbers[1:])
        if not length > 0:
            directive.position.raise_error("the axis of Rotate is zero")
        return transforms.rotate(numbers[1:] / length, float(numbers[0]))
    if directive.name == "LookAt":
        return _look_at(directive)
    return numbers.reshape(4, 4).T


def _look_at(directive: Directive) -> np.ndarray:
    """World to camera; camera space is left-handed, x is right."""
    eye, target, up = directive.numbers.reshape(3, 3)
    try:
        camera_to_world = transforms.look_at(eye, target, up)
    except ValueError:
        directive.position.raise_error(
            "LookAt needs an eye that differs from the target, and an up at an angle to them"
        )
    return np.linalg.inv(camera_to_world)
