"""isonoise: an OpenCL path tracer that spends its samples until the noise is the same everywhere."""

import importlib

__version__ = "0.1.0"

_PUBLIC = {
    "Needs": "isonoise.statistics",
    "Renderer": "isonoise.renderer",
    "Statistics": "isonoise.statistics",
    "Stops": "isonoise.loop",
    "Strategy": "isonoise.strategies",
    "Wave": "isonoise.strategies",
    "load": "isonoise.scene",
    "render": "isonoise.loop",
    "render_loop": "isonoise.loop",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str):
    """Imports a public name when it is first used, so that `isonoise --help` loads nothing."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'isonoise' has no attribute '{name}'")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return __all__
