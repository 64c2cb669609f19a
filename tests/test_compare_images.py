"""Images of runs as EXR files, and FLIP of a finished comparison."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compare_command import compare, write_flat_reference
from simulated_comparison import make_comparison

import isonoise
from isonoise.comparison.image_metrics import flip, mean_square_error
from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.results import Results
from isonoise.comparison.run_images import ensure_image
from isonoise.comparison.summary import summarise, summary_text
from isonoise.comparison.tidy_tables import runs_table
from isonoise.errors import UserError
from isonoise.film.exr import read_exr, write_exr


@pytest.fixture
def folder(tmp_path):
    """A comparison that has FLIP among its metrics."""
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is in the extra 'flip'")
    directory = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like, "b": lambda v: v}, seeds=(1, 2))
    plan = read_plan(directory)
    write_plan(directory, replace(plan, metrics=(*plan.metrics, "flip")))
    return directory


def test_half_channels_are_stored_as_they_are(tmp_path):
    pixels = np.random.default_rng(1).normal(size=(4, 5, 3)).astype(np.float16)
    write_exr(tmp_path / "half.exr", {"": pixels, "depth": pixels[..., 0].astype(np.float32)}, {})
    channels, _ = read_exr(tmp_path / "half.exr")
    assert {name: plane.dtype for name, plane in channels.items()} == {
        **dict.fromkeys("RGB", np.float16),
        "depth": np.float32,
    }
    np.testing.assert_array_equal(np.stack([channels[name] for name in "RGB"], -1), pixels)


def test_an_image_of_another_run_or_a_damaged_one_is_replaced(tmp_path):
    path, facts = tmp_path / "images" / "1.exr", {"scene": "a", "seed": 1, "elapsed_s": 2.5}
    runs = [{"rgb": np.full((2, 3, 3), value, np.float16), "facts": np.array(json.dumps(facts))} for value in (1, 2)]
    ensure_image(path, runs[0], "aaa")
    before = path.stat().st_mtime_ns
    ensure_image(path, runs[0], "aaa")
    assert path.stat().st_mtime_ns == before
    ensure_image(path, runs[1], "bbb")
    channels, header = read_exr(path)
    assert (channels["G"] == 2).all()
    assert (header["isonoise.scene"], header["isonoise.time_s"]) == ("a", "2.5")
    path.write_bytes(path.read_bytes()[:-3])
    ensure_image(path, runs[1], "bbb")
    assert (read_exr(path)[0]["R"] == 2).all()


@pytest.mark.usefixtures("in_tmp_path", "no_compare_report")
def test_images_are_kept_when_a_comparison_goes_on(capsys):
    reference = write_flat_reference("a.exr")
    arguments = ("--reference", "a.exr", "--size", "16x12", "--spp", 8, "--strategies", "uniform", "-o", "out")
    assert compare(*arguments, "--seeds", 1) == 0
    assert not Path("out/images").exists()
    runs = {path: path.stat().st_mtime_ns for path in Path("out/runs").rglob("*.npz")}
    assert compare(*arguments, "--seeds", 2, "--keep-images") == 0  # also the image of the run that was finished
    first, second = (Path(f"out/images/cornell/uniform/{seed}.exr") for seed in (0, 1))
    for path in (first, second):
        channels, header = read_exr(path)
        assert {channel.dtype for channel in channels.values()} == {np.dtype(np.float16)}
        image = np.stack([channels[name] for name in "RGB"], axis=-1)
        np.testing.assert_array_equal(image, np.load(f"out/runs/cornell/uniform/{path.stem}.npz")["rgb"])
        assert header["isonoise.seed"] == path.stem
    rendered = isonoise.render("cornell", spp=8, strategy="uniform", seed=1, size=(16, 12)).rgb
    np.testing.assert_array_equal(image, rendered.astype(np.float16))
    assert mean_square_error(image, reference) == pytest.approx(mean_square_error(rendered, reference), rel=1e-3)

    second.write_bytes(second.read_bytes()[:-1])  # damaged
    assert compare(*arguments, "--seeds", 2) == 0  # the comparison still keeps images
    assert read_exr(second)[0].keys() == set("RGB")
    assert all(path.stat().st_mtime_ns == time for path, time in runs.items())


@pytest.mark.usefixtures("in_tmp_path", "no_compare_report")
def test_metrics_can_be_added_to_a_finished_comparison(capsys):
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is in the extra 'flip'")
    write_flat_reference("a.exr")
    arguments = ("--reference", "a.exr", "--size", "16x12", "--spp", 8, "--strategies", "uniform", "--seeds", 1)
    assert compare(*arguments, "-o", "out", "--metrics", "mes") == 2
    assert "did you mean 'mse'" in capsys.readouterr().err
    assert compare(*arguments, "-o", "out") == 0
    assert "flip" not in runs_table("out")
    times = [path.stat().st_mtime_ns for path in Path("out/runs").rglob("*.npz")]
    assert compare(*arguments, "-o", "out", "--metrics", "mse,flip") == 0
    assert [path.stat().st_mtime_ns for path in Path("out/runs").rglob("*.npz")] == times
    assert read_plan(Path("out")).metrics == ("mse", "flip")
    summarise(Path("out"))
    table = runs_table("out")
    assert 0 < table["flip"][0] < 1
    assert "true_coverage" not in table


def test_flip_of_the_runs_is_that_of_their_images(folder):
    summary = summarise(folder)
    table, results = runs_table(folder), Results(folder)
    (scene,) = results.plan.scenes
    reference = results.reference(scene).rgb
    expected = [flip(run.rgb, reference) for run in results.all_runs(scene)]
    assert table["flip"].tolist() == expected
    rows = summary["scenes"][0]["rows"]
    assert [row["flip"]["value"] for row in rows] == pytest.approx([np.mean(expected[:2]), np.mean(expected[2:])])
    assert "FLIP" in summary_text(folder)


def test_flip_is_computed_once_and_again_for_other_files(folder, monkeypatch):
    calls = []

    def counted(*images):
        calls.append(images)
        return flip(*images)

    monkeypatch.setattr("isonoise.comparison.flip_values.flip", counted)
    summarise(folder)
    assert len(calls) == 4
    before = (folder / "flip.json").read_bytes()
    summarise(folder)
    assert len(calls) == 4
    (folder / "flip.json").write_text("[")
    summarise(folder)
    assert len(calls) == 8
    assert (folder / "flip.json").read_bytes() == before
    (folder / "runs/a/b/2.npz").unlink()
    summarise(folder)
    assert len(calls) == 8
    assert len(json.loads((folder / "flip.json").read_text())) == 3


def test_an_interrupt_keeps_the_values_so_far(folder, monkeypatch):
    values = iter([0.25, 0.5])

    def interrupted(*_):
        value = next(values, None)
        if value is None:
            raise KeyboardInterrupt
        return value

    monkeypatch.setattr("isonoise.comparison.flip_values.flip", interrupted)
    with pytest.raises(KeyboardInterrupt):
        summarise(folder)
    assert sorted(json.loads((folder / "flip.json").read_text()).values()) == [0.25, 0.5]


def test_flip_without_its_package_is_a_message(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(UserError, match=r"pip install 'isonoise\[flip\]'"):
        summarise(folder)


def test_tables_without_flip_have_no_column_for_it(tmp_path):
    directory = make_comparison(tmp_path / "out", ["a"], {"uniform": np.ones_like}, seeds=(1, 2))
    summarise(directory)
    assert "flip" not in runs_table(directory)
    assert "FLIP" not in summary_text(directory)
    assert not (directory / "flip.json").exists()
