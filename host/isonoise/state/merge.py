"""Adds renders of one scene with different seeds: `isonoise merge`.

Counts and means are merged with the pairwise update of Chan, Golub and LeVeque, "Algorithms for computing the sample
variance", 1983, equation 2.1, in float64.
"""

from collections.abc import Iterable, Sequence
from dataclasses import fields

import numpy as np

from isonoise.device.opencl import Device
from isonoise.errors import UserError
from isonoise.integrator.accumulator import Accumulator
from isonoise.integrator.statistics_stages import make_statistics_stages
from isonoise.state.merge_layers import merge_layers, state_layers
from isonoise.state.settings import differences_of
from isonoise.state.state import State, with_group
from isonoise.statistics import Needs, Statistics
from isonoise.strategies.uniform_allocation import MAX_COUNT

_SAME = ("version", "size", "max_depth", "parameters")
"""Settings of the renders that have to be equal, beside the scene."""
_OF_A_RENDER = ("seed", "strategy", "sampler", "device")
"""Settings that may differ; a merged state has them for each of its renders."""


def merge_states(states: Iterable[State], names: Sequence[str], device: Device) -> State:
    """Merge the renders of several states; the result can be merged again, but not continued.

    Parameters
    ----------
    states : iterable of State
        Of renders or merged ones. One of them at a time is in memory if the iterable makes them.
    names : sequence of str
        Names of the states in errors, such as their files.
    device : Device
        Computes the statistics of the renders.

    Returns
    -------
    State
        `values["merged"]["renders"]` has an entry for each render: its seed, strategy, sampler, device, samples and
        seconds. `arrays` has the statistics, in the scene's units, as the group `statistics`, and the layers that all
        renders have as the group `layers`.

    Raises
    ------
    UserError
        If the scenes differ, two renders have the same seed, or a pixel would have too many samples.
    """
    settings, statistics, layers, renders = None, None, {}, {}
    for name, state in zip(names, states, strict=True):
        settings = settings or dict(state.settings)
        differences = differences_of(settings, state.settings, _SAME)
        if differences:
            raise UserError(f"'{name}' is no render of the same scene as '{names[0]}': {'; '.join(differences)}")
        for render in _renders(state):
            seed = render["seed"]
            if seed in renders:
                raise UserError(
                    f"'{renders[seed][0]}' and '{name}' have the same seed, {seed}, and so the same samples; merge "
                    "renders with different --seed"
                )
            renders[seed] = name, render
        try:
            part = state_statistics(state, device)
        except ValueError as error:
            raise UserError(f"'{name}' is damaged: {error}") from error
        if statistics is None:
            statistics, layers = part, state_layers(state)
        else:
            settings["layers"] = [layer for layer in settings["layers"] if layer in state.settings["layers"]]
            layers = merge_layers(layers, statistics, state_layers(state), part)
            statistics = merge_two(statistics, part)
    planes = {field.name: getattr(statistics, field.name) for field in fields(Statistics)}
    arrays = with_group("statistics", {name: plane for name, plane in planes.items() if plane is not None})
    arrays |= with_group("layers", layers)
    settings = {name: value for name, value in settings.items() if name not in _OF_A_RENDER}
    return State(settings, {"merged": {"renders": [render for _, render in renders.values()]}}, arrays)


def _renders(state: State) -> list[dict[str, object]]:
    """What is stored about each render of a state."""
    if "merged" in state.values:
        return state.values["merged"]["renders"]
    loop = state.values.get("loop", {})
    own = {"samples": state.values["renderer"]["samples"], "elapsed_s": loop.get("elapsed_s", 0.0)}
    return [{name: state.settings[name] for name in _OF_A_RENDER} | own]


def state_statistics(state: State, device: Device) -> Statistics:
    """The statistics of all samples of a state, in the scene's units."""
    if "merged" in state.values:
        planes = state.group("statistics")
        return Statistics(**{"median": None} | planes)
    needs = Needs(**state.settings["needs"] | {"neighbours": None, "uniform": False})
    width, height = state.settings["size"]
    accumulator = Accumulator(make_statistics_stages(device, needs), (height, width), needs)
    accumulator.set_state(state.group("reduction"))
    return accumulator.statistics(state.settings["radiance_scale"])


def merge_two(a: Statistics, b: Statistics) -> Statistics:
    """The statistics of the samples of both, which are independent of each other.

    M_x is the mean of both, weighted by counts. The design effect is that of the parts, weighted by n s^2; a part with
    fewer than two samples has none. Statistics that one part lacks are left out.
    """
    n_a, n_b = a.count.astype(np.float64), b.count.astype(np.float64)
    n = n_a + n_b
    if (n > MAX_COUNT).any():
        raise UserError(f"a pixel would have more than {MAX_COUNT} samples")
    share = np.divide(n_b, n, out=np.zeros_like(n), where=n > 0)
    delta = b.mean - a.mean
    squares = np.maximum(n_a - 1, 0) * a.variance + np.maximum(n_b - 1, 0) * b.variance + delta * delta * n_a * share
    variance = np.divide(squares, n - 1, out=np.zeros_like(n), where=n >= 2)
    rgb = a.rgb + share[..., None] * (b.rgb.astype(np.float64) - a.rgb)
    has_median = a.median is not None and b.median is not None
    return Statistics(
        count=n.astype(np.uint32),
        rejected=a.rejected + b.rejected,
        rgb=rgb.astype(np.float32),
        mean=a.mean + share * delta,
        variance=variance,
        median=a.median + share * (b.median - a.median) if has_median else None,
        design_effect=_design_effect(a, b),
    )


def _design_effect(a: Statistics, b: Statistics) -> np.ndarray | None:
    if a.design_effect is None and b.design_effect is None:
        return None
    weighted, weights = np.zeros(a.shape), np.zeros(a.shape)
    for part in (a, b):
        weight = np.where(part.count >= 2, part.count * part.variance, 0.0)
        weights += weight
        weighted += weight if part.design_effect is None else weight * part.design_effect
    return np.divide(weighted, weights, out=np.ones(a.shape), where=weights > 0).astype(np.float32)
