"""Against other renderers: samples per second over Mitsuba 3's, rays per second over Embree's, each in turn."""

import importlib.util
import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np

from isonoise import __version__
from isonoise.benchmark.embree import has_rays, measure_rays
from isonoise.benchmark.measure import Settings, device_facts, load_subject, samples_of
from isonoise.benchmark.spread import Spread
from isonoise.benchmark.subject import MeasuredDevice, Subject
from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.mitsuba_worker import MitsubaWorker
from isonoise.errors import UserError
from isonoise.progress import ProgressBar
from isonoise.scene.compiled_scene import CompiledScene

SCHEMA, SCHEMA_VERSION = "isonoise-peers", 1
PEER_SCENES = ("cornell", "bright-spots", "mesh-82k", "mesh-1.3m")
PACKAGES = {"mitsuba": "Mitsuba 3", "embreex": "Embree"}


def measure_peers(sources: Mapping[str, str], settings: Settings) -> dict[str, object]:
    """All ratios, as the JSON has them. `sources`: name -> file or built-in scene. Raises UserError if it cannot."""
    missing = [name for package, name in PACKAGES.items() if importlib.util.find_spec(package) is None]
    if missing:
        raise UserError(f"--peers needs {' and '.join(missing)}: pip install 'isonoise[peers]'")
    device = MeasuredDevice(settings.device)
    result = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "isonoise_version": __version__,
        "mitsuba_version": version("mitsuba"),
        "embreex_version": version("embreex"),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "device": device_facts(device),
        "repeat": settings.repeat,
        "scenes": [],
        "meshes": [],
    }
    with ProgressBar() as bar:
        for number, (name, source) in enumerate(sources.items()):

            def say(done: float, what: str, number=number, name=name) -> None:
                bar.show(number + done, len(sources), f"{name}: {what}")

            say(0.0, "set-up")
            scene = load_subject(source, settings)
            result["scenes"].append(_against_mitsuba(name, source, scene, settings, say))
            if has_rays(scene):
                row = measure_rays(
                    name,
                    scene,
                    MeasuredDevice(settings.device),
                    settings.repeat,
                    lambda done, what, say=say: say(0.6 + 0.4 * done, what),
                )
                result["meshes"].append(row)
    return result


def _against_mitsuba(
    name: str, source: str, scene: CompiledScene, settings: Settings, say: Callable[[float, str], None]
) -> dict[str, object]:
    device = MeasuredDevice(settings.device)
    pixels = scene.width * scene.height
    spp = max(1, round(samples_of(scene, settings, device) / pixels))
    xml = mitsuba_xml(Path(source), "independent", settings.size, settings.max_depth)
    worker = MitsubaWorker(name, xml, pixels)
    try:
        subject = Subject(scene, device, spp * pixels)
        say(0.1, "warm-up")
        for warm_up in range(2):  # the first may compile for the size of the pass
            worker.render(spp, warm_up)
            subject.run(profile=False)
        ours, theirs = [], []
        for number in range(settings.repeat):
            say(0.2 + 0.4 * number / settings.repeat, f"repeat {number + 1} of {settings.repeat}")
            ours.append(spp * pixels / subject.run(profile=False).seconds)
            image, seconds = worker.render(spp, 2 + number)
            theirs.append(spp * pixels / seconds)
        mean = float(np.mean(subject.wavefront.accumulator.statistics(scene.radiance_scale).rgb))
    finally:
        worker.close()
    return {
        "scene": name,
        "scene_hash": scene.hash,
        "width": scene.width,
        "height": scene.height,
        "max_depth": scene.max_depth,
        "rr_depth": scene.rr_depth,
        "triangles": len(scene.faces),
        "samples": spp * pixels,
        "mitsuba_variant": worker.variant,
        "samples_per_s": Spread.of(ours).json(),
        "mitsuba_samples_per_s": Spread.of(theirs).json(),
        "ratio": Spread.of(mine / other for mine, other in zip(ours, theirs, strict=True)).json(),
        "image_mean_ratio": mean / float(np.mean(image)) if np.mean(image) else None,
    }
