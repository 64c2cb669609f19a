"""The kernels of the statistics alone, without a scene: for states that are merged, and for self-tests."""

from isonoise.device.opencl import Device
from isonoise.integrator.accumulator import build_constants
from isonoise.integrator.features import statistics_features
from isonoise.integrator.kernel_table import KERNELS
from isonoise.integrator.stages import Stages
from isonoise.statistics import Needs

_NAMES = (
    *("reduce", "summarise", "summarise_rgb"),
    *("sum_tiles", "fit_steps", "compute_design_effect", "average_neighbours"),
)


def make_statistics_stages(device: Device, needs: Needs) -> Stages:
    """The stages `reduce`, `summarise` and those after it, for an `Accumulator` of these needs."""
    features = statistics_features(needs)
    table = {name: KERNELS[name] for name in _NAMES if KERNELS[name].is_launched(features)}
    return Stages(device, table, features, build_constants(needs, device.form), {})
