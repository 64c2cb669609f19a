"""The supported subset of Mitsuba 3's scene vocabulary. Names, units and defaults are those of Mitsuba 3.9."""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from isonoise.scene.vocabulary.bsdfs import BSDFS
from isonoise.scene.vocabulary.common import ignored
from isonoise.scene.vocabulary.emitters import EMITTERS
from isonoise.scene.vocabulary.media import MEDIA
from isonoise.scene.vocabulary.plugin import Child, Plugin
from isonoise.scene.vocabulary.sensors import FILMS, INTEGRATORS, SAMPLERS, SENSORS
from isonoise.scene.vocabulary.shapes import SHAPES
from isonoise.scene.vocabulary.textures import TEXTURES
from isonoise.scene.vocabulary.unsupported import UNSUPPORTED_PLUGINS


def _referenced_only(kind: str) -> Child:
    names = tuple(plugin.name for plugin in (*FILMS, *SAMPLERS) if plugin.kind == kind)
    return Child(kind, max_count=1 << 16, referenced_only=names)


_SCENE = Plugin(
    "scene",
    "scene",
    ignored("boolean", "embree_use_robust_intersections", why="ray intersection is always watertight"),
    (
        Child("integrator"),
        Child("sensor", max_count=1 << 16),
        Child("shape", max_count=1 << 32),
        Child("emitter", max_count=1 << 32, referenced_only=("area",)),
        Child("bsdf", max_count=1 << 32),
        Child("texture", max_count=1 << 32),
        Child("medium", max_count=1 << 32),
        Child("phase", max_count=1 << 32),
        Child("volume", max_count=1 << 32),
        *map(_referenced_only, ("film", "rfilter", "sampler")),
    ),
)

PLUGINS: tuple[Plugin, ...] = (
    *SENSORS,
    *FILMS,
    *SAMPLERS,
    *INTEGRATORS,
    *BSDFS,
    *TEXTURES,
    *SHAPES,
    *EMITTERS,
    *MEDIA,
    _SCENE,
)


@cache
def plugins_of(kind: str) -> Mapping[str, Plugin]:
    """The supported plugins of a kind by name."""
    return MappingProxyType({p.name: p for p in PLUGINS if p.kind == kind})


@cache
def find_plugin(name: str) -> Plugin:
    """The supported plugin of this name, which no other kind has."""
    return next(plugin for plugin in PLUGINS if plugin.name == name)


def kinds_of(name: str) -> tuple[str, ...]:
    """All kinds in which Mitsuba 3 has a plugin with this name."""
    supported = tuple(p.kind for p in PLUGINS if p.name == name)
    return supported + tuple(kind for kind, names in UNSUPPORTED_PLUGINS.items() if name in names)
