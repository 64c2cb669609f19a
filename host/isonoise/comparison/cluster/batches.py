"""Renders reference batches on the workers of a Dask cluster, each on one worker; called by `runner`.

A reference has as many batches as one worker would render in its time; several workers take less.
"""

from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from isonoise.comparison.cluster.data import SCENE, ClusterData
from isonoise.comparison.cluster.job_dealer import JobDealer
from isonoise.comparison.cluster.jobs import ClusterJobs
from isonoise.comparison.cluster.run_worker import render_batch_on_worker, render_pilot_on_worker
from isonoise.comparison.cluster.workers import ClusterWorkers
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.reference_batch import Batch, Pilot


class _BatchJob(NamedTuple):
    scene: SceneEntry
    seed: int

    @property
    def title(self) -> str:
        return f"a batch of the reference of {self.scene.name}"


class ClusterBatches:
    """Renders on the workers of a cluster; the parameters are those of `ClusterRuns`."""

    def __init__(self, workers: ClusterWorkers, data: ClusterData, warn: Callable[[str], None]):
        self._workers, self._data, self._warn = workers, data, warn

    def allocation(self, scene: SceneEntry, pilot: Pilot) -> np.ndarray:
        """The allocation map of a batch."""
        job = _BatchJob(scene, pilot.seed)
        ((_, allocation),) = self._results([job], lambda job: (render_pilot_on_worker, pilot))
        return allocation

    def render(self, scene: SceneEntry, allocation: np.ndarray, seeds: range) -> Iterator[Batch]:
        """Batches with these seeds, in their order."""
        early, wanted = {}, iter(seeds)
        seed = next(wanted)
        jobs = [_BatchJob(scene, seed) for seed in seeds]
        for job, batch in self._results(jobs, lambda job: (render_batch_on_worker, allocation, job.seed)):
            early[job.seed] = batch
            while seed in early:
                yield early.pop(seed)
                seed = next(wanted, None)

    def _results(self, jobs: Sequence[_BatchJob], call: Callable[[_BatchJob], tuple]) -> Iterator[tuple]:
        """Jobs and their results, as they arrive. `call` is the function for a job, and its first arguments."""

        def begin(worker: str, job: _BatchJob) -> Coroutine:
            return self._render(worker, job.scene, self._data.missing(worker, job.scene, SCENE), *call(job))

        with ClusterJobs(self._workers, JobDealer(jobs, lambda job: job), begin, self._data.forget, self._warn) as all_:
            while not all_.is_done:
                for worker, job, result in all_.wait(lambda text: None):
                    all_.accept(worker)
                    yield job, result

    async def _render(
        self, worker: str, scene: SceneEntry, missing: dict[str, bytes], function: Callable, first: object, *arguments
    ) -> object:
        """Send the job, wait for its result and fetch it. `first` may be large."""
        data, client = self._data, self._workers.cluster.client
        await data.send(worker, scene, missing)
        sent = await client.scatter(first, workers=[worker], hash=False)
        arguments += (data.on_worker(worker, SCENE), data.is_compressed, self._workers.choices[worker])
        return await client.submit(function, sent, *arguments, pure=False, workers=[worker])
