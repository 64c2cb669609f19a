"""An OpenCL path tracer that measures the noise of every pixel and samples where it is needed.

Examples
--------
>>> import isonoise
>>> outcome = isonoise.render("cornell", error=0.2, size=(64, 64))
>>> outcome.reason, outcome.rgb.shape
('error', (64, 64, 3))
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what type checkers see of `_PUBLIC_NAMES`
    from isonoise.comparison.compare_scenes import Comparison, compare
    from isonoise.comparison.result_table import ResultTable
    from isonoise.distributed.cluster import Cluster
    from isonoise.error.true_error import TrueError
    from isonoise.errors import DeviceError, SceneError, UserError
    from isonoise.film.exr import read_exr, read_reference, write_exr
    from isonoise.film.log import LogRow
    from isonoise.film.png import write_png
    from isonoise.loop import Periodic, RenderLoop, render_loop
    from isonoise.outcome import Outcome
    from isonoise.render_scene import render
    from isonoise.renderer import Renderer
    from isonoise.scene.compiled_scene import CompiledScene
    from isonoise.scene.scene import Scene, load
    from isonoise.scene.view import View
    from isonoise.state.checkpoint import read_checkpoint, write_checkpoint
    from isonoise.state.state import State
    from isonoise.statistics import Needs, Statistics
    from isonoise.stops import Stops
    from isonoise.strategies import allocation, measures
    from isonoise.strategies.adaptive import Adaptive
    from isonoise.strategies.base import Strategy, Wave
    from isonoise.watch_waves import watch
    from isonoise.wave import WaveRecord

__version__ = "0.1.0"

_PUBLIC_NAMES = {
    "Adaptive": "isonoise.strategies.adaptive",
    "Cluster": "isonoise.distributed.cluster",
    "Comparison": "isonoise.comparison.compare_scenes",
    "CompiledScene": "isonoise.scene.compiled_scene",
    "DeviceError": "isonoise.errors",
    "LogRow": "isonoise.film.log",
    "Needs": "isonoise.statistics",
    "Outcome": "isonoise.outcome",
    "Periodic": "isonoise.loop",
    "RenderLoop": "isonoise.loop",
    "Renderer": "isonoise.renderer",
    "ResultTable": "isonoise.comparison.result_table",
    "Scene": "isonoise.scene.scene",
    "SceneError": "isonoise.errors",
    "State": "isonoise.state.state",
    "Statistics": "isonoise.statistics",
    "Stops": "isonoise.stops",
    "Strategy": "isonoise.strategies.base",
    "TrueError": "isonoise.error.true_error",
    "UserError": "isonoise.errors",
    "View": "isonoise.scene.view",
    "Wave": "isonoise.strategies.base",
    "WaveRecord": "isonoise.wave",
    "allocation": "isonoise.strategies.allocation",
    "compare": "isonoise.comparison.compare_scenes",
    "load": "isonoise.scene.scene",
    "measures": "isonoise.strategies.measures",
    "read_checkpoint": "isonoise.state.checkpoint",
    "read_exr": "isonoise.film.exr",
    "read_reference": "isonoise.film.exr",
    "render": "isonoise.render_scene",
    "render_loop": "isonoise.loop",
    "watch": "isonoise.watch_waves",
    "write_checkpoint": "isonoise.state.checkpoint",
    "write_exr": "isonoise.film.exr",
    "write_png": "isonoise.film.png",
}
"""Public name -> the module that has it, or the module that it is."""

__all__ = [
    "Adaptive",
    "Cluster",
    "Comparison",
    "CompiledScene",
    "DeviceError",
    "LogRow",
    "Needs",
    "Outcome",
    "Periodic",
    "RenderLoop",
    "Renderer",
    "ResultTable",
    "Scene",
    "SceneError",
    "State",
    "Statistics",
    "Stops",
    "Strategy",
    "TrueError",
    "UserError",
    "View",
    "Wave",
    "WaveRecord",
    "allocation",
    "compare",
    "load",
    "measures",
    "read_checkpoint",
    "read_exr",
    "read_reference",
    "render",
    "render_loop",
    "watch",
    "write_checkpoint",
    "write_exr",
    "write_png",
]


if not TYPE_CHECKING:  # so that type checkers find misspelt names

    def __getattr__(name: str) -> object:
        """Import a public name on first use, so that `isonoise --help` stays fast."""
        if name not in _PUBLIC_NAMES:
            raise AttributeError(f"module 'isonoise' has no attribute '{name}'")
        module = importlib.import_module(_PUBLIC_NAMES[name])
        return module if module.__name__.endswith(f".{name}") else getattr(module, name)


def __dir__() -> list[str]:
    return __all__
