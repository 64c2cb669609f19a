"""Damaged, exchanged and deleted files of a comparison: none is taken for a sound one, none ends in a traceback."""

import contextlib
import os
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from compare_command import SIZE, assert_same_runs, compare, options, run_files, write_flat_reference
from fuzz_mutations import mutate_bytes
from simulated_comparison import make_comparison

from isonoise.comparison.results import Results
from isonoise.errors import UserError

pytestmark = pytest.mark.usefixtures("in_tmp_path", "no_compare_report")

STRATEGIES = ("uniform", "oracle")
COMMAND = (*SIZE, "--spp", 8, "--seeds", 2, "--strategies", ",".join(STRATEGIES), "-o", "out")
LONG_COUNT = int(os.environ.get("ISONOISE_FUZZ", 300))


@pytest.fixture(scope="module")
def whole(tmp_path_factory, no_compare_report):
    """Folder of a comparison with a reference and a variance that it has rendered."""
    directory = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(directory)
        assert compare(*COMMAND) == 0
    return directory / "out"


@pytest.fixture
def folder(whole):
    """A copy of it. Runs of an oracle name the file of the variance, so its path must be as long."""
    shutil.copytree(whole, "out")
    return Path("out")


def run_again(capsys, *command) -> tuple[list[str], str]:
    """Give the command again; names of the runs that it has rendered, and what it has printed on stderr."""
    before = {name: path.stat().st_mtime_ns for name, path in run_files("out").items()}
    capsys.readouterr()
    assert compare(*(command or COMMAND)) == 0
    err = capsys.readouterr().err
    assert "Traceback" not in err
    assert not list(Path("out").rglob(".*"))
    return [name for name, path in run_files("out").items() if path.stat().st_mtime_ns != before.get(name)], err


def exchange(path: Path, other: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)


def test_invalid_runs_are_named_and_rendered_again_before_others(whole, folder, capsys):
    runs = folder / "runs" / "cornell"
    exchange(runs / "uniform" / "0.npz", runs / "uniform" / "1.npz")
    (runs / "oracle" / "0.npz").write_bytes((runs / "oracle" / "0.npz").read_bytes()[:-1000])
    (runs / "oracle" / "1.npz").unlink()
    rendered, err = run_again(capsys)
    assert len(rendered) == 4
    lines = err.splitlines()
    assert lines == [
        "isonoise: warning: rendering again runs/cornell/uniform/0.npz: its seed is 1 instead of 0",
        "isonoise: warning: rendering again runs/cornell/oracle/0.npz: it is damaged, or an earlier version wrote it",
        "isonoise: warning: rendering again runs/cornell/uniform/1.npz: its seed is 0 instead of 1",
    ]
    assert_same_runs(whole, folder)
    written = sorted(run_files(folder).values(), key=lambda path: path.stat().st_mtime_ns)
    assert written[-1] == runs / "oracle" / "1.npz"  # the only one that was missing


def test_a_link_to_another_run_is_replaced(whole, folder, capsys):
    run, other = (folder / "runs" / "cornell" / strategy / "0.npz" for strategy in STRATEGIES)
    run.unlink()
    run.symlink_to(other.resolve())
    content = other.read_bytes()
    rendered, err = run_again(capsys)
    assert rendered == ["runs/cornell/uniform/0.npz"]
    assert "its strategy is oracle" in err
    assert other.read_bytes() == content
    assert not run.is_symlink()
    assert_same_runs(whole, folder)


def test_a_run_of_an_earlier_version_is_rendered_again(whole, folder, capsys):
    path = folder / "runs" / "cornell" / "uniform" / "1.npz"
    with np.load(path) as file:
        np.savez_compressed(path.with_name("old.npz"), **file)
    path.with_name("old.npz").replace(path)
    rendered, err = run_again(capsys)
    assert rendered == ["runs/cornell/uniform/1.npz"]
    assert "an earlier version wrote it" in err
    assert_same_runs(whole, folder)


def test_a_reference_that_is_rendered_to_the_same_bits_keeps_its_runs(whole, folder, capsys):
    """With a number of samples as the budget, the same command renders the same reference."""
    reference = folder / "references" / "cornell.exr"
    reference.unlink()
    write_flat_reference(folder / "references" / "cornell-variance.exr")
    rendered, err = run_again(capsys)
    assert rendered == []
    assert err.count("\n") == 1
    assert "references/cornell-variance.exr' is rendered again: it is damaged" in err
    assert_same_runs(whole, folder)


def test_runs_against_another_reference_are_rendered_again(capsys):
    """With a time as the budget, another reference is rendered."""
    command = (*COMMAND, "--strategies", "relative-mean", "--reference-time", "0.05")
    assert compare(*command) == 0
    Path("out/references/cornell.exr").unlink()
    rendered, err = run_again(capsys, *command)
    assert len(rendered) == 6
    assert err.count("\n") == 1
    assert "runs/cornell/uniform/0.npz" in err
    assert "and 3 more: it was measured against another reference" in err
    exchange(Path("out/references/cornell.exr"), Path("out/references/cornell-variance.exr"))
    rendered, err = run_again(capsys, *command)
    assert len(rendered) == 6
    assert "cornell.exr' is rendered again: it is another kind of file" in err


def test_a_given_reference_may_not_change(capsys):
    write_flat_reference("a.exr")
    command = (*options("out", ("uniform",), 1), "--reference", "a.exr")
    assert compare(*command) == 0
    write_flat_reference("b.exr")
    rgb = write_flat_reference("a.exr")
    assert compare(*command) == 0
    from isonoise.film.exr import write_exr

    write_exr("a.exr", {"": 2 * rgb}, {})
    assert compare(*command) == 2
    assert "reference_sha256 of 'cornell' was" in capsys.readouterr().err


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
        assert compare(*COMMAND) == 2
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
    damage_files(tmp_path / "out", 80, 0)


@pytest.mark.long
def test_many_damaged_files_are_left_out(tmp_path):
    damage_files(tmp_path / "out", 10 * LONG_COUNT, 1)


@pytest.mark.long
def test_many_damaged_files_are_rendered_again(whole, folder, capsys):
    """Two files are damaged or exchanged at a time: the same command restores every bit of runs and references."""
    originals = {path.relative_to(whole): path.read_bytes() for path in whole.rglob("*") if path.is_file()}
    del originals[Path("plan.json")]
    rng = random.Random(2)
    for _ in range(LONG_COUNT // 2):
        for name in rng.sample(sorted(originals), 2):
            if rng.random() < 0.4:
                exchange(folder / name, folder / rng.choice(sorted(originals)))
            else:
                (folder / name).write_bytes(mutate_bytes((folder / name).read_bytes(), rng))
        run_again(capsys)
        assert_same_runs(whole, folder)
