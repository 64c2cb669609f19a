"""`isonoise bench`: checks the options, measures scene by scene, prints and writes the report."""

import argparse
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from isonoise.benchmark.baseline import Baseline
from isonoise.benchmark.copy_bandwidth import copy_gb_per_s
from isonoise.benchmark.generated_scenes import GENERATED_SCENES, write_generated_scene
from isonoise.benchmark.measure import (
    SCHEMA,
    SCHEMA_VERSION,
    Settings,
    ShowProgress,
    load_scene,
    measure_each,
    measure_scene,
    report_header,
    samples_per_run,
    scene_identity,
)
from isonoise.benchmark.outputs import Outputs, write_json
from isonoise.benchmark.report_text import (
    bandwidth_text,
    comparison_text,
    header_text,
    peers_text,
    scene_text,
    specialisation_text,
    summary_text,
    tuning_text,
    versus_text,
)
from isonoise.command_output import STANDARD_OUTPUT, logger
from isonoise.commands import EXIT_DONE
from isonoise.device import form, pool_size, program_cache
from isonoise.device.drivers import describe_driver
from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.film.files import check_no_input, check_writable
from isonoise.progress import ProgressBar
from isonoise.scene.builtin import builtin_scenes, find_scene
from isonoise.strategies.uniform_allocation import MAX_COUNT

EXIT_SLOWER = 1
DEFAULT_SCENES = ("cornell", "bright-spots", "mesh-82k")
DEFAULT_THRESHOLD = 0.9
TUNED_SCENES = ("cornell",)
MODES = ("tune", "peers", "specialisation", "versus")
MEASUREMENT_OPTIONS = ("against", "trace", "dump", "pytest_benchmark")
"""Options of the measurement that a mode replaces."""


def run(options: argparse.Namespace) -> int:
    """Run the command; returns the exit code. Raises UserError if options, files or devices are unusable."""
    _check_options(options)
    settings = Settings(
        options.repeat,
        options.size,
        options.spp,
        options.max_depth,
        options.device,
        allow_outside=options.allow_outside,
    )
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        if options.tune:
            return _tune(settings, _sources(options.scenes or TUNED_SCENES, Path(folder)))
        if options.specialisation:
            from isonoise.benchmark.specialisation import measure_specialisation

            result = measure_specialisation(_sources(options.scenes or builtin_scenes(), Path(folder)), settings)
            write_json(options.json, result)
            _print(specialisation_text(result))
            return EXIT_DONE
        if options.peers:
            from isonoise.benchmark.peers import PEER_SCENES, measure_peers

            result = measure_peers(_sources(options.scenes or PEER_SCENES, Path(folder)), settings)
            write_json(options.json, result)
            _print(peers_text(result))
            return EXIT_DONE
        if options.versus:
            return _versus(options, settings, _sources(options.scenes or DEFAULT_SCENES, Path(folder)))
        return _bench(options, settings, _sources(options.scenes or DEFAULT_SCENES, Path(folder)))


def _check_options(options: argparse.Namespace) -> None:
    report = None if options.json == STANDARD_OUTPUT else options.json
    if report:
        check_writable(report)
    check_no_input([report, options.trace, options.pytest_benchmark], map(Path, options.scenes))
    if options.spp is not None and options.spp > MAX_COUNT:
        raise UserError(f"--spp {options.spp:g} is more than a pixel can take: the limit is {MAX_COUNT}")
    if options.threshold is not None and not (options.against or options.versus):
        raise UserError("--threshold needs something to compare with: name it with --against or --versus")
    if options.tune and options.json:
        raise UserError("--tune only chooses a pool size: it cannot be combined with --json")
    mode = next((name for name in MODES if getattr(options, name)), None)
    used = next((name for name in MEASUREMENT_OPTIONS if getattr(options, name)), None)
    if mode and used:
        raise UserError(f"--{used.replace('_', '-')} belongs to the measurement that --{mode} replaces: leave out one")


def _bench(options: argparse.Namespace, settings: Settings, sources: Mapping[str, str]) -> int:
    outputs = Outputs(options.json, options.trace, options.dump, options.pytest_benchmark)
    baseline = Baseline(options.against) if options.against else None
    device = Device(options.device)
    result = report_header(SCHEMA, SCHEMA_VERSION, settings, device)
    if baseline:
        baseline.check_device(result)
    result["copy_gb_per_s"] = copy_gb_per_s(Device(options.device), settings.repeat)
    _print(header_text(result, ("copies", bandwidth_text(result))))

    def measure(name: str, source: str, show: ShowProgress) -> None:
        scene = load_scene(source, settings)
        if baseline:
            baseline.check_scene(scene_identity(name, scene, samples_per_run(scene, settings, device)))
        inspect = partial(outputs.add_scene, name)
        row = measure_scene(name, source, scene, settings, result["copy_gb_per_s"], show, inspect)
        result["scenes"].append(row)
        _print(scene_text(result["scenes"][-1]))

    measure_each(sources, measure)
    _print(summary_text(result))
    outputs.write(result)
    return _compare(baseline, result, options.threshold or DEFAULT_THRESHOLD) if baseline else EXIT_DONE


def _tune(settings: Settings, sources: Mapping[str, str]) -> int:
    """Measure forms and pool sizes, and store the fastest ones for the device."""
    from isonoise.benchmark.tune import choose_fastest, measure_forms, measure_pools

    measured = Device(settings.device)
    device = measured.device
    _print(f"{measured.name}, {describe_driver(device)}")
    scenes = [load_scene(source, settings) for source in sources.values()]
    chosen_form = default_form = form.default_form(device).name
    with ProgressBar() as bar:
        forms = measure_forms(scenes, settings, lambda done, activity: bar.show(done, 1, activity))
    if forms:
        chosen_form = choose_fastest(forms, default_form)
        _print(tuning_text("device form", forms, default_form, chosen_form) + "\n")
    with ProgressBar() as bar:
        chosen = form.FORMS[chosen_form]
        sizes = measure_pools(scenes, settings, lambda done, activity: bar.show(done, 1, activity), chosen)
    untuned = pool_size.untuned_pool_size(device)
    chosen_size = choose_fastest(sizes, untuned)
    _print(tuning_text("paths in flight", sizes, untuned, chosen_size))
    stored = form.store_tuned_form(device, chosen_form), pool_size.store_tuned_pool_size(device, chosen_size)
    if not all(stored):
        raise UserError(
            f"the choice cannot be stored: {program_cache.FOLDER_VARIABLE} is off, or its folder is not writable"
        )
    return EXIT_DONE


def _compare(baseline: Baseline, result: Mapping, threshold: float) -> int:
    comparison = baseline.compare(result)
    _print(comparison_text(comparison, threshold))
    slower = comparison.slower(threshold)
    if not slower:
        return EXIT_DONE
    logger.error(f"slower than in '{baseline.path}': {'; '.join(map(str, slower))}")
    return EXIT_SLOWER


def _versus(options: argparse.Namespace, settings: Settings, sources: Mapping[str, str]) -> int:
    from isonoise.benchmark.versus import is_slower, measure_versus

    result = measure_versus(sources, settings, options.versus)
    threshold = options.threshold or DEFAULT_THRESHOLD
    slower = [scene for scene in result["scenes"] if is_slower(scene, threshold)]
    write_json(options.json, result)
    _print(versus_text(result, threshold, [scene["scene"] for scene in slower]))
    if not slower:
        return EXIT_DONE
    ratios = "; ".join(f"{scene['scene']} samples/s {scene['speedup']['median']:.3f}" for scene in slower)
    logger.error(f"slower than '{options.versus}': {ratios}")
    return EXIT_SLOWER


def _sources(names: list[str], folder: Path) -> dict[str, str]:
    """Name -> file or built-in scene; generated scenes are written to `folder`. Raises UserError for unknown names."""
    is_generated = {name: name in GENERATED_SCENES and not Path(name).exists() for name in names}
    found = {name: str(find_scene(name)) for name in names if not is_generated[name]}
    return {name: found[name] if name in found else str(write_generated_scene(name, folder)) for name in names}


def _print(text: str) -> None:
    if text:
        print(text, flush=True)
