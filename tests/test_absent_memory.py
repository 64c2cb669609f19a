"""Features that are off take no memory on the device; others take the bytes that the table of features states."""

from pathlib import Path

import pytest
from feature_sets import all_but, needs_of, only, scene_with

from isonoise.device.opencl import Device
from isonoise.integrator import stages
from isonoise.integrator.feature_costs import cost
from isonoise.integrator.feature_superset import DUMMY_BYTES
from isonoise.integrator.features import FEATURES, features
from isonoise.integrator.kernel_table import (
    KERNELS,
    PATH_STATE,
    path_bytes,
)
from isonoise.integrator.wavefront import Wavefront
from isonoise.layers import device_layers
from isonoise.scene import builtin_scenes, compile_scene, load_description, structs
from isonoise.scene.accel.build import build_scene_bvh
from isonoise.scene.light.envmap import ENVIRONMENT
from isonoise.statistics import BASIC_NEEDS, Needs

CHECKOUT = Path(__file__).resolve().parent.parent


def allocated(
    monkeypatch, scene, needs: Needs = BASIC_NEEDS, feature_override=None
) -> tuple[dict[str, int], Wavefront]:
    """Returns the size in bytes of every buffer, by argument name. No kernel is compiled."""
    with monkeypatch.context() as patch:
        patch.setattr(stages, "stage_source", lambda *arguments: ("", ()))
        patch.setattr(Device, "build", lambda self, text, options: {})
        wavefront = Wavefront(
            Device(), scene, build_scene_bvh(scene), needs, pool_size=256, feature_override=feature_override
        )
    arguments = wavefront.stages.arguments
    return {name: value.size for name, value in arguments.items() if hasattr(value, "get_info")}, wavefront


@pytest.mark.parametrize("name", builtin_scenes())
def test_no_buffer_without_a_feature_that_reads_it(monkeypatch, name):
    scene = compile_scene(load_description(name))
    sizes, wavefront = allocated(monkeypatch, scene)
    used = wavefront.features
    for_features = {buffer for feature in FEATURES.values() for buffer in feature.buffers}
    for_used = {buffer for feature, on in used.items() if on for buffer in FEATURES[feature].buffers}
    paths = path_bytes(used)
    assert not (for_features - for_used) & set(sizes)
    assert {each for each in path_bytes(dict.fromkeys(FEATURES, True)) if each not in paths}.isdisjoint(sizes)
    # buffers of no feature are present in every scene
    buffers = {argument for row in KERNELS.values() for argument in row.arguments}
    never = {each for each, value in wavefront.stages.arguments.items() if value is None}
    never.remove("pixel_list")  # of distributed renders
    assert never & buffers <= (for_features - for_used) | set(path_bytes(dict.fromkeys(FEATURES, True)))


@pytest.mark.parametrize("name", builtin_scenes())
def test_path_state_is_the_sum_of_the_stated_bytes(monkeypatch, name):
    scene = compile_scene(load_description(name))
    sizes, wavefront = allocated(monkeypatch, scene)
    planes = int(wavefront.stages.arguments["plane_stride"])
    assert {each: sizes[each] for each in path_bytes(wavefront.features)} == {
        each: size * planes for each, size in path_bytes(wavefront.features).items()
    }
    bare = sum(path_bytes(only()).values())
    assert bare == sum(4 * field.planes for field in PATH_STATE.values() if not field.features) + 16 + 4 + 4
    stated = sum(cost(each, wavefront.features).path_bytes for each, on in wavefront.features.items() if on)
    assert sum(path_bytes(wavefront.features).values()) == bare + stated


@pytest.mark.parametrize("name", builtin_scenes())
def test_an_additional_feature_takes_the_stated_bytes(monkeypatch, name):
    """Exactly those of the paths, and a dummy for each of its buffers; other buffers do not change."""
    scene = compile_scene(load_description(name))
    without, wavefront = allocated(monkeypatch, scene)
    used = wavefront.features
    planes = int(wavefront.stages.arguments["plane_stride"])
    records = {
        "faces": 12 * len(scene.faces),
        "shapes": scene.shapes.nbytes,
        "triangle_shape": scene.triangle_shape.nbytes,
        "srgb": stated("srgb"),
        "light_bounds": stated("light_bounds") * len(scene.lights),
        "environment": ENVIRONMENT.itemsize,  # a black map
        "heterogeneous_media": structs.HETEROGENEOUS_MEDIUM.itemsize,  # a homogeneous one
    }
    of_statistics = {"CHUNK_MEDIANS", "BATCH_MEANS", "POWER_MEAN", "HALF_BUFFER"}
    for feature in (each for each, on in used.items() if not on and each not in of_statistics | {"FILTER_TABLE"}):
        more, of_more = allocated(monkeypatch, scene, feature_override=used | {feature: True})
        dropped = () if of_more.brute_force else ("corners", "corner_indices")  # it needs a BVH
        bare = {each: size for each, size in without.items() if each not in dropped}
        new = {each: size for each, size in more.items() if each not in bare}
        larger = {each: more[each] - size for each, size in bare.items() if more[each] != size}
        paths = {each: size for each, size in (new | larger).items() if each in path_bytes(of_more.features)}
        sky = feature in ("CONSTANT_LIGHT", "ENVIRONMENT_MAP") and scene.environment_light < 0
        lights = {"lights": structs.LIGHT.itemsize} if sky else {}
        assert {each: size for each, size in larger.items() if each not in paths} == lights, feature
        assert sum(paths.values()) == cost(feature, used).path_bytes * planes, feature
        assert set(new) - set(paths) == set(FEATURES[feature].buffers) - set(bare), feature
        for each in set(new) - set(paths) - {"light_nodes", "light_parents"}:  # built from the lights of the scene
            assert new[each] == records.get(each, DUMMY_BYTES), (feature, each)


def test_statistics_take_the_stated_bytes(monkeypatch):
    scene = compile_scene(load_description("cornell"), size=(16, 8))
    bare, wavefront = allocated(monkeypatch, scene)
    for needs, features_, bytes_a_pixel in (
        (Needs(median=True, chunk=7), {"CHUNK_MEDIANS"}, 4 * 7 + 4),
        (Needs(median=True, chunk=7, batch=4), {"CHUNK_MEDIANS", "BATCH_MEANS"}, 4 * 7 + 4 + 8),
        (Needs(power=2.0), {"POWER_MEAN"}, 8),
        (Needs(half=True), {"HALF_BUFFER"}, 24),
        (Needs(neighbours=5), {"NEIGHBOURS"}, 8),
    ):
        more, of_more = allocated(monkeypatch, scene, needs)
        assert {each for each, on in of_more.features.items() if on and not wavefront.features[each]} == features_
        new = {each: size for each, size in more.items() if each not in bare}
        assert set(new) == {each for feature in features_ for each in FEATURES[feature].buffers}
        assert sum(new.values()) == bytes_a_pixel * 16 * 8
        assert {each for each in bare if more[each] != bare[each]} == (set() if needs.neighbours else {"summary"})


def test_layers_take_the_stated_bytes(monkeypatch):
    scene = compile_scene(load_description("cornell"), size=(16, 8))
    bare, _ = allocated(monkeypatch, scene)
    more, wavefront = allocated(monkeypatch, scene, Needs(layers=device_layers(["normal", "depth", "shape_index"])))
    assert wavefront.features["LAYERS"]
    new = {each: size for each, size in more.items() if each not in bare}
    channels = 3 + 1 + 1  # with the coverage
    pixels = 16 * 8
    assert new == {
        "layer_sums": 8 * channels * pixels,
        "layer_indices": 4 * pixels,
        "triangle_shape": 4 * len(scene.faces),
    }
    assert all(more[each] == size for each, size in bare.items())


def test_a_filter_takes_the_stated_bytes(monkeypatch, tmp_path):
    box, table = (
        allocated(monkeypatch, compile_scene(load_description(scene_with(only(*names), tmp_path))))[0]
        for names in ((), ("FILTER_TABLE",))
    )
    assert {each: table[each] for each in table if each not in box} == {"inverse_cdf": stated("inverse_cdf")}


def stated(buffer: str) -> int:
    """Returns the number of bytes that the table of features states for a buffer."""
    (text,) = {feature.buffers[buffer] for feature in FEATURES.values() if buffer in feature.buffers}
    return int(text.split()[0].replace(",", ""))


def test_records_have_the_stated_bytes(monkeypatch, tmp_path):
    """In a scene that uses all features."""
    row = all_but()
    scene = compile_scene(load_description(scene_with(row, tmp_path)))
    used = features(scene, needs_of(row))
    assert {each for each in row if not used[each]} <= {
        "COUNT_TESTS",
        "CONSTANT_LIGHT",
        "ORTHOGRAPHIC",
        "LIGHT_LIST",
        "LIGHT_TREE",
    }
    sizes, _ = allocated(monkeypatch, scene, needs_of(row))
    triangles, lights, sky = len(scene.faces), len(scene.lights), scene.environment
    number = {
        "triangles": triangles,
        "faces": triangles,
        "corner_normals": triangles,
        "uvs": len(scene.vertices),
        "textures": len(scene.textures),
        "texel_bytes": len(scene.texel_bytes),
        "srgb": 1,
        "attributes": len(scene.attributes),
        "analytics": len(scene.analytics),
        "shapes": len(scene.shapes),
        "instances": len(scene.instances),
        "rough_transmittances": len(scene.rough_transmittances),
        "media": len(scene.media),
        "heterogeneous_media": len(scene.media),
        "grids": len(scene.heterogeneous.grids),
        "grid_values": len(scene.heterogeneous.values),
        "extinction_bounds": len(scene.heterogeneous.extinction_bounds),
        "lights": lights,
        "light_cdf": lights,
        "projections": len(scene.projections),
        "environment": 1,
        "environment_texels": sky.texels.shape[0] * sky.texels.shape[1],
        "environment_rows": len(sky.rows),
        "environment_guide": sky.guide.size,
        "triangle_blocks": sizes["triangle_blocks"] // stated("triangle_blocks"),
        "light_nodes": sizes["light_nodes"] // stated("light_nodes"),
        "inverse_cdf": 1,
    }
    number["light_parents"] = lights + number["light_nodes"]
    assert {each: sizes[each] for each in number} == {each: stated(each) * count for each, count in number.items()}
    pixels = {"medians": 4 * 5 + 4 + 8, "powers": 8, "halves": 24, "neighbours": 8}
    assert {each: sizes[each] for each in pixels} == {each: size * 9 * 7 for each, size in pixels.items()}
    unchecked = {each for feature in FEATURES.values() for each in feature.buffers} - set(number) - set(pixels)
    assert unchecked == {
        *("texel_floats", "corners", "corner_indices", "light_bounds", "net_means"),
        *("layer_sums", "layer_indices", "triangle_shape"),
    }
