"""Renders random jobs for some minutes, kills them, continues them and merges them; see README.md.

`python tests/soak.py MINUTES [SEED]` stops with an exception at the first fault, and prints figures at the end.
"""

import collections
import contextlib
import gc
import io
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from killed_renders import Files, Job, Kill, random_kill

from isonoise import Renderer
from isonoise.cli import main
from isonoise.film.exr import read_exr
from isonoise.strategies.registry import BUILT_IN

RENDERERS = 300
"""Renderers in one process: its memory and open files after the first 50 are compared with those after the last."""
MAX_GROWTH_BYTES = 6 << 20
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
STRATEGIES = [name for name in BUILT_IN if name != "oracle"]
SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/>
<transform name="to_world"><lookat origin="0, 2.4, 3" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="{floor}"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="{red}, 0.5, 0.4"/></bsdf></shape>
<shape type="sphere"><point name="center" x="{x}" y="0.4" z="0"/><float name="radius" value="{radius}"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="90"/>
<translate x="0.4" y="1.5" z="0"/></transform>
<emitter type="area"><rgb name="radiance" value="{light}"/></emitter></shape></scene>"""


def main_soak(minutes: float, seed: int) -> None:
    rng, end = random.Random(seed), time.monotonic() + 60 * minutes
    counts = collections.Counter()
    losses = []
    try:
        while time.monotonic() < end:
            run_job(rng.randrange(2**32), counts, losses)
        measure_growth()
    finally:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(f"seed {seed}: " + ", ".join(f"{n} {what}" for what, n in sorted(counts.items())))
        print(f"rendering time lost by a SIGKILL, beside the interval: at most {max(losses, default=0.0):.3f} s")
        print(f"processor time of the renders: {children.ru_utime + children.ru_stime:.0f} s")


def run_job(seed: int, counts: collections.Counter, losses: list[float]) -> None:
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        rng = random.Random(seed)
        try:
            if rng.random() < 0.8:
                soak_kills(Path(name), rng, counts, losses)
            else:
                soak_merge(Path(name), rng, counts)
        except BaseException:
            print(f"job {seed} failed; its files are in {shutil.copytree(name, tempfile.mkdtemp() + '/soak')}")
            raise


def random_scene(folder: Path, rng: random.Random) -> str:
    if rng.random() < 0.4:
        return rng.choice(("cornell", "penumbra", "bright-spots"))
    values = {"depth": rng.randint(2, 6), "floor": rng.uniform(1, 3), "red": rng.random(), "x": rng.uniform(-1, 1)}
    path = folder / "scene.xml"
    path.write_text(SCENE.format(**values, radius=rng.uniform(0.1, 0.5), light=rng.uniform(1, 20)))
    return str(path)


def random_options(rng: random.Random) -> dict[str, object]:
    size = rng.randint(1, 80), rng.randint(1, 60)
    samples = 10 ** rng.uniform(4, 6.5)
    return {
        "strategy": rng.choice(STRATEGIES),
        "size": size,
        "spp": max(1, round(samples / (size[0] * size[1]), rng.randint(0, 2))),
        "interval_s": rng.choice((0.1, 0.2, 0.5)),
        "save_every_s": rng.choice((None, 0.1, 0.3)),
        "more": ("--sampler", rng.choice(("sobol", "independent")), "--seed", str(rng.randrange(2**64))),
    }


def soak_kills(folder: Path, rng: random.Random, counts: collections.Counter, losses: list[float]) -> None:
    """A render that is killed up to four times, against the same render in one piece."""
    options = random_options(rng) | {"scene": random_scene(folder, rng)}
    print(options, flush=True)
    unbroken = make_job(folder, "unbroken", options)
    start = time.monotonic()
    unbroken.run()
    seconds = time.monotonic() - start
    whole = Files.read(unbroken)
    check_total(whole, unbroken.size, unbroken.spp)
    job = make_job(folder, "killed", options)
    files = Files.read(job)
    for _ in range(rng.randint(1, 4)):
        kill = random_kill(rng, job, seconds, operations=100)
        if not kill.operation:
            kill = Kill(kill.delay_s, kill.pattern, signal=rng.choice(SIGNALS))
        is_killed = job.run_killed(kill)
        before, files = files, Files.read(job)
        assert files.kept_samples >= before.kept_samples
        assert before.channels is None or files.channels is not None
        counts[f"{kill.signal.name if is_killed else 'too late'}"] += 1
        if is_killed and kill.signal == signal.SIGKILL:
            losses.append(max(files.logged_s - files.kept_s - job.interval_s, 0.0))
        elif is_killed and files.kept_samples > before.kept_samples and not any(job.folder.glob("*.partial*")):
            assert total(files) == files.kept_samples
    job.run()
    Files.read(job).assert_equal(whole)
    names = {path.name for path in job.folder.iterdir() if ".partial" not in path.name}
    assert names == {*job.NAMES}, names
    counts["killed renders"] += 1


def soak_merge(folder: Path, rng: random.Random, counts: collections.Counter) -> None:
    """Renders with different seeds, samplers and strategies, merged at once and in two steps."""
    scene, size = random_scene(folder, rng), (rng.randint(1, 60), rng.randint(1, 40))
    jobs = []
    for number in range(rng.randint(2, 4)):
        options = random_options(rng) | {"scene": scene, "size": size, "spp": rng.randint(1, 60)}
        options["more"] = ("--seed", str(number))
        jobs.append(make_job(folder, str(number), options))
        jobs[-1].run()
    files = [Files.read(job) for job in jobs]
    checkpoints = [str(job.folder / "a.npz") for job in jobs]
    first, together, stepwise = (str(folder / name) for name in ("first", "all.exr", "steps.exr"))
    run("merge", *checkpoints, "-o", together)
    run("merge", *checkpoints[:2], "-o", first + ".exr", "--checkpoint", first + ".npz")
    run("merge", first + ".npz", *checkpoints[2:], "-o", stepwise)
    merged, header = read_exr(together)
    counts_sum = sum(part.channels["samples"].astype(np.int64) for part in files)
    assert (merged["samples"] == counts_sum).all()
    assert int(header["isonoise.samples"]) + int(header["isonoise.rejected"]) == sum(
        part.kept_samples for part in files
    )
    for channel in "RGB":
        mean = sum(part.channels["samples"] * part.channels[channel].astype(np.float64) for part in files)
        mean /= np.maximum(counts_sum, 1)
        np.testing.assert_allclose(merged[channel], mean, rtol=1e-6, atol=1e-30)
        np.testing.assert_array_equal(merged[channel], read_exr(stepwise)[0][channel])
    counts["merges"] += 1


def make_job(folder: Path, name: str, options: dict[str, object]) -> Job:
    job = Job(folder / name, **options)
    job.folder.mkdir()
    return job


def total(files: Files) -> int:
    """Samples of the image, rejected ones included."""
    return int(files.channels["samples"].sum(dtype=np.int64)) + int(files.header["isonoise.rejected"])


def check_total(files: Files, size: tuple[int, int], spp: float) -> None:
    assert total(files) == files.kept_samples == max(1, round(spp * size[0] * size[1]))


def run(*arguments: str) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(list(arguments)) == 0, arguments


def measure_growth() -> None:
    """Memory and open files over many renderers, one after the other."""
    before = None
    for number in range(1, RENDERERS + 1):
        renderer = Renderer("cornell", size=(16, 12), seed=number, strategy=STRATEGIES[number % 2])
        renderer.step()
        assert renderer.statistics().samples > 0
        del renderer
        if number in (50, 100, 200, RENDERERS):
            gc.collect()
            now = resident_bytes(), len(os.listdir("/proc/self/fd"))
            print(f"after {number} renderers: {now[0] / 2**20:.1f} MiB resident, {now[1]} open files", flush=True)
            before = before or now
    assert now[0] - before[0] < MAX_GROWTH_BYTES, "memory grows"
    assert now[1] <= before[1], "open files grow"


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


if __name__ == "__main__":
    main_soak(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
