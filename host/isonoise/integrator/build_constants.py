"""Macros that all kernels of a scene are built with; a program gets those that its text mentions."""

from isonoise.device.form import DeviceForm
from isonoise.integrator import accumulator, error_stage
from isonoise.integrator.brute_force import MAX_CORNERS
from isonoise.integrator.kernel_table import CONSTANTS
from isonoise.layers import first_components, mean_components
from isonoise.scene.accel.bvh import STACK_SIZE
from isonoise.scene.light.light_list import MAX_LISTED_LIGHTS
from isonoise.statistics import Needs


def build_constants(needs: Needs, form: DeviceForm, bvh_stack: int = STACK_SIZE) -> dict[str, int | str]:
    """Name -> number or C expression, for the statistics that `needs` names and a device of this form.

    `bvh_stack` is the number of stack entries that a traversal may need.
    """
    return {
        **CONSTANTS,
        **accumulator.build_constants(needs, form),
        **error_stage.build_constants(form.tile_work_items),
        **{f"LAYER_{name.upper()}": str(number) for name, number in first_components(needs.layers).items()},
        "LAYER_SUMS": mean_components(needs.layers),
        "LANES": form.lanes,
        "BVH_LANES": form.bvh_lanes,
        "STACK_SIZE": form.stack_size(bvh_stack),
        "PATH_BLOCK_SIZE": form.path_block_size,
        "BLOCK_WORK_ITEMS": form.block_work_items,
        "MAX_CORNERS": MAX_CORNERS,
        "MAX_LISTED_LIGHTS": MAX_LISTED_LIGHTS,
    }
