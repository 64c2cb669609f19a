"""What `isonoise bench` measures: runs, bounces, intersection tests, BVH, start-up; generated scenes; the options."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_command import run_isonoise, small_prepared_scene
from small_scene import assert_same_bits, lamp_over_floor, without

from isonoise.benchmark import generated_scenes, prepared_scene, startup
from isonoise.benchmark.bounces import count_shadow_rays, count_tests, split_allocation, time_bounces
from isonoise.benchmark.bvh_stats import bvh_statistics, sah_cost
from isonoise.benchmark.measure import Settings
from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.commands import bench
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_every_run_traces_the_same_samples():
    measured = small_prepared_scene()
    measured.run(profile=False)
    first = measured.wavefront.accumulator.statistics()
    again = measured.run(profile=True)
    assert_same_bits(first, measured.wavefront.accumulator.statistics())
    assert measured.run(profile=False).launches is None
    other = measured.run(profile=True)
    counts = [{name: (work.launches, work.items) for name, work in run.kernels().items()} for run in (again, other)]
    assert counts[0] == counts[1]


def test_bounces_add_up_to_the_run():
    """The pool size changes the launches, but not the rays."""
    small, large = small_prepared_scene(pool_size=64), small_prepared_scene(pool_size=512)
    rays = [[bounce.rays for bounce in time_bounces(each)] for each in (small, large)]
    assert rays[0] == rays[1]
    assert count_shadow_rays(small) == count_shadow_rays(large)
    assert sum(rays[0]) == small.run(profile=True).kernels()["intersect"].items


def test_intersection_tests_are_bounded_and_independent_of_the_pool():
    """test_intersection.py checks the tests of single rays."""
    vertices, faces = generated_scenes.bumpy_ring(12, 8)
    ring = {"type": "mesh", "vertices": 0.3 * vertices + [0, 0, 0.3], "faces": faces, "face_normals": True}
    compiled = compile_scene(load_description(lamp_over_floor() | {"ring": ring}))
    sums = []
    for pool_size in (64, 512):
        measured = PreparedScene(compiled, MeasuredDevice(), 700, pool_size)
        rays = [bounce.rays for bounce in time_bounces(measured)]
        before = measured.device.buffer_bytes.total()
        sums.append(count_tests(measured, rays))
        assert measured.device.buffer_bytes.total() == before
        assert [bounce.rays for bounce in sums[-1]] == rays
    assert sums[0] == sums[1]
    nodes, blocks = len(measured.bvh.nodes), len(measured.bvh.blocks)
    for bounce in sums[0]:
        assert bounce.rays < bounce.nodes < bounce.rays * nodes
        assert bounce.triangles % 8 == 0
        assert 0 < bounce.triangles < 8 * bounce.rays * blocks


def test_without_a_bvh_every_ray_is_tested_against_all_triangles():
    measured = small_prepared_scene()
    measured.wavefront.brute_force = True
    assert [(bounce.nodes, bounce.triangles) for bounce in count_tests(measured, [400, 100])] == [(0, 1600), (0, 400)]


def test_without_light_there_are_no_shadow_rays():
    scene = compile_scene(load_description(without(lamp_over_floor(), "lamp")))
    assert count_shadow_rays(PreparedScene(scene, MeasuredDevice(), 35, 64)) == []


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
def test_an_allocation_is_split_in_pixel_order(size):
    allocation = np.array([[3, 0, 5], [0, 11, 1]], np.uint32)
    parts = list(split_allocation(allocation, size))
    assert sum(piece.astype(int) for piece in parts).tolist() == allocation.tolist()
    assert [int(piece.sum()) for piece in parts] == [size] * (20 // size) + [20 % size] * bool(20 % size)
    order = [np.repeat(np.arange(6), piece.ravel()) for piece in parts]
    assert (np.diff(np.concatenate(order)) >= 0).all()


def test_sah_cost_is_the_mean_number_of_visits_of_random_lines():
    """Boxes of `cornell` hit by uniformly distributed lines through its bounding sphere."""
    scene = compile_scene(load_description("cornell"))
    bvh = build_scene_bvh(scene)
    used = np.isfinite(bvh.nodes[:, 0])
    lower = np.moveaxis(bvh.nodes[:, 0:3], 1, 2)[used].astype(float)
    upper = np.moveaxis(bvh.nodes[:, 3:6], 1, 2)[used].astype(float)
    root = bvh.nodes[0, 0:3].min(axis=1), bvh.nodes[0, 3:6].max(axis=1)
    rng = np.random.default_rng(1)
    number = 100_000
    direction = rng.normal(size=(number, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction, rng.normal(size=(number, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    radius = 0.5 * np.linalg.norm(root[1] - root[0])
    point = 0.5 * (root[0] + root[1]) + side * (radius * np.sqrt(rng.random((number, 1))))

    def is_hit(low, high) -> np.ndarray:
        near, far = (low - point) / direction, (high - point) / direction
        return np.minimum(near, far).max(axis=1) <= np.maximum(near, far).min(axis=1)

    hits_root = is_hit(*root)
    visits = 1 + sum(is_hit(low, high)[hits_root].mean() for low, high in zip(lower, upper, strict=True))
    # hits per line have a standard deviation of about 2.5: standard error 0.01 with 60,000 lines through the root
    assert sah_cost(bvh, scene) == pytest.approx(visits, abs=0.05)


def test_sah_cost_of_instances():
    """Two unit balls in a box of 8x2x2: half areas 12, 12, 36; an instance costs the root and the leaf of its group."""
    ball = {"type": "shapegroup", "ball": {"type": "sphere"}}
    moved = [np.eye(4), np.eye(4)]
    moved[0][0, 3], moved[1][0, 3] = -3, 3
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "group": ball}
    for number, matrix in enumerate(moved):
        scene[f"i{number}"] = {"type": "instance", "to_world": matrix, "group": {"type": "ref", "id": "group"}}
    compiled = compile_scene(load_description(scene))
    facts = bvh_statistics(build_scene_bvh(compiled), compiled)
    assert facts["sah_cost"] == pytest.approx(1 + 2 * 12 / 36 * (1 + 2), rel=1e-4)
    assert facts["leaves"] == 3  # one ball, two instances of it
    assert facts["triangles_per_block"] is None


def test_startup_is_measured_in_processes_with_empty_caches(monkeypatch):
    started = []

    def process(command, env, **options):
        folder = Path(env["POCL_CACHE_DIR"])
        started.append((command[3:], folder, list(folder.iterdir())))
        (folder / "compiled").touch()
        return subprocess.CompletedProcess(command, 0, json.dumps({"setup_s": {"load": 1, "build": 2, "compile": 3}}))

    monkeypatch.setattr(startup.subprocess, "run", process)
    settings = Settings(size=(5, 4), max_depth=3, device="0")
    facts = startup.startup_times("cornell", settings.render_options(), 2)
    assert len(started) == 3
    assert [len(cached) for _, _, cached in started] == [0, 1, 1]  # the first process has empty caches
    for word in ("render", "cornell", "--size", "5x4", "--max-depth", "3", "--device", "0"):
        assert word in started[0][0]
    assert not started[0][1].exists()
    assert facts["uncached"]["compile_s"] == 3
    assert facts["cached"]["load_s"] == {"median": 1, "min": 1, "max": 1}


@pytest.mark.long
def test_startup_with_empty_caches_takes_longer():
    facts = startup.startup_times("cornell", ["--size", "16x16"], 1)
    assert facts["uncached"]["process_s"] > facts["cached"]["process_s"]["median"] > 0


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("cornel",), "did you mean 'cornell'"),
        (("cornell", "--json", "missing/a.json"), "there is no folder"),
        (("cornell", "--threshold", "0.5"), "--against or --versus"),
        (("cornell", "--peers", "--against", "a.json"), "--against belongs to the measurement that --peers replaces"),
        (("cornell", "--versus", "device:0", "--dump", "d"), "--dump belongs to the measurement that --versus"),
        (("cornell", "--trace", "missing/a.json"), "there is no folder"),
        (("cornell", "--pytest-benchmark", "missing/a.json"), "there is no folder"),
        (("cornell", "--dump", "missing/a"), "there is no folder"),
        (("cornell", "--dump", "."), "give the name of a new folder"),
        (("cornell", "--versus", "."), "is not a checkout of isonoise"),
        (("cornell", "--repeat", "0"), "must be 1 or more"),
        (("cornell", "--device", "no such device"), "no OpenCL device matches"),
    ],
)
def test_bad_options_are_messages(capsys, options, word):
    assert run_isonoise("bench", *options) == 2
    out, err = capsys.readouterr()
    assert word in err
    assert "Traceback" not in err
    assert out == ""
    assert os.listdir() == []


def test_an_interrupt_leaves_nothing(monkeypatch, capsys):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    rate = {"median": 10.0, "min": 9.0, "max": 11.0}
    monkeypatch.setattr(bench, "copy_gb_per_s", lambda device, repeat: rate)  # takes two seconds
    monkeypatch.setattr(bench, "measure_scene", interrupted)
    assert run_isonoise("bench", "cornell", "--json", "a.json") == 130
    assert os.listdir() == []


def test_help_names_scenes_options_and_exit_codes(capsys):
    assert run_isonoise("bench", "--help") == 0
    out = capsys.readouterr().out
    for word in ("--against", "mesh-82k", "exit codes", "DRJIT_LIBLLVM_PATH", *bench.DEFAULT_SCENES):
        assert word in out


def test_a_generated_scene_is_a_closed_mesh(monkeypatch, capsys):
    triangles = {name: 2 * around * tube for name, (around, tube) in generated_scenes.GENERATED_SCENES.items()}
    assert triangles == {"mesh-82k": 81_920, "mesh-1.3m": 1_310_720}
    monkeypatch.setitem(generated_scenes.GENERATED_SCENES, "mesh-82k", (32, 20))
    assert generated_scenes.main(["mesh-82k", "generated"]) == 0
    scene = compile_scene(load_description(capsys.readouterr().out.strip()))
    assert len(scene.faces) == 2 * 32 * 20 + 2
    assert scene.environment is not None
    corners, faces = generated_scenes.bumpy_ring(32, 20)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)  # every edge once in each direction: closed and oriented
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    a, b, c = (corners[faces[:, k]].astype(float) for k in range(3))
    assert np.sum(a * np.cross(b, c)) > 0  # normals point outwards
    assert generated_scenes.main(["mesh-83k", "generated"]) == 2


def test_the_render_path_imports_no_benchmark():
    code = "import sys, isonoise.commands.render; print([m for m in sys.modules if 'benchmark' in m])"
    environment = os.environ | {"PYTHONPATH": str(Path(prepared_scene.__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.strip() == "[]", done.stderr
