"""Features: every two build and run, and leave pictures as they are."""

from pathlib import Path

import pytest
from feature_sets import all_but, covering_rows, is_closed, needs_of, only, pairs_of, possible_pairs, scene_with
from small_scene import assert_same_bits

from isonoise.device.opencl import Device
from isonoise.device.program import stage_source
from isonoise.integrator.accumulator import build_constants
from isonoise.integrator.brute_force import MAX_CORNERS
from isonoise.integrator.feature_superset import feature_superset
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import CONSTANTS, STRUCTS, kernel_table
from isonoise.integrator.wavefront import Wavefront
from isonoise.scene import builtin_scenes, compile_scene, load
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.scene.light import light_list
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics
from isonoise.strategies.uniform_allocation import uniform_allocation

EVERY_STATISTIC = Needs(median=True, batch=4, power=2.0, half=True)


@pytest.fixture(scope="module")
def device():
    return Device()


# Every two features build and run.


def rendered(
    device: Device, scene: CompiledScene, spp: int, needs: Needs = BASIC_NEEDS, feature_override=None
) -> Statistics:
    """The statistics of a uniform wave; every kernel has been launched on nothing before."""
    pool_size = min(2**17, scene.width * scene.height * spp)
    wavefront = Wavefront(
        device, scene, build_scene_bvh(scene), needs, pool_size=pool_size, feature_override=feature_override
    )
    wavefront.warm_up()
    wavefront.trace(uniform_allocation((scene.height, scene.width), spp * scene.height * scene.width, 0))
    return wavefront.accumulator.statistics(scene.radiance_scale)


def runs_as_specialised(device: Device, monkeypatch, row: dict[str, bool], folder: Path, of_scene=None) -> None:
    """The program with the features of `row` builds without warnings and all its kernels run. The picture of a scene
    that uses what it can of them is, to the bit, that of the program with what the scene uses alone; with UVS if the
    row has them, since they may turn the lobes of rough materials about their normals. `of_scene`: the features that
    the scene uses, if it is not to use all that it can.
    """
    build = Device.build
    monkeypatch.setattr(Device, "build", lambda self, text, options: build(self, text, (*options, "-Werror")))
    scene, needs = compile_scene(load(scene_with(of_scene or row, folder))), needs_of(row)
    used = features(scene, needs) | {name: row[name] for name in ("LIGHT_TREE", "LIGHT_LIST", "UVS")}
    for name in ("MANY_LIGHTS", "NEXT_EVENT"):  # without which there is neither tree nor list
        used[name] |= row["LIGHT_TREE"] or row["LIGHT_LIST"]
    assert {name for name, on in used.items() if on} <= {name for name, on in row.items() if on}
    more, specialised = (rendered(device, scene, 16, needs, feature_override) for feature_override in (row, used))
    assert_same_bits(more, specialised)
    monkeypatch.setattr(Device, "build", build)


def test_few_rows_hold_every_two_features():
    """On and on, on and off, off and off: all that a scene can have."""
    rows, found = covering_rows(), set()
    assert len(rows) < 30
    for row in rows:
        assert is_closed({name for name, on in row.items() if on})
        found |= pairs_of(row)
    missing = possible_pairs()
    names = sorted(FEATURES)
    assert {(a, True, b, True) for a in names for b in names if a < b} <= missing
    impossible = 4 * len(names) * (len(names) - 1) // 2 - len(missing)
    needed = sum(len(only(name)) and sum(only(name).values()) - 1 for name in names)
    assert impossible <= needed  # a feature on without one that it cannot be without
    assert missing <= found


def test_none_run(device, monkeypatch, tmp_path):
    runs_as_specialised(device, monkeypatch, only(), tmp_path)


@pytest.mark.long
def test_all_run_a_scene_of_few(device, monkeypatch, tmp_path):
    """All that change nothing, in the programs that take many paths a work-item."""
    few = only("SPHERES", "TRIANGLES", "DIFFUSE", "CONDUCTOR", "NEXT_EVENT", "CONSTANT_LIGHT", "RUSSIAN_ROULETTE")
    row = all_but("LIGHT_TREE", "LIGHT_LIST", "HIDE_EMITTERS", "FILTER_TABLE", "VOLPATH")
    runs_as_specialised(device, monkeypatch, row, tmp_path, few)


@pytest.mark.parametrize(("lanes", "off"), [(1, ()), (64, ("VOLPATH",))])
def test_all_build(device, lanes, off):
    """What launches them takes twice as long, and is among the long tests."""
    constants = CONSTANTS | build_constants(EVERY_STATISTIC)
    constants |= {"LANES": lanes, "PATHS_PER_BLOCK": 64}
    constants |= {"MAX_CORNERS": MAX_CORNERS, "MAX_LISTED_LIGHTS": light_list.MAX_LISTED_LIGHTS}
    for few in (False, True):
        for file in dict.fromkeys(row.file for row in kernel_table(all_but(*off), few).values()):
            text, options = stage_source(file, STRUCTS, constants, all_but(*off), generated_headers())
            device.build(text, (*options, "-Werror"))


@pytest.mark.long
@pytest.mark.parametrize("off", [(), ("VOLPATH",)])
def test_all_run(device, monkeypatch, tmp_path, off):
    runs_as_specialised(device, monkeypatch, all_but(*off), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", FEATURES)
def test_each_alone_runs(device, monkeypatch, tmp_path, name):
    runs_as_specialised(device, monkeypatch, only(name), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(covering_rows())))
def test_every_two_run(device, monkeypatch, tmp_path, number):
    runs_as_specialised(device, monkeypatch, covering_rows()[number], tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", builtin_scenes())
@pytest.mark.parametrize("volpath", [False, True])
def test_everything_on_is_the_same_picture(device, name, volpath):
    """To the bit, of 64 samples in each of 65,536 pixels: no compiler may reorder what is built without leave to."""
    scene = compile_scene(load(name))
    feature_override = feature_superset(features(scene), volpath)
    full = rendered(device, scene, 64, EVERY_STATISTIC, feature_override)
    specialised = rendered(device, scene, 64, EVERY_STATISTIC)
    assert_same_bits(full, specialised)
