"""Sets up a wavefront: compiles its kernels and checks the driver. Called by `Renderer` and by tracers of tasks."""

from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.integrator.driver_check import check_driver
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene.accel.bvh import Bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import Needs


def make_wavefront(
    device: Device, scene: CompiledScene, bvh: Bvh, needs: Needs, *settings, on_compile: OnCompile, **options
) -> Wavefront:
    """A `Wavefront`, with the same parameters, that has compiled all its kernels, on a driver that has been checked."""
    wavefront = Wavefront(device, scene, bvh, needs, *settings, on_compile=on_compile, **options)
    wavefront.warm_up(on_compile)
    check_driver(wavefront, needs)
    return wavefront
