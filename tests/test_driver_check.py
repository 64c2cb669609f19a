"""The check of a driver by the kernels of a render: correct kernels pass, broken ones are refused."""

import functools

import numpy as np
import pytest
from kernel_faults import source_with_fault
from small_scene import assert_same_bits, lamp_over_floor, nested_triangles

from isonoise.cli import main
from isonoise.device import program, program_cache
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError
from isonoise.integrator import driver_check, stages
from isonoise.integrator.check_scene import SIDE, check_scenes
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.wavefront import Wavefront
from isonoise.renderer import Renderer
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS
from isonoise.strategies import make_strategy

# Deliberate faults: kernel file, text, its replacement, a part of the message.
FAULTS = {
    "a lost sample": ("stages/reduce.cl", "        ++n;", "        if (sample % 8u != 3u) ++n;", "`reduce`"),
    "wrong squares": (
        "stages/reduce.cl",
        "m->block_squares += difference * difference;",
        "m->block_squares += difference;",
        "`variance`",
    ),
    "rejected samples": ("stages/reduce.cl", "            continue;", "", "`reduce`"),
    "a missed triangle": (
        "stages/intersect.cl",
        "if (t.lane[triangle] < closest->t) {",
        "if (t.lane[triangle] < closest->t && triangle != 1u) {",
        "bounce",
    ),
    "a wrong distance": (
        "stages/intersect.cl",
        "closest->t = t.lane[triangle];",
        "closest->t = 1.2f * t.lane[triangle];",
        "bounce",
    ),
    "a wrong BSDF": ("bsdf/diffuse.h", "REFLECTANCE), *pdf);", "REFLECTANCE), 1.1f * *pdf);", "bounce"),
    "a dead vector lane": (
        "path/scatter.h",
        "mis / light->pdf);",
        "get_global_id(0) % 8u == 3u ? 0.0f : mis / light->pdf);",
        "bounce",
    ),
    "no shadow": ("stages/shadow.cl", "analytics, t_max)) continue;", "analytics, t_max)) {}", "bounce"),
}


CHECK_SCENES = 11
LONG_FAULTS = {"wrong squares", "rejected samples", "a wrong distance", "a dead vector lane"}


@pytest.fixture
def unchecked(monkeypatch, tmp_path):
    """No check has been made: the notes of this process and of the program cache are empty."""
    monkeypatch.setattr(driver_check, "_passed_here", set())
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "programs"))


@pytest.fixture
def calls(monkeypatch):
    """Names of the checks that were made."""
    made = []
    for name in ("reduce_fault", "bounce_fault"):
        check = getattr(driver_check, name)
        monkeypatch.setattr(driver_check, name, lambda *a, check=check, name=name: made.append(name) or check(*a))
    return made


def break_kernels(monkeypatch, fault: str) -> None:
    monkeypatch.setattr(program, "kernel_source", source_with_fault(*FAULTS[fault][:3]))


def check_scene(number: int) -> CompiledScene:
    return list(check_scenes())[number].compile(1, "independent", has_filter=False, hide_emitters=False)


@functools.cache
def features_of_all_check_scenes() -> dict[str, bool]:
    sets = [features(check_scene(number), BASIC_NEEDS) for number in range(CHECK_SCENES)]
    return {name: any(on[name] for on in sets) or name == "MANY_LIGHTS" for name in FEATURES}


@pytest.mark.usefixtures("one_lane")
@pytest.mark.parametrize("has_more", [True, pytest.param(False, marks=pytest.mark.long)])
@pytest.mark.parametrize("number", range(CHECK_SCENES))
def test_check_scenes_have_their_closed_form(number, has_more):
    """The images of all check scenes, by kernels with the features of all, and by such with no more than they need."""
    scene = check_scene(number)
    override = features_of_all_check_scenes() if has_more else None
    wavefront = Wavefront(Device(), scene, build_scene_bvh(scene), BASIC_NEEDS, seed=2, feature_override=override)
    wavefront.trace(np.full((SIDE, SIDE), 64, np.uint32))
    statistics = wavefront.accumulator.statistics(scene.radiance_scale)
    image = list(check_scenes())[number].image()
    deviation = np.abs((statistics.mean - image).mean())
    assert deviation < 6 * np.sqrt((statistics.variance / 64).sum()) / image.size + 1e-4 * image.mean()


@pytest.mark.usefixtures("unchecked", "one_lane")
@pytest.mark.parametrize(
    "fault", [pytest.param(name, marks=pytest.mark.long) if name in LONG_FAULTS else name for name in FAULTS]
)
def test_broken_kernels_are_refused(monkeypatch, fault):
    break_kernels(monkeypatch, fault)
    with pytest.raises(DeviceError) as caught:
        Renderer(lamp_over_floor(), strategy="uniform")
    message = str(caught.value)
    assert FAULTS[fault][-1] in message
    assert Device().name in message
    assert "--device" in message


@pytest.mark.usefixtures("unchecked", "one_lane", "in_tmp_path")
def test_a_refused_driver_ends_the_command(monkeypatch, capsys):
    from isonoise.device.drivers import driver_fields

    break_kernels(monkeypatch, "a lost sample")
    for _ in range(2):  # and again: a failure is not noted as a pass
        assert main(["render", "cornell", "--size", "8x8", "--strategy", "uniform", "-o", "a.exr"]) == 2
        error = capsys.readouterr().err
        assert driver_fields(Device().device)["driver_version"] in error
        assert "`reduce`" in error


@pytest.mark.usefixtures("unchecked")
def test_a_pass_is_noted(calls, monkeypatch):
    Renderer(lamp_over_floor(), strategy="uniform")
    assert calls == ["reduce_fault", "bounce_fault"]
    Renderer(lamp_over_floor(), strategy="uniform", seed=5)
    assert len(calls) == 2
    driver_check._passed_here.clear()  # as in another process
    Renderer(lamp_over_floor(), strategy="uniform")
    assert len(calls) == 2
    monkeypatch.setattr(driver_check, "driver_identity", lambda device: ("another version",))
    Renderer(lamp_over_floor(), strategy="uniform")
    assert len(calls) == 4


@pytest.mark.usefixtures("unchecked")
def test_without_a_program_cache_it_is_checked_once_per_process(calls, monkeypatch):
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, "off")
    for _ in range(2):
        Renderer(lamp_over_floor(), strategy="uniform")
    assert len(calls) == 2


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("scene", "pool_size"),
    [(lamp_over_floor, None), (lamp_over_floor, 150), (lamp_over_floor, 1), (nested_triangles, None)],
)
def test_the_check_compiles_nothing_and_changes_nothing(calls, monkeypatch, scene, pool_size):
    jobs, renderers = [], []
    monkeypatch.setattr(stages, "precompile", lambda device, wanted, on_compile: jobs.append(wanted))
    for check in (lambda *_: None, driver_check.check_driver):
        monkeypatch.setattr("isonoise.integrator.set_up.check_driver", check)
        renderers.append(Renderer(scene(), strategy="relative-mean", pool_size=pool_size, profile=True))
        monkeypatch.setattr(Device, "_compile", lambda self, source, options: pytest.fail("a program is compiled"))
    assert calls == ["reduce_fault", "bounce_fault"]
    assert len(jobs) == 3
    assert jobs[0] == jobs[1] == jobs[2]  # the same launches too
    for renderer in renderers:
        renderer.step()
    assert_same_bits(*(renderer.statistics() for renderer in renderers))
    assert len({renderer._wavefront.device.allocated for renderer in renderers}) == 1


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "name",
    ["cornell", *(pytest.param(name, marks=pytest.mark.long) for name in ("penumbra", "bright-spots", "glass-roof"))],
)
def test_check_scenes_suit_the_built_in_scenes(name, monkeypatch):
    traced = []
    trace = Wavefront.trace
    monkeypatch.setattr(Wavefront, "trace", lambda self, *a: traced.append(self.features) or trace(self, *a))
    renderer = Renderer(name, size=(8, 8))
    assert traced == [renderer.features]


@pytest.mark.usefixtures("one_lane")
def test_materials_without_a_check_scene_are_checked_by_their_statistics_alone(calls):
    scene = lamp_over_floor()
    scene["floor"]["bsdf"] = {"type": "conductor", "material": "none"}
    scene["lamp"]["bsdf"] = {"type": "conductor", "material": "none"}
    renderer = Renderer(scene, strategy="uniform")
    needs = make_strategy("uniform").needs.with_sampler(renderer.scene.sampler)
    assert not renderer.features["DIFFUSE"]
    assert driver_check.bounce_fault(renderer._wavefront, needs) is None
