"""Compares samples/s with Mitsuba 3's and rays/s with Embree's, in turn (`isonoise bench --peers`)."""

import importlib.util
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np

from isonoise.benchmark.embree import is_triangles_only, measure_rays
from isonoise.benchmark.measure import (
    Settings,
    ShowProgress,
    load_scene,
    measure_each,
    report_header,
    samples_per_run,
    scene_identity,
)
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.benchmark.spread import spread
from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.mitsuba_worker import MitsubaWorker
from isonoise.errors import UserError
from isonoise.scene.compiled_scene import CompiledScene

SCHEMA, SCHEMA_VERSION = "isonoise-peers", 2
PEER_SCENES = ("cornell", "bright-spots", "mesh-82k", "mesh-1.3m")
PACKAGES = {"mitsuba": "Mitsuba 3", "embreex": "Embree"}


def measure_peers(sources: Mapping[str, str], settings: Settings) -> dict[str, object]:
    """All speed ratios, as in the JSON file.

    Parameters
    ----------
    sources : mapping
        Name -> file or built-in scene.

    Raises
    ------
    UserError
        A package is missing, or Mitsuba cannot render a scene.
    """
    missing = [name for package, name in PACKAGES.items() if importlib.util.find_spec(package) is None]
    if missing:
        raise UserError(f"--peers needs {' and '.join(missing)}: pip install 'isonoise[peers]'")
    result = report_header(SCHEMA, SCHEMA_VERSION, settings, MeasuredDevice(settings.device)) | {
        "mitsuba_version": version("mitsuba"),
        "embreex_version": version("embreex"),
        "meshes": [],
    }

    def measure(name: str, source: str, show: ShowProgress) -> None:
        show(0.0, "set-up")
        scene = load_scene(source, settings)
        result["scenes"].append(_measure_samples(name, source, scene, settings, show))
        if is_triangles_only(scene):
            device = MeasuredDevice(settings.device)

            def show_rays(done: float, activity: str) -> None:
                show(0.6 + 0.4 * done, activity)

            result["meshes"].append(measure_rays(name, scene, device, settings.repeat, show_rays))

    measure_each(sources, measure)
    return result


def _measure_samples(
    name: str, source: str, scene: CompiledScene, settings: Settings, show: ShowProgress
) -> dict[str, object]:
    """An entry of the JSON field `scenes`: samples per second of isonoise and of Mitsuba."""
    device = MeasuredDevice(settings.device)
    pixels = scene.width * scene.height
    spp = max(1, round(samples_per_run(scene, settings, device) / pixels))
    xml = mitsuba_xml(Path(source), "independent", settings.size, settings.max_depth)
    mitsuba = MitsubaWorker(name, xml, pixels)
    try:
        prepared = PreparedScene(scene, device, spp * pixels)
        show(0.1, "warm-up")
        for seed in range(2):  # the first pass may compile for its size
            mitsuba.render(spp, seed)
            prepared.run(profile=False)
        speeds, mitsuba_speeds = [], []
        for index in range(settings.repeat):
            show(0.2 + 0.4 * index / settings.repeat, f"repeat {index + 1} of {settings.repeat}")
            speeds.append(spp * pixels / prepared.run(profile=False).seconds)
            image, seconds = mitsuba.render(spp, 2 + index)
            mitsuba_speeds.append(spp * pixels / seconds)
        mean = float(np.mean(prepared.wavefront.accumulator.statistics(scene.radiance_scale).rgb))
    finally:
        mitsuba.close()
    return {
        **scene_identity(name, scene, spp * pixels),
        "rr_depth": scene.rr_depth,
        "triangles": len(scene.faces),
        "mitsuba_variant": mitsuba.variant,
        "samples_per_s": spread(speeds),
        "mitsuba_samples_per_s": spread(mitsuba_speeds),
        "speedup": spread(speed / other for speed, other in zip(speeds, mitsuba_speeds, strict=True)),
        "image_mean_ratio": mean / float(np.mean(image)) if np.mean(image) else None,
    }
