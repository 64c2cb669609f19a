"""`isonoise bench --peers` and --specialisation: all programs trace the same samples and rays, in turn."""

import importlib.util
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from bench_command import documented_fields, json_fields, run_isonoise, small_prepared_scene
from small_scene import lamp_over_floor

from isonoise.benchmark import embree, peers, specialisation, startup
from isonoise.benchmark.measure import Settings
from isonoise.benchmark.prepared_scene import MeasuredDevice
from isonoise.benchmark.report_text import peers_text
from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.statistics import BASIC_NEEDS

pytestmark = pytest.mark.usefixtures("in_tmp_path")


class FakeMitsuba:
    variant = "scalar_rgb"

    def __init__(self, name, xml, pixels):
        assert 'type="independent"' in xml

    def render(self, spp, seed):
        return np.ones((10, 12, 3), np.float32), 0.5

    def close(self):
        pass


class FakeEmbree(embree.IntersectStage):
    """isonoise's stage `intersect` in place of Embree."""

    def __init__(self, scene):
        super().__init__(MeasuredDevice(), scene)

    def trace(self):
        seconds = super().trace()
        self.triangles = self.hits()[1].view(np.int32)
        self.seconds = seconds
        return seconds

    def call_overhead(self):
        return self.seconds / 4


def test_peers_report(monkeypatch, capsys):
    monkeypatch.setattr(peers, "MitsubaWorker", FakeMitsuba)
    monkeypatch.setattr(embree, "EmbreeMesh", FakeEmbree)
    monkeypatch.setattr(embree, "MAX_RAYS", 1024)
    monkeypatch.setattr(peers, "version", lambda package: "9.9")
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda package: True)
    options = ("--peers", "--size", "12x10", "--spp", "3", "--repeat", "2", "--json", "peers.json")
    assert run_isonoise("bench", "cornell", *options) == 0
    result = json.loads(Path("peers.json").read_text())
    assert json_fields(result) == documented_fields()[2]
    (scene,), (mesh,) = result["scenes"], result["meshes"]
    assert scene["samples"] == 360
    assert scene["mitsuba_samples_per_s"] == {"median": 720, "min": 720, "max": 720}
    assert scene["speedup"]["max"] == pytest.approx(scene["samples_per_s"]["max"] / 720)
    coherent, incoherent = mesh["rays"]
    assert (coherent["kind"], coherent["rays"], coherent["hit_share"]) == ("coherent", 1024, 1.0)
    assert incoherent["rays"] == 1024
    assert 0.5 < incoherent["hit_share"] < 1
    assert coherent["same_triangle_share"] == incoherent["same_triangle_share"] == 1
    assert coherent["embree_overhead_share"]["median"] == pytest.approx(0.25)
    cores = result["device"]["compute_units"]
    assert coherent["speedup_per_core"]["max"] == pytest.approx(0.75 * coherent["speedup"]["max"] / cores)
    out = capsys.readouterr().out
    assert "DRJIT_LIBLLVM_PATH" in out  # because the variant is scalar
    assert peers_text(result) in out


def test_missing_peers_are_named(monkeypatch, capsys):
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda package: None if package == "embreex" else True)
    assert run_isonoise("bench", "cornell", "--peers") == 2
    assert "needs Embree: pip install 'isonoise[peers]'" in capsys.readouterr().err


def test_embree_hits_the_same_triangles(monkeypatch):
    if importlib.util.find_spec("embreex") is None:
        pytest.skip("embreex is in the extra 'peers'")
    monkeypatch.setattr(embree, "MAX_RAYS", 4096)
    scene = compile_scene(load_description("cornell"))
    difference = embree.measure_rays("cornell", scene, MeasuredDevice(), 1, lambda done, what: None)
    for row in difference["rays"]:
        assert row["same_triangle_share"] > 0.99  # the rest hits an edge, where both are right


def test_bounced_rays_are_diffuse():
    """The mean cosine to the normal is 2/3 with a variance of 1/18: 4 standard errors."""
    scene = compile_scene(load_description(lamp_over_floor()))
    floor = np.flatnonzero(scene.triangle_shape == 0)[0]
    number = 20_000
    origins, directions = np.tile([0.1, -0.2, 5.0], (number, 1)), np.tile([0.0, 0.0, -1.0], (number, 1))
    triangle = np.full(number, floor, np.uint32)
    bounce_origins, bounce_directions = embree.bounced_rays(scene, origins, directions, np.full(number, 5.0), triangle)
    assert np.linalg.norm(bounce_directions, axis=1) == pytest.approx(1)
    assert bounce_directions[:, 2].mean() == pytest.approx(2 / 3, abs=4 * (1 / 18 / number) ** 0.5)
    assert np.abs(bounce_directions[:, :2].mean(axis=0)).max() < 4 * (0.25 / number) ** 0.5
    assert (bounce_origins[:, 2] > 0).all()
    assert bounce_origins[:, 2].max() < 1e-2


@pytest.mark.long
def test_specialisation_report(monkeypatch, capsys):
    """The larger programs have two more features, in place of all features."""
    more = {"DIELECTRIC": True, "INSTANCES": True}
    monkeypatch.setattr(specialisation, "feature_superset", lambda used, volpath: used | more)
    monkeypatch.setattr(specialisation, "ALL_STATISTICS", BASIC_NEEDS)
    monkeypatch.setattr(specialisation, "compile_seconds", lambda source, build, settings: 1.5)
    options = ("--specialisation", "--size", "12x10", "--spp", "3", "--repeat", "2", "--json", "special.json")
    assert run_isonoise("bench", "cornell", *options) == 0
    result = json.loads(Path("special.json").read_text())
    assert json_fields(result) == documented_fields()[3]
    special, *others = result["scenes"][0]["programs"]
    assert [special["program"], *(build["program"] for build in others)] == ["specialised", "all-path", "all-volpath"]
    assert special["specialised_speedup"] == {"median": 1, "min": 1, "max": 1}
    for build in others:
        assert build["feature_count"] == special["feature_count"] + len(more)
        assert build["state_bytes_per_path"] == special["state_bytes_per_path"] + 4
        assert build["total_bytes"] > special["total_bytes"]
        assert build["launches"] == special["launches"] > 0
        assert build["bit_identical"]
        assert build["max_relative_difference"] == 0
    out = capsys.readouterr().out
    assert "the same bits" in out
    assert "132" in out


def test_different_images_are_not_bit_identical():
    one, other = small_prepared_scene(), small_prepared_scene(radiance=6.0)
    images = []
    for each in (one, other):
        each.run(profile=False)
        images.append(each.wavefront.accumulator.statistics())
    difference = specialisation.image_difference(*images)
    assert not difference["bit_identical"]
    assert difference["max_relative_difference"] == pytest.approx(1 / 6, rel=1e-5)


@pytest.mark.parametrize(
    ("integrator", "more", "names"),
    [
        ("path", {}, ["specialised", "all-path", "all-volpath"]),
        ("path", {"pane": {"type": "rectangle", "bsdf": {"type": "null"}}}, ["specialised", "all-path"]),
        ("volpath", {"pane": {"type": "rectangle", "bsdf": {"type": "null"}}}, ["specialised", "all-volpath"]),
    ],
)
def test_programs_of_a_scene(integrator, more, names):
    scene = lamp_over_floor() | more
    scene["integrator"] = scene["integrator"] | {"type": integrator}
    assert list(specialisation.programs(compile_scene(load_description(scene)))) == names


def test_compilation_is_timed_in_a_process_with_empty_caches(monkeypatch):
    started = []

    def process(command, env, **options):
        started.append((command[2:5], json.loads(command[5]), list(Path(env["POCL_CACHE_DIR"]).iterdir())))
        return subprocess.CompletedProcess(command, 0, "2.5\n")

    monkeypatch.setattr(startup.subprocess, "run", process)
    assert specialisation.compile_seconds("cornell", "path", Settings(size=(5, 4))) == 2.5
    ((words, settings, cached),) = started
    assert words == ["isonoise.benchmark.specialisation", "cornell", "path"]
    assert settings["size"] == [5, 4]
    assert cached == []


@pytest.mark.long
@pytest.mark.parametrize("name", builtin_scenes())
def test_specialised_programs_are_faster_and_smaller(name):
    result = specialisation.measure_specialisation({name: name}, Settings(repeat=5))
    special, *others = result["scenes"][0]["programs"]
    for build in others:
        assert build["specialised_speedup"]["median"] >= 0.98
        assert build["state_bytes_per_path"] > special["state_bytes_per_path"]
        assert build["total_bytes"] > special["total_bytes"]
        assert build["bit_identical"]
