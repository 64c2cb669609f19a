"""Renders runs on the workers of a Dask cluster, one per worker at a time; called by `runner`.

A worker gets scene and reference with its first run of the scene. What it returns is the content of the run's file, as
if the run had been rendered in this process. Runs of Mitsuba 3 are rendered in this process, after the others.
"""

from collections.abc import Callable, Coroutine, Sequence

from isonoise.comparison.checked_files import InvalidFileError
from isonoise.comparison.cluster.data import REFERENCE, SCENE, ClusterData
from isonoise.comparison.cluster.job_dealer import JobDealer
from isonoise.comparison.cluster.jobs import ClusterJobs
from isonoise.comparison.cluster.run_worker import render_on_worker
from isonoise.comparison.cluster.workers import ClusterWorkers
from isonoise.comparison.local_runs import LocalRuns
from isonoise.comparison.run_inputs import RunInputs
from isonoise.comparison.run_order import PlannedRun
from isonoise.comparison.run_progress import RunProgress
from isonoise.comparison.run_task import RunTask
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.progress import ProgressBar


class ClusterRuns:
    """Renders on the workers of a cluster.

    Parameters
    ----------
    inputs : RunInputs
        Scenes, references and tasks.
    workers : ClusterWorkers
        The workers.
    data : ClusterData
        What the workers have.
    local : LocalRuns
        Renders the runs of Mitsuba 3.
    warn : callable
        For a line about a run that is rendered again because its worker is lost.
    """

    def __init__(
        self,
        inputs: RunInputs,
        workers: ClusterWorkers,
        data: ClusterData,
        local: LocalRuns,
        warn: Callable[[str], None],
    ):
        self._inputs, self._workers, self._data = inputs, workers, data
        self._local, self._warn = local, warn
        self._warmed_up: set[tuple[str, str, str]] = set()  # worker, scene, strategy

    def execute(
        self, runs: Sequence[PlannedRun], progress: RunProgress, on_finished: Callable[[PlannedRun, bytes], None]
    ) -> None:
        """As `LocalRuns.execute`. Raises DeviceError if the connection to the cluster is lost."""
        own = [run for run in runs if run.strategy.spec not in MITSUBA_SAMPLERS]
        dealer = JobDealer(own, lambda run: (run.scene, run.seed))
        with ClusterJobs(self._workers, dealer, self._begin, self._forget, self._warn) as jobs:
            while not jobs.is_done:
                with ProgressBar() as bar:
                    done = jobs.wait(lambda text, bar=bar: progress.show(bar, 0, text))
                for worker, run, content in done:
                    try:
                        on_finished(run, content)
                    except InvalidFileError as error:
                        jobs.report_loss(worker, f"its result is wrong: {error.reason}")
                    else:
                        jobs.accept(worker)
        self._local.execute([run for run in runs if run.strategy.spec in MITSUBA_SAMPLERS], progress, on_finished)

    def _begin(self, worker: str, run: PlannedRun) -> Coroutine:
        key = (worker, run.scene.slug, run.strategy.slug)
        is_first = key not in self._warmed_up
        self._warmed_up.add(key)
        missing = self._data.missing(worker, run.scene, SCENE, REFERENCE)
        return self._render(worker, run, self._inputs.task(run), missing, is_first)

    async def _render(
        self, worker: str, run: PlannedRun, task: RunTask, missing: dict[str, bytes], is_first: bool
    ) -> bytes:
        """Send the run, wait for its result and fetch it."""
        data = self._data
        await data.send(worker, run.scene, missing)
        scene, reference = (data.on_worker(worker, kind) for kind in (SCENE, REFERENCE))
        device = self._workers.choices[worker]
        client = self._workers.cluster.client
        sent = await client.scatter(task, workers=[worker], hash=False)  # an oracle has an image
        arguments = (sent, scene, data.is_compressed, reference, device, is_first)
        return await client.submit(render_on_worker, *arguments, pure=False, workers=[worker])

    def _forget(self, worker: str) -> None:
        self._data.forget(worker)
        self._warmed_up = {key for key in self._warmed_up if key[0] != worker}
