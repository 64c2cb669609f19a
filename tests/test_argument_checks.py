"""Wrong arguments of the public functions: the error names the argument, its value and what is accepted."""

import numpy as np
import pytest
from small_scene import lamp_over_floor

import isonoise
from isonoise.argument_checks import check_integer, check_number, check_rgb
from isonoise.errors import UserError
from isonoise.suggestions import suggestion

RGB = np.zeros((2, 3, 3), np.float32)


@pytest.mark.parametrize("value", [7, np.int8(7), np.uint64(7), np.array(7)])
def test_whole_numbers(value):
    number = check_integer("n", value, 0, 9)
    assert (number, type(number)) == (7, int)


@pytest.mark.parametrize("value", [True, np.True_, 7.0, "7", None, [7], np.nan, np.inf])
def test_no_whole_numbers(value):
    with pytest.raises(UserError, match="is not a whole number"):
        check_integer("n", value, 0, 9)


@pytest.mark.parametrize("value", [0.5, np.float16(0.5), np.float64(0.5), np.array(0.5)])
def test_numbers(value):
    assert check_number("n", value, lambda number: True, "a number") == 0.5


@pytest.mark.parametrize("value", [True, "0.5", None, b"1", [1, 2], 1j, np.nan, 10**400])
def test_no_numbers(value):
    with pytest.raises(UserError, match="n has to be a number, not"):
        check_number("n", value, lambda number: True, "a number")


@pytest.mark.parametrize("value", [RGB, RGB.astype(np.float16), RGB.astype(int), RGB.tolist()])
def test_rgb_images(value):
    assert check_rgb("image", value).shape == (2, 3, 3)


def test_similar_names():
    assert suggestion("stratgy", ["seed", "strategy"]) == " (did you mean 'strategy'?)"
    assert suggestion("abc", ["seed", "strategy"]) == ""


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: isonoise.load("cornell", size=8), "size = 8 is not"),
        (lambda: isonoise.load("cornell", size=(0, 3)), "size: width = 0 is out of range"),
        (lambda: isonoise.load("cornell", view=3), "view = 3 is not an isonoise.View"),
        (lambda: isonoise.load("cornell", parameters="a=1"), "parameters = 'a=1' is not a dict"),
        (lambda: isonoise.load("cornell", allow_outside=None), "allow_outside = None is neither True nor False"),
        (lambda: isonoise.load("cornell").compile(max_depth="4"), "max_depth = '4' is not a whole number"),
        (lambda: isonoise.load("cornell").compile(sampler="sobl"), "did you mean 'sobol'"),
        (lambda: isonoise.Renderer(None), "scene = None is no scene"),
        (lambda: isonoise.Renderer("cornell", cluster=3), "cluster = 3 is not an isonoise.Cluster"),
        (lambda: isonoise.render_loop(3, isonoise.Stops(spp=1)), "renderer = 3 is not an isonoise.Renderer"),
        (lambda: isonoise.render_loop(None, None, on_wav=print), r"'on_wav' \(did you mean 'on_wave'\?\)"),
        (lambda: isonoise.Needs(power="2"), "Needs: power = 2 must be a finite number"),
        (lambda: isonoise.Adaptive(measure="absolute", warmup="4"), "warmup = '4' is not a number"),
        (lambda: isonoise.write_exr("a.exr", {}, {}), "at least one array"),
        (lambda: isonoise.write_exr("a.exr", {"a": [1.0]}, {}), "layer 'a' is"),
        (lambda: isonoise.write_exr("a.exr", {"": np.zeros((2, 2))}, {}), r"layer '' is of shape \(2, 2\)"),
        (lambda: isonoise.write_exr("a.exr", {"": RGB, "b": np.zeros((4, 4))}, {}), "different sizes"),
        (lambda: isonoise.write_exr(3, {"": RGB}, {}), "path = 3 is not a path"),
        (lambda: isonoise.read_exr(3), "path = 3 is not a path"),
        (lambda: isonoise.write_png("a.png", RGB[0]), r"ndarray of shape \(3, 3\)"),
        (lambda: isonoise.write_png("a.png", RGB, exposure="1"), "exposure has to be a finite number, not '1'"),
    ],
)
def test_wrong_arguments(call, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=message):
        call()
    assert list(tmp_path.iterdir()) == []


def test_wrong_arguments_of_a_renderer():
    with isonoise.Renderer(lamp_over_floor(), strategy="relative-median:warmup=4") as renderer:
        for samples in ("8", 1.5, -1):
            with pytest.raises(UserError, match="samples = "):
                renderer.step(samples)
        for use in (renderer.continue_wave, renderer.end_wave):
            with pytest.raises(UserError, match="no wave has begun"):
                use()
        with pytest.raises(UserError, match=r"stops = 5 is not an isonoise\.Stops"):
            isonoise.render_loop(renderer, 5)
        with pytest.raises(UserError, match="on_wave = 3 is not a function"):
            isonoise.RenderLoop(renderer, isonoise.Stops(spp=1), on_wave=3)
        assert renderer.step().number == 1
