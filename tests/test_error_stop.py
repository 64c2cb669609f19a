"""The stop at an error with confidence: closed forms, simulations with a known true error, and a render."""

import numpy as np
import pytest
from small_scene import lamp_over_floor
from synthetic_statistics import make_statistics, statistics_of_samples

from isonoise import render
from isonoise.error.stated_error import error_distribution, stated_error
from isonoise.error.stopping import CALIBRATION_MARGIN, DISPERSION, ErrorStop, raised_quantile
from isonoise.strategies.measures import image_floor


@pytest.mark.parametrize("pixels", [2000, 65_536, 10**7])
@pytest.mark.parametrize("quantile", [0.5, 0.95, 0.99])
def test_raised_quantile_solves_its_equation(pixels, quantile):
    z = 1.959963984540054
    m = (1 - raised_quantile(quantile, pixels, 0.025)) * pixels
    allowed = (1 - quantile) * pixels
    assert m + z * np.sqrt(DISPERSION * m * (1 - m / pixels)) + (z * z - 1) / 6 == pytest.approx(allowed, rel=1e-6)


def test_raised_quantile_of_few_pixels_asks_for_no_error_at_all():
    assert raised_quantile(0.99, 1, 0.025) == pytest.approx(1 - 0.025)
    assert raised_quantile(0.99, 40, 0.025) == pytest.approx(1 - 0.025 / 40)
    for pixels in (1, 7, 40, 100, 2**28):
        raised = [raised_quantile(0.99, pixels, significance) for significance in (0.5, 0.025, 2.0**-20)]
        assert raised == sorted(raised)
        assert raised[1] > min(0.99, 1 - 0.05 / pixels)
        assert raised[-1] < 1


def test_bound_of_equal_errors():
    """se / mean = 0.1: the bound is a quantile of |Z|, whose value at 0.99106 is 2.6137."""
    stop = ErrorStop(limit=0.1, quantile=0.99, confidence=0.95)
    assert (stop.stated, stop.bound, stop.passed) == (None, None, False)
    stop.update(error_distribution(make_statistics(100, np.full((256, 256), 2.0), 4.0), 0.01))
    assert stop.stated == pytest.approx(0.1 * 2.575829, rel=1e-3)
    assert stop.bound == pytest.approx(0.1 * 2.6137 * CALIBRATION_MARGIN, rel=2e-3)
    assert not stop.passed
    assert stop.looks == 0  # a stated error above the limit cannot end the render


def test_looks_spend_the_confidence():
    """A look is a wave whose stated error is below the limit; look k has the error probability 0.05 / (k (k + 1))."""
    stop = ErrorStop(limit=0.265, quantile=0.99, confidence=0.95)
    statistics = make_statistics(100, np.full((64, 64), 2.0), 4.0)
    bounds = []
    for look in range(1, 6):
        stop.update(error_distribution(statistics, 0.01))
        assert stop.looks == look
        bounds.append(stop.bound)
        raised = raised_quantile(0.99, 64 * 64, 0.05 / (look * (look + 1)))
        assert stop.bound == pytest.approx(CALIBRATION_MARGIN * stated_error(statistics, [raised], 0.01)[0])
    assert (np.diff(bounds) > 0).all()


@pytest.mark.parametrize(
    ("shape", "renders", "allowed"),
    [((16, 16), 100, 14), *(pytest.param((side, side), 300, 30, marks=pytest.mark.long) for side in (16, 64))],
)
def test_true_error_is_below_the_limit(shape, renders, allowed, monkeypatch):
    """Exponential samples, waves of 1/8 more: at most 5 % of the renders end too early, even without the margin.

    False alarms: a rate of 5 % gives more than the allowed number with a probability of 1.4e-4.
    """
    monkeypatch.setattr("isonoise.error.stopping.CALIBRATION_MARGIN", 1.0)
    rng = np.random.default_rng(5)
    too_early, samples, samples_without = 0, [], []
    for _ in range(renders):
        stop = ErrorStop(limit=0.3, quantile=0.95, confidence=0.95)
        x = rng.exponential(size=(256, *shape))
        n, first = 16, None
        while not stop.passed:
            s = statistics_of_samples(x[:n])
            stop.update(error_distribution(s, image_floor(np.ones(shape))))
            first = first or (n if stop.stated < stop.limit else None)
            n = n if stop.passed else n + max(n // 8, 1)
        too_early += np.quantile(np.abs(s.mean - 1), 0.95) >= stop.limit
        samples.append(n)
        samples_without.append(first)
    assert too_early <= allowed
    assert np.mean(samples) < (1.2 if shape[0] == 64 else 1.6) * np.mean(samples_without)


def test_a_render_ends_at_its_bound():
    outcome = render(lamp_over_floor(), error=0.1, spp=100_000, confidence=0.99, sampler="independent")
    assert outcome.reason == "error"
    assert outcome.error_bound == outcome.rows[-1].error_bound < 0.1
    assert all(row.error_bound >= 0.1 for row in outcome.rows[:-1])
    assert all(row.error_bound > row.stated_p99 for row in outcome.rows)
    less = render(lamp_over_floor(), error=0.1, spp=100_000, confidence=0.5, sampler="independent")
    assert less.statistics.samples < outcome.statistics.samples


def test_without_a_limit_there_is_no_bound():
    outcome = render(lamp_over_floor(), spp=4)
    assert outcome.error_bound is None
    assert np.isnan(outcome.rows[-1].error_bound)
