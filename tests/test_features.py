"""Features: every pair builds and runs, and features that a scene does not use change no bit of its image."""

from pathlib import Path

import pytest
from feature_sets import (
    PARTS,
    all_but,
    covering_rows,
    is_closed,
    needs_of,
    only,
    pairs_of,
    part_of_rows,
    possible_pairs,
    scene_with,
)
from small_scene import assert_same_bits

from isonoise.device.form import FORMS
from isonoise.device.opencl import Device
from isonoise.device.program import stage_source
from isonoise.integrator.build_constants import build_constants
from isonoise.integrator.feature_superset import feature_superset
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.generated_headers import generated_headers
from isonoise.integrator.kernel_table import STRUCTS, kernel_table
from isonoise.integrator.wavefront import Wavefront
from isonoise.layers import LAYERS, device_layers
from isonoise.scene import builtin_scenes, compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics
from isonoise.strategies.uniform_allocation import uniform_allocation

KEPT_FEATURES = ("LIGHT_TREE", "LIGHT_LIST", "UVS", "SOBOL")
"""Features that select another method. UVS may rotate the lobes of rough materials."""
EVERY_STATISTIC = Needs(
    median=True, batch=4, power=2.0, half=True, neighbours=5, nets=True, layers=device_layers(LAYERS)
)


@pytest.fixture(scope="module")
def device():
    return Device()


# Every pair of features builds and runs.


def render_wave(
    device: Device, scene: CompiledScene, spp: int, needs: Needs = BASIC_NEEDS, feature_override=None
) -> Statistics:
    """Returns the statistics of a uniform wave, after a warm-up."""
    pool_size = min(2**17, scene.width * scene.height * spp)
    wavefront = Wavefront(
        device, scene, build_scene_bvh(scene), needs, pool_size=pool_size, feature_override=feature_override
    )
    wavefront.warm_up()
    wavefront.trace(uniform_allocation((scene.height, scene.width), spp * scene.height * scene.width, 0))
    return wavefront.accumulator.statistics(scene.radiance_scale)


def assert_runs_as_specialised(
    device: Device, monkeypatch, row: dict[str, bool], folder: Path, scene_features=None
) -> None:
    """Asserts that the program with the features of `row` builds without warnings, and that all its kernels run.

    The image of a scene that uses these features has the same bits as that of the program with the features that the
    scene uses, and those of KEPT_FEATURES that `row` has. `scene_features`: the features that the scene may use, if not
    all of `row`.
    """
    build = Device.build
    monkeypatch.setattr(Device, "build", lambda self, text, options: build(self, text, (*options, "-Werror")))
    scene, needs = compile_scene(load_description(scene_with(scene_features or row, folder))), needs_of(row)
    used = features(scene, needs) | {name: row[name] for name in KEPT_FEATURES}
    for name in ("MANY_LIGHTS", "NEXT_EVENT"):  # tree and list need them
        used[name] |= row["LIGHT_TREE"] or row["LIGHT_LIST"]
    assert {name for name, on in used.items() if on} <= {name for name, on in row.items() if on}
    more, specialised = (render_wave(device, scene, 16, needs, feature_override) for feature_override in (row, used))
    assert_same_bits(more, specialised)
    monkeypatch.setattr(Device, "build", build)


def test_the_rows_cover_every_pair_of_features():
    """All pairs of values that a scene can have: on and on, on and off, off and off."""
    rows, found = covering_rows(), set()
    assert len(rows) < 40
    for row in rows:
        assert is_closed({name for name, on in row.items() if on})
        found |= pairs_of(row)
    missing = possible_pairs()
    names = sorted(FEATURES)
    assert {(a, True, b, True) for a in names for b in names if a < b} <= missing
    impossible = 4 * len(names) * (len(names) - 1) // 2 - len(missing)
    needed = sum(len(only(name)) and sum(only(name).values()) - 1 for name in names)
    assert impossible <= needed  # a feature is on without one that it needs
    assert missing <= found


@pytest.mark.long
def test_no_features_run(device, monkeypatch, tmp_path):
    assert_runs_as_specialised(device, monkeypatch, only(), tmp_path)


@pytest.mark.long
def test_all_features_run_a_simple_scene(device, monkeypatch, tmp_path):
    """All features that change nothing, in programs with several lanes, and a simple scene."""
    few = only("SPHERES", "TRIANGLES", "DIFFUSE", "CONDUCTOR", "NEXT_EVENT", "CONSTANT_LIGHT", "RUSSIAN_ROULETTE")
    row = all_but("LIGHT_TREE", "LIGHT_LIST", "HIDE_EMITTERS", "FILTER_TABLE", "VOLPATH")
    assert_runs_as_specialised(device, monkeypatch, row, tmp_path, few)


@pytest.mark.long
@pytest.mark.parametrize(("form", "off"), [("gpu", ()), ("lanes", ("VOLPATH",))])
def test_all_features_build(device, form, off):
    """Builds all kernels; the long tests launch them, which takes twice as long."""
    constants = build_constants(EVERY_STATISTIC, FORMS[form])
    rows = (row for few in (False, True) for row in kernel_table(all_but(*off), few).values())
    for file in dict.fromkeys(row.file for row in rows):
        text, options = stage_source(file, STRUCTS, constants, all_but(*off), generated_headers())
        device.build(text, (*options, "-Werror"))


@pytest.mark.long
@pytest.mark.parametrize("off", [(), ("VOLPATH",)])
def test_all_features_run(device, monkeypatch, tmp_path, off):
    assert_runs_as_specialised(device, monkeypatch, all_but(*off), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", FEATURES)
def test_each_feature_runs_alone(device, monkeypatch, tmp_path, name):
    assert_runs_as_specialised(device, monkeypatch, only(name), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("number", range(PARTS))
def test_every_pair_of_features_runs(device, monkeypatch, tmp_path, number):
    for row in part_of_rows(number):
        assert_runs_as_specialised(device, monkeypatch, row, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", builtin_scenes())
@pytest.mark.parametrize("volpath", [False, True])
def test_all_features_give_the_same_image(device, name, volpath):
    """Bit-identical, 64 samples in each of 65,536 pixels: without fast-math no compiler may reorder operations."""
    scene = compile_scene(load_description(name))
    feature_override = feature_superset(features(scene), volpath)
    full = render_wave(device, scene, 64, EVERY_STATISTIC, feature_override)
    specialised = render_wave(device, scene, 64, EVERY_STATISTIC)
    assert_same_bits(full, specialised)
