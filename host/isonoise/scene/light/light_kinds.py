"""The kinds of light, one row each: `KINDS`.

From these rows come the device records, the power and the bounds of lights (`lights`), the feature of every kind
(`integrator.features`) and, for the kernels, the macros and the header of `light_macros` and `light_header`. The
parameters of a plugin are in `vocabulary.emitters`. How to add a kind: host/docs/extending.md.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from isonoise.scene import structs
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.kind_macros import any_feature, define_lists
from isonoise.scene.light import light_bounds
from isonoise.scene.light.envmap import ENVIRONMENT, ENVIRONMENT_ROW
from isonoise.scene.light.light_bounds import LightBounds, spot_solid_angle
from isonoise.scene.light.projections import Projection, project_image, project_spot

AREA = "area"
"""The plugin that makes a shape emit; its kinds are those of primitives."""


class LightKind(NamedTuple):
    """A kind of light. `name` gives its names in the kernels: the bit LIGHT_<NAME>, the file light/<name>_light.h.

    That file has `sample_<name>_light(scene, light, reference, u, &sample)`; of an analytic area light,
    `sample_<name>_light(scene, &shape, reference, u, &surface)`, which returns a pdf in solid angle or 0; of triangles,
    none.
    """

    name: str
    feature: str
    description: str  # what the feature is, for `isonoise info`
    plugin: str
    emission: str  # the plugin's parameter: radiance, radiant intensity or irradiance; '' if it comes from an image
    power_factor: Callable[[np.ndarray, float], np.ndarray | float]
    """Power over `LIGHT.radiance`, for records (n,) and the radius of the sphere around the scene."""
    bounds: Callable[[CompiledScene, np.ndarray, np.ndarray], LightBounds]
    """Bounds of lights of this kind: scene, records (n,), their power (n,)."""
    record: Callable[[dict], Mapping[str, object]] = lambda emitter: {}  # further members of `LIGHT`
    texture: str = ""  # of a light without surface: the plugin's parameter that it projects
    project: Callable[[dict, float], Projection] | None = None
    """How it projects the texture, whose width over height is the second argument. Sets more members of `LIGHT`."""
    analytic: int | None = None  # structs.ANALYTIC_...: the primitive of an area light
    triangle_count: int = 0  # of an area light: the triangles that follow each other in a mesh
    is_environment: bool = False  # emits from infinity, from all directions: a scene has at most one
    buffers: Mapping[str, str] = MappingProxyType({})  # as in `features.Feature`
    header: str = ""  # '': light/<name>_light.h

    @property
    def is_area(self) -> bool:
        """Whether a primitive of the scene emits."""
        return self.plugin == AREA

    @property
    def is_mesh(self) -> bool:
        """Whether triangles of a mesh emit."""
        return self.triangle_count > 0


def _to_world(emitter: dict) -> np.ndarray:
    return emitter.get("to_world", np.eye(4))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def _spot(emitter: dict) -> dict[str, object]:
    cutoff = np.radians(emitter["cutoff_angle"])
    beam = np.radians(emitter.get("beam_width", 0.75 * emitter["cutoff_angle"]))  # Mitsuba 3's default
    return {
        "position": _to_world(emitter)[:3, 3],
        "axis": _unit(_to_world(emitter)[:3, 2]),
        "cutoff": cutoff,
        "inverse_transition": 1.0 / max(cutoff - beam, 1e-6),  # a hard edge has a width of a millionth of a radian
    }


def _area_power(lights: np.ndarray, radius: float) -> np.ndarray:
    return np.pi * lights["area"].astype(np.float64)


def _environment_power(lights: np.ndarray, radius: float) -> float:
    return 4.0 * np.pi**2 * radius**2


def _area(name: str, bounds: Callable, analytic: int | None = None, triangle_count: int = 0) -> LightKind:
    feature, description = f"{name.upper()}_LIGHTS", f"{name} lights"
    return LightKind(
        name=name,
        feature=feature,
        description=description,
        plugin=AREA,
        emission="radiance",
        power_factor=_area_power,
        bounds=bounds,
        analytic=analytic,
        triangle_count=triangle_count,
        header="light/area_light.h",
    )


_PROJECTIONS = {"projections": f"{structs.PROJECTION.itemsize} bytes a light with a texture"}

_ROWS = (
    _area("triangle", light_bounds.triangle_bounds, triangle_count=1),
    _area("parallelogram", light_bounds.parallelogram_bounds, triangle_count=2),
    _area("sphere", light_bounds.sphere_bounds, structs.ANALYTIC_SPHERE),
    _area("disk", light_bounds.disk_bounds, structs.ANALYTIC_DISK),
    _area("cylinder", light_bounds.cylinder_bounds, structs.ANALYTIC_CYLINDER),
    LightKind(
        name="point",
        feature="POINT_LIGHTS",
        description="point lights",
        plugin="point",
        emission="intensity",
        power_factor=lambda lights, radius: 4.0 * np.pi,
        bounds=light_bounds.point_bounds,
        record=lambda emitter: {"position": emitter.get("position", _to_world(emitter)[:3, 3])},
    ),
    LightKind(
        name="spot",
        feature="SPOT_LIGHTS",
        description="spot lights",
        plugin="spot",
        emission="intensity",
        power_factor=lambda lights, radius: spot_solid_angle(lights),
        bounds=light_bounds.spot_bounds,
        record=_spot,
    ),
    LightKind(
        name="directional",
        feature="DIRECTIONAL_LIGHTS",
        description="directional lights",
        plugin="directional",
        emission="irradiance",
        power_factor=lambda lights, radius: np.pi * radius**2,
        bounds=light_bounds.directional_bounds,
        record=lambda emitter: {
            "position": _unit(np.asarray(emitter.get("direction", _to_world(emitter)[:3, 2]), float))
        },
    ),
    LightKind(
        name="constant",
        feature="CONSTANT_LIGHT",
        description="constant environment",
        plugin="constant",
        emission="radiance",
        power_factor=_environment_power,
        bounds=light_bounds.environment_bounds,
        is_environment=True,
        header="light/environment_light.h",
    ),
    LightKind(
        name="environment_map",
        feature="ENVIRONMENT_MAP",
        description="environment map",
        plugin="envmap",
        emission="",
        power_factor=_environment_power,
        bounds=light_bounds.environment_bounds,
        is_environment=True,
        buffers={
            "environment": f"{ENVIRONMENT.itemsize} bytes in all",
            "environment_texels": "16 bytes a texel",
            "environment_rows": f"{ENVIRONMENT_ROW.itemsize} bytes a row of texels",
            "environment_guide": "4 bytes a cell between texels",
        },
        header="light/environment_light.h",
    ),
    LightKind(
        name="textured_spot",
        feature="TEXTURED_SPOT_LIGHTS",
        description="spot lights with a texture",
        plugin="spot",
        emission="intensity",
        power_factor=lambda lights, radius: spot_solid_angle(lights),
        bounds=light_bounds.spot_bounds,
        record=_spot,
        texture="texture",
        project=project_spot,
        buffers=_PROJECTIONS,
    ),
    LightKind(
        name="projector",
        feature="PROJECTOR_LIGHTS",
        description="projectors",
        plugin="projector",
        emission="scale",
        power_factor=lambda lights, radius: np.pi * spot_solid_angle(lights),
        bounds=light_bounds.spot_bounds,
        record=lambda emitter: {"position": _to_world(emitter)[:3, 3], "axis": _unit(_to_world(emitter)[:3, 2])},
        texture="irradiance",
        project=project_image,
        buffers=_PROJECTIONS,
    ),
)

KINDS = {kind.name: kind for kind in _ROWS}
"""Kinds by name. Their order gives each its bit and has no other meaning."""

KIND_OF_PLUGIN = {kind.plugin: kind for kind in reversed(_ROWS) if not kind.is_area}
"""Kinds without a surface by plugin; of a spot, that without a texture."""


def kind_of_emitter(emitter: dict) -> LightKind | None:
    """The kind of an emitter without a surface; None if it has no row."""
    kinds = select(lambda kind: kind.plugin == emitter["type"] and not kind.is_area)
    projecting = next((kind for kind in kinds if kind.texture and kind.texture in emitter), None)
    return projecting or next((kind for kind in kinds if not kind.texture), None)


def light_bits(*names: str) -> int:
    """The bits of kinds, as in the member `kind` of the records."""
    return sum(1 << list(KINDS).index(name) for name in names)


def select(condition: Callable[[LightKind], bool]) -> tuple[LightKind, ...]:
    """The kinds for which a condition holds."""
    return tuple(kind for kind in KINDS.values() if condition(kind))


def bits_where(condition: Callable[[LightKind], bool]) -> int:
    """The bits of the kinds for which a condition holds."""
    return light_bits(*(kind.name for kind in select(condition)))


def kind_of_analytic(analytic: int) -> LightKind:
    """The kind of light that an emissive analytic primitive is."""
    (kind,) = select(lambda kind: kind.analytic == analytic)
    return kind


def _any_feature(condition: Callable[[LightKind], bool]) -> str:
    return any_feature(kind.feature for kind in select(condition))


@lru_cache(maxsize=1)
def light_macros() -> dict[str, int | str]:
    """Macros for the kernels: bits, and what the lights of a scene have in common."""
    return {
        **{f"LIGHT_{name.upper()}": light_bits(name) for name in KINDS},
        "HAS_ANALYTIC_LIGHTS": _any_feature(lambda kind: kind.analytic is not None),
        "HAS_ENVIRONMENT_LIGHT": _any_feature(lambda kind: kind.is_environment),
        "HAS_MESH_LIGHTS": _any_feature(lambda kind: kind.is_mesh),
        "HAS_NON_MESH_LIGHTS": _any_feature(lambda kind: not kind.is_mesh),
        "HAS_PROJECTIONS": _any_feature(lambda kind: kind.project is not None),
        "LIGHT_MESH": bits_where(lambda kind: kind.is_mesh),
    }


@lru_cache(maxsize=1)
def light_header() -> str:
    """generated/light_kinds.h: lists of the kinds that the scene has, and the headers of all kinds.

    FOR_LIGHTS_WITHOUT_SURFACE(DO) is DO(LIGHT_<NAME>, sample_<name>_light) for every kind without a surface,
    FOR_ANALYTIC_LIGHTS(DO) the same for analytic area lights.
    """
    bits = {name: f"LIGHT_{name.upper()}" for name in KINDS}
    entries = {bits[name]: (kind.feature, f"{bits[name]}, sample_{name}_light") for name, kind in KINDS.items()}
    lists = {
        "FOR_LIGHTS_WITHOUT_SURFACE": [bits[name] for name, kind in KINDS.items() if not kind.is_area],
        "FOR_ANALYTIC_LIGHTS": [bits[name] for name, kind in KINDS.items() if kind.analytic is not None],
    }
    lines = define_lists(entries, lists)
    lines += [f'#include "{header}"' for header in dict.fromkeys(map(_header, KINDS.values()))]
    return "\n".join(lines)


def _header(kind: LightKind) -> str:
    return kind.header or f"light/{kind.name}_light.h"
