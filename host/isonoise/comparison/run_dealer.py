"""Decides which worker of a cluster renders which run next; called by `cluster_runs`. Pure logic without times.

The runs of a scene and a seed go to one worker, one after the other: figures are ratios of strategies, paired over the
seeds, so that a slow worker affects both sides of a ratio. A worker for which no scene and seed is left helps one that
has the same device, from the end of its runs.
"""

from collections import deque
from collections.abc import Iterable
from itertools import groupby

from isonoise.comparison.run_order import PlannedRun

MAX_LOSSES = 3
"""Workers that a run may lose: a run that ends its workers, by their memory for example, would end all of them."""


class RunDealer:
    """Deals runs to workers, one per worker at a time.

    Parameters
    ----------
    runs : iterable of PlannedRun
        In the order of the plan.

    Attributes
    ----------
    in_progress : dict of str to PlannedRun
        Worker -> its run.
    """

    def __init__(self, runs: Iterable[PlannedRun]):
        groups = groupby(runs, key=lambda run: (run.scene, run.seed))
        self._waiting = deque(deque(group) for _, group in groups)  # no worker has begun these
        self._begun: dict[str, tuple[str, deque[PlannedRun]]] = {}  # worker -> its device, the rest of its group
        self._losses: dict[PlannedRun, int] = {}
        self.in_progress: dict[str, PlannedRun] = {}

    @property
    def is_done(self) -> bool:
        return not self.in_progress and not self._waiting and not any(rest for _, rest in self._begun.values())

    def next_run(self, worker: str, device: str) -> PlannedRun | None:
        """The run that the idle worker is to render now; None: nothing for it."""
        rest = self._begun[worker][1] if worker in self._begun else deque()
        if not rest and self._waiting:
            rest = self._waiting.popleft()
        self._begun[worker] = (device, rest)
        if not rest:
            rest = self._longest_rest(device)
            if not rest:
                return None
            self.in_progress[worker] = rest.pop()
        else:
            self.in_progress[worker] = rest.popleft()
        return self.in_progress[worker]

    def finished(self, worker: str) -> PlannedRun:
        """The worker has finished its run."""
        return self.in_progress.pop(worker)

    def lost(self, worker: str) -> PlannedRun | None:
        """The worker is gone, and its run if it had one: others get what it has not finished, before other runs."""
        run = self.in_progress.pop(worker, None)
        rest = self._begun.pop(worker, ("", deque()))[1]
        if run is not None:
            self._losses[run] = self._losses.get(run, 0) + 1
            rest.appendleft(run)
        if rest:
            self._waiting.appendleft(rest)
        return run

    def has_failed(self, run: PlannedRun) -> bool:
        """Whether the run has lost so many workers that no other should try it."""
        return self._losses.get(run, 0) >= MAX_LOSSES

    def _longest_rest(self, device: str) -> deque[PlannedRun]:
        """The most runs that a worker with the same device has before it."""
        rests = [rest for other, rest in self._begun.values() if other == device]
        return max(rests, key=len, default=deque())
