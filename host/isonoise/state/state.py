"""State: everything that a render is at a moment, as plain values and named arrays.

`Renderer.state` and `RenderLoop.state` make it. Checkpoints and merging are built on it alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.errors import UserError


@dataclass(frozen=True)
class State:
    """Everything that a render is at a moment.

    host/docs/long-renders.md lists all values and arrays.

    Attributes
    ----------
    settings : dict
        What the image depends on: scene, hashes of its parts and files, strategy, sampler, seed, size, version. A
        render can only be continued with equal settings.
    values : dict of dict
        Numbers and texts by group: `renderer` (position in the schedule, wave in progress, counters), `strategy`, and
        `loop` (log, time, limits), which a `Renderer` without a render loop does not have.
    arrays : dict of str to array
        `GROUP/NAME` -> array. `reduction/` is the state of the stage `reduce` with shape (planes, height, width), so
        the state of some pixels is a slice of it.
    """

    settings: dict[str, object]
    values: dict[str, dict[str, object]]
    arrays: dict[str, np.ndarray]

    def group(self, name: str) -> dict[str, np.ndarray]:
        """The arrays of a group, by name without the group."""
        prefix = f"{name}/"
        return {key.removeprefix(prefix): array for key, array in self.arrays.items() if key.startswith(prefix)}


def copy_array(array: np.ndarray, name: str, reuse: State | None) -> np.ndarray:
    """A copy, in the memory of the array `GROUP/NAME` of the state `reuse` if it has one: new memory takes longer."""
    earlier = None if reuse is None else reuse.arrays.get(name)
    result = np.empty_like(array) if earlier is None else earlier
    result[:] = array
    return result


def with_group(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays named `GROUP/NAME`."""
    return {f"{name}/{key}": array for key, array in arrays.items()}


def split_strategy_state(name: str, state: Mapping[str, object]) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """Values and arrays of what `Strategy.state` of the strategy `name` returned; UserError if it cannot be stored."""
    values, arrays = {}, {}
    for key, value in state.items():
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, np.ndarray) and value.dtype != object:
            arrays[key] = value.copy()
        elif value is None or isinstance(value, (bool, int, float, str)):
            values[key] = value
        else:
            raise UserError(
                f"strategy '{name}' keeps '{key}', a {type(value).__name__}, from wave to wave, which cannot be "
                "stored: define state() and set_state() with arrays, numbers and texts (isonoise.Strategy)"
            )
    return values, arrays
