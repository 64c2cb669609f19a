"""The live page in a headless Chromium: what it draws, its buttons, a phone's width, and the end of the render."""

import numpy as np
import pytest
from headless_chromium import headless_chromium
from live_client import decode, running_render, wait_for

from isonoise.film.png import tone_map
from isonoise.live.layers import encode_image
from isonoise.stops import Stops

SIZE = (160, 120)
PICTURE = """
const canvas = document.getElementById("picture");
return Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data)
  .concat([canvas.width, canvas.height]);
"""


class Page:
    """The page as its user sees it."""

    def __init__(self, driver):
        self.driver = driver

    def find(self, name):
        return self.driver.find_element("id", name)

    def text(self, name):
        return self.find(name).text

    def click(self, name):
        self.find(name).click()

    def show_layer(self, layer):
        self.driver.find_element("css selector", f"[data-layer={layer}]").click()

    def set_exposure(self, stops):
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
        self.driver.execute_script(script, self.find("exposure"), str(stops))

    def drawn(self):
        """The pixels that the canvas shows, without its empty border."""
        *values, width, height = self.driver.execute_script(PICTURE)
        rgba = np.array(values, np.uint8).reshape(height, width, 4)
        rows, columns = np.nonzero(rgba[..., 3])
        if not len(rows):
            return np.empty((0, 0, 3))
        return rgba[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1, :3]

    def shows(self, expected):
        """Whether the canvas shows this image, but for one step of 255: float16 in place of float32."""
        drawn = self.drawn()
        return drawn.shape == expected.shape and np.abs(drawn.astype(int) - expected).max() <= 1


@pytest.mark.long
def test_the_page_in_chromium(tmp_path):
    saved = []

    def save(loop):
        saved.append(loop.renderer.samples)
        return ["out.exr"]

    with headless_chromium(tmp_path, 1280, 800) as driver:
        page = Page(driver)
        with running_render(Stops(error=1e-4), save, "pooled", "cornell", SIZE) as (client, loop, outcomes):
            driver.get(client.url)
            wait_for(lambda: page.text("state") == "rendering")
            wait_for(lambda: "stated p99" in page.text("curve-key"))
            page.click("pause")
            wait_for(lambda: page.text("state") == "paused")
            rgb = loop.renderer.image()
            exposure = decode(encode_image(rgb, 0))[0]["exposure"]
            page.click("actual")
            wait_for(lambda: page.shows(tone_map(rgb)))
            page.set_exposure(1.5)
            wait_for(lambda: page.shows(tone_map(rgb, 2**1.5 * exposure)))
            assert page.text("exposure-value") == "+1.5 EV"
            assert "target 0.01 %" in page.text("curve-key")
            assert "about" in page.text("numbers")
            for layer, title in (("error", "Relative standard error"), ("samples", "Samples per pixel")):
                page.show_layer(layer)
                wait_for(lambda title=title: page.text("legend-title") == title)
                assert len(page.text("ticks").split("\n")) >= 2
                assert driver.save_screenshot(str(tmp_path / f"{layer}.png"))
            page.click("save")
            wait_for(lambda: "Saved out.exr." in page.text("message"))
            assert saved == [loop.renderer.samples]
            check_phone(driver, page, tmp_path)
            page.click("pause")
            wait_for(lambda: loop.renderer.samples > saved[0])
            page.show_layer("image")
            page.set_exposure(0)
            page.click("stop")
            assert not outcomes
            page.click("stop")
            wait_for(lambda: outcomes)
            assert outcomes[0].reason == "interrupted"
        wait_for(lambda: page.text("state") == "ended: it was stopped")  # the server is gone
        page.click("actual")
        wait_for(lambda: page.shows(tone_map(outcomes[0].rgb)))
        page.show_layer("samples")
        wait_for(lambda: page.text("legend-title") == "Samples per pixel")
        assert [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []


def check_phone(driver, page, folder):
    """On a phone nothing is wider than the screen, and buttons are large enough for fingers."""
    metrics = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    )
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
    for button in driver.find_elements("tag name", "button"):
        assert button.size["height"] >= 40
    background = driver.find_element("tag name", "body").value_of_css_property("background-color")
    assert background == "rgba(20, 23, 26, 1)"
    driver.save_screenshot(str(folder / "phone.png"))
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics | {"width": 1280, "deviceScaleFactor": 1})


@pytest.mark.long
def test_a_lost_connection_is_shown(tmp_path):
    with headless_chromium(tmp_path, 1280, 800) as driver:
        page = Page(driver)
        with running_render(Stops(error=1e-4)) as (client, _, outcomes):
            driver.get(client.url)
            wait_for(lambda: page.text("state") == "rendering")
            driver.execute_cdp_cmd("Network.enable", {})
            offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
            driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
            page.click("pause")
            wait_for(lambda: "does not answer" in page.text("message"))
            assert not outcomes
