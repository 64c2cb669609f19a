"""Sets up the wavefront of a renderer: on one device, on several, or on a cluster. Called by `Renderer`."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, TypedDict

from isonoise.device.drivers import describe_driver
from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.device.selection import SelectedDevice
from isonoise.integrator.set_up import make_wavefront
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import Needs

if TYPE_CHECKING:
    from isonoise.distributed.cluster import Cluster
    from isonoise.distributed.distributed_wavefront import DistributedWavefront
    from isonoise.integrator.wavefront import Wavefront

OnDevice = Callable[[str, str], None]
"""Called with the name of a device and the version of its driver."""
Measured = Callable[[str], AbstractContextManager[None]]
"""A `with` block of this step of the set-up is measured."""


class Hooks(TypedDict):
    """Functions of a renderer that are called during the set-up."""

    measured: Measured
    on_device: OnDevice
    on_compile: OnCompile


def set_up_device(
    device: Device,
    scene: CompiledScene,
    needs: Needs,
    seed: int,
    pool_size: int | None,
    memory: int | None,
    is_adaptive: bool,
    *,
    build_bvh: Callable[[CompiledScene], Bvh],
    measured: Measured,
    on_device: OnDevice,
    on_compile: OnCompile,
) -> "Wavefront":
    """A wavefront on one device. Other arguments as for `Wavefront`; `on_device` is called before the first program."""
    with measured("build"):
        bvh = build_bvh(scene)
    with measured("compile"):
        on_device(device.name, describe_driver(device.device))
        settings = scene, bvh, needs, seed, pool_size
        return make_wavefront(device, *settings, memory=memory, is_adaptive=is_adaptive, on_compile=on_compile)


def set_up_workers(
    selected: list[SelectedDevice],
    cluster: "Cluster | None",
    scene: CompiledScene,
    needs: Needs,
    seed: int,
    pool_size: int | None,
    memory: int | None,
    is_adaptive: bool,
    *,
    measured: Measured,
    on_device: OnDevice,
    on_compile: OnCompile,
) -> "DistributedWavefront":
    """A wavefront on several devices, or on the workers of a cluster; other arguments as for `set_up_device`."""
    from isonoise.distributed import set_up  # a render on one device does not need it

    wavefront = None
    try:
        with measured("compile"):
            on_device(*set_up.describe_workers(selected, cluster))
            settings = scene, needs, seed, pool_size, memory, is_adaptive
            wavefront = set_up.make_distributed_wavefront(selected, cluster, *settings, on_compile)
    except BaseException:  # a signal ends the set-up late
        if wavefront is not None:
            wavefront.close()
        raise
    return wavefront
