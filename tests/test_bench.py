"""`isonoise bench`: the report is consistent and documented; --against finds what has become slower."""

import copy
import json
import os
import re
from itertools import pairwise
from pathlib import Path

import pytest
from bench_command import documented_fields, json_fields, run_isonoise

from isonoise.benchmark.baseline import Baseline
from isonoise.benchmark.measure import SCHEMA, SCHEMA_VERSION, Settings, measure_scene, report_header
from isonoise.benchmark.prepared_scene import MeasuredDevice
from isonoise.benchmark.report_text import header_text, scene_text, summary_text
from isonoise.commands import bench
from isonoise.integrator.kernel_table import COMPACTION_KERNELS
from isonoise.integrator.wavefront import PLANE_PADDING
from isonoise.scene import compile_scene, load_description

START = {"process_s": 1.0, "load_s": 0.1, "build_s": 0.01, "compile_s": 0.5}
STARTUP = {"uncached": START, "cached": {name: {"median": s, "min": s, "max": s} for name, s in START.items()}}
SETTINGS = Settings(repeat=2, size=(24, 20), spp=8.5, pool_size=512)
COMMAND = ("--size", "24x20", "--spp", "8.5")

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.fixture(scope="module")
def cornell():
    """The report of a small `cornell`; only the start-up times are not measured."""
    scene = compile_scene(load_description("cornell"), size=SETTINGS.size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isonoise.benchmark.measure.startup_times", lambda *arguments: STARTUP)
        result = report_header(SCHEMA, SCHEMA_VERSION, SETTINGS, MeasuredDevice())
        result["copy_gb_per_s"] = {"median": 10.0, "min": 9.0, "max": 11.0}
        row = measure_scene("cornell", "cornell", scene, SETTINGS, result["copy_gb_per_s"])
        result["scenes"].append(row)
    return result


def test_the_json_fields_are_documented(cornell):
    assert json_fields(cornell) == documented_fields()[0]


def test_counts_add_up(cornell):
    (scene,) = cornell["scenes"]
    kernels = {row["kernel"]: row for row in scene["kernels"]}
    assert sum(row["time_share"] for row in scene["kernels"]) == pytest.approx(1)
    assert scene["samples"] == round(8.5 * 24 * 20) == kernels["generate"]["items"]
    rays = {row["kind"]: row["rays"] for row in scene["rays"]["kinds"]}
    bounces = scene["rays"]["bounces"]
    assert rays["camera"] == scene["samples"] == bounces[0]["rays"]
    assert rays["camera"] + rays["indirect"] == kernels["intersect"]["items"] == sum(row["rays"] for row in bounces)
    assert rays["shadow"] == sum(row["shadow_rays"] for row in bounces) > 0
    assert [row["depth"] for row in bounces] == list(range(1, 9))  # cornell's max_depth
    for before, row in pairwise(bounces):
        assert 0 < row["rays"] <= before["rays"]
        assert row["shadow_rays"] <= row["rays"]
    assert bounces[-1]["shadow_rays"] == 0  # the last vertex samples no light
    for name in ("shade", "shadow"):
        assert {key: kernels[name][key] for key in ("launches", "items")} == {
            key: kernels["intersect"][key] for key in ("launches", "items")
        }
    for row in scene["kernels"]:
        time = row["time_s"]
        assert 0 < time["min"] <= time["median"] <= time["max"]
        assert row["ns_per_item"] == pytest.approx(1e9 * time["median"] / row["items"])
        assert len(row["runs_s"]) == 2
        assert time["max"] == max(row["runs_s"])
        if row["local_memory_bytes"] is not None:  # work-groups share memory where they compact a path block
            shares = cornell["device"]["form"] == "gpu" and row["kernel"] in COMPACTION_KERNELS
            assert (row["local_memory_bytes"] > 0) == shares
        if row["gb_per_s"] is not None:
            moved = row["bytes_per_item"] + (row["traversal_bytes_per_item"] or 0)
            assert row["gb_per_s"] == pytest.approx(moved / row["ns_per_item"])
            assert row["copy_share"] == pytest.approx(row["gb_per_s"] / 10)
    tests = {row["kind"]: (row["node_tests_per_ray"], row["triangle_tests_per_ray"]) for row in scene["rays"]["kinds"]}
    assert tests["shadow"] == (None, None)
    for kind in ("camera", "indirect"):
        assert tests[kind] == (0, 36) or (tests[kind][0] >= 1 and tests[kind][1] > 0)
    launches = kernels["intersect"]["launches"]
    assert scene["pool_occupancy"] == pytest.approx(kernels["intersect"]["items"] / (launches * 512))
    assert scene["pool_occupancy"] > 0.5
    assert scene["run_s"]["median"] == pytest.approx(scene["samples"] / scene["samples_per_s"]["median"], rel=0.5)
    assert scene["device_busy_share"]["min"] > 0
    assert scene["device_busy_share"]["max"] <= 1
    costs = scene["wave_costs"]
    parts = [costs[f"{name}_share"] for name in ("statistics", "errors", "allocation")]
    assert all(part["min"] > 0 for part in parts)
    assert sum(part["min"] for part in parts) <= costs["total_share"]["median"] < 1


def test_bytes_per_path_are_those_of_the_buffers(cornell):
    memory = cornell["scenes"][0]["memory"]
    labels = ("paths", "hits", "shadow rays", "flags of the paths", "slots of dead paths")
    plane_stride = cornell["scenes"][0]["pool_size"] + PLANE_PADDING
    assert memory["state_bytes_per_path"] == sum(memory["buffers_bytes"][label] for label in labels) / plane_stride
    assert memory["total_bytes"] == sum(memory["buffers_bytes"].values())


def test_the_text_has_the_figures(cornell):
    two = cornell | {"scenes": cornell["scenes"] * 2}
    text = header_text(cornell) + scene_text(cornell["scenes"][0]) + summary_text(two)
    for word in (
        "driver",
        "24x20",
        "NEXT_EVENT",
        "samples/s",
        "first image",
        "intersect",
        "ns/item",
        "depth 8",
        "SAH",
        "triangles/ray",
        "of a copy",
        cornell["device"]["driver_version"],
        cornell["device"]["compiler_target"] or "",
        cornell["host"],
        (cornell["commit"] or "")[:12],
    ):
        assert word in text
    assert summary_text(cornell) == ""
    assert "the machine is busy" in header_text(cornell | {"load_average": 1e3})


@pytest.fixture
def measured(cornell, monkeypatch):
    """Figures that `isonoise bench` reports; a test may change them. before.json has the original ones."""
    figures = copy.deepcopy(cornell["scenes"][0])
    for figure in (figures["samples_per_s"], *(row["time_s"] for row in figures["kernels"])):
        figure["min"] = figure["max"] = figure["median"]
    monkeypatch.setattr(bench, "measure_scene", lambda *arguments: copy.deepcopy(figures))
    monkeypatch.setattr(bench, "copy_gb_per_s", lambda *arguments: cornell["copy_gb_per_s"])
    assert run_isonoise("bench", "cornell", *COMMAND, "--json", "before.json") == 0
    return figures


def slow_down(figures: dict, kernel: str, factor: float, share: float) -> None:
    row = next(row for row in figures["kernels"] if row["kernel"] == kernel)
    row["time_share"] = share
    scale(row["time_s"], factor)


def scale(figure: dict, factor: float) -> None:
    for name in figure:
        figure[name] *= factor


def test_nothing_is_slower_than_itself(measured, capsys):
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "before.json", "--json", "now.json") == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "1.000" in out
    assert json.loads(Path("now.json").read_text())["scenes"] == json.loads(Path("before.json").read_text())["scenes"]


@pytest.mark.parametrize(("threshold", "code"), [((), 1), (("--threshold", "0.75"), 0)])
def test_fewer_samples_per_second_are_slower(measured, capsys, threshold, code):
    scale(measured["samples_per_s"], 0.8)
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "before.json", *threshold) == code
    out, err = capsys.readouterr()
    assert ("cornell samples/s 0.800" in err) == bool(code)
    assert "0.800" in out


@pytest.mark.parametrize(("best", "code"), [(0.99, 1), (1.01, 0)])
def test_overlapping_spreads_are_not_slower(measured, capsys, best, code):
    """The fastest repeat was as fast as before."""
    before = measured["samples_per_s"]["median"]
    scale(measured["samples_per_s"], 0.8)
    measured["samples_per_s"]["max"] = best * before
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == code
    assert ("within the spread" in capsys.readouterr().out) != bool(code)


@pytest.mark.parametrize(("share", "code"), [(0.06, 1), (0.04, 0)])
def test_a_slower_kernel_is_judged_by_its_share(measured, capsys, share, code):
    content = json.loads(Path("before.json").read_text())
    for scene in (measured, content["scenes"][0]):
        slow_down(scene, "reduce", 1.0, 0.04)
    Path("before.json").write_text(json.dumps(content))
    slow_down(measured, "reduce", 1.25, share)
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == code
    out, err = capsys.readouterr()
    assert ("cornell kernel reduce 0.800" in err) == bool(code)
    assert "0.800" in out


def test_added_and_removed_kernels_are_listed(measured, capsys):
    for row in measured["kernels"]:
        row["kernel"] = row["kernel"].replace("count_alive", "count_more")
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == 0
    out = capsys.readouterr().out
    assert re.search(r"count_more +new", out)
    assert re.search(r"count_alive +removed", out)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (
            ("cornell", "--size", "24x21", "--spp", "8.5"),
            "height is 20 in 'before.json' and 21 now; give the same --size",
        ),
        (("cornell", "--size", "24x20"), "give the same --spp"),
        (("cornell", *COMMAND, "--max-depth", "3"), "give the same --max-depth"),
        (("penumbra", *COMMAND), "has no scene penumbra; it has: cornell"),
    ],
)
def test_other_settings_are_not_compared(measured, capsys, options, word):
    assert run_isonoise("bench", *options, "--against", "before.json", "--json", "now.json") == 2
    assert word in capsys.readouterr().err
    assert os.listdir() == ["before.json"]


def test_other_scenes_and_devices_are_not_compared(measured, capsys):
    content = json.loads(Path("before.json").read_text())
    changed = copy.deepcopy(content)
    changed["scenes"][0]["scene_hash"] = "0" * 32
    Path("scene.json").write_text(json.dumps(changed))
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "scene.json") == 2
    assert "the scene itself has changed" in capsys.readouterr().err
    content["device"]["name"] = "Abacus 9000"
    Path("device.json").write_text(json.dumps(content))
    assert run_isonoise("bench", "cornell", *COMMAND, "--against", "device.json") == 2
    assert "was measured on Abacus 9000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (None, "cannot read"),
        ("{", "not a JSON"),
        ("[]", "was not written by"),
        ('{"schema": "isonoise-peers"}', "was not written by"),
        ('{"schema": "isonoise-bench", "schema_version": 99}', "schema_version 99"),
        ('{"schema": "isonoise-bench", "schema_version": 2}', "damaged"),
        ('{"schema": "isonoise-bench", "schema_version": 2, "scenes": 7}', "damaged"),
        ('{"schema": "isonoise-bench", "schema_version": 2, "scenes": [], "device": {}}', "damaged"),
    ],
)
def test_unusable_baselines_are_messages(capsys, content, word):
    if content is not None:
        Path("x.json").write_text(content)
    assert run_isonoise("bench", "cornell", "--against", "x.json") == 2
    out, err = capsys.readouterr()
    assert word in err
    assert "x.json" in err
    assert "Traceback" not in err
    assert out == ""


@pytest.mark.parametrize("path", ["samples_per_s", "kernels"])
def test_a_damaged_baseline_is_a_message(cornell, path):
    content = copy.deepcopy(cornell)
    content["scenes"][0][path] = {"median": 0} if path == "samples_per_s" else [{}]
    Path("x.json").write_text(json.dumps(content))
    with pytest.raises(Exception, match=r"'x\.json' is damaged"):
        Baseline("x.json").compare(cornell)
