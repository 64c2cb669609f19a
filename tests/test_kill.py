"""Killed renders: continued by the same command they have the bits of unbroken ones, and no file is ever incomplete."""

import collections
import random
import sys
import time

import numpy as np
import pytest
from killed_renders import Files, Job, Kill, left_behind, random_kill

from isonoise.film.exr import write_exr
from isonoise.film.png import write_png

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")

EARLIER = np.full((2, 3, 3), 0.25, np.float32)
"""An image that is there before the render."""
SLACK_S = 1.0
"""What may be lost beside the interval: a bounce and the time to write a checkpoint, on a busy machine."""


def write_earlier_images(job: Job) -> None:
    write_exr(job.folder / "a.exr", {"": EARLIER}, {})
    write_png(job.folder / "a.png", EARLIER)


def check_after_kill(job: Job, before: Files, had_image: bool) -> Files:
    """No file is incomplete or gone, the checkpoint is not older than before, and little is lost."""
    files = Files.read(job)
    assert files.channels is not None or not had_image
    assert files.kept_samples >= before.kept_samples
    assert not (before.rows and not files.rows)
    assert files.logged_s - files.kept_s <= job.interval_s + SLACK_S
    return files


def check_at_end(job: Job, unbroken: Files) -> None:
    Files.read(job).assert_equal(unbroken)
    assert sorted(path.name for path in job.folder.iterdir()) == sorted(job.NAMES)


def make_job(folder, name: str, **options) -> Job:
    job = Job(folder / name, **options)
    job.folder.mkdir()
    return job


def test_a_killed_render_continues_to_the_same_bits(tmp_path):
    """It is killed before its second checkpoint gets its name, and then before the images get theirs."""
    options = {"strategy": "pooled", "spp": 500, "size": (32, 24), "interval_s": 0.1}
    job = make_job(tmp_path, "killed", **options)
    write_earlier_images(job)
    files = Files.read(job)
    for kill, left in (
        (Kill(operation=2 + 4 + 4, pattern=".*.tmp.npz"), ".npz"),  # one is a check, then 4 for each checkpoint
        (Kill(operation=2 + 2 + 3, pattern=".*.tmp.exr"), ".exr"),
    ):
        assert job.run_killed(kill)
        files = check_after_kill(job, files, had_image=True)
        assert left_behind(job) == [left]
        assert files.kept_samples > 0
    job.run()
    unbroken = make_job(tmp_path, "unbroken", **options)
    unbroken.run()
    check_at_end(job, Files.read(unbroken))


KILLS = 50
"""Per strategy."""


@pytest.mark.long
@pytest.mark.parametrize("strategy", ["uniform", "pooled", "relative-median", "luxcore"])
def test_many_killed_renders(strategy, tmp_path):
    """At random moments: set-up, compilation into an empty cache, writes of every file, and between them."""
    rng = random.Random(f"kills {strategy}")
    options = {"strategy": strategy, "spp": 1500, "save_every_s": 0.3}
    job = make_job(tmp_path, "unbroken", **options)
    job.run()
    start = time.monotonic()
    job.run()
    setup_s = time.monotonic() - start
    unbroken = Files.read(job)
    seconds = setup_s + unbroken.logged_s
    counts, losses, kills, renders = collections.Counter(), [], 0, 0
    while kills < KILLS:
        renders += 1
        cache = tmp_path / f"cache-{renders}"
        cold = {"POCL_CACHE_DIR": str(cache), "ISONOISE_PROGRAM_CACHE": str(cache / "programs")}
        is_cold = renders % 3 == 1
        job = make_job(tmp_path, f"killed-{renders}", **options, environment=cold if is_cold else {})
        cache.mkdir()
        has_earlier = rng.random() < 0.5
        if has_earlier:
            write_earlier_images(job)
        files, is_killed = Files.read(job), True
        while is_killed:
            kill = random_kill(rng, job, seconds, operations=120)
            if is_cold and not any(cache.rglob("*.so")) and rng.random() < 0.8:
                kill = Kill(rng.uniform(0.5, 8))
            is_killed = job.run_killed(kill)
            kills += is_killed
            before, files = files, check_after_kill(job, files, has_earlier)
            losses.append(files.logged_s - files.kept_s)
            moments = [f"while writing {kind}" for kind in left_behind(job)] or ["between writes"]
            if files.kept_samples == before.kept_samples and not left_behind(job):
                moments = ["before the first checkpoint"]
            counts.update(moments if is_killed else ["not killed"])
        check_at_end(job, unbroken)
    print(f"{strategy}: {kills} kills of {renders} renders, loss at most {max(losses):.3f} s; {dict(counts)}")
