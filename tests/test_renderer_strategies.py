"""Custom strategies: the documented example, invalid waves and maps, waves without spp."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from small_scene import PIXELS, assert_same_bits, lamp_over_floor

from isonoise.errors import UserError
from isonoise.render_scene import render
from isonoise.renderer import Renderer
from isonoise.strategies import Strategy, Wave
from isonoise.strategies.uniform_allocation import uniform_allocation

EXAMPLES = Path(__file__).resolve().parent.parent / "host" / "docs" / "examples"


def test_the_examples_are_short_and_those_of_the_page():
    page = (EXAMPLES.parent / "custom.md").read_text()
    for example in EXAMPLES.glob("*.py"):
        text = example.read_text()
        assert f"`{example.name}`:\n\n```python\n{text}```" in page, example.name
        code = [line for line in text.splitlines() if line.strip() and not line.startswith(("import", "from"))]
        assert len(code) <= 10, example.name


@pytest.mark.usefixtures("one_lane")
def test_the_strategy_of_the_examples(monkeypatch):
    """By name and as an object, and it does what the text says."""
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.syspath_prepend(EXAMPLES)
    by_name = render(lamp_over_floor(), spp=24, strategy="proportional:Proportional").statistics
    from proportional import Proportional

    as_object = render(lamp_over_floor(), spp=24, strategy=Proportional()).statistics
    assert_same_bits(by_name, as_object)
    assert by_name.samples == 24 * PIXELS
    assert (
        by_name.count[by_name.variance == 0] <= 17
    ).all()  # 16 of the uniform waves, 8 to 16 in all if it did nothing
    assert by_name.count.max() > 32


@pytest.mark.usefixtures("one_lane")
def test_the_measure_and_the_rule_of_the_examples(monkeypatch):
    """The rule gives half of the adaptive samples to all pixels, and those without noise no more than that."""
    monkeypatch.chdir(EXAMPLES)
    spec = "adaptive:measure=displayed:displayed_error,rule=half_uniform:half_uniform,ratio=inf,clip=1"
    with Renderer(lamp_over_floor(), strategy=spec) as renderer:
        adaptive = sum(renderer.step().samples for _ in range(6)) - 16 * PIXELS
        statistics = renderer.statistics()
    black = statistics.mean == 0
    assert black.any()
    np.testing.assert_allclose(statistics.count[black], 16 + adaptive / PIXELS / 2, atol=5)  # rounded in each wave
    assert statistics.count.min() == statistics.count[black].min()
    assert statistics.count.max() > 16 + 2 * adaptive / PIXELS


class Scripted(Strategy):
    """Plans the given waves and returns the given allocation maps."""

    name = "scripted"

    def __init__(self, waves, maps=()):
        self.planned, self.maps = waves, iter(maps)

    def waves(self):
        return iter(self.planned)

    def allocate(self, statistics, budget):
        return next(self.maps)(statistics.shape, budget)


def test_invalid_allocation_maps():
    maps = {
        "sum 71": lambda shape, budget: uniform_allocation(shape, budget + 1, 0),
        "int64": lambda shape, budget: uniform_allocation(shape, budget, 0).astype(np.int64),
        "float64": lambda shape, budget: uniform_allocation(shape, budget, 0).astype(np.float64),
        r"shape \(7, 5\)": lambda shape, budget: uniform_allocation(shape[::-1], budget, 0),
        r"shape \(35,\)": lambda shape, budget: uniform_allocation(shape, budget, 0).ravel(),
        "sum 150323855325": lambda shape, budget: np.full(shape, 2**32 - 1, np.uint32),
        "object": lambda shape, budget: None,
    }
    renderer = Renderer(lamp_over_floor(), strategy=Scripted([Wave("adaptive", 2.0)] * len(maps), maps.values()))
    for problem in maps:
        with pytest.raises(UserError, match=f"strategy 'scripted' returned an allocation map of .*{problem}"):
            renderer.step()
    assert renderer.statistics().samples == 0


def test_invalid_waves():
    invalid = [Wave("uniform", 0.0), Wave("uniform", np.nan), Wave("adaptive", np.inf), Wave("random", 1.0)]
    invalid += [Wave("uniform", None), Wave("random", None), Wave("adaptive", 0)]
    renderer = Renderer(lamp_over_floor(), strategy=Scripted([Wave("uniform", 3), *invalid]))
    assert renderer.step().samples == 3 * PIXELS
    for wave in invalid:
        with pytest.raises(UserError, match=re.escape(f"strategy 'scripted' planned {wave}")):
            renderer.step()
    with pytest.raises(UserError, match="strategy 'scripted' plans no more waves"):
        renderer.step()
    assert renderer.statistics().samples == 3 * PIXELS


def one_in_three(shape, budget):
    """A map of 100 samples in every third pixel, 1,200 in all; asked for without a budget.

    It is read-only and in column order: a strategy may keep its map in any form.
    """
    assert budget is None
    allocation = np.asfortranarray(np.where(np.arange(PIXELS) % 3 == 1, 100, 0).astype(np.uint32).reshape(shape))
    allocation.flags.writeable = False
    return allocation


def test_a_wave_without_spp_uses_the_map_unchanged():
    renderer = Renderer(lamp_over_floor(), strategy=Scripted([Wave("adaptive", None)] * 2, [one_in_three] * 2))
    for wave in range(1, 3):
        record = renderer.step(samples=1200 if wave == 1 else None)
        assert (record.kind, record.samples, record.planned) == ("adaptive", 1200, 1200)
        assert (renderer.statistics().count == wave * one_in_three((5, 7), None)).all()


@pytest.mark.parametrize("samples", [1, 11, 12, 600, 1199])
def test_a_wave_without_spp_is_scaled_down_in_proportion(samples):
    renderer = Renderer(lamp_over_floor(), strategy=Scripted([Wave("adaptive", None)], [one_in_three]))
    record = renderer.step(samples=samples)
    assert record.samples == record.planned == samples
    count = renderer.statistics().count.ravel()
    assert count.sum() == samples
    assert set(count[1::3].tolist()) <= {samples // 12, samples // 12 + 1}


def test_invalid_maps_of_a_wave_without_spp():
    maps = {
        "sum 0;": lambda shape, budget: np.zeros(shape, np.uint32),
        "int64": lambda shape, budget: np.ones(shape, np.int64),
        r"shape \(7, 5\)": lambda shape, budget: np.ones(shape[::-1], np.uint32),
    }
    renderer = Renderer(lamp_over_floor(), strategy=Scripted([Wave("adaptive", None)] * len(maps), maps.values()))
    for problem in maps:
        with pytest.raises(UserError, match=f"returned an allocation map of .*{problem}.*sum 1 or more"):
            renderer.step(samples=50)
    assert renderer.statistics().samples == 0


def test_waves_without_spp_meet_the_budget():
    endless = itertools.chain([Wave("uniform", 2)], itertools.repeat(Wave("adaptive", None)))
    strategy = Scripted(endless, itertools.repeat(one_in_three))
    outcome = render(lamp_over_floor(), spp=100.3, strategy=strategy)
    assert [row.samples for row in outcome.rows] == [70, 1270, 2470, round(100.3 * PIXELS)]
