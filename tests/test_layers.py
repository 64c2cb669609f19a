"""Layers: closed forms, the same bits however a render is cut, merging, files, and the denoiser."""

import numpy as np
import pytest
from small_scene import HEIGHT, PIXELS, WIDTH, assert_same_bits, lamp_over_floor

from isonoise import Renderer
from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.film.exr import read_exr
from isonoise.film.layers import ImageLayers, layer_channels
from isonoise.film.output import ImageFiles
from isonoise.layers import HOST, LAYERS, NO_HIT_DEPTH, check_layers, device_layers, first_components
from isonoise.state.checkpoint import read_checkpoint, write_checkpoint
from isonoise.state.merge import merge_states
from isonoise.state.merge_layers import merge_layers, state_layers

DEVICE_LAYERS = tuple(name for name, layer in LAYERS.items() if layer.made != HOST)
EYE, AHEAD = np.array([0.0, 2.4, 3.0]), np.array([0.0, -2.4, -3.0]) / np.hypot(2.4, 3.0)


def render(
    spp: int = 8, layers=DEVICE_LAYERS, steps: int = 1, seed: int = 1, strategy="uniform", **options
) -> Renderer:
    renderer = Renderer(lamp_over_floor(), strategy=strategy, layers=layers, seed=seed, **options)
    while renderer.samples < spp * PIXELS:
        renderer.step(min(spp * PIXELS - renderer.samples, -(-spp * PIXELS // steps)))
    return renderer


@pytest.fixture
def rendered(one_lane) -> Renderer:
    return render()


def test_the_layers_of_a_floor_have_their_closed_forms(rendered):
    layers = rendered.layers()
    assert list(layers) == list(DEVICE_LAYERS)
    on_floor = (layers["coverage"] == 1) & (layers["position"][..., 2] == 0)
    assert on_floor.sum() > 5
    np.testing.assert_array_equal(layers["albedo"][on_floor], np.float32(0.6))
    np.testing.assert_array_equal(layers["normal"][on_floor], np.tile((0, 0, 1), (on_floor.sum(), 1)))
    np.testing.assert_array_equal(layers["normal"], layers["geometric_normal"])
    position, hits = layers["position"], layers["coverage"] > 0
    np.testing.assert_allclose(layers["depth"][hits], (position[hits] - EYE) @ AHEAD, rtol=1e-5)
    uv = (position[on_floor][:, :2] + 1) / 2  # of the rectangle
    np.testing.assert_allclose(layers["uv"][on_floor], uv, atol=1e-6)
    for name in ("shape_index", "material_index"):
        assert len(np.unique(layers[name][on_floor])) == 1


def test_pixels_without_a_hit_have_the_values_of_the_background(rendered):
    layers = rendered.layers()
    missed = layers["coverage"] == 0
    assert missed.any()
    for name, value in {"depth": NO_HIT_DEPTH, "shape_index": -1, "material_index": -1}.items():
        assert (layers[name][missed] == value).all()
    for name in ("albedo", "normal", "position", "uv"):
        assert not layers[name][missed].any()


def test_the_coverage_is_a_number_of_samples(rendered):
    share = rendered.layers()["coverage"] * 8
    np.testing.assert_array_equal(share, np.rint(share))
    assert ((share > 0) & (share < 8)).any()


def test_layers_change_no_sample(one_lane):
    with render(layers=()) as without, render() as with_layers:
        assert without.layers() == {}
        assert_same_bits(without.statistics(), with_layers.statistics())


@pytest.mark.parametrize("options", [{"steps": 4}, {"pool_size": 16}])
def test_waves_and_pool_change_no_bit_of_the_layers(rendered, options):
    with render(**options) as other:
        assert_same_layers(rendered, other)


def test_a_continued_render_has_the_same_layers(rendered):
    with (
        render(spp=3) as first,
        Renderer(lamp_over_floor(), strategy="uniform", layers=DEVICE_LAYERS, seed=1) as second,
    ):
        second.restore(first.state())
        second.step(5 * PIXELS)
        assert_same_layers(rendered, second)
        second.reset()
        assert not second.layers()["coverage"].any()


def test_a_render_is_continued_only_with_the_same_layers(rendered):
    with (
        Renderer(lamp_over_floor(), strategy="uniform", layers=["depth"], seed=1) as other,
        pytest.raises(UserError, match="layers"),
    ):
        other.restore(rendered.state())


def test_merged_layers_are_means_over_the_samples_of_both(rendered):
    with render(spp=24, seed=2) as other:
        a, b = ((each.layers(), each.statistics()) for each in (rendered, other))
        merged = merge_layers(*a, *b)
    assert list(merged) == list(DEVICE_LAYERS)
    for name in ("albedo", "normal", "coverage"):
        np.testing.assert_allclose(merged[name], (a[0][name] + 3.0 * b[0][name]) / 4, rtol=1e-6, atol=1e-7)
    hits = [layers["coverage"].astype(float) * weight for (layers, _), weight in ((a, 1), (b, 3))]
    both = (hits[0] > 0) & (hits[1] > 0)
    sums = [hits[k] * each[0]["depth"] for k, each in enumerate((a, b))]
    np.testing.assert_allclose(merged["depth"][both], (sum(sums) / sum(hits).clip(1e-9))[both], rtol=1e-6)
    np.testing.assert_array_equal(merged["shape_index"], a[0]["shape_index"])


def test_checkpoints_keep_layers_for_merging(rendered, tmp_path):
    paths = [str(tmp_path / name) for name in ("a.npz", "b.npz", "merged.npz")]
    with render(layers=("depth", "normal", "uv", "coverage", "measure"), seed=2, strategy="relative-mean") as other:
        for renderer, path in ((rendered, paths[0]), (other, paths[1])):
            write_checkpoint(path, renderer.state())
        expected = merge_layers(rendered.layers(), rendered.statistics(), other.layers(), other.statistics())
    merged = merge_states(map(read_checkpoint, paths[:2]), paths[:2], Device())
    assert merged.settings["layers"] == ["normal", "depth", "uv", "coverage"]
    write_checkpoint(paths[2], merged)
    layers = state_layers(read_checkpoint(paths[2]))
    assert list(layers) == ["normal", "depth", "uv", "coverage"]
    for name in layers:
        np.testing.assert_array_equal(layers[name], expected[name])


def test_variance_and_measure_come_from_statistics_and_strategy(one_lane):
    with Renderer(lamp_over_floor(), strategy="relative-mean", layers=["measure", "variance"]) as renderer:
        renderer.step()
        layers, statistics = renderer.layers(), renderer.statistics()
        assert list(layers) == ["variance", "measure"]
        np.testing.assert_array_equal(layers["variance"], statistics.variance)
        from isonoise.strategies.measures import image_floor, relative_mean

        expected = relative_mean(statistics, image_floor(statistics.mean))
        np.testing.assert_allclose(layers["measure"], expected, rtol=1e-6)


def test_files_have_a_channel_for_each_component(rendered, tmp_path):
    path, layers = tmp_path / "a.exr", rendered.layers()
    ImageFiles([str(path)]).write(rendered.statistics(), 0.1, {}, layers=layers)
    channels = read_exr(path)[0]
    assert {"R", "G", "B", "samples", "error", "albedo.G", "normal.Z", "depth.Z", "uv.V", "coverage.X"} <= set(channels)
    for name, image in layers.items():
        planes = np.atleast_3d(image)
        for k, channel in enumerate(LAYERS[name].channels):
            np.testing.assert_array_equal(channels[f"{name}.{channel}"], planes[..., k])


def test_a_preview_shows_the_denoised_image(rendered, tmp_path):
    from PIL import Image

    path, bright = tmp_path / "a.png", np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    layers = ImageLayers({"denoised": lambda: bright})
    ImageFiles([str(path)]).write(rendered.statistics(), 0.1, {}, exposure=1.0, layers=layers)
    assert (np.asarray(Image.open(path)) == 188).all()  # of 0.5 in sRGB
    ImageFiles([str(path)]).write(rendered.statistics(), 0.1, {}, exposure=1.0, layers=layers, stops=-1.0)
    assert (np.asarray(Image.open(path)) == 137).all()  # of 0.25


def test_a_layer_is_made_once_and_when_it_is_read():
    made = []
    layers = ImageLayers({"depth": lambda: made.append(1) or np.zeros((2, 3), np.float32)})
    assert list(layers) == ["depth"]
    assert len(layers) == 1
    assert "depth" in layers
    assert made == []
    assert layers["depth"] is layers["depth"]
    assert made == [1]
    assert list(layer_channels(layers)) == ["depth.Z"]


def test_names_are_ordered_and_lead_to_what_the_device_makes():
    assert check_layers(["depth", "albedo", "depth"]) == ("albedo", "depth")
    assert device_layers(["denoised"]) == ("albedo", "normal")
    assert device_layers(["depth"]) == ("depth", "coverage")
    assert device_layers(["variance"]) == ()
    numbers = first_components(DEVICE_LAYERS)
    assert sorted(numbers.values()) == sorted([0, 3, 6, 9, 10, 13, 15, 0, 1])
    assert set(first_components(()).values()) == {-1}


@pytest.mark.parametrize(
    ("layers", "strategy", "message"),
    [
        (["dpeth"], "uniform", "did you mean 'depth'"),
        ("depth", "uniform", "must be a list of names"),
        (["measure"], "uniform", "uniform has no measure"),
    ],
)
def test_wrong_layers_are_errors(layers, strategy, message):
    with pytest.raises(UserError, match=message):
        Renderer(lamp_over_floor(), strategy=strategy, layers=layers)


def test_a_missing_denoiser_is_an_error(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyoidn", None)
    with pytest.raises(UserError, match=r"isonoise\[denoise\]"):
        Renderer(lamp_over_floor(), layers=["denoised"])


def test_the_denoiser_removes_noise_and_keeps_what_the_guides_show():
    pytest.importorskip("pyoidn")
    from isonoise.film.denoise import denoise

    rng = np.random.default_rng(1)
    albedo = np.where(np.arange(64)[:, None] < 32, 0.2, 0.8)[..., None] * np.ones((64, 64, 3))
    normal = np.zeros((64, 64, 3))
    normal[..., 2] = 1
    noisy = albedo * 40 * rng.exponential(size=(64, 64, 1))
    before, after = (np.abs(image - albedo * 40).mean() for image in (noisy, denoise(noisy, albedo, normal)))
    assert after < 0.25 * before


@pytest.mark.long
@pytest.mark.parametrize("device", ["0/2"])
def test_several_devices_make_the_same_layers(device):
    with (
        render(layers=(*DEVICE_LAYERS, "variance")) as one,
        render(layers=(*DEVICE_LAYERS, "variance"), device=device) as several,
    ):
        assert_same_layers(one, several)


def assert_same_layers(a: Renderer, b: Renderer) -> None:
    first, second = a.layers(), b.layers()
    assert list(first) == list(second)
    for name, image in first.items():
        assert image.tobytes() == second[name].tobytes(), name


MATERIALS = (
    {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.9]}},
    {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.4, 0.8]}},
    {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.4, 0.8]}},
    {"type": "conductor", "material": "Au"},
    {"type": "roughconductor", "material": "Cu", "alpha": 0.3},
    {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.3, 0.1]}, "metallic": 0.3, "roughness": 0.4},
)


@pytest.mark.long
def test_the_albedo_is_what_a_surface_reflects_of_light_from_everywhere():
    """Under an environment of radiance 1 one bounce has the radiance of the albedo."""
    film = {"type": "hdrfilm", "width": 8 * len(MATERIALS), "height": 8, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": {"type": "orthographic", "film": film, "to_world": np.diag([6.0, 1.0, 1.0, 1.0])},
        "sky": {"type": "constant", "radiance": 1.0},
    }
    for k, material in enumerate(MATERIALS):
        place = np.diag([-1.0, 1.0, -1.0, 1.0])  # faces the camera
        place[:3, 3] = 2.0 * k - 5.0, 0.0, 4.0
        place[2, 1] = 1.2  # at an angle of 50 degrees; all in one plane, so that none sees another
        scene[f"card{k}"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "twosided", "bsdf": material}}
    with Renderer(scene, strategy="uniform:wave_spp=4096", layers=["albedo", "coverage", "material_index"]) as renderer:
        renderer.step()
        layers, rgb = renderer.layers(), renderer.image()
    inside = layers["coverage"] == 1
    assert inside.sum() > 300
    difference = layers["albedo"] - rgb
    for index in np.unique(layers["material_index"][inside]):
        one = inside & (layers["material_index"] == index)
        assert np.abs(difference[one].mean(axis=0)).max() < 0.003, index


@pytest.mark.long
def test_layers_agree_with_those_of_mitsuba():
    """In pixels that one shape fills; Mitsuba's depth is the distance from the camera."""
    from scalar_mitsuba import as_mitsuba, import_mitsuba

    mitsuba = import_mitsuba()
    ball = {"type": "sphere", "center": [-0.3, 0.1, 0.4], "radius": 0.4}
    texels = np.random.default_rng(3).random((4, 4, 3)).astype(np.float32)
    paint = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}}
    scene = lamp_over_floor(width=48, height=32) | {"ball": ball | {"bsdf": paint}}
    aovs = "albedo:albedo,distance:depth,position:position,uv:uv,geometric_normal:geo_normal,normal:sh_normal"
    aovs += ",shape_index:shape_index"
    loaded = mitsuba.load_dict(as_mitsuba(mitsuba, scene | {"integrator": {"type": "aov", "aovs": aovs}}))
    image = np.array(mitsuba.render(loaded, spp=256))
    theirs, first = {}, 0
    for name, channels in (("albedo", 3), ("distance", 1), ("position", 3), ("uv", 2), ("geometric_normal", 3)):
        theirs[name], first = image[..., first : first + channels], first + channels
    theirs["normal"], theirs["shape_index"] = image[..., first : first + 3], image[..., first + 3]
    with Renderer(scene, strategy="uniform:wave_spp=256", layers=DEVICE_LAYERS) as renderer:
        renderer.step()
        ours = dict(renderer.layers())
    distance = np.linalg.norm(ours["position"] - EYE, axis=-1) * (1 - 0.01 / ours["depth"])  # from near_clip on
    ours["distance"] = distance[..., None]
    same = np.stack([np.roll(ours["shape_index"], (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    filled = (np.ptp(same, axis=0) == 0) & (ours["coverage"] == 1)
    assert filled.sum() > 300
    assert len(np.unique(ours["shape_index"][filled])) >= 2
    for name, tolerance in (("distance", 0.01), ("position", 0.01), ("uv", 0.05), ("albedo", 0.08)):
        assert np.abs(ours[name] - theirs[name])[filled].max() < tolerance, name
    for name in ("normal", "geometric_normal"):
        toward = np.sign(np.sum(theirs[name] * (EYE - theirs["position"]), axis=-1, keepdims=True))
        assert np.abs(ours[name] - toward * theirs[name])[filled].max() < 0.05, name


def test_a_denoiser_that_fails_costs_no_other_layer():
    from isonoise.commands.render import _made_layers

    def fail() -> np.ndarray:
        raise UserError("it has failed")

    depth = np.ones((2, 3), np.float32)
    layers = ImageLayers({"depth": depth, "denoised": fail})
    for has_ended in (True, False):
        made = _made_layers(layers, has_ended)
        assert list(made) == ["depth"]
        assert made["depth"] is depth
