"""`isonoise.render`: references, callbacks, progress, and its arguments."""

import io
import sys

import numpy as np
import pytest
from small_scene import HEIGHT, PIXELS, WIDTH, assert_same_bits, lamp_over_floor

import isonoise
from isonoise.error.true_error import true_error
from isonoise.errors import UserError
from isonoise.film.exr import write_exr
from isonoise.render_scene import render

STRATEGY = "relative-median:warmup=4"


@pytest.fixture(scope="module")
def outcome():
    return render(lamp_over_floor(), spp=12, seed=9, strategy=STRATEGY)


def test_references_of_all_kinds(outcome, tmp_path):
    """The errors in the log are those of the image against the reference, with its standard error if it has one."""
    error = np.full((HEIGHT, WIDTH, 3), 0.01, np.float32)
    write_exr(tmp_path / "plain.exr", {"": outcome.rgb}, {})
    write_exr(tmp_path / "with-error.exr", {"": outcome.rgb, "stderr": error}, {})
    own_error = np.sqrt(outcome.statistics.variance_of_mean())[..., None] * np.ones(3, np.float32)
    cases = [
        (tmp_path / "plain.exr", None),
        (str(tmp_path / "with-error.exr"), error),
        (outcome.rgb, None),
        (outcome.rgb.astype(np.float64), None),
        ((outcome.rgb, None), None),
        ((outcome.rgb, error), error),
        (outcome, own_error.astype(np.float32)),
    ]
    for reference, standard_error in cases:
        image = render(lamp_over_floor(), spp=4, strategy=STRATEGY, reference=reference)
        expected = true_error(image.rgb, outcome.rgb, standard_error, image.statistics)
        assert image.rows[-1].true == expected


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("missing.exr", "missing.exr"),
        (np.zeros((HEIGHT, WIDTH)), r"reference: ndarray of shape \(5, 7\)"),
        (np.zeros((HEIGHT, WIDTH, 4)), r"shape \(5, 7, 4\)"),
        (np.full((HEIGHT, WIDTH, 3), "a"), "type <U1"),
        (3, "reference = 3 is none: it has to be the path"),
        ([[1], [1, 2]], "reference = "),
        (np.full((HEIGHT, WIDTH, 3), np.nan), "105 values are not finite"),
        ((np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH))), "standard error of the reference"),
        ((np.zeros((HEIGHT, WIDTH, 3)), np.full((HEIGHT, WIDTH, 3), -1.0)), "no standard error is below 0"),
        (np.zeros((HEIGHT + 1, WIDTH, 3)), r"reference is 7x6 and the image 7x5: render with size=\(7, 6\)"),
    ],
)
def test_wrong_references(reference, message):
    with pytest.raises(UserError, match=message):
        render(lamp_over_floor(), spp=4, strategy=STRATEGY, reference=reference)


def test_a_reference_without_samples(outcome):
    first = render(lamp_over_floor(), spp=1, strategy=STRATEGY)
    with pytest.raises(UserError, match="fewer than 2 samples"):
        render(lamp_over_floor(), spp=4, strategy=STRATEGY, reference=first)


def test_every_wave_is_shown():
    seen = []
    outcome = render(
        lamp_over_floor(), spp=20, strategy=STRATEGY, on_wave=lambda row, statistics: seen.append((row, statistics))
    )
    assert [row for row, _ in seen] == outcome.rows
    assert [statistics.samples for _, statistics in seen] == [row.samples for row in outcome.rows]
    assert len(seen) > 1
    assert_same_bits(seen[-1][1], outcome.statistics)


def test_progress_as_a_function():
    calls = []
    render(lamp_over_floor(), time=0.7, strategy=STRATEGY, progress=lambda *progress: calls.append(progress))
    assert len(calls) >= 2
    elapsed, samples, _, _ = zip(*calls, strict=True)
    assert list(elapsed) == sorted(elapsed)
    assert samples[-1] > PIXELS


@pytest.mark.parametrize(("progress", "is_shown"), [(None, True), (True, True), (False, False)])
def test_progress_on_a_terminal(progress, is_shown, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    render(lamp_over_floor(), spp=4, strategy=STRATEGY, progress=progress)
    assert bool(sys.stderr.getvalue()) == is_shown


def test_the_sample_count_of_the_scene_is_the_limit_without_another():
    scene = isonoise.load(lamp_over_floor()).compile()
    assert render(scene, strategy="uniform").statistics.samples == scene.sample_count * PIXELS


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spp": "8"}, "spp has to be a number from 1e-30 to 1e"),
        ({"spp": True}, "spp has to be"),
        ({"spp": -1}, "spp has to be"),
        ({"time": np.nan}, "time has to be"),
        ({"error": "2%"}, "error has to be"),
        ({"quantile": "0.5"}, "quantile has to be between 0 and 1, not '0.5'"),
        ({"confidence": None}, "confidence has to be at least 0.5"),
        ({"quantil": 0.5}, r"no argument 'quantil' \(did you mean 'quantile'\?\)"),
        ({"stratgy": "uniform"}, r"no argument 'stratgy' \(did you mean 'strategy'\?\)"),
        ({"progress": 3}, "progress = 3 is not a function"),
        ({"on_wave": "print"}, "on_wave = 'print' is not a function"),
        ({"size": (0, 3)}, "size: width = 0 is out of range: it goes from 1 to"),
        ({"size": (3, -1)}, "size: height = -1 is out of range"),
        ({"size": 8}, r"size = 8 is not \(width, height\) in pixels, such as \(640, 360\)"),
        ({"size": "8x8"}, "size = '8x8' is not"),
        ({"size": (8, 8, 3)}, r"size = \(8, 8, 3\) is not"),
        ({"size": (8.0, 8)}, "size: width = 8.0 is not a whole number"),
        ({"size": (True, 8)}, "size: width = True is not a whole number"),
        ({"size": (2**20, 2**20)}, "an image has 1 to"),
        ({"seed": -1}, r"seed = -1 is out of range: it goes from 0 to 2\^64 - 1"),
        ({"seed": 1.5}, "seed = 1.5 is not a whole number"),
        ({"seed": None}, "seed = None is not a whole number"),
        ({"seed": np.nan}, "seed = nan is not a whole number"),
        ({"max_depth": "4"}, "max_depth = '4' is not a whole number"),
        ({"max_depth": -2}, "max_depth = -2 is out of range: it goes from -1"),
        ({"pool_size": 0}, "pool_size = 0 is out of range"),
        ({"memory": "1G"}, r"memory \(in bytes\) = '1G' is not a whole number"),
        ({"sampler": "sobl"}, r"sampler = 'sobl' is not one of sobol, independent \(did you mean 'sobol'\?\)"),
        ({"strategy": 3}, "strategy = 3 is neither a strategy's name nor an object"),
        ({"profile": 1}, "profile = 1 is neither True nor False"),
        ({"allow_outside": "no"}, "allow_outside = 'no' is neither True nor False"),
        ({"parameters": "a=1"}, "parameters = 'a=1' is not a dict"),
        ({"view": (0, 0, 0)}, r"view = \(0, 0, 0\) is not an isonoise.View"),
        ({"device": -1}, "device = -1 is out of range"),
        ({"device": 1.5}, "device = 1.5 is not a whole number"),
        ({"on_compile": 4}, "on_compile = 4 is not a function"),
    ],
)
def test_wrong_arguments(arguments, message):
    with pytest.raises(UserError, match=message):
        render(lamp_over_floor(), **arguments)


def test_numbers_of_numpy_are_numbers(outcome):
    options = {"spp": np.float32(12), "seed": np.int64(9), "size": np.array([WIDTH, HEIGHT]), "max_depth": np.int8(4)}
    assert_same_bits(render(lamp_over_floor(), strategy=STRATEGY, **options).statistics, outcome.statistics)


def test_outcomes_and_statistics_show_themselves_in_a_line(outcome):
    """Without the values of their arrays, which fill a terminal."""
    line = repr(outcome)
    assert line.startswith(f"<isonoise.Outcome: {WIDTH}x{HEIGHT} pixels, 12 samples per pixel in ")
    assert line.endswith("ended by: spp>")
    names = "count, rejected, rgb, mean, variance, median, design_effect"
    assert (
        repr(outcome.statistics) == f"<isonoise.Statistics: {WIDTH}x{HEIGHT} pixels, {12 * PIXELS:,} samples; {names}>"
    )
