"""The state of a render: continued renders have the bits of unbroken ones, and merged ones are exact."""

import copy
import dataclasses
import itertools

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.loop import Periodic, RenderLoop, Stops, render_loop
from isonoise.renderer import Renderer
from isonoise.selftest.synthetic_samples import Reducer, luminance32
from isonoise.state.checkpoint import read_checkpoint, write_checkpoint
from isonoise.state.merge import merge_states
from isonoise.state.state import State
from isonoise.statistics import Needs
from isonoise.strategies import Strategy, Wave
from isonoise.strategies.registry import BUILT_IN

POOL_SIZE = 32
"""Small, so that a wave has many places at which it can stop."""
SHORT = ("pooled", "pooled:unbiased=true", "luxcore:step=4,warmup=4", "dammertz:smallest=1,step=4,threshold=0.02")
OTHERS = [name for name in BUILT_IN if name not in ("oracle", *SHORT)] + ["tsallis:q=1.5"]


def make_loop(strategy: str, stops: Stops, **options) -> RenderLoop:
    return RenderLoop(Renderer(lamp_over_floor(), strategy=strategy, pool_size=POOL_SIZE), stops, **options)


def rows_without_times(rows) -> str:
    return repr([dataclasses.replace(row, elapsed_s=0.0) for row in rows])


@pytest.mark.parametrize("strategy", [*SHORT, *(pytest.param(name, marks=pytest.mark.long) for name in OTHERS)])
def test_a_continued_render_has_the_bits_of_an_unbroken_one(strategy, tmp_path):
    """Stopped at random places, in waves and between them, and continued from files each time."""
    stops = Stops(spp=60)
    unbroken = make_loop(strategy, stops).run()
    random, path, state, parts = np.random.default_rng(1), tmp_path / "state.npz", None, 0
    while True:
        left = itertools.repeat(False, int(random.integers(2, 25 if parts < 8 else 10**6)))
        loop = make_loop(
            strategy,
            stops,
            state=state,
            should_stop=lambda left=left: next(left, True),
            on_end=lambda loop: write_checkpoint(path, loop.state()),
        )
        outcome = loop.run()
        parts += 1
        if outcome.reason != "interrupted":
            break
        state = read_checkpoint(path)
    assert parts > 5
    assert_same_bits(outcome.statistics, unbroken.statistics)
    assert rows_without_times(outcome.rows) == rows_without_times(unbroken.rows)
    assert outcome.stated_error == unbroken.stated_error


def test_periodic_actions_change_nothing_and_give_states_to_continue_from():
    stops, states = Stops(spp=60), []
    unbroken = make_loop("pooled", stops).run()
    outcome = make_loop("pooled", stops, periodic=[Periodic(0.01, lambda loop: states.append(loop.state()))]).run()
    assert_same_bits(outcome.statistics, unbroken.statistics)
    assert any(state.values["renderer"]["wave"] for state in states)  # in the middle of a wave
    for state in states[:: len(states) // 4]:
        assert_same_bits(make_loop("pooled", stops, state=state).run().statistics, unbroken.statistics)


def test_limits_may_be_raised():
    states = []
    make_loop("pooled", Stops(spp=16), on_end=lambda loop: states.append(loop.state())).run()
    outcome = make_loop("pooled", Stops(spp=40), state=states[0]).run()
    assert outcome.reason == "spp"
    assert outcome.statistics.samples == 40 * outcome.statistics.count.size
    assert [row.wave for row in outcome.rows] == list(range(1, len(outcome.rows) + 1))


def finished_state(scene: dict | None = None, spp: float = 4, **options) -> State:
    states = []
    renderer = Renderer(scene or lamp_over_floor(), pool_size=POOL_SIZE, **options)
    render_loop(renderer, Stops(spp=spp), on_end=lambda loop: states.append(loop.state()))
    return states[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strategy": "uniform"}, "the strategy was pooled:.* and is now uniform"),
        ({"seed": 1}, "the seed was 0 and is now 1"),
        ({"size": (8, 5)}, "the image size was 7x5 and is now 8x5"),
        ({"sampler": "independent"}, "the sampler was sobol and is now independent"),
        ({"max_depth": 3}, "the max_depth was 4 and is now 3"),
        (
            {"scene": lamp_over_floor(radiance=6.0)},
            "the scene .* differs from .* in: lights",
        ),
    ],
)
def test_other_settings_are_refused_by_name(options, message):
    state = finished_state()
    renderer = Renderer(options.pop("scene", lamp_over_floor()), pool_size=POOL_SIZE, **options)
    with pytest.raises(UserError, match=message):
        renderer.restore(state)


def test_a_changed_file_is_named(tmp_path):
    text = (
        '<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"><rfilter type="box"/></film></sensor>'
    )
    text += '<shape type="rectangle"><emitter type="area"/></shape><shape type="obj">'
    text += '<boolean name="face_normals" value="true"/><string name="filename" value="m.obj"/></shape></scene>'
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 {z}\nf 1 2 3\n"
    (tmp_path / "scene.xml").write_text(text)
    (tmp_path / "m.obj").write_text(mesh.format(z=0))

    def make():
        return Renderer(str(tmp_path / "scene.xml"), size=(7, 5), strategy="uniform")

    state = make().state()
    (tmp_path / "scene.xml").write_text(text + "<!-- no effect -->")
    make().restore(state)
    (tmp_path / "m.obj").write_text(mesh.format(z=1))
    with pytest.raises(UserError, match=r"'m\.obj' has changed"):
        make().restore(state)
    renderer = make()
    (tmp_path / "m.obj").unlink()
    assert renderer.state().settings["files"]["m.obj"] is None  # removed before the first checkpoint


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        ("renderer", "planner", {}),
        ("renderer", "wave", {"kind": "uniform"}),
        ("strategy", "waves", 1),
        ("strategy", "warmup", 3),
        ("loop", None, None),
        (None, "reduction/sums", np.zeros((10, 5, 6), np.float32)),
        (None, "reduction/sums", np.zeros((10, 5, 7))),
    ],
)
def test_states_that_do_not_fit_are_refused(group, name, value):
    state = copy.deepcopy(finished_state())
    if group is None:
        state.arrays[name] = value
    elif name is None:
        del state.values[group]
    else:
        state.values[group][name] = value
    with pytest.raises(UserError, match="the render cannot be continued: its state is"):
        make_loop("pooled", Stops(spp=8), state=state)


class _Forgetful(Strategy):
    name = "forgetful"

    def __init__(self):
        self.generator = np.random.default_rng(1)

    def waves(self):
        while True:
            yield Wave("uniform", 1)


def test_what_a_strategy_keeps_has_to_be_storable():
    renderer = Renderer(lamp_over_floor(), strategy=_Forgetful())
    with pytest.raises(UserError, match=r"'forgetful' keeps 'generator', a Generator, .* define state"):
        renderer.state()


# merge


def synthetic_state(device: Device, needs: Needs, samples: list[np.ndarray], seed: int) -> State:
    """The state of an image of one row with these samples."""
    reducer = Reducer(device, len(samples), needs)
    reducer.add(samples)
    settings = {
        "version": "1", "size": [len(samples), 1], "max_depth": 1, "parameters": {}, "scene": "s", "scene_parts": {},
        "files": {}, "scene_hash": "", "radiance_scale": 1.0, "needs": dataclasses.asdict(needs), "seed": seed,
        "layers": [], "strategy": "uniform", "sampler": "independent", "device": "d",
    }  # fmt: skip
    count = sum(map(len, samples))
    arrays = {f"reduction/{name}": array for name, array in reducer.accumulator.state().items()}
    return State(settings, {"renderer": {"samples": count}}, arrays)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device()


def test_a_merged_render_has_the_statistics_of_all_samples(device):
    """Four renders with 0 to 40 samples in a pixel, of different sizes in each; against float64."""
    random, needs = np.random.default_rng(2), Needs(nets=True)
    samples = [
        [2.0**k * random.gamma(0.3, 3.0, random.integers(0, 40)).astype(np.float32) for k in range(-20, 20)]
        for _ in range(4)
    ]
    states = [synthetic_state(device, needs, part, seed) for seed, part in enumerate(samples)]
    together = [luminance32(np.concatenate(parts)) for parts in zip(*samples, strict=True)]
    pairs = [merge_states(states[k : k + 2], ["a", "b"], device) for k in (0, 2)]
    for merged in (merge_states(states, "abcd", device), merge_states(pairs, "ab", device)):
        statistics = merged.group("statistics")
        assert statistics["count"].ravel().tolist() == list(map(len, together))
        np.testing.assert_allclose(statistics["mean"].ravel(), [x.mean() for x in together], rtol=1e-6)
        np.testing.assert_allclose(statistics["variance"].ravel(), [x.var(ddof=1) for x in together], rtol=1e-6)
        assert [render["seed"] for render in merged.values["merged"]["renders"]] == [0, 1, 2, 3]


def test_merging_refuses_what_does_not_belong_together(device):
    state = finished_state()
    with pytest.raises(UserError, match="'a' and 'b' have the same seed, 0"):
        merge_states([state, state], "ab", device)
    with pytest.raises(UserError, match="'b' is no render of the same scene as 'a': the image size was 7x5"):
        merge_states([state, finished_state(seed=1, size=(8, 5))], "ab", device)
    with pytest.raises(UserError, match="in: lights"):
        merge_states([state, finished_state(lamp_over_floor(radiance=6.0), seed=1)], "ab", device)
    merged = merge_states([state, finished_state(seed=1)], "ab", device)
    with pytest.raises(UserError, match="'a' and 'b' have the same seed, 1"):
        merge_states([merged, finished_state(seed=1)], "ab", device)


def test_a_merged_render_cannot_be_continued(device):
    merged = merge_states([finished_state(), finished_state(seed=1)], "ab", device)
    with pytest.raises(UserError, match="merged"):
        make_loop("pooled", Stops(spp=8), state=merged)
