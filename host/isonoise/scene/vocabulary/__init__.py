"""The supported subset of Mitsuba 3's scene vocabulary, as tables; names, units and defaults are its own (3.9)."""

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

_SCENE = Plugin(
    "scene",
    "scene",
    ignored("boolean", "embree_use_robust_intersections", why="rays are intersected watertightly"),
    (
        Child("integrator"),
        Child("sensor", most=1 << 16),
        Child("shape", most=1 << 32),
        Child("emitter", most=1 << 32, types=tuple(plugin.name for plugin in EMITTERS if plugin.name != "area")),
        Child("bsdf", most=1 << 32),
        Child("texture", most=1 << 32),
        Child("medium", most=1 << 32),
        Child("phase", most=1 << 32),
        Child("volume", most=1 << 32),
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


def kinds_of(name: str) -> tuple[str, ...]:
    """All kinds in which Mitsuba 3 has a plugin with this name."""
    here = tuple(p.kind for p in PLUGINS if p.name == name)
    return here + tuple(kind for kind, names in UNSUPPORTED_PLUGINS.items() if name in names)
