"""Measures and allocation rules of users: names, parameters, needs, and what is said of wrong ones."""

from importlib.metadata import EntryPoint
from itertools import islice

import numpy as np
import pytest
from small_scene import PIXELS, lamp_over_floor
from synthetic_statistics import make_statistics

from isonoise.cli import main
from isonoise.errors import UserError
from isonoise.renderer import Renderer
from isonoise.statistics import Needs
from isonoise.strategies import describe, lookup, make_strategy, measures
from isonoise.strategies.adaptive import Adaptive, Pooled
from isonoise.strategies.allocation import distribute_in_proportion
from isonoise.strategies.registry import is_built_in
from isonoise.strategies.uniform_allocation import uniform_allocation

RNG = np.random.default_rng(7)
MEAN = RNG.lognormal(size=(6, 5))
STATISTICS = make_statistics(RNG.integers(2, 40, MEAN.shape), MEAN, MEAN**2 * RNG.uniform(size=MEAN.shape), median=MEAN)
FLOOR = measures.image_floor(STATISTICS.mean)

PIECES = """
import numpy as np
import isonoise
from isonoise.strategies.allocation import distribute_in_proportion

def contrast(statistics):
    return np.sqrt(statistics.variance / statistics.count)

contrast.needs = isonoise.Needs(half=True)

def darkest(count, variance, budget):
    allocation = np.zeros(count.shape, np.uint32)
    allocation[np.unravel_index(variance.argmin(), count.shape)] = budget
    return allocation

def unknown(statistics):
    return np.full(statistics.shape, np.nan)

def broken(statistics):
    return statistics.no_such_array

class Pieces:
    @staticmethod
    def ones(statistics):
        return np.ones(statistics.shape)
"""


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    (tmp_path / "my_pieces.py").write_text(PIECES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize("name", ["relative-mean", "relative-median", "absolute"])
@pytest.mark.parametrize("rule", ["deficit", "sqrt", "proportional"])
def test_a_named_measure_is_that_of_the_strategy_of_this_name(name, rule):
    by_measure = make_strategy(f"adaptive:measure={name},rule={rule}")
    strategy = make_strategy(f"{name}:rule={rule}")
    assert by_measure.needs == strategy.needs
    assert (by_measure.allocate(STATISTICS, 300) == strategy.allocate(STATISTICS, 300)).all()
    assert list(islice(by_measure.waves(), 9)) == list(islice(strategy.waves(), 9))


def test_the_half_buffer_is_a_measure():
    strategy = Adaptive(measure="half-buffer")
    assert strategy.needs == Needs(half=True)
    np.testing.assert_allclose(
        strategy.variance(STATISTICS, FLOOR), measures.half_buffer(STATISTICS) ** 2 * STATISTICS.count
    )


def test_a_measure_gets_the_floor_if_it_has_a_parameter_for_it():
    with_floor = Adaptive(measure=lambda statistics, floor: np.full(statistics.shape, floor))
    without = Adaptive(measure=lambda statistics: np.full(statistics.shape, 3))
    np.testing.assert_allclose(with_floor.variance(STATISTICS, 0.25), STATISTICS.count / 16)
    np.testing.assert_allclose(without.variance(STATISTICS, 0.25), STATISTICS.count * 9)


def test_what_a_measure_returns_is_not_written_to():
    """It may be an array of the statistics, which others read."""
    before = STATISTICS.mean.copy()
    Adaptive(measure=lambda statistics: statistics.mean, rule="sqrt").allocate(STATISTICS, 100)
    assert (STATISTICS.mean == before).all()


def test_a_rule_gets_what_it_has_parameters_for():
    seen = {}

    def rule(count, variance, budget, *, clip, wave_index, exponent):
        seen.update(clip=clip, wave_index=wave_index, exponent=exponent)
        assert count is STATISTICS.count
        return uniform_allocation(count.shape, budget, wave_index)

    strategy = Adaptive(measure="absolute", rule=rule, clip=0.75, exponent=2.0)
    assert strategy.allocate(STATISTICS, 77).sum() == 77
    assert seen == {"clip": 0.75, "wave_index": STATISTICS.samples, "exponent": 2.0}


def test_a_rule_is_a_parameter_of_every_strategy_with_rules():
    def rule(count, variance, budget):
        return distribute_in_proportion(variance, budget, 0)

    weights = Pooled(window=3).variance(STATISTICS, FLOOR)
    allocation = Pooled(window=3, rule=rule).allocate(STATISTICS, 1000)
    np.testing.assert_allclose(allocation, 1000 * weights / weights.sum(), atol=1)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda s: s.mean[0], r"float64 of shape \(5,\), sum .*shape \(6, 5\) \(height, width\)"),
        (lambda s: s.rgb, r"float32 of shape \(6, 5, 3\)"),
        (lambda s: s.mean.T, r"float64 of shape \(5, 6\)"),
        (lambda s: 1.0, r"float64 of shape \(\)"),
        (lambda s: None, r"object of shape \(\)"),
        (lambda s: s.mean + 0j, "complex128"),
        (lambda s: s.mean > 0, "bool"),
        (lambda s: np.where(s.mean == s.mean[2, 3], np.nan, 1), "nan in 1 pixel, first at x = 3, y = 2; .* 0 or more"),
        (lambda s: np.where(np.arange(5) > 2, -0.5, s.mean), "-0.5 in 12 pixels, first at x = 3, y = 0"),
    ],
)
def test_wrong_measures(returned, message):
    def my_measure(statistics):
        return returned(statistics)

    with pytest.raises(UserError, match=f"measure '.*my_measure' returned .*{message}"):
        Adaptive(measure=my_measure).allocate(STATISTICS, 100)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda count: uniform_allocation(count.shape, 99, 0), r"uint32 of shape \(6, 5\), sum 99; .* sum 100"),
        (lambda count: np.full(count.shape, 100 / 30), r"float64 of shape \(6, 5\), sum (100|99.9|100.0)"),
        (lambda count: np.full(count.shape, np.nan), r"float64 of shape \(6, 5\) with nan in it"),
        (lambda count: uniform_allocation(count.shape, 100, 0).astype(np.int64), "int64"),
        (lambda count: uniform_allocation(count.shape, 100, 0).ravel(), r"uint32 of shape \(30,\)"),
        (lambda count: None, "object"),
    ],
)
def test_wrong_rules(returned, message):
    def my_rule(count, variance, budget):
        return returned(count)

    with pytest.raises(UserError, match=f"allocation rule '.*my_rule' returned {message}.*distribute_in_proportion"):
        Adaptive(measure="absolute", rule=my_rule).allocate(STATISTICS, 100)


@pytest.mark.parametrize("kind", ["measure", "rule"])
@pytest.mark.parametrize(
    "function", [lambda: 0, lambda one, two, three, four: 0, 3, dict, lambda *, floor: 0, lambda statistics, /, x: 0]
)
def test_functions_with_other_parameters_are_refused_at_once(kind, function):
    with pytest.raises(UserError, match=r"(measure|rule) .*(is not a function|has to be a function of \()"):
        Adaptive(**{"measure": "absolute", kind: function})


@pytest.mark.usefixtures("user_module")
def test_names_of_modules_and_their_functions():
    import my_pieces

    spec = "adaptive:measure=my_pieces:contrast,rule=my_pieces:darkest,warmup=2"
    strategy = make_strategy(spec)
    assert (strategy.measure, strategy.rule) == (my_pieces.contrast, my_pieces.darkest)
    assert strategy.needs == Needs(half=True)
    assert describe(strategy).startswith("adaptive:rule=my_pieces:darkest,")
    assert vars(make_strategy(describe(strategy))) == vars(strategy)
    assert make_strategy("adaptive:measure=my_pieces:Pieces.ones").measure is my_pieces.Pieces.ones
    with pytest.raises(UserError, match=r"measure 'my_pieces:contrat': .*did you mean 'contrast'"):
        make_strategy("adaptive:measure=my_pieces:contrat")


@pytest.mark.usefixtures("user_module")
def test_names_of_entry_points(monkeypatch):
    import my_pieces

    entries = {
        "isonoise.measures": [EntryPoint("contrast", "my_pieces:contrast", "isonoise.measures")],
        "isonoise.allocation_rules": [EntryPoint("darkest", "my_pieces:darkest", "isonoise.allocation_rules")],
    }
    monkeypatch.setattr(lookup, "entry_points", lambda group: entries[group])
    strategy = make_strategy("adaptive:measure=contrast,rule=darkest")
    assert (strategy.measure, strategy.rule) == (my_pieces.contrast, my_pieces.darkest)
    with pytest.raises(UserError, match=r"there is no measure 'contras'.*did you mean 'contrast'"):
        make_strategy("adaptive:measure=contras")
    with pytest.raises(UserError, match="known are deficit, sqrt, proportional, darkest"):
        make_strategy("adaptive:measure=contrast,rule=brightest")


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("pooled", True),
        ("pooled:rule=deficit,window=7", True),
        ("pooled:rule=module:function", False),
        ("pooled:rule=installed", False),
        ("adaptive:measure=absolute,rule=sqrt", True),
        ("adaptive:rule=sqrt,measure=module:function", False),
        ("module:Class", False),
    ],
)
def test_a_checkpoint_does_not_choose_code(spec, expected):
    """`--resume` makes only strategies that import nothing else."""
    assert is_built_in(spec) == expected


@pytest.mark.usefixtures("user_module", "one_lane")
def test_a_render_with_a_rule_of_the_user():
    """The darkest pixel gets all samples of the adaptive waves, and the other ones the same number each."""
    spec = "adaptive:measure=my_pieces:contrast,rule=my_pieces:darkest,warmup=4,growth=0.5"
    with Renderer(lamp_over_floor(), strategy=spec) as renderer:
        records = [renderer.step() for _ in range(5)]
        count = np.sort(renderer.statistics().count.ravel())
        assert renderer.statistics().half is not None
    uniform = sum(record.samples for record in records if record.kind == "uniform") // PIXELS
    assert [record.kind for record in records] == ["uniform", "adaptive"] * 2 + ["uniform"]
    assert (count[:-2] == uniform).all()
    assert count.sum() == sum(record.samples for record in records)


def render_with(measure, image):
    """The exit code of a command with this measure of the user's module."""
    strategy = f"adaptive:measure=my_pieces:{measure}"
    return main(["render", "cornell", "--size", "8x6", "--spp", "32", "--strategy", strategy, "-o", str(image)])


@pytest.mark.usefixtures("user_module", "one_lane")
def test_a_wrong_measure_ends_the_command_with_a_message(tmp_path, capfd):
    """Without a traceback, and the image so far is written."""
    image = tmp_path / "image.exr"
    assert render_with("unknown", image) == 2
    message = capfd.readouterr().err
    assert "measure 'my_pieces:unknown' returned nan in 48 pixels, first at x = 0, y = 0" in message
    assert "Traceback" not in message
    assert image.exists()


@pytest.mark.usefixtures("user_module", "one_lane")
def test_an_exception_of_a_measure_is_not_to_be_reported(tmp_path, capfd):
    """Its author finds the traceback and the line."""
    import my_pieces

    assert render_with("broken", tmp_path / "image.exr") == 70
    message = capfd.readouterr().err
    number = PIECES.splitlines().index("    return statistics.no_such_array") + 1
    assert f"{my_pieces.__file__}', line {number}, which is no part of isonoise" in message
    assert "Traceback" in message
    assert "please report" not in message
