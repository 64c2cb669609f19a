"""The kernels of the statistics alone, without a scene: for merged and distributed renders, and for self-tests."""

from isonoise.device.opencl import Device
from isonoise.device.precompile import OnCompile
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.features import statistics_features
from isonoise.integrator.kernel_table import IMAGE_KERNELS, KERNELS
from isonoise.integrator.stages import Stages
from isonoise.statistics import Needs

TRACING_KERNELS = {"list_samples", "reduce"}
"""Kernels of the program of the statistics that run while samples are traced."""


def make_statistics_stages(
    device: Device,
    needs: Needs,
    compiled_items: int | None = None,
    on_compile: OnCompile = lambda name, done, total: None,
) -> Stages:
    """The stages that build and read statistics of these needs, for an `Accumulator` and an `ErrorStage`.

    They are the same program as in a render of a scene, so that it is compiled once. `compiled_items`: as for `Stages`.
    """
    features = statistics_features(needs)
    names = TRACING_KERNELS | IMAGE_KERNELS
    table = {name: row for name, row in KERNELS.items() if name in names and row.is_launched(features)}
    return Stages(
        device,
        table,
        features,
        build_constants(needs, device.form),
        {},
        local_sizes={"relative_errors": device.form.tile_work_items},
        compiled_items=compiled_items,
        on_compile=on_compile,
    )
