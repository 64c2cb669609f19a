"""Which pool size is fastest on a device: runs with several, in turn."""

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence

from isonoise.benchmark.measure import Settings, samples_of
from isonoise.benchmark.subject import MeasuredDevice, Subject
from isonoise.device.opencl import Device
from isonoise.device.pool_size import untuned_pool_size
from isonoise.scene.compiled_scene import CompiledScene

FACTORS = (0.25, 0.5, 1, 2, 4)
"""Pool sizes that are tried, over the usual one."""
LEAST_GAIN = 1.02
"""What another size has to win over the usual one, in the median of the turns."""
MEMORY_SHARE = 0.5
"""Of the device's memory, for all pools together: they take turns, so all are there at once."""


def measure_pools(
    scenes: Iterable[CompiledScene], settings: Settings, say: Callable[[float, str], None]
) -> dict[int, list[float]]:
    """Samples per second with every pool size, a number a turn: the geometric mean over the scenes.

    `say` gets the share that is done, and what is being done.
    """
    scenes, logarithms = list(scenes), {}
    for place, scene in enumerate(scenes):
        subjects = _subjects(scene, settings)
        for turn in range(settings.repeat + 1):  # the first one warms up
            for number, (size, subject) in enumerate(subjects.items()):
                share = (turn + number / len(subjects)) / (settings.repeat + 1)
                say((place + share) / len(scenes), f"{size:,} paths")
                speed = subject.samples / subject.run(profile=False).seconds
                if turn:
                    logarithms.setdefault(size, [0.0] * settings.repeat)[turn - 1] += math.log(speed) / len(scenes)
    return {size: [math.exp(sum_) for sum_ in turns] for size, turns in logarithms.items()}


def _subjects(scene: CompiledScene, settings: Settings) -> dict[int, Subject]:
    """The scene with every pool size for which there is memory; the usual one always."""
    device = Device(settings.device)
    usual, samples = untuned_pool_size(device.device), samples_of(scene, settings, device)
    subjects = {usual: Subject(scene, MeasuredDevice(settings.device), samples, usual)}
    taken, room = subjects[usual].device.allocated, MEMORY_SHARE * device.device.global_mem_size
    for factor in FACTORS:
        size = int(factor * usual)
        needed = max(factor, 1) * subjects[usual].device.allocated
        if size not in subjects and taken + needed <= room:
            subjects[size] = Subject(scene, MeasuredDevice(settings.device), samples, size)
            taken += needed
    return dict(sorted(subjects.items()))


def fastest(speeds: Mapping[int, Sequence[float]], usual: int) -> int:
    """The size with the largest median gain over the usual one, of those that win every turn; else the usual one.

    Of sizes that are equally fast one wins all of five turns once in 32 times.
    """
    best, most = usual, LEAST_GAIN
    for size, turns in speeds.items():
        gains = [mine / its for mine, its in zip(turns, speeds[usual], strict=True)]
        if min(gains) > 1 and statistics.median(gains) > most:
            best, most = size, statistics.median(gains)
    return best
