"""Files and figures of `isonoise bench` for driver developers: trace, programs, pytest-benchmark, bytes, origin."""

import json
import math
import statistics
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bench_command import run_isonoise, small_prepared_scene
from small_scene import lamp_over_floor

from isonoise.benchmark import generated_scenes, origin, program_dump
from isonoise.benchmark.bounces import RayTests, count_shadow_rays
from isonoise.benchmark.copy_bandwidth import copy_gb_per_s
from isonoise.benchmark.kernel_memory import kernel_memory
from isonoise.benchmark.launch_trace import QUEUE_TRACK, WAVEFRONT_TRACK, trace_json
from isonoise.benchmark.program_dump import DumpedProgram, check_folder, dump_programs, write_dump
from isonoise.benchmark.pytest_benchmark import pytest_benchmark_json
from isonoise.benchmark.traffic import TRAFFIC, counted_bytes, traversal_bytes
from isonoise.device.drivers import load_pyopencl
from isonoise.device.opencl import Device, Launch
from isonoise.errors import UserError
from isonoise.integrator.kernel_table import KERNELS, PATH_STATE, path_bytes
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.fixture(scope="module")
def prepared():
    return small_prepared_scene()


@pytest.fixture(scope="module")
def profiled(prepared):
    return prepared.run(profile=True)


def check_trace(trace: dict) -> None:
    """The rules of the Trace Event Format's JSON Object Format for the kinds of events that are written."""
    assert isinstance(trace["traceEvents"], list)
    assert trace["displayTimeUnit"] in ("ms", "ns")
    named = {"process_name": set(), "thread_name": set()}
    for event in trace["traceEvents"]:
        assert isinstance(event["name"], str)
        assert all(isinstance(event[key], int) for key in ("pid", "tid"))
        assert isinstance(event["args"], dict)
        if event["ph"] == "M":
            assert isinstance(event["args"]["name"], str)
            named[event["name"]].add(event["pid"] if event["name"] == "process_name" else (event["pid"], event["tid"]))
        else:
            assert event["ph"] == "X"
            assert event["ts"] >= 0
            assert event["dur"] >= 0
            assert event["pid"] in named["process_name"]
            assert (event["pid"], event["tid"]) in named["thread_name"]


def test_the_trace_holds_every_launch(profiled):
    trace = json.loads(json.dumps(trace_json({"host": "here"}, {"a": profiled.launches, "b": profiled.launches})))
    check_trace(trace)
    assert trace["otherData"] == {"host": "here"}
    for process in (1, 2):
        spans = [event for event in trace["traceEvents"] if event["ph"] == "X" and event["pid"] == process]
        queue = [event for event in spans if event["tid"] == QUEUE_TRACK]
        assert [event["name"] for event in queue] == [launch.kernel for launch in profiled.launches]
        assert [event["args"]["items"] for event in queue] == [launch.items for launch in profiled.launches]
        for event, launch in zip(queue, profiled.launches, strict=True):
            assert event["dur"] == pytest.approx(1e6 * launch.seconds)
            assert event["args"]["queued_us"] >= 0
        for before, event in pairwise(queue):
            assert event["ts"] >= before["ts"] + before["dur"] - 1e-3  # the queue is in order
        kernels = profiled.kernels()
        wavefront = [event for event in spans if event["tid"] == WAVEFRONT_TRACK]
        slices = [event for event in wavefront if event["name"] == "slice"]
        bounces = [event for event in wavefront if event["name"] == "bounce"]
        assert len(slices) == kernels["reduce"].launches
        assert len(bounces) == kernels["intersect"].launches
        assert sum(event["args"]["items"] for event in bounces) == kernels["intersect"].items
        for bounce in bounces:
            assert any(
                each["ts"] <= bounce["ts"] and bounce["ts"] + bounce["dur"] <= each["ts"] + each["dur"]
                for each in slices
            )


def test_times_of_a_trace_are_microseconds_of_the_device_clock():
    launches = [Launch("shade", 9, 4_999_000_000, 4_999_999_999, 5_000_000_500)]
    launches += [Launch("reduce", 7, 5_000_000_000, 5_000_001_500, 5_000_003_500)]
    first, event = (each for each in trace_json({}, {"a": launches})["traceEvents"] if each["ph"] == "X")
    assert (first["ts"], first["dur"]) == (0.0, 0.501)
    assert (event["ts"], event["dur"]) == (1.501, 2.0)
    assert event["args"] == {"items": 7, "queued_us": pytest.approx(1.5)}
    assert not [each for each in trace_json({}, {"a": []})["traceEvents"] if each["ph"] == "X"]


@pytest.mark.filterwarnings("ignore:.*compiler output.*")
def test_the_dump_holds_every_program_and_its_binary_loads(prepared):
    programs = dump_programs(prepared.device)
    assert {kernel for program in programs for kernel in program.kernels} == set(prepared.wavefront.stages)
    write_dump(check_folder("dump"), {"host": "here"}, {"a/scene.xml": programs, "b/scene.xml": programs[:1]})
    index = json.loads(Path("dump/index.json").read_text())
    assert (index["schema"], index["schema_version"], index["host"]) == ("isonoise-programs", 1, "here")
    assert [row["scene"] for row in index["programs"]] == ["a/scene.xml"] * len(programs) + ["b/scene.xml"]
    assert index["programs"][0]["source_file"] == "scene.xml/list_samples.cl"
    assert index["programs"][-1]["source_file"] == "scene.xml-2/list_samples.cl"
    files = {str(path.relative_to("dump")) for path in Path("dump").rglob("*.*") if path.is_file()}
    named = {row[key] for row in index["programs"] for key in ("source_file", "log_file", "binary_file")}
    assert files == (named | {"index.json"}) - {None}
    cl, device = load_pyopencl(), prepared.device
    for row, program in zip(index["programs"], programs, strict=False):
        assert Path("dump", row["source_file"]).read_text() == program.source
        assert row["options"][0].startswith("-cl-std")
        if row["binary_file"]:
            binary = Path("dump", row["binary_file"]).read_bytes()
            built = cl.Program(device.context, [device.device], [binary]).build(cache_dir=False)
            assert sorted(kernel.function_name for kernel in built.all_kernels()) == row["kernels"]


def test_a_dump_is_complete_or_not_there(monkeypatch):
    program = DumpedProgram("shade", ["shade"], "source", ("-w",), "", b"")

    def fail(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(program_dump.os, "replace", fail)
    with pytest.raises(UserError, match="cannot write 'dump': No space left"):
        write_dump(check_folder("dump"), {}, {"a": [program]})
    assert list(Path().iterdir()) == []
    Path("dump").mkdir()
    with pytest.raises(UserError, match="exists already; give the name of a new folder"):
        check_folder("dump")


def test_the_files_of_one_measurement(monkeypatch, capsys):
    """Only start-up times and bandwidth are not measured."""
    start = {f"{name}_s": 1.0 for name in ("process", "load", "build", "compile")}
    cached = {name: {"median": 1.0, "min": 1.0, "max": 1.0} for name in start}
    monkeypatch.setattr(
        "isonoise.benchmark.measure.startup_times", lambda *arguments: {"uncached": start, "cached": cached}
    )
    monkeypatch.setattr("isonoise.commands.bench.copy_gb_per_s", lambda *arguments: cached["load_s"])
    files = ("--json", "a.json", "--trace", "t.json", "--dump", "d", "--pytest-benchmark", "p.json")
    assert run_isonoise("bench", "cornell", "--size", "12x10", "--spp", "4", "--repeat", "1", *files) == 0
    report, trace, benchmark = (json.loads(Path(name).read_text()) for name in ("a.json", "t.json", "p.json"))
    check_trace(trace)
    assert trace["otherData"]["date"] == report["date"] == benchmark["datetime"]
    kernels = {row["kernel"]: row["launches"] for row in report["scenes"][0]["kernels"]}
    queue = [event["name"] for event in trace["traceEvents"] if event["tid"] == QUEUE_TRACK and event["ph"] == "X"]
    assert {name: queue.count(name) for name in set(queue)} == kernels
    dumped = json.loads(Path("d/index.json").read_text())["programs"]
    assert set(kernels) <= {kernel for row in dumped for kernel in row["kernels"]}
    assert {each["name"] for each in benchmark["benchmarks"]} == {"cornell", *(f"cornell/{name}" for name in kernels)}
    driver = report["device"]["driver_version"]
    assert driver in capsys.readouterr().out


STATS = {
    **dict.fromkeys(("min", "max", "mean", "stddev", "median", "iqr", "q1", "q3", "ld15iqr", "hd15iqr", "ops"), float),
    **dict.fromkeys(("rounds", "iterations", "iqr_outliers", "stddev_outliers"), int),
    "total": float,
    "outliers": str,
    "data": list,
}
"""Fields of `stats` in a file of pytest-benchmark 5.3.1."""


@pytest.mark.parametrize("seconds", [[0.5], [0.25, 0.75], [0.1, 0.1, 0.1, 0.1, 5.0], [0.0]])
def test_the_form_of_pytest_benchmark(seconds):
    scene = {
        "scene": "cornell",
        "scene_hash": "0",
        "width": 4,
        "height": 3,
        "max_depth": 8,
        "samples": 96,
        "runs_s": seconds,
        "kernels": [{"kernel": "shade", "runs_s": seconds, "items": 7}],
    }
    result = {"host": "here", "cpu_model": "A CPU", "date": "2026-01-02T03:04:05+00:00", "device": {"name": "d"}}
    content = pytest_benchmark_json(result | {"commit": None, "has_local_changes": None, "scenes": [scene]})
    json.dumps(content, allow_nan=False)
    assert set(content) == {"machine_info", "commit_info", "benchmarks", "datetime", "version"}
    assert {"node", "machine", "python_version", "system", "cpu"} <= set(content["machine_info"])
    assert {"id", "time", "author_time", "dirty", "project", "branch"} == set(content["commit_info"])
    assert [each["name"] for each in content["benchmarks"]] == ["cornell", "cornell/shade"]
    for each in content["benchmarks"]:
        assert {"group", "name", "fullname", "params", "param", "extra_info", "options", "stats"} == set(each)
        stats = each["stats"]
        assert set(stats) == set(STATS)
        for name, kind in STATS.items():
            assert isinstance(stats[name], (kind, int) if kind is float else kind), name
        assert stats["data"] == seconds
        assert stats["rounds"] == len(seconds)
        assert stats["median"] == statistics.median(seconds)
        assert stats["min"] <= stats["q1"] <= stats["median"] <= stats["q3"] <= stats["max"]
        assert stats["ld15iqr"] in seconds
        assert stats["hd15iqr"] in seconds
        assert stats["ops"] == (len(seconds) / sum(seconds) if sum(seconds) else 0)
    assert (stats["iqr_outliers"], stats["hd15iqr"]) == ((1, 0.1) if len(seconds) == 5 else (0, max(seconds)))


def test_traffic_names_buffers_of_the_kernel_table():
    for name, rows in TRAFFIC.items():
        kernel = KERNELS[name]
        for row in rows:
            reads, writes = ({word.partition(":")[0] for word in text.split()} for text in (row.reads, row.writes))
            assert reads <= {*kernel.reads, *kernel.writes}, name
            assert writes <= set(kernel.writes), name


def test_counted_bytes_of_known_kernels(prepared, profiled):
    """The bytes of scenes without instances and media, whose path state is four buffers of 16 bytes."""
    shadow_rays = sum(count_shadow_rays(prepared))
    kernels = profiled.kernels()
    moved = counted_bytes(prepared, kernels, shadow_rays)
    paths, new_paths, pixels = (kernels[name].items for name in ("intersect", "generate", "list_samples"))
    sizes = path_bytes(prepared.wavefront.features)
    assert {name: sizes[name] for name in PATH_STATE if name in sizes} == {
        "ray_origin": 16, "ray_direction": 16, "throughput": 16, "path_ids": 16,
    }  # fmt: skip
    survivors = paths - new_paths
    assert moved["intersect"] == paths * (16 + 12 + 4 + 16)
    assert moved["generate"] == new_paths * (4 + 4 + 64 + 12)
    assert moved["shade"] == paths * (16 + 64 + 4) + survivors * (16 + 16 + 16 + 8) + shadow_rays * (16 + 16 + 12)
    assert moved["shadow"] == paths * 4 + shadow_rays * (12 + 16 + 4)
    assert moved["count_alive"] == 4 * paths
    assert moved["list_holes"] == 4 * paths
    assert moved["list_samples"] == pixels * (4 + 4 + 4) + prepared.samples * (4 + 4)
    assert moved["reduce"] == pixels * (4 + 2 * (4 + 4 + 40 + 8)) + 12 * prepared.samples
    assert moved["summarise"] == kernels["summarise"].items * (4 + 40 + 8 + 12 + 8)
    assert "scan_blocks" not in moved


def test_survivors_of_a_run_are_the_paths_that_continue(prepared):
    """The sum over all bounces of the paths that continue, as the host reads them, is what `traffic` takes for it."""
    continuing = []
    compact = Wavefront._compact
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Wavefront, "_compact", lambda self, paths: continuing.append(compact(self, paths)) or continuing[-1]
        )
        kernels = prepared.run(profile=True).kernels()
    assert sum(continuing) == kernels["intersect"].items - kernels["generate"].items > 0


def test_bytes_of_traversal_are_those_of_nodes_and_blocks(prepared):
    tests = [RayTests(10, 30, 16), RayTests(5, 7, 8)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prepared.wavefront, "brute_force", False)
        # a node has 7 float8: 6 planes of boxes, the children; a block 10: 9 of corners, the triangles' numbers
        assert traversal_bytes(prepared, tests) == {"intersect": (30 + 7) * 7 * 32 + (2 + 1) * 10 * 32}
        patch.setattr(prepared.wavefront, "brute_force", True)
        assert traversal_bytes(prepared, tests) == {}


def test_members_of_a_ray_that_intersect_does_not_count_do_not_matter():
    """`intersect` finds the same hits whatever is in the members of its buffers that `traffic` leaves out."""
    vertices, faces = generated_scenes.bumpy_ring(12, 8)
    ring = {"type": "mesh", "vertices": 0.3 * vertices + [0, 0, 0.3], "faces": faces}
    scene = compile_scene(load_description(lamp_over_floor() | {"ring": ring}))
    paths, device = 400, Device()
    wavefront = Wavefront(device, scene, build_scene_bvh(scene), pool_size=512)
    wavefront.warm_up()
    arguments = wavefront.stages.arguments
    stride = int(arguments["plane_stride"])
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(3, paths))
    for plane, values in enumerate([*rng.uniform(-1, 1, (3, paths)), np.full(paths, np.inf)]):
        device.write(arguments["ray_origin"], values.astype(np.float32), offset=4 * plane * stride)
    for plane, values in enumerate(directions / np.linalg.norm(directions, axis=0)):
        device.write(arguments["ray_direction"], values.astype(np.float32), offset=4 * plane * stride)
    device.write(arguments["path_ids"], np.full(paths, 2**32 - 1, np.uint32), offset=4 * stride)  # start on nothing

    def hits_with(content: int) -> np.ndarray:
        garbage = np.full(paths, content, np.uint32)
        device.write(arguments["ray_direction"], garbage, offset=4 * 3 * stride)
        for plane in (0, 2, 3):
            device.write(arguments["path_ids"], garbage, offset=4 * plane * stride)
        wavefront.trace_rays("intersect", paths)
        return device.read(arguments["hit"], np.uint32, 4 * stride).reshape(4, stride)[:, :paths].copy()

    first = hits_with(0)
    assert 0 < np.mean(first[3] != 2**32 - 1) < 1
    assert np.array_equal(first, hits_with(0x7FC00000))


def test_the_bandwidth_of_a_copy_is_finite(monkeypatch):
    monkeypatch.setattr("isonoise.benchmark.copy_bandwidth.MAX_COPY_BYTES", 2**16)
    rate = copy_gb_per_s(Device(), 2)
    assert 0 < rate["min"] <= rate["median"] <= rate["max"] < math.inf


def test_memory_of_kernels(monkeypatch):
    device = Device()
    source = "__kernel void twice(__global float* a) { __local float x[64]; x[get_local_id(0)] = a[0]; "
    source += "barrier(CLK_LOCAL_MEM_FENCE); a[get_global_id(0)] = x[63 - get_local_id(0)]; }"
    kernel = device.build(source, ())["twice"]
    facts = kernel_memory(device, kernel)
    assert facts["local_memory_bytes"] == 256
    assert facts["preferred_work_group_multiple"] >= 1
    assert (facts["private_memory_bytes"] is None) == device.is_pocl


def git(*arguments: str) -> str:
    identity = ("-c", "user.name=n", "-c", "user.email=e@example.org")
    return subprocess.run(["git", *identity, *arguments], check=True, capture_output=True, text=True).stdout.strip()


def test_the_commit_of_a_checkout(tmp_path):
    checkout = tmp_path / "checkout"
    (checkout / "host" / "isonoise").mkdir(parents=True)
    assert not origin.is_checkout(checkout)
    for name in ("pyproject.toml", "host/isonoise/__init__.py"):
        (checkout / name).touch()
    assert origin.is_checkout(checkout)
    git("init", "-q", ".")  # a repository around the checkout, which is not its own
    git("add", ".")
    git("commit", "-q", "-m", "outer")
    assert origin.commit_fields(checkout) == origin.NO_COMMIT
    git("init", "-q", "checkout")
    assert origin.commit_fields(checkout) == origin.NO_COMMIT  # no commit yet
    git("-C", "checkout", "add", ".")
    git("-C", "checkout", "commit", "-q", "-m", "first")
    commit = git("-C", "checkout", "rev-parse", "HEAD")
    assert origin.commit_fields(checkout) == {"commit": commit, "has_local_changes": False}
    (checkout / "new").touch()
    assert not origin.commit_fields(checkout)["has_local_changes"]
    (checkout / "pyproject.toml").write_text("[project]")
    assert origin.commit_fields(checkout) == {"commit": commit, "has_local_changes": True}


def test_without_git_there_is_no_commit(monkeypatch):
    def missing(*arguments, **options):
        raise FileNotFoundError("git")

    monkeypatch.setattr(origin.subprocess, "run", missing)
    fields = origin.origin_fields()
    assert (fields["commit"], fields["has_local_changes"]) == (None, None)
    assert fields["date"].endswith("+00:00")
