"""Strategies by name: specs, parameters, schedules, error messages."""

import inspect
import itertools
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from isonoise.errors import UserError
from isonoise.statistics import Needs
from isonoise.strategies import (
    DEFAULT_STRATEGY,
    Strategy,
    available_strategies,
    describe,
    lookup,
    make_strategy,
    registry,
)

USER_STRATEGY = '''
import numpy as np
from isonoise.strategies import Strategy, Wave

class Dark(Strategy):
    """Everything to the darkest pixel."""
    name = "dark"
    def __init__(self, *, spp: float = 2.0, fast: bool = False, label="none"):
        self.spp, self.fast, self.label = spp, fast, label
    def waves(self):
        while True:
            yield Wave("adaptive", self.spp)
    def allocate(self, statistics, budget):
        allocation = np.zeros(statistics.shape, np.uint32)
        allocation.flat[statistics.mean.argmin()] = budget
        return allocation

class Needy(Strategy):
    def __init__(self, *, power: float):
        self.power = power

NotOne = dict
'''


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    (tmp_path / "my_strategies.py").write_text(USER_STRATEGY)
    (tmp_path / "broken_strategies.py").write_text("import no_such_module_at_all")
    monkeypatch.chdir(tmp_path)


def first(strategy, k):
    return list(itertools.islice(strategy.waves(), k))


def test_the_built_in_strategies():
    assert available_strategies()[:3] == ["uniform", "pooled", "relative-median"]
    assert DEFAULT_STRATEGY == "pooled"
    assert make_strategy("pooled:window=7").needs == Needs(neighbours=7)
    assert make_strategy("pooled:unbiased=true").needs == Needs(uniform=True)
    assert make_strategy("tsallis").needs == Needs()  # q = 2 is in the variance
    assert make_strategy("relative-median").needs == Needs(median=True, chunk=5, batch=4)
    assert make_strategy("relative-median:chunk=9,batch=2").needs == Needs(median=True, chunk=9, batch=2)
    assert make_strategy("tsallis:q=1").needs == Needs(power=1.0)
    assert make_strategy("relative-mean").needs == make_strategy("uniform").needs == Needs()
    strategy = make_strategy("uniform")
    assert make_strategy(strategy) is strategy


@pytest.mark.parametrize("name", ["relative-mean", "relative-median", "pooled:ratio=1,growth=0.5"])
def test_uniform_and_adaptive_waves_alternate(name):
    waves = first(make_strategy(name), 40)
    assert (waves[0].kind, waves[0].spp) == ("uniform", 16)
    assert [w.kind for w in waves[1:]] == ["adaptive", "uniform"] * 19 + ["adaptive"]
    uniform = [w.spp for w in waves if w.kind == "uniform"]
    assert all(spp == int(spp) for spp in uniform)
    assert uniform[1:] == [w.spp for w in waves if w.kind == "adaptive"][:-1]  # 1:1


def test_without_alternation_every_wave_but_the_first_is_adaptive():
    waves = first(make_strategy("relative-mean:ratio=inf"), 12)
    assert [w.kind for w in waves] == ["uniform"] + ["adaptive"] * 11
    assert [w.spp for w in waves[:3]] == [16, 4, 5]


def test_the_ratio_is_in_samples():
    waves = first(make_strategy("relative-mean:ratio=3,warmup=8"), 21)
    assert waves[0].spp == 8
    for adaptive, uniform in itertools.pairwise(waves[1:3]):
        assert adaptive.spp == 3 * uniform.spp


@pytest.mark.parametrize("name", ["uniform", "relative-mean", "relative-median"])
def test_the_number_of_waves_is_logarithmic(name):
    spp = list(itertools.accumulate(w.spp for w in first(make_strategy(name), 200)))
    assert next(i for i, total in enumerate(spp) if total > 1e6) < 70
    assert all(w.spp >= 1 for w in first(make_strategy(f"{name}:growth=0.01,warmup=2"), 100))


def test_uniform_in_three_or_thirty_waves():
    thirty, three = make_strategy("uniform:wave_spp=4"), make_strategy("uniform:wave_spp=40")
    assert sum(w.spp for w in first(thirty, 30)) == sum(w.spp for w in first(three, 3)) == 120
    assert {w.kind for w in first(thirty, 30)} == {"uniform"}


@pytest.mark.parametrize(
    "spec",
    [
        "uniform",
        "uniform:wave_spp=4",
        "relative-mean:ratio=0.1,clip=0.99",
        "relative-median:kappa=inf,cap=inf",
        " relative-median:kappa=2.5, growth=1 ",
    ],
)
def test_describe_returns_a_spec_of_the_same_strategy(spec):
    strategy = make_strategy(spec)
    again = make_strategy(describe(strategy))
    assert type(again) is type(strategy)
    assert vars(again) == vars(strategy)
    assert describe(again) == describe(strategy)


def test_describe_writes_every_parameter():
    assert describe(make_strategy("uniform:wave_spp=4")) == "uniform:wave_spp=4,warmup=16,growth=0.25"
    assert "kappa=8," in describe(make_strategy("relative-median"))


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_built_in_strategies_describe_themselves_and_document_their_parameters(name):
    required = {"oracle": ":file=variance.exr", "adaptive": ":measure=absolute"}
    strategy = make_strategy(name + required.get(name, ""))
    assert strategy.name == name
    again = make_strategy(describe(strategy))
    assert type(again) is type(strategy)
    assert vars(again) == vars(strategy)
    documentation = "".join(cls.__doc__ for cls in type(strategy).__mro__ if issubclass(cls, Strategy))
    for parameter in inspect.signature(type(strategy)).parameters:
        assert f"\n    {parameter} : " in documentation, parameter


@pytest.mark.usefixtures("user_module")
def test_custom_classes():
    strategy = make_strategy("my_strategies:Dark")
    assert isinstance(strategy, Strategy)
    assert describe(strategy) == "my_strategies:Dark:spp=2,fast=false,label=none"
    strategy = make_strategy("my_strategies:Dark:spp=0.5,fast=true,label=a")
    assert (strategy.spp, strategy.fast, strategy.label) == (0.5, True, "a")
    assert vars(make_strategy(describe(strategy))) == vars(strategy)
    assert make_strategy("my_strategies:Needy:power=2").power == 2.0


@pytest.mark.usefixtures("user_module")
def test_names_from_entry_points(monkeypatch):
    entries = [
        EntryPoint("dark", "my_strategies:Dark", "isonoise.strategies"),
        EntryPoint("broken", "broken_strategies:X", "isonoise.strategies"),
        EntryPoint("uniform", "my_strategies:Dark", "isonoise.strategies"),  # a built-in name takes precedence
    ]
    monkeypatch.setattr(lookup, "entry_points", lambda group: [entry for entry in entries if entry.group == group])
    assert available_strategies()[-3:] == ["luxcore", "broken", "dark"]
    monkeypatch.syspath_prepend(".")
    assert make_strategy("dark:spp=3").spp == 3.0
    assert type(make_strategy("uniform")).__name__ == "Uniform"
    with pytest.raises(UserError, match="no_such_module_at_all"):
        make_strategy("broken")


@pytest.mark.usefixtures("user_module")
@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("unifrom", "did you mean 'uniform'"),
        ("", "known are uniform, pooled, relative-median"),
        ("uniform:wave_sp=3", "did you mean 'wave_spp'"),
        ("uniform:3", "key=value"),
        ("uniform:", "key=value"),
        ("uniform:wave_spp=", "key=value"),
        ("uniform:warmup=1,warmup=2", "given twice"),
        ("uniform:warmup=1.5", "a whole number"),
        ("relative-mean:ratio=much", "a number"),
        ("relative-mean:ratio=0", "from 0.01"),
        ("relative-mean:ratio=nan", "from 0.01"),
        ("relative-mean:growth=inf", "0.01 to 4"),
        ("relative-mean:rule=best", "deficit, sqrt, proportional"),
        ("relative-mean:rule=defict", "did you mean 'deficit'"),
        ("adaptive", "needs measure="),
        ("adaptive:measure=relative_mean", "did you mean 'relative-mean'"),
        ("adaptive:measure=my_strategies:drak", "measure 'my_strategies:drak': .* has no 'drak'"),
        ("adaptive:measure=my_strategies:Dark", "is not a function"),
        ("adaptive:measure=my_strategies:np", "is not a function"),
        ("relative-median:chunk=4", "odd"),
        ("pooled:window=4", "odd"),
        ("tsallis:q=0", "0.1 to 8"),
        ("relative-mean:cap=1", "from 2"),
        ("relative-mean:cap=2.5", "whole number"),
        ("relative-median:kappa=0.5", "from 1"),
        ("relative-median:clip=0", "0.5 to 1"),
        ("relative-median:warmup=1", "2 to 65536"),
        ("uniform:wave_spp=-1", "from 0"),
        ("no_such_module:Class", "cannot import"),
        ("broken_strategies:X", "no_such_module_at_all"),
        ("my_strategies:Drak", "did you mean 'Dark'"),
        ("my_strategies:NotOne", "not a subclass"),
        ("my_strategies:Needy", "power="),
        ("my_strategies:Dark:fast=maybe", "true or false"),
    ],
)
def test_error_messages(spec, message):
    with pytest.raises(UserError, match=message):
        make_strategy(spec)


def test_allocations_are_repeatable():
    from isonoise.statistics import Statistics

    rng = np.random.default_rng(1)
    mean = rng.lognormal(size=(9, 8))
    count = np.full(mean.shape, 16, np.uint32)
    s = Statistics(count, np.zeros_like(count), np.zeros((9, 8, 3), np.float32), mean, mean**2, mean / 2)
    for name in ("relative-mean", "relative-median", "pooled", "relative-mean:rule=proportional"):
        a, b = make_strategy(name), make_strategy(name)
        assert (a.allocate(s, 100) == b.allocate(s, 100)).all()
        assert (a.allocate(s, 100) == b.allocate(s, 100)).all()  # no state: the same after a resume
