"""`isonoise compare` up to its finished runs: plans, resuming, what a run's file holds, references, Mitsuba as a peer.

Scenes are tiny and budgets are samples, so that results can be compared bit by bit. False-alarm rates, the chance that
a correct program fails under other seeds: 1 % for the comparison of a reference by values, 0.8 % for its image means,
6e-5 for each check of its stated variance.
"""

import importlib.util
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import references

import isonoise
from isonoise.cli import main
from isonoise.comparison import plan as plans
from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.presets import PRESETS
from isonoise.comparison.recorder import SNAPSHOTS, Recorder
from isonoise.comparison.references import BatchSums, reference_allocation
from isonoise.comparison.strategy_specs import describe_spec, needs_variance, split_specs
from isonoise.errors import UserError
from isonoise.film.exr import read_exr, read_reference, write_exr
from isonoise.film.log import LogRow, columns
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

WIDTH, HEIGHT = 16, 12
SIZE = ("--size", f"{WIDTH}x{HEIGHT}")
STRATEGIES = ("uniform", "relative-mean")
HAS_MITSUBA = importlib.util.find_spec("mitsuba") is not None


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True, scope="module")
def _no_report():
    """The report is made from the runs and has tests of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isonoise.comparison.report.write_report", lambda directory: None)
        patch.setattr("isonoise.comparison.summary.summary_text", lambda directory: "the table")
        yield


def compare(*arguments, scene="cornell"):
    """Exit code of a comparison, run in this process."""
    scenes = [scene] if scene else []
    try:
        return main(["compare", *scenes, *map(str, arguments)])
    except SystemExit as exit_:  # how argparse ends
        return exit_.code


def options(directory, strategies=STRATEGIES, seeds=2, spp=8):
    return (*SIZE, "--spp", spp, "--strategies", ",".join(strategies), "--seeds", seeds, "-o", directory)


def write_flat_reference(path, size=(WIDTH, HEIGHT)):
    rgb = np.random.default_rng(1).uniform(0.2, 1, (size[1], size[0], 3)).astype(np.float32)
    write_exr(path, {"": rgb, "stderr": 0.01 * rgb}, {})
    return rgb


def run_files(directory) -> dict[str, Path]:
    return {str(path.relative_to(directory)): path for path in sorted(Path(directory).glob("runs/*/*/[0-9]*.npz"))}


TIMES = {"elapsed_s", "device_s", "setup_s"}


def read_run(path) -> dict[str, object]:
    """A run's content without what a clock has said."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name != "snapshot_s"}
    content["rows"] = [
        {name: value for name, value in row.items() if name not in TIMES} for row in json.loads(str(content["rows"]))
    ]
    content["facts"] = {name: value for name, value in json.loads(str(content["facts"])).items() if name not in TIMES}
    return content


def assert_same_runs(directory, other):
    """Bit by bit: runs, and references where they were rendered."""
    files, others = run_files(directory), run_files(other)
    assert list(files) == list(others)
    for name, path in files.items():
        a, b = read_run(path), read_run(others[name])
        assert a.keys() == b.keys()
        for key, value in a.items():
            if isinstance(value, np.ndarray):
                assert value.tobytes() == b[key].tobytes(), (name, key)
            else:
                assert repr(value) == repr(b[key]), (name, key)  # repr: nan is nan
    for path in Path(directory).glob("references/*"):
        channels, same = (read_exr(folder / "references" / path.name)[0] for folder in (Path(directory), Path(other)))
        assert channels.keys() == same.keys()
        assert all(plane.tobytes() == same[name].tobytes() for name, plane in channels.items())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A comparison that nobody stopped."""
    directory = tmp_path_factory.mktemp("whole") / "out"
    assert compare(*options(directory)) == 0
    return directory


# ---- plans


@pytest.mark.parametrize(
    ("text", "specs"),
    [
        ("uniform", ["uniform"]),
        ("uniform,relative-mean", ["uniform", "relative-mean"]),
        ("a:k=v,l=w,b", ["a:k=v,l=w", "b"]),
        ("a,b:k=v,c:l=w,m=x,d", ["a", "b:k=v", "c:l=w,m=x", "d"]),
        ("oracle:rule=sqrt,file=C:/a.exr,uniform", ["oracle:rule=sqrt,file=C:/a.exr", "uniform"]),
        ("module:Class,module:Class:k=v", ["module:Class", "module:Class:k=v"]),
        (" a , b:k=v , c,", ["a", "b:k=v ", "c"]),
    ],
)
def test_lists_of_strategies(text, specs):
    assert [spec.strip() for spec in split_specs(text)] == [spec.strip() for spec in specs]


def test_a_parameter_needs_a_strategy():
    with pytest.raises(UserError, match="without a strategy"):
        split_specs("k=v,uniform")


def test_oracles_without_a_file_are_known_and_described_without_it():
    assert needs_variance("oracle")
    assert needs_variance("oracle:rule=sqrt")
    assert not needs_variance("oracle:rule=sqrt,file=a.exr")
    assert not needs_variance("uniform")
    assert describe_spec("oracle:rule=sqrt").startswith("oracle:rule=sqrt,")
    assert "file" not in describe_spec("oracle")


def request(**changes):
    values = {"scenes": ["cornell"], "strategies": ["uniform"], "first_seed": 0, "seeds": 2, "time": None, "spp": 4.0}
    return plans.Request(**(values | {"size": (WIDTH, HEIGHT)} | changes))


def test_a_plan_survives_its_file(tmp_path):
    made = plans.make_plan(request(max_depth=3))
    plans.write_plan(tmp_path, made)
    assert plans.read_plan(tmp_path) == made
    assert plans.differences(made, plans.read_plan(tmp_path)) == []
    assert plans.read_plan(tmp_path / "nothing") is None


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"spp": 5.0}, "spp was 4.0 and is 5.0"),
        ({"spp": None, "time": 1.0}, "time was not given and is 1.0"),
        ({"size": (8, 8)}, "size was 16x12 and is 8x8"),
        ({"max_depth": 2}, "hash of 'cornell'"),
        ({"reference_time": 3.0}, "reference_time was not given"),
        ({"strategies": ["relative-mean"]}, "'uniform' is missing"),
        ({"scenes": ["penumbra"]}, "'cornell' is missing"),
        ({"first_seed": 1}, "seeds are missing: 0"),
        ({"seeds": 1}, "seeds are missing: 1"),
        ({"references": ["a.exr"]}, "reference of 'cornell' was references/cornell.exr"),
    ],
)
def test_another_plan_says_what_differs(changes, difference):
    write_flat_reference("a.exr", changes.get("size", (WIDTH, HEIGHT)))
    stored = plans.make_plan(request())
    assert any(difference in text for text in plans.differences(stored, plans.make_plan(request(**changes), stored)))


def test_a_plan_may_grow():
    stored = plans.make_plan(request())
    changes = {"strategies": ["relative-mean", "uniform"], "scenes": ["penumbra", "cornell"], "seeds": 3}
    larger = plans.make_plan(request(**changes), stored)
    assert plans.differences(stored, larger) == []
    assert plans.additions(stored, larger) == ["penumbra", "relative-mean", "seed 2"]


def test_slugs_name_folders_and_stay(tmp_path):
    """Many scenes are called scene.xml; what a plan has called one before stays."""
    paths = []
    for folder in ("a", "b/a", "c"):
        path = tmp_path / folder / "scene.xml"
        path.parent.mkdir(parents=True)
        path.write_bytes(isonoise.scene.builtin.find_scene("cornell").read_bytes())
        paths.append(str(path))
    strategies = ["uniform:warmup=4,growth=0.5", "uniform:warmup=4", "uniform"]
    first = plans.make_plan(request(scenes=paths[1:2], strategies=strategies[1:2]))
    assert [scene.slug for scene in first.scenes] == ["a"]
    made = plans.make_plan(request(scenes=paths, strategies=strategies), first)
    assert [scene.slug for scene in made.scenes] == ["a-scene", "a", "c"]
    assert [strategy.slug for strategy in made.strategies] == [
        "uniform-warmup-4-growth-0.5",
        "uniform-warmup-4",
        "uniform",
    ]
    assert made.scenes[0].source == str(Path(paths[0]).resolve())


def test_references_go_by_order_or_by_name():
    write_flat_reference("a.exr")
    write_flat_reference("b.exr")
    scenes = ["cornell", "penumbra"]
    for given in (["a.exr", "b.exr"], ["penumbra=b.exr", "cornell=a.exr"]):
        made = plans.make_plan(request(scenes=scenes, references=given))
        assert [Path(scene.reference).name for scene in made.scenes] == ["a.exr", "b.exr"]
        assert all(len(scene.reference_sha256) == 64 for scene in made.scenes)
    (one, other) = plans.make_plan(request(scenes=scenes, references=["penumbra=b.exr"])).scenes
    assert (one.reference, one.reference_sha256) == ("references/cornell.exr", None)
    assert Path(other.reference) == Path("b.exr").resolve()
    with pytest.raises(UserError, match="one for each of the 2 scenes"):
        plans.make_plan(request(scenes=scenes, references=["a.exr"]))


def test_presets_can_be_planned():
    for preset in PRESETS.values():
        made = plans.make_plan(request(scenes=preset.scenes, strategies=preset.strategies, seeds=preset.seeds))
        assert len(made.scenes) == len(preset.scenes)


def test_a_plan_keeps_its_preset(tmp_path):
    """Its figures belong to the report, also when the runs that are missing were asked for one by one."""
    stored = plans.make_plan(request(preset="poster"))
    plans.write_plan(tmp_path, stored)
    assert plans.read_plan(tmp_path) == stored
    assert plans.make_plan(request(), stored).preset == "poster"
    late = plans.make_plan(request(preset="poster"), plans.make_plan(request()))
    assert (late.preset, plans.differences(plans.make_plan(request()), late)) == ("poster", [])


def test_options_replace_pieces_of_a_preset():
    from isonoise.cli import _parser
    from isonoise.commands.compare import _request

    def made(*arguments):
        return _request(_parser().parse_args(["compare", "--preset", "poster", "-o", "out", *arguments]))

    whole, preset = made(), PRESETS["poster"]
    assert (whole.scenes, whole.strategies, whole.seeds) == (preset.scenes, preset.strategies, preset.seeds)
    assert (whole.time, whole.spp, whole.size) == (preset.time, None, None)
    small = made("--time", "1", "--seeds", "2", "--size", "64x64")
    assert (small.time, small.seeds, small.size, small.strategies) == (1, 2, (64, 64), preset.strategies)
    assert (made("--spp", "4").time, made("--spp", "4").spp) == (None, 4)
    assert made("--strategies", "uniform").strategies == ["uniform"]
    assert made("cornell").scenes == ["cornell"]


# ---- bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--time", "1", "--spp", "4"), "--time and --spp are both given"),
        (("--time", "0"), "more than 0"),
        (("--seeds", "0"), "1 or more"),
        (("--seeds", "1.5"), "not a whole number"),
        (("--seed", 2**63), "seeds go up to"),
        (("--strategies", "relative-meen"), "relative-mean"),
        (("--strategies", "uniform:warmap=3"), "warmup"),
        (("--strategies", "uniform"), "'uniform' is named twice"),
        (("--strategies", "oracle:rle=sqrt"), "rule"),
        (("--preset", "postr"), "poster"),
        (("--device", "no such device"), "no such device"),
        (("--reference", "nothing.exr"), "No such file"),
        (("--reference", "small.exr"), "is 5x4 and the image of cornell 16x12"),
        (("--reference", "a.exr", "--reference", "a.exr"), "one for each of the 1 scenes"),
        (("--reference-time", "-1"), "more than 0"),
        (("no such scene",), "no such file or built-in scene"),
        (("cornell",), "'cornell' is named twice"),
    ],
)
def test_bad_input_is_a_message(arguments, message, capsys):
    write_flat_reference("a.exr")
    write_flat_reference("small.exr", (5, 4))
    assert compare(*arguments, *SIZE, "--strategies", "uniform", "-o", "out") == 2
    out, err = capsys.readouterr()
    assert message in err
    assert "Traceback" not in err + out
    assert not Path("out").exists()


def test_nothing_to_compare_is_a_message(capsys):
    assert compare("--strategies", "uniform", "-o", "out", scene=None) == 2
    assert "give a SCENE" in capsys.readouterr().err
    assert compare("-o", "out") == 2
    assert "give --strategies" in capsys.readouterr().err


@pytest.mark.parametrize(("package", "message"), [("jinja2", "isonoise[compare]"), ("mitsuba", "isonoise[peers]")])
def test_a_missing_package_is_a_message(package, message, capsys, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == package else find(name, *more))
    assert compare(*SIZE, "--strategies", "uniform,mitsuba-independent", "-o", "out") == 2
    err = capsys.readouterr().err
    assert package in err.lower()
    assert message in err
    assert not Path("out").exists()


def test_a_folder_that_cannot_be_written_is_a_message(capsys):
    Path("file").touch()
    for directory in ("file", "file/below"):
        assert compare(*options(directory)) == 2
        assert "cannot write" in capsys.readouterr().err


def test_a_damaged_plan_is_a_message(capsys):
    Path("out").mkdir()
    Path("out/plan.json").write_text("{")
    assert compare(*options("out")) == 2
    assert "cannot read the plan" in capsys.readouterr().err


def test_help_explains_presets_files_and_exit_codes(capsys):
    assert compare("--help") == 0
    out = capsys.readouterr().out
    for word in ("mitsuba-multijitter", "oracle", "poster", "waves.csv", "SEED.npz", "130 after Ctrl-C"):
        assert word in out


# ---- runs


def test_the_files_of_a_comparison(whole):
    assert sorted(run_files(whole)) == [
        f"runs/cornell/{strategy}/{seed}.npz" for strategy in sorted(STRATEGIES) for seed in (0, 1)
    ]
    assert sorted(path.name for path in (whole / "references").iterdir()) == ["cornell.exr"]
    made = json.loads((whole / "plan.json").read_text())
    assert [(scene["slug"], scene["name"], scene["reference"]) for scene in made["scenes"]] == [
        ("cornell", "cornell", "references/cornell.exr")
    ]
    assert [(strategy["slug"], strategy["spec"]) for strategy in made["strategies"]] == [(s, s) for s in STRATEGIES]
    assert made["seeds"] == [0, 1]
    assert (made["time"], made["spp"]) == (None, 8.0)
    rgb, error = read_reference(whole / "references" / "cornell.exr")
    assert rgb.shape == error.shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_run_is_the_render_that_it_says(tmp_path, strategy):
    """64 samples per pixel, so that snapshots are of several waves."""
    reference = write_flat_reference("a.exr")
    assert compare(*options("out", (strategy,), 1, 64), "--seed", 3, "--reference", "a.exr") == 0
    with np.load(f"out/runs/cornell/{strategy}/3.npz") as file:
        run = {name: file[name] for name in file.files}
    assert set(run) == {"rows", "snapshot_s", "snapshot_samples", "errors", "count", "facts"}
    outcome = isonoise.render("cornell", spp=64, strategy=strategy, seed=3, size=(WIDTH, HEIGHT))

    rows = json.loads(str(run["rows"]))
    assert [row["samples"] for row in rows] == [row.samples for row in outcome.rows]
    assert all(list(row) == [*columns(true_errors=True), "device_s"] for row in rows)
    device = [row["device_s"] for row in rows]
    assert device[0] > 0
    assert device == sorted(device)
    assert run["count"].dtype == np.uint32
    assert (run["count"] == outcome.statistics.count).all()

    samples = np.array([row["samples"] for row in rows])
    reached = [samples[samples >= 64 * WIDTH * HEIGHT / 2 ** (SNAPSHOTS - 1 - k)][0] for k in range(SNAPSHOTS)]
    assert run["snapshot_samples"].tolist() == reached
    assert len(set(reached)) > 2
    elapsed = {row["samples"]: row["elapsed_s"] for row in rows}
    assert run["snapshot_s"].tolist() == [elapsed[each] for each in reached]

    assert (run["errors"].dtype, run["errors"].shape) == (np.float16, (SNAPSHOTS, HEIGHT, WIDTH))
    r = luminance(reference)
    expected = (luminance(outcome.rgb) - r) / np.maximum(r, image_floor(r))
    np.testing.assert_allclose(run["errors"][-1], expected, rtol=2**-11, atol=2**-24)
    for k in range(SNAPSHOTS - 1):
        assert (run["errors"][k].tobytes() == run["errors"][k + 1].tobytes()) == (reached[k] == reached[k + 1])
    assert rows[-1]["true_p99"] == pytest.approx(np.quantile(np.abs(expected), 0.99), rel=1e-6)

    facts = json.loads(str(run["facts"]))
    assert (facts["scene"], facts["seed"], facts["samples"]) == ("cornell", 3, int(samples[-1]))
    assert facts["strategy"].startswith(f"{strategy}:warmup=") or "warmup=" in facts["strategy"]
    assert facts["setup_s"] > 0
    assert facts["elapsed_s"] >= rows[-1]["elapsed_s"]


def row_at(elapsed, samples):
    stated = {"stated_p50": 0.1, "stated_p95": 0.1, "stated_p99": 0.1}
    return LogRow(elapsed_s=elapsed, wave=1, kind="uniform", samples=samples, spp=1, **stated, true=None, rejected=0)


def test_snapshots_go_by_the_clock_where_time_is_the_budget():
    """8 s: moments are 0.25, 0.5, 1, 2, 4 s and the end, which a deadline may put a little before 8 s."""
    recorder = Recorder(Stops(time=8.0), np.ones((2, 3, 3), np.float32))
    times = (0.1, 0.3, 0.9, 1.5, 3.9, 5.0, 7.99)
    for number, elapsed in enumerate(times):
        image = np.full((2, 3, 3), 1 + elapsed, np.float32)
        recorder.wave(row_at(elapsed, number), image, None)
    recorder.write(Path("run.npz"), row_at(times[-1], 6), image, np.ones((2, 3)), {})
    with np.load("run.npz") as run:
        assert run["snapshot_s"].tolist() == [0.3, 0.9, 1.5, 3.9, 5.0, 7.99]
        assert run["snapshot_samples"].tolist() == [1, 2, 3, 4, 5, 6]
        np.testing.assert_allclose(run["errors"][:, 0, 0], run["snapshot_s"], rtol=1e-3)


def test_errors_that_no_half_float_holds_are_clipped():
    reference = np.zeros((1, 4, 3), np.float32)
    image = np.array([0.0, 1.0, -1.0, 1e30], np.float32)[None, :, None] * np.ones(3, np.float32)
    recorder = Recorder(Stops(spp=1.0), reference)
    recorder.wave(row_at(1.0, 4), image, None)
    recorder.write(Path("run.npz"), row_at(1.0, 4), image, np.ones((1, 4)), {})
    with np.load("run.npz") as run:
        assert run["errors"][-1].tolist() == [[0, 65504, -65504, 65504]]


# ---- going on


def test_one_run_that_was_deleted_is_rendered_again_and_the_same(whole, capsys):
    files = run_files(whole)
    before = {name: path.stat().st_mtime_ns for name, path in files.items()}
    deleted = "runs/cornell/relative-mean/1.npz"
    content = read_run(files[deleted])
    files[deleted].unlink()
    capsys.readouterr()
    assert compare(*options(whole)) == 0
    out = capsys.readouterr().out
    assert "[1 of 1]" in out
    assert "the table" in out
    changed = {name for name, path in run_files(whole).items() if path.stat().st_mtime_ns != before[name]}
    assert changed == {deleted}
    assert all(np.array_equal(a, b) for a, b in zip(content.values(), read_run(files[deleted]).values(), strict=True))


def test_a_plan_that_grows_keeps_its_runs(capsys):
    write_flat_reference("a.exr")
    given = ("--reference", "a.exr")
    assert compare(*options("out", ("uniform",), 1), *given) == 0
    (kept,) = run_files("out").values()
    before = kept.stat().st_mtime_ns
    capsys.readouterr()
    assert compare(*options("out", STRATEGIES, 2), *given) == 0
    assert "added: relative-mean, seed 1" in capsys.readouterr().out
    assert len(run_files("out")) == 4
    assert kept.stat().st_mtime_ns == before
    assert compare(*options("whole", STRATEGIES, 2), *given) == 0
    assert_same_runs("whole", "out")

    assert compare(*options("out", ("uniform",), 2), *given) == 2
    assert "'relative-mean' is missing" in capsys.readouterr().err
    assert compare(*options("out", STRATEGIES, 2, 9), *given) == 2
    assert "spp was 8.0 and is 9.0" in capsys.readouterr().err
    assert len(run_files("out")) == 4


def start(*arguments, **more):
    command = [sys.executable, "-m", "isonoise", "compare", "cornell", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)


def wait_for(process, directory, pattern):
    deadline = time.monotonic() + 60
    while not any(Path(directory).glob(pattern)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_killed_and_started_again_it_gives_the_same():
    """Killed twice: in the middle of the reference, and in the middle of the runs."""
    arguments = options("killed", seeds=6, spp=256)
    Path("killed/references").mkdir(parents=True)
    Path("killed/references/.0123456789ab.tmp.npz").touch()  # as a process leaves it that is killed while it writes
    for pattern in ("references/cornell.partial.npz", "runs/*/*/[0-9]*.npz"):
        process = start(*arguments)
        wait_for(process, "killed", pattern)
        process.kill()
        process.communicate()
        assert len(run_files("killed")) < 12
    assert compare(*arguments) == 0
    assert compare(*options("whole", seeds=6, spp=256)) == 0
    assert len(run_files("whole")) == 12
    assert_same_runs("whole", "killed")
    assert sorted(os.listdir("killed/references")) == ["cornell.exr"]
    assert not list(Path("killed").rglob("*.tmp*"))


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_keeps_what_is_finished():
    """The report is written from it: here the real one."""
    write_flat_reference("a.exr")
    arguments = (*SIZE, "--time", "0.3", "--strategies", "uniform", "--seeds", 50, "-o", "out", "--reference", "a.exr")
    # a test run that was started in the background may have handed down that Ctrl-C is to be ignored
    process = start(*arguments, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
    wait_for(process, "out", "runs/cornell/uniform/1.npz")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "finished runs are kept" in err
    assert "Traceback" not in err
    assert 2 <= len(run_files("out")) < 50
    assert Path("out/report.html").exists()
    assert not list(Path("out").rglob("*.tmp*"))
    assert "seed 0" in out  # that of seed 1 may be interrupted between its file and its line


# ---- references


@pytest.fixture(scope="module")
def uniform_batches():
    """32 independent uniform renders, (batches, height, width, 3), 64 samples per pixel each."""
    render = {"spp": 64, "strategy": "uniform:wave_spp=64", "size": (WIDTH, HEIGHT)}
    return np.stack([isonoise.render("cornell", seed=100 + seed, **render).rgb for seed in range(32)]).astype(float)


@pytest.fixture(scope="module")
def reference_file(tmp_path_factory):
    """Rendered for runs of 64 samples per pixel: 1280 samples per pixel, half of them where a pilot run says."""
    directory = tmp_path_factory.mktemp("reference") / "out"
    assert compare(*options(directory, ("uniform",), 1, 64)) == 0
    return directory / "references" / "cornell.exr"


def test_a_reference_is_unbiased(reference_file, uniform_batches, tmp_path):
    rgb, error = (image.astype(float) for image in read_reference(reference_file))
    image, truth = references.Estimate(rgb, error, 31), references.from_batches(uniform_batches)
    references.assert_agree(image, truth, tmp_path)
    references.assert_means_agree(image, truth)


def test_a_reference_states_its_variance(reference_file, uniform_batches):
    """The batches' spread, times the samples, is the variance of one sample that uniform batches have.

    Both are unbiased, so the sum of their differences over its own standard error is a standard normal deviate."""
    channels, header = read_exr(reference_file)
    assert header["isonoise.batches"] == "32"
    error = np.stack([channels[f"stderr.{c}"] for c in "RGB"], axis=-1).astype(float)
    stated = error**2 * channels["samples"][..., None]
    measured = uniform_batches.var(axis=0, ddof=1) * 64
    differences = ((stated - measured) / np.maximum(uniform_batches.mean(axis=0), 1e-3) ** 2).sum(axis=-1)
    assert abs(differences.sum() / np.sqrt((differences**2).sum())) <= 4
    assert channels["samples"].mean() == 1280
    assert channels["samples"].min() >= 640
    assert channels["samples"].max() > 1600


def normal_statistics(rng, count, mean, sigma):
    """Statistics of `count` normal samples of each pixel, the same in all channels."""
    x = rng.normal(mean, sigma, (count, *mean.shape))
    rgb = np.repeat(x.mean(axis=0)[..., None], 3, axis=-1).astype(np.float32)
    counts = np.full(mean.shape, count, np.uint32)
    return Statistics(counts, np.zeros_like(counts), rgb, x.mean(axis=0), x.var(axis=0, ddof=1), None)


def test_batches_add_up():
    """20 batches of 5 normal samples: the standard error squared is chi-square of 19 degrees of freedom over the truth,
    s^2 of 99, so their means over 10,000 pixels have these relative standard errors; five of them are allowed."""
    rng = np.random.default_rng(5)
    sigma = rng.uniform(0.1, 1, (100, 100))
    mean = rng.uniform(1, 2, (100, 100))
    sums = BatchSums(np.full((100, 100), 5, np.uint32))
    for _ in range(20):
        sums.add(normal_statistics(rng, 5, mean, sigma), 0.5)
    assert (sums.batches, sums.seconds) == (20, 10.0)
    assert (sums.count == 100).all()
    error = sums.standard_error()[..., 0]
    assert np.mean(error**2 / (sigma**2 / 100)) == pytest.approx(1, abs=5 * np.sqrt(2 / 19 / 10_000))
    assert np.mean(sums.m2 / 99 / sigma**2) == pytest.approx(1, abs=5 * np.sqrt(2 / 99 / 10_000))
    assert np.mean(((sums.rgb[..., 0] - mean) / sigma) ** 2 * 100) == pytest.approx(1, abs=5 * np.sqrt(2 / 10_000))
    np.testing.assert_allclose(sums.mean, sums.rgb[..., 1], rtol=1e-6)
    np.testing.assert_allclose(sums.relative_variance(), sums.m2 / 99 / sums.mean**2, rtol=1e-12)


@pytest.mark.parametrize("spp", [2, 3, 7, 64])
def test_a_map_is_half_uniform_and_takes_the_other_half_where_errors_are_large(spp):
    count = np.full((20, 30), 16, np.uint32)
    variance = np.broadcast_to(np.geomspace(1e-3, 1e3, 30), count.shape)
    ones = np.ones(count.shape)
    pilot = Statistics(count, 0 * count, np.ones((20, 30, 3), np.float32), ones, variance, None)
    allocation = reference_allocation(pilot, spp)
    assert allocation.dtype == np.uint32
    assert allocation.sum() == spp * 600
    assert allocation.min() >= spp / 2
    assert allocation[:, -3:].mean() > 1.4 * allocation[:, :3].mean()


def test_an_oracle_gets_the_variance_of_one_sample(capsys):
    """Against s^2 of a render of as many samples: each has a relative error of about sqrt(kurtosis / n), so their means
    over the image agree within some percent, and twice the variance would not."""
    write_flat_reference("a.exr")
    given = ("--reference", "a.exr")
    assert compare(*options("out", ("uniform", "oracle:rule=sqrt"), 1, 64), *given) == 0
    channels, _ = read_exr("out/references/cornell-variance.exr")
    assert list(channels) == ["variance"]
    truth = isonoise.render("cornell", spp=1280, strategy="uniform", seed=5, size=(WIDTH, HEIGHT)).statistics
    expected = truth.variance / np.maximum(truth.mean, image_floor(truth.mean)) ** 2
    ratio = channels["variance"].astype(float) / expected
    assert np.median(ratio) == pytest.approx(1, abs=0.1)
    assert channels["variance"].mean() == pytest.approx(expected.mean(), rel=0.3)

    facts = read_run("out/runs/cornell/oracle-rule-sqrt/0.npz")["facts"]
    assert facts["strategy"].startswith("oracle:rule=sqrt,")
    assert facts["strategy"].endswith("cornell-variance.exr")
    assert sorted(os.listdir("out/references")) == ["cornell-variance.exr"]


def test_an_oracle_cannot_be_handed_a_name_with_a_comma(capsys):
    assert compare(*options("a,b", ("oracle",))) == 2
    assert "comma" in capsys.readouterr().err
    assert not Path("a,b").exists()


# ---- Mitsuba


def test_the_scene_that_mitsuba_gets(tmp_path):
    from xml.etree.ElementTree import fromstring

    Path("sub").mkdir()
    Path("sub/a.ply").touch()
    source = tmp_path / "sub" / "scene.xml"
    text = isonoise.scene.builtin.find_scene("cornell").read_text()
    source.write_text(text)
    root = fromstring(mitsuba_xml(source, "multijitter", (20, 30), 4))
    values = {child.get("name"): child.get("value") for child in root.find("sensor/film")}
    assert (values["width"], values["height"], values["pixel_format"]) == ("20", "30", "rgb")
    assert root.find("sensor/film/rfilter").get("type") == "box"
    assert [sampler.get("type") for sampler in root.findall("sensor/sampler")] == ["multijitter"]
    (integrator,) = root.findall("integrator")
    assert {child.get("name"): child.get("value") for child in integrator} == {
        "max_depth": "4",
        "rr_depth": "5",
        "hide_emitters": "false",
    }
    with pytest.raises(UserError, match=r"reads \.xml scenes only"):
        mitsuba_xml(tmp_path / "sub" / "a.ply", "independent", None, None)


@pytest.mark.skipif(not HAS_MITSUBA, reason="needs Mitsuba 3: pip install 'isonoise[peers]'")
def test_mitsuba_renders_the_same_picture(reference_file):
    """Image means of two samplers against the reference: 4096 samples per pixel, within five times the standard error
    that the reference's runs have at 64 (a false alarm at 5e-7)."""
    strategies = ("uniform", "mitsuba-independent", "mitsuba-multijitter")
    given = ("--reference", reference_file)
    assert compare(*options("out", strategies, 1, 1024), *given) == 0
    energy = {}
    for strategy in strategies:
        with np.load(f"out/runs/cornell/{strategy}/0.npz") as run:
            rows, facts = (json.loads(str(run[name])) for name in ("rows", "facts"))
            assert (run["count"] == 1024).all()
            assert run["errors"].shape == (SNAPSHOTS, HEIGHT, WIDTH)
        assert rows[-1]["samples"] == facts["samples"] == 1024 * WIDTH * HEIGHT
        assert all(list(row) == [*columns(true_errors=True), "device_s"] for row in rows)
        assert len(rows) > 4
        assert all(a["elapsed_s"] < b["elapsed_s"] for a, b in itertools.pairwise(rows))
        energy[strategy] = rows[-1]
    error = energy["uniform"]["true_energy_ratio_se"]
    for strategy in strategies[1:]:
        assert energy[strategy]["true_energy_ratio"] == pytest.approx(1, abs=5 * error)
        assert energy[strategy]["true_p99"] < 2 * energy["uniform"]["true_p99"]
        assert np.isnan(energy[strategy]["stated_p99"])
        assert np.isnan(energy[strategy]["true_coverage"])


@pytest.mark.skipif(not HAS_MITSUBA, reason="needs Mitsuba 3: pip install 'isonoise[peers]'")
def test_what_mitsuba_cannot_render_is_a_message(capsys, monkeypatch):
    monkeypatch.setattr("isonoise.comparison.mitsuba_worker.mitsuba_xml", lambda *_: "<scene version='3.0.0'><shape/>")
    write_flat_reference("a.exr")
    assert compare(*options("out", ("mitsuba-independent",), 1), "--reference", "a.exr") == 2
    err = capsys.readouterr().err
    assert "Mitsuba cannot render cornell: llvm_ad_rgb: " in err
    assert "; scalar_rgb: " in err
    assert "Traceback" not in err
    assert not run_files("out")
