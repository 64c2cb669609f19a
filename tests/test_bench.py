"""isonoise bench: what is measured adds up, what is written is what is documented, what is slower is said to be."""

import copy
import importlib.util
import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor, without

from isonoise.benchmark import embree, generated_scenes, peers, specialisation, startup, subject
from isonoise.benchmark.baseline import Earlier
from isonoise.benchmark.bounces import count_shadow_rays, count_tests, pools, timed_bounces
from isonoise.benchmark.bvh_stats import sah_cost, tree_facts
from isonoise.benchmark.measure import Settings, head, measure
from isonoise.benchmark.peers_text import peers_text
from isonoise.benchmark.subject import MeasuredDevice, Subject
from isonoise.benchmark.text import head_text, scene_text, summary_text
from isonoise.cli import main
from isonoise.commands import bench
from isonoise.scene import builtin_scenes, compile_scene, load
from isonoise.scene.accel.build import build_scene_bvh

CHECKOUT = Path(__file__).resolve().parent.parent
START = {"process_s": 1.0, "load_s": 0.1, "build_s": 0.01, "compile_s": 0.5}
STARTS = {"uncached": START, "cached": {name: {"median": s, "min": s, "max": s} for name, s in START.items()}}
SETTINGS = Settings(repeat=2, size=(24, 20), spp=8.5, pool_size=512)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def cornell():
    """The figures of a small `cornell`, all but the starts measured."""
    scene = compile_scene(load("cornell"), size=SETTINGS.size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isonoise.benchmark.measure.start_facts", lambda *arguments: STARTS)
        result = head(SETTINGS, MeasuredDevice())
        result["scenes"].append(measure("cornell", "cornell", scene, SETTINGS))
    return result


def small_subject(pool_size: int = 64, samples: int = 400, **scene) -> Subject:
    compiled = compile_scene(load(lamp_over_floor(**scene)))
    return Subject(compiled, MeasuredDevice(), samples, pool_size)


def isonoise(*arguments) -> int:
    """Exit code of a command, run in this process."""
    try:
        return main(list(arguments))
    except SystemExit as exit_:  # how argparse ends
        return exit_.code


def fields(value, path: str = "") -> set[str]:
    """The fields of a JSON object as host/docs/benchmarks.md names them; spreads and plain lists are one field."""
    if isinstance(value, dict) and set(value) != {"median", "min", "max"} and not path.endswith("buffers_bytes"):
        return set().union(*(fields(item, f"{path}.{name}" if path else name) for name, item in value.items()))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(fields(item, f"{path}[]") for item in value))
    return {path}


def documented() -> tuple[set[str], ...]:
    """Fields of the tables: of `isonoise bench`, and of it with --peers and with --specialisation."""
    text = (CHECKOUT / "host" / "docs" / "benchmarks.md").read_text()
    tables = text.split("| field | what it is |")[1:]
    rows = [re.findall(r"^\| (`.*?) \|", table.split("\n\n")[0], re.MULTILINE) for table in tables]
    return tuple(set(re.findall(r"`([^`]+)`", " ".join(names))) for names in rows)


def test_the_json_is_what_is_documented(cornell):
    assert fields(cornell) == documented()[0]


def test_what_is_counted_adds_up(cornell):
    (scene,) = cornell["scenes"]
    kernels = {row["kernel"]: row for row in scene["kernels"]}
    assert sum(row["share"] for row in scene["kernels"]) == pytest.approx(1)
    assert scene["samples"] == round(8.5 * 24 * 20) == kernels["generate"]["items"]
    rays = {row["kind"]: row["rays"] for row in scene["rays"]["kinds"]}
    bounces = scene["rays"]["bounces"]
    assert rays["camera"] == scene["samples"] == bounces[0]["rays"]
    assert rays["camera"] + rays["bounce"] == kernels["intersect"]["items"] == sum(row["rays"] for row in bounces)
    assert rays["shadow"] == sum(row["shadow_rays"] for row in bounces) > 0
    assert [row["depth"] for row in bounces] == list(range(1, 9))  # cornell's max_depth
    for before, row in pairwise(bounces):
        assert 0 < row["rays"] <= before["rays"]
        assert row["shadow_rays"] <= row["rays"]
    assert bounces[-1]["shadow_rays"] == 0  # light is sampled one vertex before the end
    for name in ("shade", "shadow"):
        assert {key: kernels[name][key] for key in ("launches", "items")} == {
            key: kernels["intersect"][key] for key in ("launches", "items")
        }
    for row in scene["kernels"]:
        time = row["time_s"]
        assert 0 < time["min"] <= time["median"] <= time["max"]
        assert row["ns_per_item"] == pytest.approx(1e9 * time["median"] / row["items"])
    tests = {row["kind"]: (row["node_tests_per_ray"], row["triangle_tests_per_ray"]) for row in scene["rays"]["kinds"]}
    assert tests["shadow"] == (None, None)
    for kind in ("camera", "bounce"):
        assert tests[kind] == (0, 36) or (tests[kind][0] >= 1 and tests[kind][1] > 0)
    launches = kernels["intersect"]["launches"]
    assert scene["occupancy"] == pytest.approx(kernels["intersect"]["items"] / (launches * 512))
    assert scene["occupancy"] > 0.5
    assert scene["run_s"]["median"] == pytest.approx(scene["samples"] / scene["samples_per_s"]["median"], rel=0.5)
    assert scene["busy_share"]["min"] > 0
    assert scene["busy_share"]["max"] <= 1


def test_bytes_of_a_path_are_those_of_the_kernels_readme(cornell):
    table = (CHECKOUT / "kernels" / "README.md").read_text()
    stated = {what: int(size) for what, size in re.findall(r"^\| (.*?) \| (\d+) a path", table, re.MULTILINE)}
    always = sum(
        size for what, size in stated.items() if what.startswith(("path state", "`hit`", "shadow ray", "`alive`"))
    )
    memory = cornell["scenes"][0]["memory"]
    assert memory["state_bytes_per_path"] == always
    assert memory["total_bytes"] == sum(memory["buffers_bytes"].values())


def test_every_run_traces_the_same_samples():
    measured = small_subject()
    measured.run(profile=False)
    first = measured.wavefront.accumulator.statistics()
    again = measured.run(profile=True)
    assert_same_bits(first, measured.wavefront.accumulator.statistics())
    assert measured.run(profile=False).kernels is None
    other = measured.run(profile=True)
    counts = [{name: (work.launches, work.items) for name, work in run.kernels.items()} for run in (again, other)]
    assert counts[0] == counts[1]


def test_bounces_are_those_of_the_run():
    """Another pool size makes other launches, but the same rays; and both passes over them see the same."""
    small, large = small_subject(pool_size=64), small_subject(pool_size=512)
    rays = [[bounce.rays for bounce in timed_bounces(each)] for each in (small, large)]
    assert rays[0] == rays[1]
    assert count_shadow_rays(small) == count_shadow_rays(large)
    assert sum(rays[0]) == small.run(profile=True).kernels["intersect"].items


def test_tests_are_those_of_the_rays_of_a_run():
    """What one ray is tested against is in test_intersection.py. Here sums are bounded, and no pool changes them."""
    vertices, faces = generated_scenes.bumpy_ring(12, 8)
    ring = {"type": "mesh", "vertices": 0.3 * vertices + [0, 0, 0.3], "faces": faces}
    compiled = compile_scene(load(lamp_over_floor() | {"ring": ring}))
    sums = []
    for pool_size in (64, 512):
        measured = Subject(compiled, MeasuredDevice(), 700, pool_size)
        rays = [bounce.rays for bounce in timed_bounces(measured)]
        before = measured.device.bytes_of.total()
        sums.append(count_tests(measured, rays))
        assert measured.device.bytes_of.total() == before
        assert [bounce.rays for bounce in sums[-1]] == rays
    assert sums[0] == sums[1]
    nodes, blocks = len(measured.bvh.nodes), len(measured.bvh.blocks)
    for bounce in sums[0]:
        assert bounce.rays < bounce.nodes < bounce.rays * nodes
        assert bounce.triangles % 8 == 0
        assert 0 < bounce.triangles < 8 * bounce.rays * blocks


def test_where_there_is_no_hierarchy_every_ray_meets_all_triangles():
    measured = small_subject()
    measured.wavefront.brute_force = True
    assert [(bounce.nodes, bounce.triangles) for bounce in count_tests(measured, [400, 100])] == [(0, 1600), (0, 400)]


def test_without_light_there_are_no_shadow_rays():
    scene = compile_scene(load(without(lamp_over_floor(), "lamp")))
    assert count_shadow_rays(Subject(scene, MeasuredDevice(), 35, 64)) == []


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
def test_pools_cut_a_map_in_order(size):
    allocation = np.array([[3, 0, 5], [0, 11, 1]], np.uint32)
    cut = list(pools(allocation, size))
    assert sum(piece.astype(int) for piece in cut).tolist() == allocation.tolist()
    assert [int(piece.sum()) for piece in cut] == [size] * (20 // size) + [20 % size] * bool(20 % size)
    order = [np.repeat(np.arange(6), piece.ravel()) for piece in cut]
    assert (np.diff(np.concatenate(order)) >= 0).all()


def test_sah_cost_is_what_random_lines_visit():
    """Boxes of `cornell` met by lines that are uniform over those through a sphere around it."""
    scene = compile_scene(load("cornell"))
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

    def met(low, high) -> np.ndarray:
        near, far = (low - point) / direction, (high - point) / direction
        return np.minimum(near, far).max(axis=1) <= np.maximum(near, far).min(axis=1)

    through = met(*root)
    visits = 1 + sum(met(low, high)[through].mean() for low, high in zip(lower, upper, strict=True))
    # boxes met by a line scatter by about 2.5: a standard error of 0.01 with the 60,000 lines that meet the root
    assert sah_cost(bvh, scene) == pytest.approx(visits, abs=0.05)


def test_sah_cost_of_instances():
    """Two unit balls in a box of 8x2x2: half areas 12, 12, 36; a visit to one costs its group's root and its leaf."""
    ball = {"type": "shapegroup", "ball": {"type": "sphere"}}
    moved = [np.eye(4), np.eye(4)]
    moved[0][0, 3], moved[1][0, 3] = -3, 3
    scene = {"type": "scene", "sensor": {"type": "perspective"}, "group": ball}
    for number, matrix in enumerate(moved):
        scene[f"i{number}"] = {"type": "instance", "to_world": matrix, "group": {"type": "ref", "id": "group"}}
    compiled = compile_scene(load(scene))
    facts = tree_facts(build_scene_bvh(compiled), compiled)
    assert facts["sah_cost"] == pytest.approx(1 + 2 * 12 / 36 * (1 + 2), rel=1e-4)
    assert facts["leaves"] == 3  # one ball, two instances of it
    assert facts["triangles_per_block"] is None


def test_starts_are_processes_of_their_own(monkeypatch):
    asked = []

    def process(command, env, **options):
        folder = Path(env["POCL_CACHE_DIR"])
        asked.append((command[3:], folder, list(folder.iterdir())))
        (folder / "compiled").touch()
        return subprocess.CompletedProcess(command, 0, json.dumps({"setup_s": {"load": 1, "build": 2, "compile": 3}}))

    monkeypatch.setattr(startup.subprocess, "run", process)
    settings = Settings(size=(5, 4), max_depth=3, device="0")
    facts = startup.start_facts("cornell", settings.render_options(), 2)
    assert len(asked) == 3
    assert [len(held) for _, _, held in asked] == [0, 1, 1]  # the first finds nothing compiled
    for word in ("render", "cornell", "--size", "5x4", "--max-depth", "3", "--device", "0"):
        assert word in asked[0][0]
    assert not asked[0][1].exists()
    assert facts["uncached"]["compile_s"] == 3
    assert facts["cached"]["load_s"] == {"median": 1, "min": 1, "max": 1}


@pytest.mark.long
def test_a_start_without_compiled_programs_takes_longer():
    facts = startup.start_facts("cornell", ["--size", "16x16"], 1)
    assert facts["uncached"]["process_s"] > facts["cached"]["process_s"]["median"] > 0


def test_what_a_person_reads(cornell):
    two = cornell | {"scenes": cornell["scenes"] * 2}
    text = head_text(cornell) + scene_text(cornell["scenes"][0]) + summary_text(two)
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
    ):
        assert word in text
    assert summary_text(cornell) == ""
    assert "keep the machine busy" in head_text(cornell | {"load_average": 1e3})


# --against


@pytest.fixture
def measured(cornell, monkeypatch):
    """`isonoise bench` without the measuring: figures that a test may change."""
    figures = copy.deepcopy(cornell["scenes"][0])
    for figure in (figures["samples_per_s"], *(row["time_s"] for row in figures["kernels"])):
        figure["min"] = figure["max"] = figure["median"]
    monkeypatch.setattr(bench, "measure", lambda *arguments: copy.deepcopy(figures))
    assert isonoise("bench", "cornell", *COMMAND, "--json", "before.json") == 0
    return figures


COMMAND = ("--size", "24x20", "--spp", "8.5")


def slow_down(figures: dict, kernel: str, factor: float, share: float) -> None:
    row = next(row for row in figures["kernels"] if row["kernel"] == kernel)
    row["share"] = share
    scale(row["time_s"], factor)


def scale(figure: dict, factor: float) -> None:
    for name in figure:
        figure[name] *= factor


def test_nothing_is_slower_than_itself(measured, capsys):
    assert isonoise("bench", "cornell", *COMMAND, "--against", "before.json", "--json", "now.json") == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "1.000" in out
    assert json.loads(Path("now.json").read_text())["scenes"] == json.loads(Path("before.json").read_text())["scenes"]


@pytest.mark.parametrize(("threshold", "code"), [((), 1), (("--threshold", "0.75"), 0)])
def test_fewer_samples_a_second_are_slower(measured, capsys, threshold, code):
    scale(measured["samples_per_s"], 0.8)
    assert isonoise("bench", "cornell", *COMMAND, "--against", "before.json", *threshold) == code
    out, err = capsys.readouterr()
    assert ("cornell samples/s 0.800" in err) == bool(code)
    assert "0.800" in out


@pytest.mark.parametrize(("best", "code"), [(0.99, 1), (1.01, 0)])
def test_what_the_spread_cannot_tell_is_not_slower(measured, capsys, best, code):
    """One repeat of five may have been as fast as before."""
    before = measured["samples_per_s"]["median"]
    scale(measured["samples_per_s"], 0.8)
    measured["samples_per_s"]["max"] = best * before
    assert isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == code
    assert ("within the spread" in capsys.readouterr().out) != bool(code)


@pytest.mark.parametrize(("share", "code"), [(0.06, 1), (0.04, 0)])
def test_a_slower_kernel_counts_if_it_matters(measured, capsys, share, code):
    for path in (measured, content := json.loads(Path("before.json").read_text())):
        scene = path if path is measured else content["scenes"][0]
        slow_down(scene, "reduce", 1.0, 0.04)
    Path("before.json").write_text(json.dumps(content))
    slow_down(measured, "reduce", 1.25, share)
    assert isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == code
    out, err = capsys.readouterr()
    assert ("cornell kernel reduce 0.800" in err) == bool(code)
    assert "0.800" in out


def test_kernels_come_and_go(measured, capsys):
    for row in measured["kernels"]:
        row["kernel"] = row["kernel"].replace("count_alive", "count_more")
    assert isonoise("bench", "cornell", *COMMAND, "--against", "before.json") == 0
    out = capsys.readouterr().out
    assert re.search(r"count_more +was not there before", out)
    assert re.search(r"count_alive +is not there any more", out)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("cornell", "--size", "24x21", "--spp", "8.5"), "height 20 in 'before.json' and 21 now; give the same --size"),
        (("cornell", "--size", "24x20"), "give the same --spp"),
        (("cornell", *COMMAND, "--max-depth", "3"), "give the same --max-depth"),
        (("penumbra", *COMMAND), "has no scene penumbra; it has: cornell"),
    ],
)
def test_other_settings_are_not_compared(measured, capsys, options, word):
    assert isonoise("bench", *options, "--against", "before.json", "--json", "now.json") == 2
    assert word in capsys.readouterr().err
    assert os.listdir() == ["before.json"]


def test_other_scenes_and_devices_are_not_compared(measured, capsys):
    content = json.loads(Path("before.json").read_text())
    changed = copy.deepcopy(content)
    changed["scenes"][0]["scene_hash"] = "0" * 32
    Path("scene.json").write_text(json.dumps(changed))
    assert isonoise("bench", "cornell", *COMMAND, "--against", "scene.json") == 2
    assert "the scene itself has changed" in capsys.readouterr().err
    content["device"]["name"] = "Abacus 9000"
    Path("device.json").write_text(json.dumps(content))
    assert isonoise("bench", "cornell", *COMMAND, "--against", "device.json") == 2
    assert "was measured on Abacus 9000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (None, "cannot read"),
        ("{", "no JSON"),
        ("[]", "was not written by"),
        ('{"schema": "isonoise-peers"}', "was not written by"),
        ('{"schema": "isonoise-bench", "schema_version": 99}', "version 99"),
        ('{"schema": "isonoise-bench", "schema_version": 1}', "damaged"),
        ('{"schema": "isonoise-bench", "schema_version": 1, "scenes": 7}', "damaged"),
        ('{"schema": "isonoise-bench", "schema_version": 1, "scenes": [], "device": {}}', "damaged"),
    ],
)
def test_files_that_nothing_can_be_compared_with(capsys, content, word):
    if content is not None:
        Path("x.json").write_text(content)
    assert isonoise("bench", "cornell", "--against", "x.json") == 2
    out, err = capsys.readouterr()
    assert word in err
    assert "x.json" in err
    assert "Traceback" not in err
    assert out == ""


@pytest.mark.parametrize("path", ["samples_per_s", "kernels"])
def test_damage_is_found_where_it_is_read(cornell, path):
    content = copy.deepcopy(cornell)
    content["scenes"][0][path] = {"median": 0} if path == "samples_per_s" else [{}]
    Path("x.json").write_text(json.dumps(content))
    with pytest.raises(Exception, match=r"'x\.json' is damaged"):
        Earlier("x.json").compare(cornell)


# the command


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("cornel",), "did you mean 'cornell'"),
        (("cornell", "--json", "missing/a.json"), "there is no folder"),
        (("cornell", "--threshold", "0.5"), "--against"),
        (("cornell", "--peers", "--against", "a.json"), "without --peers"),
        (("cornell", "--repeat", "0"), "must be 1 or more"),
        (("cornell", "--device", "no such device"), "no OpenCL device matches"),
    ],
)
def test_mistakes_are_told(capsys, options, word):
    assert isonoise("bench", *options) == 2
    out, err = capsys.readouterr()
    assert word in err
    assert "Traceback" not in err
    assert out == ""
    assert os.listdir() == []


def test_an_interrupt_leaves_nothing(monkeypatch, capsys):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(bench, "measure", interrupted)
    assert isonoise("bench", "cornell", "--json", "a.json") == 130
    assert os.listdir() == []


def test_help_says_what_there_is(capsys):
    assert isonoise("bench", "--help") == 0
    out = capsys.readouterr().out
    for word in ("--against", "mesh-82k", "exit codes", "DRJIT_LIBLLVM_PATH", *bench.DEFAULT_SCENES):
        assert word in out


# made scenes


def test_a_made_scene_is_a_closed_mesh(monkeypatch, capsys):
    triangles = {name: 2 * around * tube for name, (around, tube) in generated_scenes.MADE_SCENES.items()}
    assert triangles == {"mesh-82k": 81_920, "mesh-1.3m": 1_310_720}
    monkeypatch.setitem(generated_scenes.MADE_SCENES, "mesh-82k", (32, 20))
    assert generated_scenes.main(["mesh-82k", "made"]) == 0
    scene = compile_scene(load(capsys.readouterr().out.strip()))
    assert len(scene.faces) == 2 * 32 * 20 + 2
    assert scene.environment is not None
    corners, faces = generated_scenes.bumpy_ring(32, 20)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)  # every edge once a direction: closed, with one outside
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    a, b, c = (corners[faces[:, k]].astype(float) for k in range(3))
    assert np.sum(a * np.cross(b, c)) > 0  # normals point outwards
    assert generated_scenes.main(["mesh-83k", "made"]) == 2


# peers


class FakeMitsuba:
    variant = "scalar_rgb"

    def __init__(self, name, xml, pixels):
        assert 'type="independent"' in xml

    def render(self, spp, seed):
        return np.ones((10, 12, 3), np.float32), 0.5

    def close(self):
        pass


class FakeEmbree(embree.IntersectStage):
    """Our own stage once more, in the place of Embree."""

    def __init__(self, scene):
        super().__init__(MeasuredDevice(), scene)

    def trace(self):
        seconds = super().trace()
        self.triangles = self.hits()[1].view(np.int32)
        return seconds


def test_peers_take_turns(monkeypatch, capsys):
    monkeypatch.setattr(peers, "MitsubaWorker", FakeMitsuba)
    monkeypatch.setattr(embree, "EmbreeMesh", FakeEmbree)
    monkeypatch.setattr(embree, "RAYS", 1024)
    monkeypatch.setattr(peers, "version", lambda package: "9.9")
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda package: True)
    options = ("--peers", "--size", "12x10", "--spp", "3", "--repeat", "2", "--json", "peers.json")
    assert isonoise("bench", "cornell", *options) == 0
    result = json.loads(Path("peers.json").read_text())
    assert fields(result) == documented()[1]
    (scene,), (mesh,) = result["scenes"], result["meshes"]
    assert scene["samples"] == 360
    assert scene["mitsuba_samples_per_s"] == {"median": 720, "min": 720, "max": 720}
    assert scene["ratio"]["max"] == pytest.approx(scene["samples_per_s"]["max"] / 720)
    coherent, incoherent = mesh["rays"]
    assert (coherent["kind"], coherent["rays"], coherent["hit_share"]) == ("coherent", 1024, 1.0)
    assert incoherent["rays"] == 1024
    assert 0.5 < incoherent["hit_share"] < 1
    assert coherent["same_triangle_share"] == incoherent["same_triangle_share"] == 1
    out = capsys.readouterr().out
    assert "DRJIT_LIBLLVM_PATH" in out  # the variant is a slow one
    assert peers_text(result) in out


def test_missing_peers_are_named(monkeypatch, capsys):
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda package: None if package == "embreex" else True)
    assert isonoise("bench", "cornell", "--peers") == 2
    assert "needs Embree: pip install 'isonoise[peers]'" in capsys.readouterr().err


def test_embree_meets_the_same_triangles(monkeypatch):
    if importlib.util.find_spec("embreex") is None:
        pytest.skip("embreex is in the extra 'peers'")
    monkeypatch.setattr(embree, "RAYS", 4096)
    scene = compile_scene(load("cornell"))
    facts = embree.measure_rays("cornell", scene, MeasuredDevice(), 1, lambda done, what: None)
    for row in facts["rays"]:
        assert row["same_triangle_share"] > 0.99  # the rest meets an edge, where either is right


def test_bounced_rays_are_diffuse():
    """The mean cosine to the normal is 2/3 with a variance of 1/18: 4 standard errors."""
    scene = compile_scene(load(lamp_over_floor()))
    floor = np.flatnonzero(scene.triangle_shape == 0)[0]
    number = 20_000
    origins, directions = np.tile([0.1, -0.2, 5.0], (number, 1)), np.tile([0.0, 0.0, -1.0], (number, 1))
    triangle = np.full(number, floor, np.uint32)
    begins, leave = embree.bounced_rays(scene, origins, directions, np.full(number, 5.0), triangle)
    assert np.linalg.norm(leave, axis=1) == pytest.approx(1)
    assert leave[:, 2].mean() == pytest.approx(2 / 3, abs=4 * (1 / 18 / number) ** 0.5)
    assert np.abs(leave[:, :2].mean(axis=0)).max() < 4 * (0.25 / number) ** 0.5
    assert (begins[:, 2] > 0).all()
    assert begins[:, 2].max() < 1e-2


# specialisation


def test_what_is_built_in_is_told_from_what_is_used(monkeypatch, capsys):
    """With two features more than the scene uses, in place of all that there are."""
    more = {"DIELECTRIC": True, "INSTANCES": True}
    monkeypatch.setattr(specialisation, "feature_superset", lambda used, volpath: used | more)
    monkeypatch.setattr(specialisation, "compile_seconds", lambda source, build, settings: 1.5)
    options = ("--specialisation", "--size", "12x10", "--spp", "3", "--repeat", "2", "--json", "special.json")
    assert isonoise("bench", "cornell", *options) == 0
    result = json.loads(Path("special.json").read_text())
    assert fields(result) == documented()[2]
    special, *others = result["scenes"][0]["builds"]
    assert [special["build"], *(build["build"] for build in others)] == ["specialised", "path", "everything"]
    assert special["specialised_ratio"] == {"median": 1, "min": 1, "max": 1}
    for build in others:
        assert build["features"] == special["features"] + len(more)
        assert build["state_bytes_per_path"] == special["state_bytes_per_path"] + 8
        assert build["total_bytes"] > special["total_bytes"]
        assert build["launches"] == special["launches"] > 0
        assert build["same_bits"]
        assert build["largest_difference"] == 0
    out = capsys.readouterr().out
    assert "the same bits" in out
    assert "192" in out


def test_other_pictures_are_not_the_same_bits():
    one, other = small_subject(), small_subject(radiance=6.0)
    images = []
    for each in (one, other):
        each.run(profile=False)
        images.append(each.wavefront.accumulator.statistics())
    facts = specialisation._difference(*images)
    assert not facts["same_bits"]
    assert facts["largest_difference"] == pytest.approx(1 / 6, rel=1e-5)


@pytest.mark.parametrize(
    ("integrator", "more", "names"),
    [
        ("path", {}, ["specialised", "path", "everything"]),
        ("path", {"pane": {"type": "rectangle", "bsdf": {"type": "null"}}}, ["specialised", "path"]),
        ("volpath", {"pane": {"type": "rectangle", "bsdf": {"type": "null"}}}, ["specialised", "everything"]),
    ],
)
def test_programs_that_a_scene_is_measured_with(integrator, more, names):
    scene = lamp_over_floor() | more
    scene["integrator"] = scene["integrator"] | {"type": integrator}
    assert list(specialisation.builds(compile_scene(load(scene)))) == names


def test_programs_are_compiled_in_processes_of_their_own(monkeypatch):
    asked = []

    def process(command, env, **options):
        asked.append((command[2:5], json.loads(command[5]), list(Path(env["POCL_CACHE_DIR"]).iterdir())))
        return subprocess.CompletedProcess(command, 0, "2.5\n")

    monkeypatch.setattr(specialisation.subprocess, "run", process)
    assert specialisation.compile_seconds("cornell", "path", Settings(size=(5, 4))) == 2.5
    ((words, settings, held),) = asked
    assert words == ["isonoise.benchmark.specialisation", "cornell", "path"]
    assert settings["size"] == [5, 4]
    assert held == []


@pytest.mark.long
@pytest.mark.parametrize("name", builtin_scenes())
def test_specialised_is_faster_and_smaller(name):
    result = specialisation.measure_specialisation({name: name}, Settings(repeat=5))
    special, *others = result["scenes"][0]["builds"]
    for build in others:
        assert build["specialised_ratio"]["median"] >= 0.98
        assert build["state_bytes_per_path"] > special["state_bytes_per_path"]
        assert build["total_bytes"] > special["total_bytes"]
        assert build["same_bits"]


def test_the_render_path_imports_no_benchmark():
    code = "import sys, isonoise.commands.render; print([m for m in sys.modules if 'benchmark' in m])"
    environment = os.environ | {"PYTHONPATH": str(Path(subject.__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.strip() == "[]", done.stderr
