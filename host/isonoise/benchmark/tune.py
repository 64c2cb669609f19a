"""Finds the fastest form and pool size of a device: runs with several in turn (`isonoise bench --tune`)."""

import math
import statistics
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence

from isonoise.benchmark.measure import Settings, ShowProgress, samples_per_run
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.device.form import CPU_FORMS, FORMS, DeviceForm
from isonoise.device.opencl import Device
from isonoise.device.pool_size import MAX_POOL_SIZE, untuned_pool_size
from isonoise.scene.compiled_scene import CompiledScene

FACTORS = (0.25, 0.5, 1, 2, 4)
"""Pool sizes that are tried, over the untuned one."""
MIN_GAIN = 1.02
"""Median speed over that of the default from which another choice is taken."""
MEMORY_SHARE = 0.5
"""Share of the device's memory for all pools together; they are allocated at the same time."""


Speeds = dict[Hashable, list[float]]
"""Samples per second of each choice, one value per turn: the geometric mean over the scenes."""


def measure_forms(scenes: Iterable[CompiledScene], settings: Settings, show: ShowProgress) -> Speeds:
    """Speeds of the device forms, by name, with the untuned pool size; empty if the device has only one form."""
    device = Device(settings.device)
    if not device.is_cpu:
        return {}
    size = untuned_pool_size(device.device)

    def prepare(scene: CompiledScene) -> dict[Hashable, PreparedScene]:
        return {name: _prepare(scene, settings, FORMS[name], size) for name in CPU_FORMS}

    return _measure_in_turn(scenes, settings, show, prepare)


def measure_pools(scenes: Iterable[CompiledScene], settings: Settings, show: ShowProgress, form: DeviceForm) -> Speeds:
    """Speeds of the pool sizes that fit into the memory."""

    def prepare(scene: CompiledScene) -> dict[Hashable, PreparedScene]:
        return _prepare_sizes(scene, settings, form)

    return _measure_in_turn(scenes, settings, show, prepare)


def _measure_in_turn(
    scenes: Iterable[CompiledScene],
    settings: Settings,
    show: ShowProgress,
    prepare: Callable[[CompiledScene], dict[Hashable, PreparedScene]],
) -> Speeds:
    scenes, log_speeds = list(scenes), {}
    for scene_index, scene in enumerate(scenes):
        choices = prepare(scene)
        for turn in range(settings.repeat + 1):  # the first one warms up
            for index, (choice, prepared) in enumerate(choices.items()):
                done = (turn + index / len(choices)) / (settings.repeat + 1)
                show((scene_index + done) / len(scenes), choice_text(choice))
                speed = prepared.samples / prepared.run(profile=False).seconds
                if turn:
                    log_speeds.setdefault(choice, [0.0] * settings.repeat)[turn - 1] += math.log(speed) / len(scenes)
    return {choice: [math.exp(value) for value in turns] for choice, turns in log_speeds.items()}


def choice_text(choice: Hashable) -> str:
    """A device form or a number of paths, for the user."""
    return f"{choice:,} paths" if isinstance(choice, int) else f"form {choice}"


def _prepare(scene: CompiledScene, settings: Settings, form: DeviceForm, pool_size: int) -> PreparedScene:
    device = MeasuredDevice(settings.device)
    device.form = form
    return PreparedScene(scene, device, samples_per_run(scene, settings, device), pool_size)


def _prepare_sizes(scene: CompiledScene, settings: Settings, form: DeviceForm) -> dict[Hashable, PreparedScene]:
    """The scene with the untuned pool size, and with all others that fit into the memory."""
    device = Device(settings.device).device
    untuned = untuned_pool_size(device)
    by_size = {untuned: _prepare(scene, settings, form, untuned)}
    untuned_bytes = by_size[untuned].device.allocated
    allocated, limit = untuned_bytes, MEMORY_SHARE * device.global_mem_size
    for factor in FACTORS:
        size, needed = int(factor * untuned), max(factor, 1) * untuned_bytes
        if size not in by_size and size <= MAX_POOL_SIZE and allocated + needed <= limit:
            by_size[size] = _prepare(scene, settings, form, size)
            allocated += needed
    return dict(sorted(by_size.items()))


def choose_fastest(speeds: Mapping[Hashable, Sequence[float]], default: Hashable) -> Hashable:
    """The choice with the largest median gain over the default among those that are faster in every turn.

    Returns the default if there is none. A choice of equal speed is faster in all of five turns with probability 1/32.
    """
    best, best_gain = default, MIN_GAIN
    for choice, turns in speeds.items():
        gains = [speed / reference for speed, reference in zip(turns, speeds[default], strict=True)]
        if min(gains) > 1 and statistics.median(gains) > best_gain:
            best, best_gain = choice, statistics.median(gains)
    return best
