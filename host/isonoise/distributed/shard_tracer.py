"""Computes tasks on one device: the pure function that distributed renders are made of."""

import time
from collections.abc import Callable

from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.distributed.task import Task, TaskResult
from isonoise.integrator.set_up import make_wavefront
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import Needs


class ShardTracer:
    """A scene on a device, ready for tasks. It keeps nothing of a task.

    Parameters
    ----------
    device : Device
        The device to trace on.
    scene : CompiledScene
        The scene.
    needs : Needs
        Statistics of the state, those of the sampler included (`Needs.with_sampler`).
    pool_size, memory : int or None
        As for `Renderer`.
    bvh : Bvh or None
        Of the scene; None: it is built.
    on_compile : callable
        Called before each program is compiled, with its name, how many are done, and how many there are.

    Raises
    ------
    DeviceError
        If the device has too little memory, or its driver computes wrong numbers.
    """

    def __init__(
        self,
        device: Device,
        scene: CompiledScene,
        needs: Needs,
        pool_size: int | None = None,
        memory: int | None = None,
        bvh: Bvh | None = None,
        on_compile: OnCompile = lambda name, done, total: None,
    ):
        self.device = device
        bvh, options = bvh or build_scene_bvh(scene), {"memory": memory, "has_image": False, "on_compile": on_compile}
        self._wavefront = make_wavefront(device, scene, bvh, needs, pool_size=pool_size, **options)

    def trace(self, task: Task, should_continue: Callable[[], bool] = lambda: True) -> TaskResult:
        """Trace the samples of a task, until `should_continue` returns False; the state of its pixels with them."""
        start, remaining = time.perf_counter(), task.allocation.copy()
        self._wavefront.set_seed(task.seed)
        self._wavefront.set_pixels(task.pixels, task.state)
        self._wavefront.trace(remaining, should_continue)
        state = self._wavefront.reduction.read()
        return TaskResult(task.number, state, remaining if remaining.any() else None, time.perf_counter() - start)
