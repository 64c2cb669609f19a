"""What notebooks show: pictures, maps with their scales, the error curve, and the HTML of an outcome."""

import base64
import io
import math
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from PIL import Image
from small_scene import HEIGHT as SCENE_HEIGHT
from small_scene import WIDTH as SCENE_WIDTH
from small_scene import lamp_over_floor

from isonoise.film.log import LogRow
from isonoise.film.png import tone_map
from isonoise.notebook.error_curve import HEIGHT, LABEL_DISTANCE, error_curve
from isonoise.notebook.pictures import INFERNO, MAX_SIDE, VIRIDIS, image_picture, map_picture, reduce_plane
from isonoise.outcome import Outcome
from isonoise.progress import format_percent
from isonoise.scene.parameter_list import count_objects
from isonoise.scene.scene import load
from isonoise.statistics import Statistics
from isonoise.stops import Stops
from isonoise.wave import WaveRecord

RNG = np.random.default_rng(19)


def decode(data_uri: str) -> np.ndarray:
    """The pixels of a PNG data URI."""
    kind, data = data_uri.split(",")
    assert kind == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def statistics(shape=(6, 9)) -> Statistics:
    count = RNG.integers(2, 90, shape).astype(np.uint32)
    rgb = RNG.lognormal(size=(*shape, 3)).astype(np.float32)
    mean = rgb.mean(axis=-1, dtype=np.float64)
    return Statistics(count, np.zeros_like(count), rgb, mean, (0.3 * mean) ** 2, None)


def rows(errors=(0.4, 0.2, 0.1)) -> list[LogRow]:
    """A log whose error at 0.99 is the one given, and half and a quarter of it at the lower quantiles."""
    return [
        LogRow(0.5 * 2**wave, wave + 1, "uniform", 54 * 8, 8.0, e / 4, e / 2, e, None, 0, error_bound=1.1 * e)
        for wave, e in enumerate(errors)
    ]


def outcome(**changes) -> Outcome:
    values = {"stops": Stops(error=0.15, quantile=0.95)} | changes
    return Outcome("error", rows(), 2.0, statistics(), 0.01, 0.1, **values)


def test_small_images_are_shown_as_png_files_would_be():
    rgb = RNG.lognormal(size=(5, 7, 3)).astype(np.float32)
    assert (decode(image_picture(rgb)) == tone_map(rgb)).all()


def test_large_pictures_are_averaged_to_the_limit():
    plane = RNG.uniform(size=(4, 2 * MAX_SIDE)).astype(np.float32)
    expected = plane.reshape(2, 2, MAX_SIDE, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(reduce_plane(plane), expected, rtol=1e-5)


@pytest.mark.parametrize(("ratio", "is_log"), [(4, False), (900, True)])
def test_a_map_runs_through_its_colours(ratio, is_log):
    """From the first colour to the last one, with the middle one at the middle of the scale."""
    middle = math.sqrt(ratio) if is_log else (1 + ratio) / 2
    picture, scale = map_picture(np.array([[1, middle, ratio]]), VIRIDIS)
    assert scale == (1, ratio, is_log, False, False)
    np.testing.assert_allclose(decode(picture)[0], [(0x44, 1, 0x54), (0x21, 0x91, 0x8C), (0xFD, 0xE7, 0x25)], atol=2)


def test_few_pixels_do_not_decide_the_scale_of_a_map():
    values = np.linspace(2, 3, 10_000).reshape(100, 100)
    values[0, :4] = 0, 1e-3, 1e6, np.inf
    picture, scale = map_picture(values, INFERNO)
    assert 2 <= scale.low < 2.01
    assert 2.99 < scale.high <= 3
    assert (scale.has_lower, scale.has_higher) == (True, True)
    ends = decode(picture)[0, :4]
    assert (ends[:2] == (0, 0, 4)).all()
    assert (ends[2:] == (0xFC, 0xFF, 0xA4)).all()


def test_errors_that_are_mere_rounding_do_not_stretch_the_scale():
    values = np.geomspace(0.01, 1, 10_000).reshape(100, 100)
    values[:20] = 1e-9
    _, scale = map_picture(values, INFERNO)
    assert scale.low == pytest.approx(scale.high / 1000)
    assert scale.has_lower


@pytest.mark.parametrize("value", [0.0, 16.0, np.inf])
def test_a_map_of_one_value(value):
    _, scale = map_picture(np.full((2, 3), value), VIRIDIS)
    assert scale.low == scale.high == (value if math.isfinite(value) else 0)
    assert scale.has_higher == (not math.isfinite(value))


def elements(svg: str, name: str) -> list[ElementTree.Element]:
    return ElementTree.fromstring(svg).findall(f"{{http://www.w3.org/2000/svg}}{name}")


def test_the_curve_is_straight_where_errors_halve_as_time_doubles():
    """The axes are logarithmic and the target lies between the waves around it."""
    svg = error_curve(rows(), target=math.sqrt(0.4 * 0.2))
    lines = [
        [tuple(map(float, p.split(","))) for p in line.get("points").split()] for line in elements(svg, "polyline")
    ]
    assert len(lines) == 4  # three quantiles and the bound
    for line in lines:
        steps = np.diff(line, axis=0)
        np.testing.assert_allclose(steps[0], steps[1], atol=0.2)
    (target,) = (line for line in elements(svg, "line") if line.get("stroke-dasharray"))
    assert float(target.get("y1")) == pytest.approx((lines[2][0][1] + lines[2][1][1]) / 2, abs=0.1)


def test_no_label_of_a_curve_covers_another():
    svg = error_curve(rows((1e-3, 1.0001e-3)), target=1e-3)
    texts = elements(svg, "text")
    labels = sorted(float(text.get("y")) for text in texts if text.text in ("median", "p95", "p99", "bound"))
    labels += [float(text.get("y")) for text in texts if "target" in text.text]
    assert len(labels) == 5
    assert (np.diff(sorted(labels)) >= LABEL_DISTANCE).all()
    assert max(labels) < HEIGHT


def test_a_curve_without_known_errors_is_left_out():
    unknown = [LogRow(1.0, 1, "uniform", 54, 1.0, math.inf, math.inf, math.inf, None, 0)]
    assert error_curve(unknown) == error_curve([]) == ""


def test_an_outcome_shows_image_maps_and_curve():
    shown = outcome()
    html = shown._repr_html_()
    assert "9x6 pixels" in html
    assert "stated error 10 % at quantile 0.95; ended by: error" in html
    pictures = re.findall(r'src="(data:image/png[^"]*)"', html)
    assert len(pictures) == 3
    assert (decode(pictures[0]) == tone_map(shown.rgb)).all()
    low, high = shown.statistics.count.min(), shown.statistics.count.max()
    assert f"<span>{low}</span>" in html
    assert f"<span>{high}</span>" in html
    assert f"<span>{format_percent(shown.error.max())}</span>" in html
    (curve,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', html)
    assert b"target 15 %" in base64.b64decode(curve)
    assert "http" not in html  # it needs no network
    ElementTree.fromstring(html)  # every element is closed


def test_an_outcome_without_limits_shows_itself():
    """That of a merged render, for example."""
    assert "ended by" not in outcome(stops=None)._repr_html_()


def test_a_wave_shows_image_and_maps():
    shown = WaveRecord("adaptive", 1234, 1234, 0.5, number=3, _read=statistics)
    html = shown._repr_html_()
    assert "wave 3, adaptive: 1.23 k samples in 0.50 s; " in html
    assert html.count("data:image/png") == 3
    assert "data:image/svg" not in html


def test_a_wave_without_statistics_says_so():
    html = WaveRecord("uniform", 54, 54, 0.5)._repr_html_()
    assert "were not read" in html
    assert "<img" not in html


def test_a_scene_shows_its_objects_and_parameters():
    """Also one that several shapes share, and text that is no HTML."""
    scene = load(lamp_over_floor() | {"<b>": {"type": "sphere", "bsdf": {"type": "conductor"}}})
    html = scene._repr_html_()
    assert f"{SCENE_WIDTH}x{SCENE_HEIGHT} pixels" in html
    for kind, plugin, number in (("shape", "rectangle", 2), ("shape", "sphere", 1), ("emitter", "area", 1)):
        assert re.search(f">{kind}</td><td [^>]*>{plugin}</td><td [^>]*>{number}</td>", html)
    for path, value in (("floor.bsdf.reflectance", "0.6"), ("sensor.fov", "50"), ("lamp.emitter.radiance", "5, 4, 3")):
        assert re.search(f"{path}</td>.*?>{value}</td>", html)
    assert "&lt;b&gt;.bsdf" in html
    assert "<b>." not in html
    assert f"{len(scene.params())} parameters" in html
    assert "lamp.emitter.radiance" in scene["lamp"]._repr_html_()
    assert "floor" not in scene["lamp"]._repr_html_()


def test_an_object_with_several_users_counts_once():
    floor = {"type": "rectangle", "bsdf": {"type": "ref", "id": "paint"}}
    scene = load(lamp_over_floor() | {"paint": {"type": "dielectric"}, "a": floor, "b": floor})
    assert ("bsdf", "dielectric", "1") in count_objects(scene.description).rows


def layers() -> dict[str, np.ndarray]:
    """One of each kind."""
    depth = RNG.uniform(1, 5, (6, 9)).astype(np.float32)
    depth[0, 0] = 1e10
    index = np.zeros((6, 9), np.float32)
    index[:, :3], index[:, 6:] = -1, 7
    vectors = np.zeros((6, 9, 3), np.float32)
    vectors[0, :3] = (-1, 0, 1)
    return {
        "albedo": np.full((6, 9, 3), 0.5, np.float32),
        "normal": vectors,
        "uv": vectors[..., :2] + 1,
        "depth": depth,
        "shape_index": index,
    }


def test_an_outcome_shows_its_layers():
    html = outcome(layers=layers())._repr_html_()
    ElementTree.fromstring(html)
    pictures = re.findall(r'src="(data:image/png[^"]*)" alt="(\w+)"', html)
    albedo, normal, uv, depth, index = (decode(picture) for picture, name in pictures if name in layers())
    assert (albedo == tone_map(np.full((1, 1, 3), 0.5), exposure=1)[0, 0]).all()
    assert normal[0, 0].tolist() == [0, 128, 255]
    assert normal[1, 0].tolist() == [128, 128, 128]
    assert "normal: x, y, z as red, green, blue from -1 to 1" in html
    assert uv[0, 0].tolist() == [0, 255, 0]
    assert (depth[0, 0] == (0xFD, 0xE7, 0x25)).all()  # no hit: the last colour, and beyond the scale
    assert len(np.unique(depth.reshape(-1, 3), axis=0)) > 20
    assert (index[:, :3] == 0).all()
    assert len(np.unique(index.reshape(-1, 3), axis=0)) == 3
    assert "shape_index: 2 different numbers" in html
