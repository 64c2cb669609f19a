"""The figures of every kernel: time, memory, bytes moved and their rate. Called by `measure`."""

from collections.abc import Sequence

from isonoise.benchmark.bounces import RayTests
from isonoise.benchmark.kernel_memory import kernel_memory
from isonoise.benchmark.prepared_scene import PreparedScene, Run
from isonoise.benchmark.spread import spread
from isonoise.benchmark.traffic import counted_bytes, traversal_bytes


def kernel_rows(
    prepared: PreparedScene, runs: Sequence[Run], shadow_rays: int, tests: Sequence[RayTests], copy_gb_per_s: float
) -> list[dict[str, object]]:
    """The JSON field `kernels`: a row per kernel, the one with the largest time first.

    Parameters
    ----------
    runs : sequence of Run
        Profiled runs; launches and items are equal in all.
    shadow_rays, tests
        Of a run, from `bounces`.
    copy_gb_per_s : float
        Bandwidth of the device, from `copy_bandwidth`.
    """
    totals_of_runs = [run.kernels() for run in runs]
    kernels = totals_of_runs[0]
    seconds = {name: [totals[name].seconds for totals in totals_of_runs] for name in kernels}
    times = {name: spread(each) for name, each in seconds.items()}
    total = sum(time["median"] for time in times.values())
    moved, traversed = counted_bytes(prepared, kernels, shadow_rays), traversal_bytes(prepared, tests)
    rows = []
    for name, totals in kernels.items():
        time = times[name]["median"]
        bytes_moved = moved[name] + traversed.get(name, 0) if name in moved else None
        gb_per_s = 1e-9 * bytes_moved / time if bytes_moved is not None and time > 0 else None
        rows.append(
            {
                "kernel": name,
                "launches": totals.launches,
                "items": totals.items,
                "time_s": times[name],
                "runs_s": seconds[name],
                "time_share": time / total if total else 0.0,
                "ns_per_item": 1e9 * time / totals.items,
                **kernel_memory(prepared.device, prepared.wavefront.stages[name]),
                "bytes_per_item": moved[name] / totals.items if name in moved else None,
                "traversal_bytes_per_item": traversed[name] / totals.items if name in traversed else None,
                "gb_per_s": gb_per_s,
                "copy_share": None if gb_per_s is None else gb_per_s / copy_gb_per_s,
            }
        )
    return sorted(rows, key=lambda row: -row["time_share"])
