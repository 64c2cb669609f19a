"""Damaged, exchanged and deleted files of a comparison: none is taken for a sound one, none ends in a traceback."""

import contextlib
import errno
import os
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from compare_command import assert_same_runs, compare, options, run_files, write_flat_reference
from fuzz_mutations import mutate_bytes
from simulated_comparison import make_comparison

from isonoise.comparison.checked_files import read_image, write_image
from isonoise.comparison.identity import reference_identity
from isonoise.comparison.plan import read_plan
from isonoise.comparison.results import Results
from isonoise.errors import UserError
from isonoise.film.exr import write_exr

pytestmark = pytest.mark.usefixtures("in_tmp_path", "no_compare_report")

LONG_COUNT = int(os.environ.get("ISONOISE_FUZZ", 300))


@pytest.fixture
def folder(finished_comparison):
    """A copy of a finished comparison."""
    shutil.copytree(finished_comparison, "out")
    return Path("out")


def run_again(capsys, *more) -> tuple[list[str], str]:
    """Give the command again; names of the runs that it has rendered, and what it has printed on stderr."""
    before = {name: path.stat().st_mtime_ns for name, path in run_files("out").items()}
    capsys.readouterr()
    assert compare(*options("out"), *more) == 0
    err = capsys.readouterr().err
    assert "Traceback" not in err
    assert not list(Path("out").rglob(".*"))  # no lock, no temporary file
    return [name for name, path in run_files("out").items() if path.stat().st_mtime_ns != before.get(name)], err


def exchange(path: Path, other: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def test_invalid_runs_are_named_and_rendered_again_before_others(finished_comparison, folder, capsys):
    uniform, other = (folder / "runs" / "cornell" / strategy for strategy in ("uniform", "relative-mean"))
    exchange(uniform / "0.npz", uniform / "1.npz")
    (other / "0.npz").write_bytes((other / "0.npz").read_bytes()[:-1000])
    (other / "1.npz").unlink()
    rendered, err = run_again(capsys)
    assert len(rendered) == 4
    begin = "isonoise: warning: rendering again runs/cornell/"
    assert err.splitlines() == [
        f"{begin}uniform/0.npz: its seed is 1 instead of 0",
        f"{begin}relative-mean/0.npz: it is damaged, or an earlier version wrote it",
        f"{begin}uniform/1.npz: its seed is 0 instead of 1",
    ]
    written = sorted(run_files(folder).values(), key=lambda path: path.stat().st_mtime_ns)
    assert written[-1] == other / "1.npz"  # the only one that was missing
    assert_same_runs(finished_comparison, folder)


def test_links_to_other_runs_and_files_without_digest_are_replaced(finished_comparison, folder, capsys):
    uniform, other = (folder / "runs" / "cornell" / strategy for strategy in ("uniform", "relative-mean"))
    (uniform / "0.npz").unlink()
    (uniform / "0.npz").symlink_to((other / "0.npz").resolve())
    with np.load(uniform / "1.npz") as file:
        np.savez_compressed("old.npz", **file)  # as earlier versions wrote it
    Path("old.npz").replace(uniform / "1.npz")
    (other / "1.npz").unlink()
    (other / "1.npz").symlink_to("/dev/zero")
    rendered, err = run_again(capsys)
    assert [Path(name).parts[2:] for name in rendered] == [
        ("relative-mean", "1.npz"),
        ("uniform", "0.npz"),
        ("uniform", "1.npz"),
    ]
    assert "its strategy is relative-mean" in err
    assert "uniform/1.npz: it is damaged, or an earlier version wrote it" in err
    assert "relative-mean/1.npz: it cannot be read" in err
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    assert_same_runs(finished_comparison, folder)


def test_runs_against_another_reference_are_rendered_again(folder, capsys):
    """It has the identity of the reference that it replaces, as one with a time as its budget may have."""
    path = folder / "references" / "cornell.exr"
    (scene,) = read_plan(folder).scenes
    identity = reference_identity(read_plan(folder), scene, "reference")
    channels, _ = read_image(path, identity)
    write_image(path, channels | {"R": channels["R"] * 1.01}, {}, identity)
    rendered, err = run_again(capsys)
    assert len(rendered) == 4
    assert err.count("\n") == 1
    assert err.startswith("isonoise: warning: rendering again runs/cornell/uniform/0.npz, ")
    assert err.endswith(" and 1 more: it was measured against another reference\n")
    assert run_again(capsys) == ([], "")


@pytest.mark.long
@pytest.mark.parametrize("damage", [Path.unlink, write_flat_reference], ids=["deleted", "replaced"])
def test_a_reference_that_is_rendered_to_the_same_bits_keeps_its_runs(finished_comparison, folder, damage, capsys):
    """With a number of samples as the budget, the same command renders the same reference."""
    damage(folder / "references" / "cornell.exr")
    rendered, err = run_again(capsys)
    assert rendered == []
    assert ("cornell.exr' is rendered again: it is damaged" in err) == (damage is not Path.unlink)
    assert_same_runs(finished_comparison, folder)


def test_a_given_reference_may_not_change(capsys):
    rgb = write_flat_reference("a.exr")
    command = (*options("out", ("uniform",), 1), "--reference", "a.exr")
    assert compare(*command) == 0
    write_exr("a.exr", {"": 2 * rgb}, {})
    assert compare(*command) == 2
    assert "the reference '" in (err := capsys.readouterr().err)
    assert "has been edited" in err


def fill_disk(path: Path, _) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def remove_folder(path: Path, _) -> None:
    shutil.rmtree("out")
    path.touch()  # as a write does


@pytest.mark.parametrize(
    ("damage", "message"),
    [(fill_disk, "No space left on device; finished runs are kept"), (remove_folder, "No such file or directory")],
)
def test_a_run_that_cannot_be_written_is_a_message(folder, capsys, monkeypatch, damage, message):
    runs = run_files(folder)
    runs.popitem()[1].unlink()
    monkeypatch.setattr("isonoise.comparison.checked_files._write_bytes", damage)
    assert compare(*options("out")) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err
    assert folder.exists() == (damage is fill_disk)
    assert not folder.exists() or run_files(folder).keys() == runs.keys()


def test_a_deleted_plan_keeps_the_runs(folder, capsys):
    plan = (folder / "plan.json").read_bytes()
    (folder / "plan.json").unlink()
    assert run_again(capsys) == ([], "")
    assert (folder / "plan.json").read_bytes() == plan


def test_a_damaged_plan_is_a_message(folder, capsys):
    plan = folder / "plan.json"
    content = plan.read_bytes()
    for damaged in (content[:-40], content.replace(b"16", b"61", 1), b"[" * 100_000, b"null", b"[]", b'{"seeds": 1}'):
        plan.write_bytes(damaged)
        assert compare(*options("out")) == 2
        err = capsys.readouterr().err
        assert "cannot read the plan" in err
        assert "Traceback" not in err
        assert plan.read_bytes() == damaged


def content_of(directory: Path) -> dict[str, tuple]:
    """Everything that figures are computed from, of the files that are taken for sound ones."""
    results, found = Results(directory), {"plan.json": (Results(directory).plan,)}
    for scene in results.plan.scenes:
        for strategy, runs in results.runs(scene).items():
            for seed, run in runs.items():
                arrays = (run.count.tobytes(), run.errors.tobytes(), run.snapshot_s.tobytes())
                found[f"runs/{scene.slug}/{strategy}/{seed}.npz"] = (repr(run.rows), repr(run.facts), *arrays)
            reference = results.reference(scene)
            found[scene.reference] = (reference.rgb.tobytes(), reference.relative_se.tobytes())
        variance = results.variance(scene)
        if variance is not None:
            found[f"references/{scene.slug}-variance.exr"] = (variance.tobytes(),)
    return found


def damage_files(directory: Path, count: int, seed: int) -> None:
    """Damage or exchange a file, `count` times: what is read must be what was there before, or be left out."""
    strategies = {"uniform": np.ones_like, "oracle:rule=sqrt": np.sqrt}
    make_comparison(directory, ["a", "b"], strategies, seeds=[1, 2], shape=(9, 12))
    originals = {path: path.read_bytes() for path in sorted(directory.rglob("*")) if path.is_file()}
    sound, rng = content_of(directory), random.Random(seed)
    for _ in range(count):
        path = rng.choice(list(originals))
        others = [content for content in originals.values() if content != originals[path]]
        path.write_bytes(rng.choice(others) if rng.random() < 0.3 else mutate_bytes(originals[path], rng))
        if path.name == "plan.json":
            with contextlib.suppress(UserError):
                assert content_of(directory) == sound
        else:
            found = content_of(directory)
            assert found.items() <= sound.items()
            if path.suffix == ".npz" and path.read_bytes() != originals[path]:
                assert str(path.relative_to(directory)) not in found
        path.write_bytes(originals[path])


def test_damaged_files_are_left_out(tmp_path):
    damage_files(tmp_path / "out", 50, 0)


@pytest.mark.long
def test_many_damaged_files_are_left_out(tmp_path):
    damage_files(tmp_path / "out", 10 * LONG_COUNT, 1)


@pytest.mark.long
def test_many_damaged_files_are_rendered_again(capsys):
    """Two files are damaged or exchanged at a time: the same command restores every bit of runs and references."""
    more = ("--strategies", "oracle")
    assert compare(*options("out"), *more) == 0
    shutil.copytree("out", "sound")
    names = [path.relative_to("out") for path in sorted(Path("out").rglob("*.*")) if path.name != "plan.json"]
    rng = random.Random(2)
    for _ in range(LONG_COUNT // 2):
        for name in rng.sample(names, 2):
            if rng.random() < 0.4:
                exchange("out" / name, "out" / rng.choice(names))
            else:
                Path("out", name).write_bytes(mutate_bytes(Path("out", name).read_bytes(), rng))
        run_again(capsys, *more)
        assert_same_runs("sound", "out")
