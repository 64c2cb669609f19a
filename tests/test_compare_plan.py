"""`isonoise compare` before it renders: strategy specs, plans, presets, bad input."""

import importlib.util
from pathlib import Path

import pytest
from compare_command import HEIGHT, SIZE, WIDTH, compare, options, write_flat_reference

import isonoise
from isonoise.comparison import plan_changes
from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.planning import make_plan
from isonoise.comparison.presets import PRESETS
from isonoise.comparison.request import Request, SceneRequest, StrategyRequest
from isonoise.comparison.strategy_specs import (
    describe_spec,
    first_waves_spp,
    independent_counterpart,
    needs_variance,
    split_sampler,
    split_specs,
)
from isonoise.errors import UserError
from isonoise.strategies import make_strategy

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.mark.parametrize(
    ("text", "specs"),
    [
        ("uniform", ["uniform"]),
        ("uniform,relative-mean", ["uniform", "relative-mean"]),
        ("a:k=v,l=w,b", ["a:k=v,l=w", "b"]),
        ("a,b:k=v,c:l=w,m=x,d", ["a", "b:k=v", "c:l=w,m=x", "d"]),
        ("oracle:rule=sqrt,file=C:/a.exr,uniform", ["oracle:rule=sqrt,file=C:/a.exr", "uniform"]),
        ("module:Class,module:Class:k=v", ["module:Class", "module:Class:k=v"]),
        ("adaptive:measure=m:f,rule=n:g,uniform", ["adaptive:measure=m:f,rule=n:g", "uniform"]),
        (" a , b:k=v , c,", ["a", "b:k=v ", "c"]),
    ],
)
def test_lists_of_specs_are_split(text, specs):
    assert [spec.strip() for spec in split_specs(text)] == [spec.strip() for spec in specs]


def test_a_parameter_needs_a_strategy():
    with pytest.raises(UserError, match="without a strategy"):
        split_specs("k=v,uniform")


def test_an_oracle_without_a_file_needs_the_variance():
    assert needs_variance("oracle")
    assert needs_variance("oracle:rule=sqrt")
    assert not needs_variance("oracle:rule=sqrt,file=a.exr")
    assert not needs_variance("uniform")
    assert describe_spec("oracle:rule=sqrt").startswith("oracle:rule=sqrt,")
    assert "file" not in describe_spec("oracle")


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("uniform", ("uniform", "sobol")),
        ("uniform:sampler=independent", ("uniform", "independent")),
        ("uniform:warmup=4,sampler=independent", ("uniform:warmup=4", "independent")),
        ("uniform:sampler=sobol,warmup=4", ("uniform:warmup=4", "sobol")),
        ("module:Class:sampler=independent", ("module:Class", "independent")),
        ("module:Class", ("module:Class", "sobol")),
        ("adaptive:measure=m:f,sampler=independent", ("adaptive:measure=m:f", "independent")),
        ("adaptive:sampler=independent,measure=m:f", ("adaptive:measure=m:f", "independent")),
        ("adaptive:measure=m:f", ("adaptive:measure=m:f", "sobol")),
    ],
)
def test_a_spec_may_name_its_sampler(spec, expected):
    assert split_sampler(spec) == expected


def test_samplers_are_described_and_have_an_independent_counterpart():
    assert describe_spec("uniform:sampler=independent").endswith(",sampler=independent")
    assert describe_spec("uniform").endswith(",sampler=sobol")
    assert needs_variance("oracle:sampler=independent")
    assert "file" not in describe_spec("oracle:sampler=independent")
    assert independent_counterpart("uniform") == "uniform:sampler=independent"
    assert independent_counterpart("uniform:warmup=4,sampler=sobol") == "uniform:warmup=4,sampler=independent"
    assert independent_counterpart("mitsuba-multijitter") == "mitsuba-independent"


def test_the_samples_before_the_first_adaptive_wave():
    assert first_waves_spp(make_strategy("uniform:warmup=4")) == (4, None)
    assert first_waves_spp(make_strategy("relative-mean:warmup=5")) == (5, 5)


def request(scenes=("cornell",), strategies=("uniform",), size=(WIDTH, HEIGHT), max_depth=None, **changes):
    values = {"seeds": [0, 1], "spp": 4.0} | changes
    scenes = [SceneRequest(name, size=size, max_depth=max_depth) for name in scenes]
    return Request(scenes, [StrategyRequest(spec) for spec in strategies], **values)


def messages(stored, plan):
    found = plan_changes.differences(stored, plan)
    return found.settings + found.changes


def test_a_plan_is_stored_and_read(tmp_path):
    plan = make_plan(request(max_depth=3))
    write_plan(tmp_path, plan)
    assert read_plan(tmp_path) == plan
    assert messages(plan, read_plan(tmp_path)) == []
    assert read_plan(tmp_path / "nothing") is None


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"spp": 5.0}, "spp was 4.0 and is 5.0"),
        ({"spp": None, "time": 1.0}, "time was not given and is 1.0"),
        ({"size": (8, 8)}, "size of 'cornell' was 16x12 and is 8x8"),
        ({"max_depth": 2}, "max_depth of 'cornell' was not given and is 2"),
        ({"reference_time": 3.0}, "reference_time was not given"),
        ({"strategies": ["relative-mean"]}, "'uniform' is missing"),
        ({"scenes": ["penumbra"]}, "'cornell' is missing"),
        ({"seeds": [1, 2]}, "seeds are missing: 0"),
        ({"seeds": [0]}, "seeds are missing: 1"),
        ({"references": ["a.exr"]}, "reference of 'cornell' was references/cornell.exr"),
    ],
)
def test_differences_of_plans_are_messages(changes, difference):
    write_flat_reference("a.exr", changes.get("size", (WIDTH, HEIGHT)))
    stored = make_plan(request())
    assert any(difference in text for text in messages(stored, make_plan(request(**changes), stored)))


def test_a_plan_may_grow():
    stored = make_plan(request())
    changes = {"strategies": ["relative-mean", "uniform"], "scenes": ["penumbra", "cornell"], "seeds": [0, 1, 2]}
    larger = make_plan(request(**changes), stored)
    assert messages(stored, larger) == []
    assert plan_changes.additions(stored, larger) == ["penumbra", "relative-mean", "seed 2"]


def test_slugs_are_unique_and_do_not_change(tmp_path):
    """Many scenes are called scene.xml. A plan keeps the slugs that it has."""
    paths = []
    for folder in ("a", "b/a", "c"):
        path = tmp_path / folder / "scene.xml"
        path.parent.mkdir(parents=True)
        path.write_bytes(isonoise.scene.builtin.find_scene("cornell").read_bytes())
        paths.append(str(path))
    strategies = ["uniform:warmup=4,growth=0.5", "uniform:warmup=4", "uniform"]
    first = make_plan(request(scenes=paths[1:2], strategies=strategies[1:2]))
    assert [scene.slug for scene in first.scenes] == ["a"]
    plan = make_plan(request(scenes=paths, strategies=strategies), first)
    assert [scene.slug for scene in plan.scenes] == ["a-scene", "a", "c"]
    assert [strategy.slug for strategy in plan.strategies] == [
        "uniform-warmup-4-growth-0.5",
        "uniform-warmup-4",
        "uniform",
    ]
    assert plan.scenes[0].source == str(Path(paths[0]).resolve())


def test_references_are_assigned_by_order_or_by_name():
    write_flat_reference("a.exr")
    write_flat_reference("b.exr")
    scenes = ["cornell", "penumbra"]
    for given in (["a.exr", "b.exr"], ["penumbra=b.exr", "cornell=a.exr"]):
        plan = make_plan(request(scenes=scenes, references=given))
        assert [Path(scene.reference).name for scene in plan.scenes] == ["a.exr", "b.exr"]
        assert all(len(scene.reference_sha256) == 64 for scene in plan.scenes)
    (one, other) = make_plan(request(scenes=scenes, references=["penumbra=b.exr"])).scenes
    assert (one.reference, one.reference_sha256) == ("references/cornell.exr", None)
    assert Path(other.reference) == Path("b.exr").resolve()
    with pytest.raises(UserError, match="one for each of the 2 scenes"):
        make_plan(request(scenes=scenes, references=["a.exr"]))


def test_presets_can_be_planned(monkeypatch):
    monkeypatch.setattr("isonoise.comparison.strategy_code.version", lambda package: "3")  # also without Mitsuba
    for preset in PRESETS.values():
        plan = make_plan(request(scenes=preset.scenes, strategies=preset.strategies))
        assert len(plan.scenes) == len(preset.scenes)


def test_a_plan_keeps_its_preset(tmp_path):
    """The report has the preset's figures also if later runs are requested without it."""
    stored = make_plan(request(preset="poster"))
    write_plan(tmp_path, stored)
    assert read_plan(tmp_path) == stored
    assert make_plan(request(), stored).preset == "poster"
    late = make_plan(request(preset="poster"), make_plan(request()))
    assert (late.preset, messages(make_plan(request()), late)) == ("poster", [])


def test_options_override_a_preset():
    from isonoise.cli import make_parser
    from isonoise.commands.compare import _members

    def parsed(*arguments):
        options = make_parser().parse_args(["compare", "--preset", "poster", "-o", "out", *arguments])
        return _members(options)[0].request

    whole, preset = parsed(), PRESETS["poster"]
    assert tuple(scene.source for scene in whole.scenes) == preset.scenes
    assert tuple(strategy.spec for strategy in whole.strategies) == preset.strategies
    assert (whole.time, whole.spp, len(whole.seeds), whole.scenes[0].size) == (preset.time, None, preset.seeds, None)
    small = parsed("--time", "1", "--seeds", "2", "--size", "64x64")
    assert (small.time, len(small.seeds), small.scenes[0].size) == (1, 2, (64, 64))
    assert small.strategies == whole.strategies
    assert (parsed("--spp", "4").time, parsed("--spp", "4").spp) == (None, 4)
    assert all((preset.time is None) == bool(preset.spp) for preset in PRESETS.values())
    assert parsed("--strategies", "uniform").strategies == [StrategyRequest("uniform")]
    assert parsed("cornell").scenes == [SceneRequest("cornell")]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--time", "1", "--spp", "4"), "time and spp are both given"),
        (("--spp", "4,4"), "4,4 has a number twice"),
        (("--spp", "4,0"), "more than 0"),
        (("--strategies", "uniform:sampler=sobel"), "no sampler 'sobel'"),
        (("--time", "0"), "more than 0"),
        (("--seeds", "0"), "1 or more"),
        (("--seeds", "1.5"), "not a whole number"),
        (("--seed", 2**63), "seeds go up to"),
        (("--seeds", 10**9), "at most 1,000,000 runs"),
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


def test_missing_scenes_or_strategies_are_a_message(capsys):
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
