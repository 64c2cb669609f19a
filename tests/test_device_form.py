"""Device forms: they give the same bits, and their traversal stacks are large enough."""

from collections.abc import Iterator

import numpy as np
import pytest
from feature_sets import PARTS, needs_of, part_of_rows, scene_with
from small_scene import assert_same_bits, assert_sound, lamp_over_floor, nested_triangles

from isonoise.device.form import FORMS, MAX_STACK_SIZE
from isonoise.device.opencl import Device
from isonoise.integrator.wavefront import Wavefront
from isonoise.render_scene import render
from isonoise.scene import compile_scene, load_description
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.statistics import BASIC_NEEDS, Needs, Statistics
from isonoise.strategies.uniform_allocation import uniform_allocation


def many_kinds() -> dict:
    """Several kinds of surfaces and materials, a texture and a sky, so that neighbouring paths differ in kind."""
    board = {"type": "checkerboard", "to_uv": np.diag([4.0, 4.0, 1.0, 1.0])}
    tiles = {"type": "diffuse", "reflectance": board}
    transform = np.eye(4)
    transform[:3, 3] = 0.3, 0.5, 0.2
    return lamp_over_floor(width=32, height=24, max_depth=8) | {
        "floor": {"type": "rectangle", "bsdf": tiles},
        "glass": {"type": "sphere", "center": [-0.5, 0.0, 0.3], "radius": 0.2, "bsdf": {"type": "dielectric"}},
        "net": {"type": "disk", "to_world": transform, "bsdf": {"type": "mask", "opacity": board, "inner": tiles}},
        "group": {"type": "shapegroup", "box": {"type": "cube", "to_world": np.diag([0.1, 0.1, 0.1, 1.0])}},
        "box": {"type": "instance", "to_world": transform, "group": {"type": "ref", "id": "group"}},
        "sky": {"type": "constant", "radiance": 0.2},
    }


def many_materials() -> dict:
    """The same with more lights and with rough materials, whose kernels take long to compile."""
    board = {"type": "checkerboard", "to_uv": np.diag([4.0, 4.0, 1.0, 1.0])}
    glossy = {"type": "roughconductor", "alpha": board, "distribution": "ggx"}
    tiles = {"type": "blendbsdf", "weight": board, "first": {"type": "roughplastic"}, "second": glossy}
    clear = {"type": "principled", "base_color": board, "spec_trans": 0.5}
    scene = many_kinds()
    scene["floor"]["bsdf"] = {"type": "twosided", "inner": tiles}
    scene["net"]["bsdf"]["inner"] = glossy
    spot = {"type": "spot", "to_world": scene["net"]["to_world"], "intensity": 3.0}
    return scene | {"ball": {"type": "sphere", "radius": 0.3, "bsdf": clear}, "spot": spot}


def fog() -> dict:
    """Light through pass-through surfaces and a medium, which `shadow_transmittance` traces; all statistics."""
    ball = {"type": "sphere", "radius": 0.5, "bsdf": {"type": "null"}}
    scene = lamp_over_floor() | {"fog": {**ball, "interior": {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.5}}}
    return scene | {"integrator": {"type": "volpath", "max_depth": 6}}


@pytest.mark.parametrize("scene", [lamp_over_floor, pytest.param(nested_triangles, marks=pytest.mark.long)])
def test_the_form_changes_no_bit(monkeypatch, scene):
    compiled = compile_scene(load_description(scene()))
    needs = BASIC_NEEDS.with_sampler(compiled.sampler)
    first, *others = statistics_of_all_forms(monkeypatch, compiled, needs)
    assert_sound(first)
    for other in others:
        assert_same_bits(first, other)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "strategy"),
    [(lamp_over_floor, "uniform"), (many_kinds, "uniform"), (fog, "relative-median"), (many_materials, "pooled")],
)
def test_the_form_changes_no_bit_of_a_render(monkeypatch, scene, strategy):
    """It also estimates errors, whose kernel takes long to compile."""
    renders = []
    for form in FORMS.values():
        monkeypatch.setattr(Device, "form", form)
        renders.append(render(scene(), spp=30, seed=3, strategy=strategy).statistics)
    assert_sound(renders[0])
    for other in renders[1:]:
        assert_same_bits(renders[0], other)


@pytest.mark.long
@pytest.mark.parametrize("number", range(PARTS))
def test_the_form_changes_no_bit_with_every_pair_of_features(monkeypatch, tmp_path, number):
    for on in part_of_rows(number):
        scene, needs = compile_scene(load_description(scene_with(on, tmp_path))), needs_of(on)
        first, *others = statistics_of_all_forms(monkeypatch, scene, needs, on)
        for other in others:
            assert_same_bits(first, other)


def statistics_of_all_forms(monkeypatch, scene: CompiledScene, needs: Needs, on=None) -> Iterator[Statistics]:
    """Two waves of 16 samples per pixel by kernels with the features `on`, if given, in a pool smaller than a wave."""
    size = scene.height, scene.width
    for form in FORMS.values():
        monkeypatch.setattr(Device, "form", form)
        wavefront = Wavefront(Device(), scene, build_scene_bvh(scene), needs, pool_size=600, feature_override=on)
        for wave in range(2):
            wavefront.trace(uniform_allocation(size, 16 * scene.height * scene.width, wave))
        yield wavefront.accumulator.statistics(scene.radiance_scale)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_the_stack_is_the_smallest_that_the_tree_fits(form):
    for needed in range(1, MAX_STACK_SIZE - 1):
        size = form.stack_size(needed)
        assert size >= needed + 2
        assert not any(needed + 2 <= other < size for other in form.stack_sizes)


def test_the_nested_triangles_need_a_large_stack():
    stack = build_scene_bvh(compile_scene(load_description(nested_triangles()))).stack
    assert [form.stack_size(stack) for form in FORMS.values()] == [MAX_STACK_SIZE, MAX_STACK_SIZE, 130]
