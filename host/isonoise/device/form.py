"""How kernels divide their work among work-items, which differs between CPUs and GPUs.

The form changes the speed, never a bit of a result. `Device.form` chooses it; the kernels are built with its numbers.
"""

import os
from typing import NamedTuple

from isonoise.device.drivers import is_cpu, is_pocl
from isonoise.device.tuned import load_tuned, store_tuned
from isonoise.errors import DeviceError

FORM_VARIABLE = "ISONOISE_DEVICE_FORM"
"""Environment variable with the name of the form for all devices, for tests and measurements."""
_NAME = "form"

MAX_STACK_SIZE = 258
"""Entries of a traversal stack: `build_scene_bvh` rejects trees that need more than 256; two more hold end markers."""


class DeviceForm(NamedTuple):
    """Numbers of a form."""

    name: str
    lanes: int
    """Paths per work-item of `generate` and the brute-force stages (kernels/path/path_state.h)."""
    shade_lanes: int
    """The same of `shade`."""
    max_rays_per_item: int
    """Most rays that a work-item traces, one after the other."""
    bvh_lanes: int
    """Children of a node, or triangles of a block, that a work-item tests at a time (kernels/geometry/bvh.h)."""
    stack_sizes: tuple[int, ...]
    """Sizes of a ray's traversal stack, of which a scene's programs have the smallest that its BVH fits. Each size is
    another program. The largest is for all trees that `build_scene_bvh` accepts."""
    path_block_size: int
    """Paths that the compaction moves at a time."""
    block_work_items: int
    """Work-items that share a path block: 1, or all of a work-group."""
    tile_work_items: int
    """Work-items that share a tile of `relative_errors`."""
    pixels_per_item: int
    """Pixels that a work-item of `summarise` processes."""
    neighbour_run: int
    """Pixels that a work-item of `average_neighbours` processes."""

    def stack_size(self, bvh_stack: int) -> int:
        """Stack entries of the programs for a BVH that needs `bvh_stack`, beside the two end markers."""
        return next(size for size in self.stack_sizes if size >= bvh_stack + 2)


FORMS = {
    form.name: form
    for form in (
        # PoCL vectorises across work-items only in trivial kernels, but often vectorises a loop inside a kernel.
        # A work-item of `shade` takes so many paths that compacted lists are long, and so few that their lane state
        # fits the level-2 cache; with 64, `shade` takes 1.2 times as long on a scene of four kinds of BSDF.
        # PoCL gives every work-item of a group a stack of its own; with one ray a work-item these stacks would not fit
        # the cache. With the small stack mesh-82k takes 0.97 of the CPU time (PoCL 3.0, quartiles 0.95 to 0.98).
        DeviceForm(
            "lanes",
            lanes=64,
            shade_lanes=256,
            max_rays_per_item=32,
            bvh_lanes=8,
            stack_sizes=(66, MAX_STACK_SIZE),
            path_block_size=512,
            block_work_items=1,
            tile_work_items=1,
            pixels_per_item=16,
            neighbour_run=64,
        ),
        # Other compilers vectorise across work-items.
        DeviceForm(
            "cpu",
            lanes=1,
            shade_lanes=1,
            max_rays_per_item=32,
            bvh_lanes=8,
            stack_sizes=(MAX_STACK_SIZE,),
            path_block_size=512,
            block_work_items=1,
            tile_work_items=256,
            pixels_per_item=1,
            neighbour_run=1,
        ),
        # Neighbouring work-items access neighbouring memory. A driver reserves the stack of every work-item that the
        # device can run at a time, 270,000 on an H100: 560 MB with the largest, 140 MB with the smallest.
        DeviceForm(
            "gpu",
            lanes=1,
            shade_lanes=1,
            max_rays_per_item=1,
            bvh_lanes=4,
            stack_sizes=(66, 130, MAX_STACK_SIZE),
            path_block_size=256,
            block_work_items=256,
            tile_work_items=256,
            pixels_per_item=1,
            neighbour_run=1,
        ),
    )
}


CPU_FORMS = ("lanes", "cpu")
"""Forms that a CPU may be fastest with: which one depends on its compiler."""


def choose_form(device) -> DeviceForm:
    """The form of an OpenCL device: that of `FORM_VARIABLE`, if set, else the tuned one, else the default.

    Raises DeviceError for a name that does not exist.
    """
    chosen = os.environ.get(FORM_VARIABLE)
    if not chosen:
        return tuned_form(device) or default_form(device)
    if chosen not in FORMS:
        raise DeviceError(f"{FORM_VARIABLE} is '{chosen}'; choose one of {', '.join(FORMS)}, or remove it")
    return FORMS[chosen]


def default_form(device) -> DeviceForm:
    """The form of a device that was never tuned."""
    if not is_cpu(device):
        return FORMS["gpu"]
    return FORMS["lanes" if is_pocl(device) else "cpu"]


def tuned_form(device) -> DeviceForm | None:
    """The form that `isonoise bench --tune` found to be faster than the default; None if there is none."""
    name = load_tuned(device, _NAME)
    return FORMS.get(name) if isinstance(name, str) else None


def store_tuned_form(device, name: str) -> bool:
    """Store the form of a device; return whether that succeeded."""
    store_tuned(device, _NAME, None if FORMS[name] == default_form(device) else name)
    return (tuned_form(device) or default_form(device)).name == name
