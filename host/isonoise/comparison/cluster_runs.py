"""Renders runs on the workers of a Dask cluster, one per worker at a time; called by `runner`.

A worker gets scene and reference with its first run of the scene. What it returns is the content of the run's file, as
if the run had been rendered in this process. Runs of Mitsuba 3 are rendered in this process, after the others.
"""

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future
from functools import lru_cache

from isonoise.comparison.checked_files import InvalidFileError
from isonoise.comparison.cluster_workers import ClusterWorkers, first_line
from isonoise.comparison.local_runs import LocalRuns
from isonoise.comparison.plan import SceneEntry
from isonoise.comparison.run_dealer import MAX_LOSSES, RunDealer
from isonoise.comparison.run_inputs import MAX_CACHED, RunInputs
from isonoise.comparison.run_order import PlannedRun
from isonoise.comparison.run_progress import RunProgress
from isonoise.comparison.run_task import RunStoppedError, RunTask
from isonoise.comparison.run_worker import render_on_worker
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.distributed.packing import pack_scene
from isonoise.errors import DeviceError, UserError
from isonoise.progress import ProgressBar

_WAIT_S = 0.2
"""Longest time between looks at the workers."""


class ClusterRuns:
    """Renders on the workers of a cluster.

    Parameters
    ----------
    inputs : RunInputs
        Scenes, references and tasks.
    workers : ClusterWorkers
        The workers.
    local : LocalRuns
        Renders the runs of Mitsuba 3.
    warn : callable
        For a line about a run that is rendered again because its worker is lost.
    """

    def __init__(self, inputs: RunInputs, workers: ClusterWorkers, local: LocalRuns, warn: Callable[[str], None]):
        self._inputs, self._workers, self._local, self._warn = inputs, workers, local, warn
        self._sent: dict[str, tuple[SceneEntry, object, object]] = {}  # worker -> scene, and what it has of it
        self._warmed_up: set[tuple[str, str, str]] = set()  # worker, scene, strategy
        self._running: dict[str, Future] = {}
        # workers of this machine get bytes faster than zlib makes them fewer
        self._compresses = workers.cluster.size is None
        self._packed = lru_cache(MAX_CACHED)(self._pack)

    def execute(
        self, runs: Sequence[PlannedRun], progress: RunProgress, on_finished: Callable[[PlannedRun, bytes], None]
    ) -> None:
        """As `LocalRuns.execute`. Raises DeviceError if the connection to the cluster is lost."""
        of_mitsuba = [run for run in runs if run.strategy.spec in MITSUBA_SAMPLERS]
        dealer = RunDealer(run for run in runs if run.strategy.spec not in MITSUBA_SAMPLERS)
        try:
            while not dealer.is_done:
                with ProgressBar() as bar:
                    while not any(future.done() for future in self._running.values()):
                        self._drop_lost(dealer)
                        self._begin_runs(dealer)
                        progress.show(bar, 0, f"{len(self._running)} runs on {len(self._workers.devices)} workers")
                        self._workers.wait(self._running.values(), _WAIT_S)
                for worker in [worker for worker, future in self._running.items() if future.done()]:
                    self._end_run(dealer, worker, on_finished)
        finally:
            for future in self._running.values():
                future.cancel()
            self._running.clear()
        self._local.execute(of_mitsuba, progress, on_finished)
        self._sent.clear()

    def _begin_runs(self, dealer: RunDealer) -> None:
        for worker, device in self._workers.devices.items():
            if worker not in self._running and (run := dealer.next_run(worker, device)) is not None:
                self._running[worker] = self._workers.start(self._render(worker, run, *self._prepared(worker, run)))

    def _prepared(self, worker: str, run: PlannedRun) -> tuple:
        """The task, what the worker lacks of the scene, and whether it has rendered no run of this kind yet."""
        key = (worker, run.scene.slug, run.strategy.slug)
        is_first = key not in self._warmed_up
        self._warmed_up.add(key)
        has_scene = worker in self._sent and self._sent[worker][0] == run.scene
        return self._inputs.task(run), None if has_scene else self._packed(run.scene), is_first

    def _pack(self, scene: SceneEntry) -> tuple[bytes, bytes]:
        """Scene and reference as bytes."""
        return pack_scene(self._inputs.scene(scene), self._compresses), pickle.dumps(self._inputs.reference(scene))

    async def _render(
        self, worker: str, run: PlannedRun, task: RunTask, data: tuple[bytes, bytes] | None, is_first: bool
    ) -> bytes:
        """In the thread of Dask's client: send the run, wait for its result and fetch it."""
        client, device = self._workers.cluster.client, self._workers.choices[worker]
        if data is not None:
            self._sent[worker] = (run.scene, *await client.scatter(list(data), workers=[worker], hash=False))
        _, scene, reference = self._sent[worker]
        arguments = (task, scene, self._compresses, reference, device, is_first)
        return await client.submit(render_on_worker, *arguments, pure=False, workers=[worker])

    def _end_run(self, dealer: RunDealer, worker: str, on_finished: Callable[[PlannedRun, bytes], None]) -> None:
        content = self._result(dealer, worker, self._running.pop(worker))
        if content is not None:
            try:
                on_finished(dealer.in_progress[worker], content)
            except InvalidFileError as error:
                self._lose(dealer, worker, f"its result is wrong: {error.reason}")
            else:
                dealer.finished(worker)

    def _result(self, dealer: RunDealer, worker: str, future: Future) -> bytes | None:
        """What the worker has returned; None if its run is lost. Raises UserError if no worker can render the run."""
        try:
            return future.result()
        except (CancelledError, RunStoppedError):
            self._lose(dealer, worker, "it has dropped the run")
        except DeviceError as error:
            self._workers.refuse(worker, str(error))
            self._lose(dealer, worker, "its device has failed")
        except UserError as error:
            raise UserError(f"{dealer.in_progress[worker].title}, worker {worker}: {error}") from error
        except Exception as error:  # whatever Dask or the installation of the worker raises
            self._workers.refuse(worker, first_line(error))
            self._lose(dealer, worker, "it has failed")
        return None

    def _drop_lost(self, dealer: RunDealer) -> None:
        """Other workers render what workers that are gone have not finished."""
        for worker in self._workers.update():
            if worker in self._running:
                self._running.pop(worker).cancel()
            self._lose(dealer, worker, "it has left the cluster")

    def _lose(self, dealer: RunDealer, worker: str, reason: str) -> None:
        self._sent.pop(worker, None)
        self._warmed_up = {key for key in self._warmed_up if key[0] != worker}
        run = dealer.lost(worker)
        if run is None:
            return
        if dealer.has_failed(run):
            raise UserError(f"{run.title}: {MAX_LOSSES} workers were lost while they rendered it; the last: {reason}")
        self._warn(f"{run.title} is rendered again: worker {worker} is lost, {reason}")
