"""Experiments from TOML files: sweeps, errors of the file, and a sweep that is killed and resumed."""

import csv
import itertools
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from compare_command import assert_same_runs, compare, run_files, write_flat_reference

from isonoise.comparison import runner
from isonoise.comparison.experiment_file import read_experiment
from isonoise.comparison.planning import make_plan
from isonoise.comparison.session import EXPERIMENT_FILE
from isonoise.comparison.summary import summarise
from isonoise.comparison.sweep import variants
from isonoise.comparison.tidy_tables import write_tables
from isonoise.errors import UserError
from isonoise.scene.scene import load

pytestmark = pytest.mark.usefixtures("in_tmp_path")

SMALL = 'scenes = ["cornell"]\nstrategies = ["uniform"]\nspp = 4\nsize = [16, 12]\nseeds = 1\n'


def write(text: str, path: str = "e.toml") -> Path:
    Path(path).write_text(text)
    return Path(path)


def requests(text: str):
    return [member.request for member in read_experiment(write(text))]


def test_a_grid_has_every_combination_and_a_list_its_rows():
    found = variants({"a": 0}, {"b": [1, 2], "c": [3, 4]}, {"d": [5, 6], "e": [7, 8]})
    expected = [
        {"a": 0, "b": b, "c": c, "d": d, "e": e} for (d, e), b, c in itertools.product([(5, 7), (6, 8)], [1, 2], [3, 4])
    ]
    assert [dict(variant.values) for variant in found] == expected
    assert all(set(variant.swept) == set("bcde") for variant in found)
    assert [dict(variant.values) for variant in variants({"a": 1}, {}, {})] == [{"a": 1}]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (({"a": 1}, {"a": [1]}, {}), "'a' has values in two of"),
        (({}, {"a": []}, {}), "'a' has no values"),
        (({}, {"a": [1, 2, 1]}, {}), "'a' has the value 1 twice"),
        (({}, {}, {"a": [1], "b": [1, 2]}), "'a' has 1, 'b' has 2"),
        (({}, {name: list(range(100)) for name in "abc"}, {}), "1,000,000 variants are too many"),
    ],
)
def test_wrong_sweeps_are_a_message(parts, message):
    with pytest.raises(UserError, match=message):
        variants(*parts)


def test_every_key_of_a_file_takes_effect():
    write_flat_reference("a.exr")
    (only,) = requests("""
        seeds = [3, 5]
        time = 2
        size = "16x12"
        max_depth = 4
        sampler = "independent"
        reference_time = 7
        metrics = ["rel-mse", "quantiles"]
        keep_images = true
        allow_outside = true
        devices = 0

        [[scenes]]
        source = "cornell"
        name = "box"
        reference = "a.exr"
        size = [8, 6]
        max_depth = -1
        set = { "lamp.emitter.radiance" = 5.0, "$spp" = 16 }

        [[strategies]]
        name = "pooled"
        set = { warmup = 8, unbiased = true }
    """)
    (scene,), (strategy,) = only.scenes, only.strategies
    assert (only.seeds, only.time, only.spp, only.device, only.reference_time) == ([3, 5], 2.0, None, "0", 7.0)
    assert (only.metrics, only.keep_images, only.allow_outside) == (["rel-mse", "quantiles"], True, True)
    assert (scene.source, scene.name, scene.size, scene.max_depth) == ("cornell", "box", (8, 6), -1)
    assert scene.reference == str(Path("a.exr").resolve())
    assert scene.settings == {"lamp.emitter.radiance": 5.0, "$spp": 16}
    assert strategy.spec == "pooled:warmup=8,unbiased=true,sampler=independent"
    assert strategy.settings == {"warmup": 8, "unbiased": True}


def test_sweeps_make_scenes_strategies_and_comparisons():
    found = read_experiment(
        write("""
        scenes = [{ source = "cornell", grid = { max_depth = [2, 4], "lamp.emitter.radiance" = [1.0, 10.5] } }]
        strategies = ["uniform", { name = "pooled", list = { warmup = [4, 8], growth = [0.5, 1.0] } }]
        sampler = ["sobol", "independent"]
        spp = [4, 16]
        devices = [0, "pocl/2"]
        seeds = 2
        first_seed = 7
    """)
    )
    assert [member.folder for member in found] == [
        "device-0/spp-16",
        "device-0/spp-4",
        "device-pocl-2/spp-16",
        "device-pocl-2/spp-4",
    ]
    assert [member.shares_with for member in found] == [*["device-0/spp-16"] * 2, *["device-pocl-2/spp-16"] * 2]
    request = found[1].request
    assert (request.spp, request.device, list(request.seeds)) == (4, "0", [7, 8])
    assert [scene.name for scene in request.scenes] == [
        f"cornell max_depth={depth} lamp.emitter.radiance={radiance}"
        for depth, radiance in itertools.product([2, 4], [1, 10.5])
    ]
    specs = ["uniform:", "pooled:warmup=4,growth=0.5,", "pooled:warmup=8,growth=1,"]
    assert [strategy.spec for strategy in request.strategies] == [
        f"{spec}sampler={sampler}" for spec in specs for sampler in ("sobol", "independent")
    ]


def test_settings_change_the_scene():
    """A number for a colour is grey, and the description has what `Scene` has."""
    from isonoise.comparison.scene_source import compile_entry

    (request,) = requests(
        'strategies = ["uniform"]\nspp = 4\nsize = [16, 12]\n'
        '[[scenes]]\nsource = "cornell"\n'
        'set = { "teal.reflectance" = [0.1, 0.2, 0.3], "$spp" = 9 }\n'
        'grid = { "lamp.emitter.radiance" = [5.0, 20.0] }'
    )
    plan = make_plan(request)
    assert [scene.slug for scene in plan.scenes] == [f"cornell-lamp.emitter.radiance-{n}" for n in (5, 20)]
    for entry, radiance in zip(plan.scenes, (5.0, 20.0), strict=True):
        compiled = compile_entry(entry, {}, False)
        expected = load("cornell", {"spp": "9"})
        expected["teal.reflectance"] = [0.1, 0.2, 0.3]
        expected["lamp.emitter.radiance"] = radiance
        assert entry.hash == compiled.hash == expected.compile((16, 12)).hash
        assert compiled.sample_count == 9
    assert len({scene.hash for scene in plan.scenes}) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("= 1", "is not TOML"),
        ("sceens = 1", "there is no key 'sceens' (did you mean 'scenes'?)"),
        ("seeds = 1", "'scenes' is missing"),
        ('scenes = "cornell"', "scenes should be a list of names or tables, not 'cornell'"),
        ('scenes = [{ name = "a" }]', "scenes[0]: 'source' is missing"),
        (
            'scenes = [{ source = "cornell", sizes = 1 }]',
            "scenes[0] (cornell): there is no key 'sizes' (did you mean 'size'",
        ),
        ('scenes = ["corneli"]\nstrategies = ["uniform"]\nspp = 1', "no such file or built-in scene"),
        (SMALL + "time = 1", "time and spp are both given"),
        (SMALL.replace("spp = 4", ""), "there is no budget: give time"),
        (SMALL.replace("spp = 4", "spp = 0"), "spp has to be a number above 0, not 0"),
        (SMALL.replace("spp = 4", "spp = [4, 4]"), "spp = [4, 4] has a value twice"),
        (SMALL.replace("[16, 12]", "[16]"), "size = [16] is not (width, height)"),
        (SMALL.replace("seeds = 1", "seeds = 0"), "seeds = 0 is out of range"),
        (SMALL.replace("seeds = 1", "seeds = [1]\nfirst_seed = 4"), "leave out first_seed"),
        (SMALL + 'sampler = "sobel"', "sampler = 'sobel' is not one of sobol, independent (did you mean 'sobol'?)"),
        (SMALL + "keep_images = 1", "keep_images = 1 is neither true nor false"),
        (SMALL.replace('["uniform"]', '["unifrm"]'), "strategies[0] (unifrm): there is no strategy 'unifrm' (did you"),
        (
            SMALL.replace('["uniform"]', '[{ name = "pooled", grid = { warmap = [1] } }]'),
            "strategies[0] (pooled): strategy 'pooled' has no parameter 'warmap' (did you mean 'warmup'?)",
        ),
        (SMALL.replace('["uniform"]', '[{ name = "pooled", grid = { warmup = 1 } }]'), "'warmup' = 1 is one value"),
        (
            SMALL.replace('["cornell"]', '[{ source = "cornell", grid = { "lamp.emiter.radiance" = [1] } }]'),
            "did you mean",
        ),
        (
            SMALL.replace('["cornell"]', '[{ source = "cornell", reference = "a", grid = { max_depth = [1, 2] } }]'),
            "'reference' is one image for several scenes",
        ),
        pytest.param(
            SMALL.replace('["uniform"]', '["mitsuba-independent"]').replace(
                '["cornell"]', '[{ source = "cornell", set = { "$spp" = 4 } }]'
            ),
            "render scene files as they are",
            marks=pytest.mark.skipif(not find_spec("mitsuba"), reason="Mitsuba 3 is not installed"),
        ),
    ],
)
def test_a_wrong_file_is_a_message(text, message, capsys):
    path = write(text)
    assert compare(path, "-o", "out", scene=None) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err
    assert not Path("out").exists()
    if "both given" not in message and "mitsuba" not in text:
        assert "experiment 'e.toml'" in err


def test_an_experiment_is_given_alone(capsys):
    write(SMALL)
    assert compare("e.toml", "-o", "out", scene="cornell") == 2
    assert "given alone" in capsys.readouterr().err
    assert compare("e.toml", "--time", 2, "-o", "out", scene=None) == 2
    assert "--time is a key of an experiment's file" in capsys.readouterr().err
    assert compare("nothing.toml", "-o", "out", scene=None) == 2
    assert "cannot read the experiment 'nothing.toml'" in capsys.readouterr().err


def without_times(path: Path) -> list[dict]:
    """The rows of a table, without what differs between two equal runs."""
    with path.open(newline="") as file:
        return [{name: value for name, value in row.items() if not name.endswith("_s")} for row in csv.DictReader(file)]


def assert_same_results(directory, other):
    assert_same_runs(directory, other)
    for table in ("runs.csv", "waves.csv"):
        assert without_times(Path(directory) / table) == without_times(Path(other) / table)


def test_a_sweep_that_is_stopped_twice_gives_the_same_tables(monkeypatch):
    monkeypatch.setattr("isonoise.commands.compare._report", lambda directory: write_tables(directory))
    write_flat_reference("a.exr")
    write(
        SMALL.replace(
            '["cornell"]',
            '[{ source = "cornell", name = "a", reference = "a.exr" }, '
            '{ source = "cornell", name = "b", reference = "a.exr", max_depth = 2 }]',
        ).replace('["uniform"]', '[{ name = "relative-mean", grid = { warmup = [2, 3, 4] } }]')
    )
    write_run, written = runner.write_packed, []

    def write_or_stop(path, content):
        if len(written) in (1, 4):
            written.append(None)  # the next call goes on
            raise RuntimeError
        written.append(path)
        write_run(path, content)

    monkeypatch.setattr(runner, "write_packed", write_or_stop)
    for expected in (1, 3):
        assert compare("e.toml", "-o", "stopped", scene=None) == 70
        assert len(run_files("stopped")) == expected
    assert compare("e.toml", "-o", "stopped", scene=None) == 0
    assert len(written) == 6 + 2  # finished runs are not rendered again
    monkeypatch.setattr(runner, "write_packed", write_run)
    assert compare("e.toml", "-o", "whole", scene=None) == 0
    assert len(run_files("whole")) == 6
    assert_same_results("whole", "stopped")
    assert Path("whole", EXPERIMENT_FILE).read_text() == Path("e.toml").read_text()


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_3x2x4_sweep_that_is_killed_twice_gives_the_same_tables():
    """Three parameters of a strategy, two of the scene, four seeds, with references that are rendered."""
    text = SMALL.replace("seeds = 1", "seeds = 4").replace("spp = 4", "spp = 256")
    text = text.replace('["cornell"]', '[{ source = "cornell", grid = { "lamp.emitter.radiance" = [5.0, 20.0] } }]')
    write(text.replace('["uniform"]', '[{ name = "pooled", grid = { growth = [0.25, 0.5, 1.0] } }]'))
    for finished in (3, 11):
        command = [sys.executable, "-m", "isonoise", "compare", "e.toml", "-o", "killed"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 120
        while len(run_files("killed")) < finished:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.kill()
        process.communicate()
        assert len(run_files("killed")) < 24
    for folder in ("killed", "whole"):
        assert compare("e.toml", "-o", folder, scene=None) == 0
    assert len(run_files("whole")) == 24
    assert_same_results("whole", "killed")


def test_a_folder_holds_one_budget_or_several(monkeypatch, capsys):
    monkeypatch.setattr("isonoise.commands.compare._report", summarise)
    write_flat_reference("a.exr")
    text = SMALL.replace('["cornell"]', '[{ source = "cornell", reference = "a.exr" }]')
    several = text.replace("spp = 4", "spp = [2, 4]")
    write(text)
    assert compare("e.toml", "-o", "results/one", scene=None) == 0
    assert compare("e.toml", "-o", "results", scene=None) == 0  # beside another one
    write(several)
    assert compare("e.toml", "-o", "results/one", scene=None) == 2
    assert "holds a comparison with one budget" in capsys.readouterr().err
    assert compare("e.toml", "-o", "several", scene=None) == 0
    write(text)
    assert compare("e.toml", "-o", "several", scene=None) == 2
    assert "holds comparisons with several budgets" in capsys.readouterr().err
