"""Bytes that kernels move, counted from the buffers of `kernel_table`: their place under the roofline.

Williams, Waterman and Patterson, "Roofline: An Insightful Visual Performance Model", CACM 2009. Operations are not
counted: OpenCL does not report them. Called by `measure`.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from isonoise.benchmark.bounces import BLOCK_TRIANGLES, RayTests
from isonoise.benchmark.prepared_scene import KernelTotals, PreparedScene
from isonoise.integrator.accumulator import SUMMARY_STRIP_PIXELS
from isonoise.integrator.kernel_table import PATH_STATE, path_bytes


class Traffic(NamedTuple):
    """Buffers that a kernel reads and writes once per `unit`; NAME:n stands for n of the buffer's 4-byte members."""

    unit: str
    reads: str
    writes: str = ""


_STATE = " ".join(PATH_STATE)
_SUMS = "count sums sample_block_sums"

TRAFFIC: dict[str, tuple[Traffic, ...]] = {
    "list_samples": (
        Traffic("pixel", "pixel_offset count rejected"),
        Traffic("sample", "", "sample_pixel sample_index"),
    ),
    "generate": (Traffic("new path", "sample_pixel sample_index", f"{_STATE} samples"),),
    "intersect": (Traffic("path", "ray_origin ray_direction:3 path_ids:1 instance", "hit instance"),),
    "shade": (
        Traffic("path", f"hit {_STATE}", "alive"),
        Traffic("survivor", "", "ray_origin ray_direction throughput path_ids:2"),
        Traffic("shadow ray", "", "shadow_origin shadow_direction shadow_radiance"),
    ),
    "shadow": (
        Traffic("path", "shadow_direction:1"),
        Traffic("shadow ray", "shadow_direction:3 shadow_origin hit:1 instance"),
    ),
    "count_alive": (Traffic("path", "alive"),),
    "list_holes": (Traffic("path", "alive"),),
    "reduce": (Traffic("pixel", f"pixel_offset rejected {_SUMS}", f"rejected {_SUMS}"), Traffic("sample", "samples")),
    "summarise": (Traffic("image pixel", _SUMS, "summary luminance"),),
}
"""What kernels move, with the basic statistics and in a scene where every ray hits a surface.

Not counted: the scene (materials, textures, lights, the primitives at a hit), what only some of a unit's members move
(radiance of unoccluded lights, emission), and private memory. Nodes and triangle blocks: `traversal_bytes`. Kernels
that are not listed work on small buffers or, like `shadow_transmittance`, mostly on the scene.
"""

_SAMPLE_BUFFERS = ("samples", "sample_pixel", "sample_index")
_PIXEL_BUFFERS = ("pixel_offset", "rejected", "luminance", *_SUMS.split())


def counted_bytes(prepared: PreparedScene, kernels: Mapping[str, KernelTotals], shadow_rays: int) -> dict[str, int]:
    """Bytes that every kernel of `TRAFFIC` moves in a run with these launches and shadow rays."""
    sizes, units = _element_bytes(prepared), _unit_counts(prepared, kernels, shadow_rays)
    return {
        name: sum(units[row.unit] * _bytes(f"{row.reads} {row.writes}", sizes) for row in TRAFFIC[name])
        for name in kernels
        if name in TRAFFIC
    }


def traversal_bytes(prepared: PreparedScene, tests: Iterable[RayTests]) -> dict[str, int]:
    """Bytes of the nodes and triangle blocks that `intersect` tests rays against in a run; empty with brute force."""
    if prepared.wavefront.brute_force:
        return {}
    node_bytes, block_bytes = prepared.bvh.nodes[0].nbytes, prepared.bvh.blocks[:1].nbytes
    return {
        "intersect": sum(each.nodes * node_bytes + each.triangles // BLOCK_TRIANGLES * block_bytes for each in tests)
    }


def _element_bytes(prepared: PreparedScene) -> dict[str, int]:
    """Bytes of a path, a sample or a pixel in every buffer of them; without those that the features leave out."""
    wavefront = prepared.wavefront
    arguments, pixels = wavefront.stages.arguments, prepared.scene.width * prepared.scene.height
    return {
        **path_bytes(wavefront.features),
        **{name: arguments[name].size // wavefront.slice_samples for name in _SAMPLE_BUFFERS},
        **{name: arguments[name].size // pixels for name in _PIXEL_BUFFERS},
        "summary": arguments["summary"].size // SUMMARY_STRIP_PIXELS,
    }


def _unit_counts(prepared: PreparedScene, kernels: Mapping[str, KernelTotals], shadow_rays: int) -> dict[str, int]:
    def items(kernel: str) -> int:
        return kernels[kernel].items if kernel in kernels else 0

    return {
        "path": items("intersect"),
        "new path": items("generate"),
        "survivor": items("intersect") - items("generate"),  # every survivor of a bounce is in the next one
        "shadow ray": shadow_rays,
        "sample": prepared.samples,
        "pixel": items("list_samples"),
        "image pixel": items("summarise"),
    }


def _bytes(names: str, sizes: Mapping[str, int]) -> int:
    total = 0
    for word in names.split():
        name, _, members = word.partition(":")
        size = sizes.get(name, 0)
        total += min(4 * int(members), size) if members else size
    return total
