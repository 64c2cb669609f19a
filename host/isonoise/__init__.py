"""An OpenCL path tracer that measures the noise of every pixel and samples where it is needed.

Examples
--------
>>> import isonoise
>>> outcome = isonoise.render("cornell", error=0.2, size=(64, 64))
>>> outcome.reason, outcome.rgb.shape
('error', (64, 64, 3))
"""

import importlib

__version__ = "0.1.0"

_PUBLIC_NAMES = {
    "Needs": "isonoise.statistics",
    "Periodic": "isonoise.loop",
    "RenderLoop": "isonoise.loop",
    "Renderer": "isonoise.renderer",
    "Scene": "isonoise.scene.scene",
    "State": "isonoise.state",
    "Statistics": "isonoise.statistics",
    "Stops": "isonoise.stops",
    "Strategy": "isonoise.strategies",
    "View": "isonoise.scene.view",
    "Wave": "isonoise.strategies",
    "load": "isonoise.scene.scene",
    "watch": "isonoise.watch_waves",
    "read_checkpoint": "isonoise.state.checkpoint",
    "render": "isonoise.render_scene",
    "render_loop": "isonoise.loop",
    "write_checkpoint": "isonoise.state.checkpoint",
}
__all__ = sorted(_PUBLIC_NAMES)


def __getattr__(name: str):
    """Import a public name on first use, so that `isonoise --help` stays fast."""
    if name not in _PUBLIC_NAMES:
        raise AttributeError(f"module 'isonoise' has no attribute '{name}'")
    return getattr(importlib.import_module(_PUBLIC_NAMES[name]), name)


def __dir__() -> list[str]:
    return __all__
