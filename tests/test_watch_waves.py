"""`isonoise.watch`: the waves that it yields, and what notebooks and terminals show of them."""

import sys

import numpy as np
import pytest
from small_scene import PIXELS, lamp_over_floor

import isonoise
from isonoise import watch_waves
from isonoise.errors import UserError
from isonoise.renderer import Renderer

pytestmark = pytest.mark.usefixtures("one_lane")


@pytest.fixture
def renderer():
    with Renderer(lamp_over_floor(), strategy="relative-mean:warmup=4") as renderer:
        yield renderer


def test_the_waves_are_those_of_the_renderer(renderer):
    """And the last one is cut to meet the number of samples."""
    watched = list(isonoise.watch(renderer, spp=9.5))
    assert renderer.samples == round(9.5 * PIXELS) == sum(wave.samples for wave in watched)
    count = renderer.statistics().count.copy()
    renderer.reset()
    for wave in watched:
        again = renderer.step(wave.samples)
        assert (again.kind, again.samples) == (wave.kind, wave.samples)
    assert (renderer.statistics().count == count).all()
    assert list(isonoise.watch(renderer, spp=9.5)) == []  # that many are there already


@pytest.mark.parametrize("spp", [0, -1, np.nan, "8", True])
def test_a_wrong_number_of_samples_is_an_error_at_once(renderer, spp):
    with pytest.raises(UserError, match="spp has to be a number"):
        isonoise.watch(renderer, spp=spp)


def test_a_notebook_shows_the_waves_and_keeps_the_last_picture(renderer, notebook_outputs):
    waves = []
    for wave in isonoise.watch(renderer):
        waves.append(wave)
        if len(waves) == 3:
            break
    bar, pictures = notebook_outputs
    texts = [content["text/plain"].partition(" in ")[0] for content in bar]
    assert texts == ["first samples", "wave 1 (uniform)", "wave 2 (adaptive)", "wave 3 (uniform)", ""]
    assert pictures[0]["text/html"] == waves[0]._repr_html_()
    assert pictures[-1]["text/html"] == waves[-1]._repr_html_()
    assert len(pictures) == 2  # the second wave came less than a second after the first one


def test_pictures_take_a_tenth_of_the_time(renderer, notebook_outputs, monkeypatch):
    """With a clock on which a wave takes 10 s and a picture 5 s: every fifth wave has one, and the last one."""
    seconds = [0.0]
    monkeypatch.setattr(watch_waves.time, "perf_counter", lambda: seconds[0])
    show = watch_waves.NotebookOutput.show

    def slow(self, *content):
        seconds[0] += 5
        show(self, *content)

    monkeypatch.setattr(watch_waves.NotebookOutput, "show", slow)
    monkeypatch.setattr(watch_waves.ProgressBar, "show", lambda *_: None)
    numbers = []
    for wave in isonoise.watch(renderer):
        numbers.append(wave.number)
        seconds[0] += 10
        if len(numbers) == 13:
            break
    (pictures,) = notebook_outputs
    shown = [int(content["text/html"].split("wave ")[1].split(",")[0]) for content in pictures]
    assert shown == [1, 6, 11, 13]


def test_nothing_is_computed_where_nothing_is_shown(renderer, monkeypatch):
    monkeypatch.setattr(Renderer, "error_distribution", None)
    assert not sys.stderr.isatty()
    assert len(list(isonoise.watch(renderer, spp=9))) > 1
