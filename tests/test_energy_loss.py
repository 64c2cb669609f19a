"""The estimated loss of energy: closed forms, and a simulated render whose samples decide their counts."""

import numpy as np
import pytest
from synthetic_statistics import make_statistics

from isonoise.error.energy_loss import EnergyLoss
from isonoise.statistics import Statistics


def statistics_of(pixels: list[list[float]]) -> Statistics:
    """Statistics of an image of one row, from the samples of every pixel."""
    rows = [[function(x) for x in pixels] for function in (len, np.mean, lambda x: np.var(x, ddof=1))]
    return make_statistics(*([row] for row in rows))


def test_it_is_the_ratio_to_the_mean_of_the_uniform_waves():
    loss = EnergyLoss()
    first = [[1.0, 3.0], [2.0, 2.0]]
    loss.end_wave("uniform", statistics_of(first))
    assert loss.estimate(statistics_of(first)) == (0.0, 0.0)
    loss.begin_wave("adaptive", lambda: statistics_of(first))
    second = [first[0] + [0.0, 0.0], first[1] + [2.0]]
    loss.end_wave("adaptive", statistics_of(second))
    after = statistics_of(second)
    ratio, error = loss.estimate(after)
    assert ratio == pytest.approx(1 - (1.0 + 2.0) / (2.0 + 2.0))
    assert error == pytest.approx(np.sqrt(np.var(second[0], ddof=1) * (1 / 2 - 1 / 4)) / 4.0)
    third = [second[0] + [8.0], second[1] + [6.0]]
    loss.begin_wave("uniform", lambda: statistics_of(second))
    loss.end_wave("uniform", statistics_of(third))
    ratio, _ = loss.estimate(statistics_of(third))
    assert ratio == pytest.approx(1 - (12 / 5 + 12 / 4) / (12 / 3 + 10 / 3))


def test_a_black_image_and_a_pixel_without_uniform_samples():
    loss = EnergyLoss()
    empty, black = make_statistics([[0]], [[0.0]], [[0.0]]), statistics_of([[0.0, 0.0]])
    loss.begin_wave("adaptive", lambda: empty)
    loss.end_wave("adaptive", black)
    assert np.isnan(loss.estimate(black)).all()
    loss = EnergyLoss()
    loss.begin_wave("adaptive", lambda: black)
    loss.end_wave("adaptive", black)
    assert np.isnan(loss.estimate(black)).all()


def test_it_finds_the_loss_of_samples_that_decide_their_counts():
    """4000 pixels with one sample in 32 of 32, else 0: those that saw one take 64 more, the others 4. The true loss is
    known from the pixels' distribution; 5 standard errors, false alarms 6e-7."""
    random = np.random.default_rng(5)
    loss, pixels = EnergyLoss(), 4000
    samples = [list(32.0 * (random.random(16) < 1 / 32)) for _ in range(pixels)]
    loss.begin_wave("adaptive", lambda: statistics_of(samples))
    samples = [x + list(32.0 * (random.random(64 if sum(x) else 4) < 1 / 32)) for x in samples]
    statistics = statistics_of(samples)
    loss.end_wave("adaptive", statistics)
    measured, error = loss.estimate(statistics)
    unseen = (31 / 32) ** 16  # the mean of a sample is 1
    expected = unseen * 4 / 20 + (16 + 64 * (1 - unseen)) / 80
    assert measured == pytest.approx(1 - expected, abs=5 * error)
    assert 1 - expected > 5 * error
