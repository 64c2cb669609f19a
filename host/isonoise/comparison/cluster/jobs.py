"""Keeps the workers of a cluster busy with the jobs of a comparison; called by `runs` and `batches`."""

from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError, Future
from typing import Generic

from isonoise.comparison.cluster.job_dealer import MAX_LOSSES, Job, JobDealer
from isonoise.comparison.cluster.workers import ClusterWorkers, first_line
from isonoise.comparison.run_task import RunStoppedError
from isonoise.errors import DeviceError, UserError

_WAIT_S = 0.2
"""Longest time between looks at the workers."""


class ClusterJobs(Generic[Job]):
    """Jobs on their way. A context manager that drops those in progress at its end.

    Parameters
    ----------
    workers : ClusterWorkers
        The workers.
    dealer : JobDealer
        The jobs.
    begin : callable
        Called with a worker and a job; the coroutine that it returns has the job's result. It runs in the thread of
        Dask's client.
    on_lost : callable
        Called with a worker that has been lost, and so has what was sent to it.
    warn : callable
        For a line about a job that another worker does again. A job is named by its `title`.
    """

    def __init__(
        self,
        workers: ClusterWorkers,
        dealer: JobDealer[Job],
        begin: Callable[[str, Job], Coroutine],
        on_lost: Callable[[str], None],
        warn: Callable[[str], None],
    ):
        self._workers, self._dealer, self._begin = workers, dealer, begin
        self._on_lost, self._warn = on_lost, warn
        self._running: dict[str, Future] = {}

    def __enter__(self) -> "ClusterJobs":
        return self

    def __exit__(self, *exception) -> None:
        for future in self._running.values():
            future.cancel()
        self._running.clear()

    @property
    def is_done(self) -> bool:
        return self._dealer.is_done

    def wait(self, show: Callable[[str], None]) -> list[tuple[str, Job, object]]:
        """Wait until jobs are done; worker, job and result of each. The caller accepts each one, or reports a loss.

        `show` is called a few times per second with a text about the jobs in progress.

        Raises
        ------
        DeviceError
            If the connection to the cluster is lost, or no worker can render.
        UserError
            If a job fails that would fail anywhere.
        """
        while not any(future.done() for future in self._running.values()):
            for worker in self._workers.update():
                if worker in self._running:
                    self._running.pop(worker).cancel()
                self.report_loss(worker, "it has left the cluster")
            if self._workers.is_connected:
                self._start_idle_workers()
            show(f"{len(self._running)} of {len(self._workers.devices)} workers are rendering")
            self._workers.wait(self._running.values(), _WAIT_S)
        done = []
        for worker in [worker for worker, future in self._running.items() if future.done()]:
            result = self._result(worker, self._running.pop(worker))
            if result is not None:
                done.append((worker, self._dealer.in_progress[worker], result))
        return done

    def _start_idle_workers(self) -> None:
        for worker, device in self._workers.devices.items():
            if worker not in self._running and (job := self._dealer.next_job(worker, device)) is not None:
                self._running[worker] = self._workers.start(self._begin(worker, job))

    def accept(self, worker: str) -> None:
        """The result of the worker's job is sound."""
        self._dealer.finished(worker)

    def report_loss(self, worker: str, reason: str) -> None:
        """The worker's job, if it has one, has to be done again. Raises UserError if that has happened too often."""
        self._on_lost(worker)
        self._workers.look_again()
        job = self._dealer.lost(worker)
        if job is None:
            return
        if self._dealer.has_failed(job):
            raise UserError(f"{job.title}: {MAX_LOSSES} workers were lost while they rendered it; the last: {reason}")
        self._warn(f"{job.title} is rendered again: worker {worker} is lost, {reason}")

    def _result(self, worker: str, future: Future) -> object | None:
        """What the worker has returned; None if its job is lost."""
        try:
            return future.result()
        except (CancelledError, RunStoppedError):
            self.report_loss(worker, "it has dropped the job")
        except DeviceError as error:
            self._workers.refuse(worker, str(error))
            self.report_loss(worker, "its device has failed")
        except UserError as error:
            raise UserError(f"{self._dealer.in_progress[worker].title}, worker {worker}: {error}") from error
        except Exception as error:  # whatever Dask or the installation of the worker raises
            if self._workers.is_connected:
                self._workers.refuse(worker, first_line(error))
            self.report_loss(worker, "it has failed" if self._workers.is_connected else "there is no connection to it")
        return None
