"""`isonoise bench`: check what can be checked, measure scene by scene, report, compare."""

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from isonoise.benchmark.baseline import Earlier
from isonoise.benchmark.generated_scenes import MADE_SCENES, write_made_scene
from isonoise.benchmark.measure import Settings, head, identity, load_subject, measure, samples_of
from isonoise.benchmark.text import against_text, head_text, pools_text, scene_text, summary_text
from isonoise.commands import EXIT_DONE
from isonoise.device import pool_size, program_cache
from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.film.files import check_writable, write_atomically
from isonoise.progress import ProgressBar
from isonoise.scene.builtin import builtin_scenes, find_scene

EXIT_SLOWER = 1
DEFAULT_SCENES = ("cornell", "bright-spots", "mesh-82k")
DEFAULT_THRESHOLD = 0.9
TUNED_SCENES = ("cornell",)


def run(options: argparse.Namespace) -> int:
    """Measure as the options say; returns the exit code. Raises UserError for what is the user's to mend."""
    if options.json:
        check_writable(options.json)
    if options.threshold is not None and not options.against:
        raise UserError("--threshold says how slow is too slow against a file: name it with --against")
    settings = Settings(options.repeat, options.size, options.spp, options.max_depth, options.device)
    with tempfile.TemporaryDirectory(prefix="isonoise-bench-") as folder:
        if options.tune:
            if options.against or options.json:
                raise UserError("--tune chooses a pool size: it goes with neither --against nor --json")
            return _tune(settings, _sources(options.scenes or TUNED_SCENES, Path(folder)))
        if options.against and (options.peers or options.specialisation):
            raise UserError("--against compares measurements without --peers and without --specialisation")
        if options.specialisation:
            from isonoise.benchmark.specialisation import measure_specialisation
            from isonoise.benchmark.specialisation_text import specialisation_text

            sources = _sources(options.scenes or builtin_scenes(), Path(folder))
            result = measure_specialisation(sources, settings)
            _write(options.json, result)
            _say(specialisation_text(result))
            return EXIT_DONE
        if options.peers:
            from isonoise.benchmark.peers import PEER_SCENES, measure_peers
            from isonoise.benchmark.peers_text import peers_text

            result = measure_peers(_sources(options.scenes or PEER_SCENES, Path(folder)), settings)
            _write(options.json, result)
            _say(peers_text(result))
            return EXIT_DONE
        return _bench(options, settings, _sources(options.scenes or DEFAULT_SCENES, Path(folder)))


def _bench(options: argparse.Namespace, settings: Settings, sources: Mapping[str, str]) -> int:
    earlier = Earlier(options.against) if options.against else None
    device = Device(options.device)
    result = head(settings, device)
    if earlier:
        earlier.check_device(result)
    _say(head_text(result))
    with ProgressBar() as bar:
        for number, (name, source) in enumerate(sources.items()):
            scene = load_subject(source, settings)
            if earlier:
                earlier.check_scene(identity(name, scene, samples_of(scene, settings, device)))

            def show(done: float, what: str, number=number, name=name) -> None:
                bar.show(number + done, len(sources), f"{name}: {what}")

            result["scenes"].append(measure(name, source, scene, settings, show))
            _say(scene_text(result["scenes"][-1]))
    _say(summary_text(result))
    _write(options.json, result)
    return _judge(earlier, result, options.threshold or DEFAULT_THRESHOLD) if earlier else EXIT_DONE


def _tune(settings: Settings, sources: Mapping[str, str]) -> int:
    """Measures pool sizes and keeps the fastest for the device."""
    from isonoise.benchmark.tune import fastest, measure_pools

    device = Device(settings.device).device
    scenes = [load_subject(source, settings) for source in sources.values()]
    with ProgressBar() as bar:
        speeds = measure_pools(scenes, settings, lambda done, what: bar.show(done, 1, what))
    usual = pool_size.untuned_pool_size(device)
    chosen = fastest(speeds, usual)
    _say(pools_text(speeds, usual, chosen))
    if not pool_size.store_tuned_pool_size(device, chosen):
        raise UserError(
            f"the choice cannot be kept: {program_cache.FOLDER_VARIABLE} is off, or its folder cannot be written to"
        )
    return EXIT_DONE


def _judge(earlier: Earlier, result: Mapping, threshold: float) -> int:
    comparison = earlier.compare(result)
    _say(against_text(comparison, threshold))
    slower = comparison.slower(threshold)
    if not slower:
        return EXIT_DONE
    print(f"isonoise: slower than in '{earlier.path}': {'; '.join(map(str, slower))}", file=sys.stderr)
    return EXIT_SLOWER


def _sources(names: list[str], folder: Path) -> dict[str, str]:
    """Name -> file or built-in scene; made scenes are written into `folder`. Raises UserError for what is not there."""
    sources = {}
    for name in names:
        if name in MADE_SCENES and not Path(name).exists():
            sources[name] = ""
        else:
            sources[name] = str(find_scene(name))
    return {name: source or str(write_made_scene(name, folder)) for name, source in sources.items()}


def _write(path: str | None, result: Mapping) -> None:
    if path:
        text = json.dumps(result, indent=1, allow_nan=False) + "\n"
        write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _say(text: str) -> None:
    if text:
        print(text, flush=True)
