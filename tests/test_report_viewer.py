"""The report's image viewer and crops: their data, and the page in a headless Chromium."""

import base64
import json
import zlib

import numpy as np
import pytest
from headless_chromium import headless_chromium
from simulated_comparison import make_comparison

pytest.importorskip("matplotlib", reason="matplotlib is in the extra 'compare'")
pytest.importorskip("jinja2", reason="jinja2 is in the extra 'compare'")

from isonoise.comparison.report.map_grids import error_maps, sample_maps
from isonoise.comparison.report.regions import worst_regions
from isonoise.comparison.report.strategy_images import StrategyImages, read_strategy_images
from isonoise.comparison.report.viewer_data import MAX_PIXELS, encode_half, viewer_factor, viewer_json
from isonoise.comparison.results import Results
from isonoise.comparison.summary import summarise
from isonoise.film.png import automatic_exposure, tone_map

SHAPE = (60, 80)
STRATEGIES = {"uniform": np.ones_like, "relative-median": lambda v: v}


def decode(text: str, shape) -> np.ndarray:
    raw = zlib.decompress(base64.b64decode(text), -zlib.MAX_WBITS)
    low, high = np.frombuffer(raw, np.uint8).reshape(2, -1).astype(np.uint16)
    return (low | high << 8).view(np.float16).reshape(shape)


def viewer_of(factor: int, height=13, width=18, count=70_000):
    """A viewer with a reference and one strategy, and its images."""
    rng = np.random.default_rng(1)
    rgb = rng.random((2, height, width, 3)).astype(np.float16)
    error = rng.normal(0, 0.1, (height, width)).astype(np.float16)
    images = StrategyImages("a </script>", rgb[1], error, np.full((height, width), count, np.uint32), np.abs(error))
    scales = {"error": error_maps({"a": images.rms.astype(float)}), "samples": sample_maps({"a": images.count})}
    text = viewer_json(rgb[0].astype(np.float32), [images], scales, factor)
    return rgb, images, text, json.loads(text)


def test_halves_survive_the_encoding():
    values = np.array([0.0, -1.5, 1e-7, 65504, 1e9, -1e9, 0.1])
    decoded = decode(encode_half(values), values.shape)
    assert decoded.tolist() == np.clip(values, -65504, 65504).astype(np.float16).tolist()


def test_a_viewer_has_all_pixels_of_small_images():
    rgb, images, text, data = viewer_of(1)
    assert "<" not in text  # it may not end the script element
    assert (data["width"], data["height"], data["factor"], data["signed"]) == (18, 13, 1, True)
    assert data["exposure"] == pytest.approx(automatic_exposure(rgb[0].astype(np.float32)))
    reference, strategy = data["images"]
    assert list(reference) == ["title", "rgb"]
    assert strategy["title"] == "a </script>"
    for entry, expected in ((reference, rgb[0]), (strategy, rgb[1])):
        assert (np.moveaxis(decode(entry["rgb"], (3, 13, 18)), 0, 2) == expected).all()
    assert (decode(strategy["error"], (13, 18)) == images.error).all()
    samples = decode(strategy["samples"], (13, 18)).astype(float) * strategy["samples_factor"]
    np.testing.assert_allclose(samples, 70_000, rtol=2**-11)
    assert len(data["scales"]["error"]["colours"]) == 64


def test_large_images_are_reduced_by_blocks():
    rgb, images, _, data = viewer_of(4)
    assert (data["width"], data["height"], data["factor"], data["signed"]) == (4, 3, 4, False)
    strategy = data["images"][1]
    corner = np.moveaxis(decode(strategy["rgb"], (3, 3, 4)), 0, 2)[0, 0]
    np.testing.assert_allclose(corner, rgb[1][:4, :4].astype(float).mean(axis=(0, 1)), rtol=1e-3)
    root = np.sqrt(np.mean(images.error[:4, :4].astype(float) ** 2))
    assert decode(strategy["error"], (3, 4))[0, 0] == pytest.approx(root, rel=1e-3)


def test_pages_are_bounded():
    assert viewer_factor([(512, 512, 8)]) == 1
    assert viewer_factor([(513, 100, 2)]) == 2
    assert viewer_factor([(1920, 1080, 4)]) == 4
    sizes = [(512, 512, 13)] * 12
    factor = viewer_factor(sizes)
    assert sum((w // factor) * (h // factor) * n for w, h, n in sizes) <= MAX_PIXELS
    assert sum((w // (factor - 1)) * (h // (factor - 1)) * n for w, h, n in sizes) > MAX_PIXELS
    assert viewer_factor([(4000, 1, 2)]) == 1  # no image may vanish


def test_worst_regions_are_where_the_errors_are():
    image = np.full((120, 150), 0.1)
    for k, (x, y) in enumerate(((30, 20), (100, 90), (10, 70), (70, 20))):
        image[y : y + 20, x : x + 20] = 1 - 0.1 * k
    found = worst_regions([image, 5 * image])
    assert [(region.x, region.y, region.side) for region in found] == [(30, 20, 20), (100, 90, 20), (10, 70, 20)]
    assert (found[1].crop(image) == 0.9).all()


def test_a_strategy_with_large_errors_has_no_more_weight():
    good, bad = np.full((64, 64), 0.01), np.full((64, 64), 5.0)
    good[:16, :16], bad[40:56, 40:56] = 0.1, 6.0
    first, *_ = worst_regions([good, bad])
    assert (first.x, first.y) == (0, 0)


@pytest.mark.parametrize(("shape", "count"), [((5, 7), 1), ((16, 16), 1), ((16, 40), 2)])
def test_regions_of_small_images(shape, count):
    assert len(worst_regions([np.random.default_rng(1).random(shape)])) == count
    assert worst_regions([np.zeros(shape)]) == []


def test_images_are_those_of_the_first_common_seed(tmp_path):
    folder = make_comparison(tmp_path / "out", ["a"], STRATEGIES, (3, 4))
    results, summary = Results(folder), summarise(folder)
    images = read_strategy_images(results, summary, summary["scenes"][0])
    runs = results.runs(results.plan.scenes[0])
    assert [image.title for image in images] == list(STRATEGIES)
    for image, by_seed in zip(images, runs.values(), strict=True):
        assert (image.rgb == by_seed[3].rgb).all()
        assert (image.error == by_seed[3].errors[-1]).all()
        squares = [by_seed[seed].errors[-1].astype(float) ** 2 for seed in (3, 4)]
        np.testing.assert_allclose(image.rms**2, np.mean(squares, axis=0))


PIXELS = """
const canvas = document.querySelector(".viewer [data-part=compare]");
return Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data)
  .concat([canvas.width, canvas.height]);
"""
READY = "return [...document.querySelectorAll('.viewer')].every(viewer => viewer.dataset.state === 'ready')"


class Page:
    """The report in a browser."""

    def __init__(self, driver, path):
        from selenium.webdriver.support.ui import WebDriverWait

        self.driver = driver
        driver.get(path.resolve().as_uri())
        driver.execute_script("document.querySelector('.viewer').scrollIntoView()")
        WebDriverWait(driver, 20).until(lambda driver: driver.execute_script(READY))

    def part(self, name):
        return self.driver.find_element("css selector", f".viewer [data-part={name}]")

    def choose(self, name, value):
        self.driver.find_element("css selector", f".viewer input[data-part={name}][value={value}]").click()

    def set(self, name, value):
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
        self.driver.execute_script(script, self.part(name), str(value))

    def drawn(self):
        *values, width, height = self.driver.execute_script(PIXELS)
        return np.array(values, np.uint8).reshape(height, width, 4)[..., :3].astype(int)

    def values(self, row):
        cells = self.driver.find_elements("css selector", f".viewer tr[data-image='{row}'] td")
        return [cell.text for cell in cells]

    def keys(self, name, *keys):
        self.part(name).send_keys(*keys)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    from isonoise.comparison.report import write_report

    folder = make_comparison(tmp_path_factory.mktemp("folder") / "out", ["a"], STRATEGIES, (1, 2), SHAPE)
    write_report(folder)
    return folder


def at_centres(drawn, shape):
    """The canvas at the centres of the image's pixels."""
    rows, columns = (((np.arange(n) + 0.5) * size / n).astype(int) for n, size in zip(shape, drawn.shape, strict=False))
    return drawn[rows][:, columns]


@pytest.mark.long
def test_the_viewer_in_chromium(report, tmp_path):
    """Both sides of the divider are tone-mapped as PNG files are; values are those of the runs; keys work."""
    from selenium.webdriver.common.keys import Keys

    results = Results(report)
    run = results.runs(results.plan.scenes[0])["uniform"][1]
    reference = results.reference(results.plan.scenes[0]).rgb
    exposure = automatic_exposure(reference)
    with headless_chromium(tmp_path, 1280, 900) as driver:
        page = Page(driver, report / "report.html")
        for stops in (0, -2):
            page.set("exposure", stops)
            drawn, half = at_centres(page.drawn(), SHAPE), SHAPE[1] // 2
            left, right = (tone_map(rgb, exposure * 2.0**stops).astype(int) for rgb in (run.rgb, reference))
            assert np.abs(drawn[:, : half - 1] - left[:, : half - 1]).max() <= 1
            assert np.abs(drawn[:, half + 1 :] - right[:, half + 1 :]).max() <= 1
        page.set("exposure", 0)

        x, y = SHAPE[1] // 2, SHAPE[0] // 2
        for key, dx, dy in ((Keys.ARROW_RIGHT, 1, 0), (Keys.ARROW_UP, 0, -1)):
            page.keys("compare", key)
            x, y = x + dx, y + dy
        assert page.part("pixel").text == f"pixel {x}, {y}"
        *rgb, error, samples = page.values(1)
        np.testing.assert_allclose([float(text) for text in rgb], run.rgb[y, x], rtol=1e-3)
        assert float(error.removesuffix(" %")) == pytest.approx(100 * run.errors[-1][y, x], rel=6e-3)
        assert float(samples) == run.count[y, x]
        assert page.values(0)[3:] == ["", ""]

        page.keys("compare", "3")
        assert page.part("right").get_attribute("value") == "2"
        page.keys("divider", Keys.HOME)
        assert page.part("divider").get_attribute("aria-valuenow") == "0"
        page.keys("divider", Keys.END, Keys.ARROW_LEFT)
        assert page.part("divider").get_attribute("aria-valuenow") == "98"

        before = page.drawn()
        page.part("in").click()
        assert (page.drawn() != before).any()
        page.part("fit").click()
        page.choose("layer", "samples")
        assert len(np.unique(page.drawn()[:, 10:100].reshape(-1, 3), axis=0)) == 1  # uniform
        driver.save_screenshot(str(tmp_path / "viewer.png"))
        assert [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []


@pytest.mark.long
def test_all_images_have_the_same_zoom(report, tmp_path):
    """A region that is shown in the viewer fills all canvases."""
    with headless_chromium(tmp_path, 1280, 900) as driver:
        page = Page(driver, report / "report.html")
        page.choose("layout", "all")
        driver.find_element("css selector", "button[data-viewer]").click()
        page.choose("layer", "error")
        canvases = driver.find_elements("css selector", ".viewer [data-part=single]")
        script = """const {width, height} = arguments[0], context = arguments[0].getContext("2d");
        const data = context.getImageData(0, height / 2, width, 1).data;
        return new Set(Array.from({length: width}, (_, k) => data.slice(4 * k, 4 * k + 3).join())).size"""
        colours = [driver.execute_script(script, canvas) for canvas in canvases]
        assert all(3 < count < 30 for count in colours[1:])  # of at most 22 pixels in a row
        driver.save_screenshot(str(tmp_path / "all.png"))


@pytest.mark.long
def test_the_page_fits_a_phone_and_is_printed(report, tmp_path):
    with headless_chromium(tmp_path, 390, 844) as driver:
        Page(driver, report / "report.html")
        widths = driver.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert widths == [390, 390]
        driver.save_screenshot(str(tmp_path / "phone.png"))
        pdf = base64.b64decode(driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"])
    assert pdf.startswith(b"%PDF")
    pages = pdf.count(b"/Type /Page\n")
    assert 3 < pages < 12
