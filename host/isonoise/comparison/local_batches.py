"""Renders reference batches one after the other in this process; called by `runner`."""

from collections.abc import Iterator

import numpy as np

from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.reference_batch import Batch, Pilot, render_batch, render_pilot
from isonoise.comparison.run_inputs import RunInputs
from isonoise.device.selection import select_device


class LocalBatches:
    """Renders on one device, `device` as for `select_device`."""

    def __init__(self, inputs: RunInputs, device: str | None):
        self._inputs, self._device = inputs, device

    def allocation(self, scene: SceneEntry, pilot: Pilot) -> np.ndarray:
        """The allocation map of a batch."""
        return render_pilot(pilot, self._inputs.scene(scene), select_device(self._device))

    def render(self, scene: SceneEntry, allocation: np.ndarray, seeds: range) -> Iterator[Batch]:
        """One batch: its time says how many follow."""
        yield render_batch(allocation, seeds[0], self._inputs.scene(scene), select_device(self._device))
