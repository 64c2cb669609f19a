"""Finds the fastest pool size of a device: runs with several sizes in turn (`isonoise bench --tune`)."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence

from isonoise.benchmark.measure import Settings, ShowProgress, samples_per_run
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.device.opencl import Device
from isonoise.device.pool_size import MAX_POOL_SIZE, untuned_pool_size
from isonoise.scene.compiled_scene import CompiledScene

FACTORS = (0.25, 0.5, 1, 2, 4)
"""Pool sizes that are tried, over the untuned one."""
MIN_GAIN = 1.02
"""Median speed over that of the untuned size from which another size is chosen."""
MEMORY_SHARE = 0.5
"""Share of the device's memory for all pools together; they are allocated at the same time."""


def measure_pools(scenes: Iterable[CompiledScene], settings: Settings, show: ShowProgress) -> dict[int, list[float]]:
    """Samples per second by pool size, one value per turn: the geometric mean over the scenes."""
    scenes, log_speeds = list(scenes), {}
    for scene_index, scene in enumerate(scenes):
        by_size = _prepare_sizes(scene, settings)
        for turn in range(settings.repeat + 1):  # the first one warms up
            for index, (size, prepared) in enumerate(by_size.items()):
                done = (turn + index / len(by_size)) / (settings.repeat + 1)
                show((scene_index + done) / len(scenes), f"{size:,} paths")
                speed = prepared.samples / prepared.run(profile=False).seconds
                if turn:
                    log_speeds.setdefault(size, [0.0] * settings.repeat)[turn - 1] += math.log(speed) / len(scenes)
    return {size: [math.exp(value) for value in turns] for size, turns in log_speeds.items()}


def _prepare_sizes(scene: CompiledScene, settings: Settings) -> dict[int, PreparedScene]:
    """The scene with the untuned pool size, and with all others that fit into the memory."""
    device = Device(settings.device)
    untuned, samples = untuned_pool_size(device.device), samples_per_run(scene, settings, device)
    by_size = {untuned: PreparedScene(scene, MeasuredDevice(settings.device), samples, untuned)}
    untuned_bytes = by_size[untuned].device.allocated
    allocated, limit = untuned_bytes, MEMORY_SHARE * device.device.global_mem_size
    for factor in FACTORS:
        size, needed = int(factor * untuned), max(factor, 1) * untuned_bytes
        if size not in by_size and size <= MAX_POOL_SIZE and allocated + needed <= limit:
            by_size[size] = PreparedScene(scene, MeasuredDevice(settings.device), samples, size)
            allocated += needed
    return dict(sorted(by_size.items()))


def choose_pool_size(speeds: Mapping[int, Sequence[float]], untuned: int) -> int:
    """The size with the largest median gain over the untuned one among those that are faster in every turn.

    Returns the untuned size if there is none. A size of equal speed is faster in all of five turns with probability
    1/32.
    """
    best, best_gain = untuned, MIN_GAIN
    for size, turns in speeds.items():
        gains = [speed / reference for speed, reference in zip(turns, speeds[untuned], strict=True)]
        if min(gains) > 1 and statistics.median(gains) > best_gain:
            best, best_gain = size, statistics.median(gains)
    return best
