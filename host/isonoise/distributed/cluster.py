"""A Dask cluster to render on: one that is there, or worker processes on this machine.

`Renderer` and `isonoise compare` use it. Nothing here listens on other addresses than 127.0.0.1: a cluster that spans
machines is started with Dask's own tools, and `Cluster.connect` gets the address of its scheduler.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from isonoise import __version__
from isonoise.distributed.dask_worker import DeviceChoice, TracerSettings, other_version
from isonoise.errors import DeviceError, UserError
from isonoise.scene.compiled_scene import CompiledScene
from isonoise.signals import deferred, raise_if_received
from isonoise.statistics import Needs

if TYPE_CHECKING:
    from isonoise.distributed.dask_pool import DaskPool

CONNECT_TIMEOUT_S = 5.0
_LOOPBACK = "127.0.0.1"
_CLOSE_TIMEOUT_S = 5.0
_SILENT = logging.CRITICAL + 1
_LOCAL_CONFIG = {
    "distributed.scheduler.work-stealing": False,  # tasks are dealt by measured speed, and must stay where they are
    "distributed.nanny.pre-spawn-environ": {},  # would change the environment of this process, too
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.disk": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.scheduler.active-memory-manager.start": False,
}
"""Dask's settings for the processes of `Cluster.local`. Its own measurements would take 2 % of a core."""


class Cluster:
    """Workers of a Dask cluster. Made by `connect` or `local`; a context manager that calls `close`.

    Attributes
    ----------
    client : distributed.Client
        The connection to the cluster.
    size : int or None
        Worker processes of `local`; None: they come and go.
    device_of : callable
        What the worker with a name (`name` of Dask's scheduler_info) renders on.
    on_wait : callable
        Called by `pool` with the number of workers that are being prepared, again and again while none is ready.

    Examples
    --------
    >>> with isonoise.Cluster.local(2) as cluster:
    ...     outcome = isonoise.render("cornell", spp=64, cluster=cluster)
    """

    def __init__(
        self, client: Any, device_of: Callable[[object], DeviceChoice], stack: ExitStack, size: int | None = None
    ):
        self.client, self.size = client, size
        self.device_of, self._stack = device_of, stack
        self.on_wait: Callable[[int], None] = lambda workers: None

    @classmethod
    def connect(cls, address: str, device: str | None = None) -> "Cluster":
        """Use the workers of the scheduler at an address.

        Parameters
        ----------
        address : str
            Such as `tcp://10.0.0.1:8786`. With `tls://` Dask's own configuration names the certificates.
        device : str or None
            What each worker renders on, as for `select_devices`; of several devices the first.

        Raises
        ------
        UserError
            If Dask is missing or the address is wrong; DeviceError if no scheduler answers.
        """
        distributed = _load_distributed()
        with ExitStack() as stack:
            stack.enter_context(_quiet_logs())
            _check_scheduler(distributed, address)
            client = _connect(distributed, address)
            stack.callback(_suppressed(client.close), timeout=_CLOSE_TIMEOUT_S)
            return cls(client, lambda name: DeviceChoice(device), stack.pop_all())

    @classmethod
    def local(cls, workers: int, device: str | None = None) -> "Cluster":
        """Start worker processes on this machine. They listen on 127.0.0.1 alone, and end with this process.

        A script that calls this needs `if __name__ == "__main__":`, because each process imports it.

        Parameters
        ----------
        workers : int
            Processes, 1 or more.
        device : str or None
            As for `select_devices`. Worker k takes device k of them; a single CPU is split among the workers.

        Raises
        ------
        UserError
            If Dask is missing or a parameter is wrong; DeviceError if there is no such device.
        """
        if workers < 1:
            raise UserError(f"workers = {workers} must be 1 or more")
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise UserError(
                "a worker process has run the script that started it: put the start of the cluster below the line "
                "`if __name__ == '__main__':`"
            )
        distributed = _load_distributed()
        choice = _split_device(device, workers)
        import dask

        with ExitStack() as stack:
            stack.enter_context(_quiet_logs())
            stack.enter_context(dask.config.set(_LOCAL_CONFIG))
            with _terminal_signals_blocked():  # in all threads that are started here, and in their processes
                cluster = distributed.LocalCluster(
                    n_workers=0,
                    threads_per_worker=1,
                    host=_LOOPBACK,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": f"{_LOOPBACK}:0"},
                    memory_limit=None,
                    silence_logs=_SILENT,
                )
            stack.callback(_suppressed(cluster.close), timeout=_CLOSE_TIMEOUT_S)
            stack.callback(_kill_workers, cluster)
            cluster.scale(workers)
            client = _connect(distributed, cluster)
            stack.callback(_suppressed(client.close), timeout=_CLOSE_TIMEOUT_S)
            return cls(client, lambda name: DeviceChoice(choice, int(name)), stack.pop_all(), workers)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """End the connection, and the processes of `local`."""
        with deferred():
            self._stack.close()

    @property
    def name(self) -> str:
        """What it is, for people."""
        return f"{self.size} local workers" if self.size else f"Dask cluster at {self.client.scheduler.address}"

    def check_processes(self) -> None:
        """Raise DeviceError if all processes of `local` have failed to start."""
        processes = self.client.cluster.workers.values() if self.size else ()
        if processes and all(each.status.name in ("failed", "closed") for each in processes):
            raise DeviceError("the worker processes have failed to start; their messages above say why")

    def _while_waiting(self, workers: int) -> None:
        self.check_processes()
        self.on_wait(workers)

    def pool(
        self,
        scene: CompiledScene,
        needs: Needs,
        pool_size: int | None = None,
        memory: int | None = None,
    ) -> "DaskPool":
        """Send a scene to the workers, and wait until one is ready for tasks. The others join as they get ready.

        Parameters
        ----------
        scene, needs, pool_size, memory
            As for `ShardTracer`.

        Returns
        -------
        DaskPool

        Raises
        ------
        DeviceError
            If no worker can render the scene, or the connection is lost.
        """
        from isonoise.distributed.dask_pool import DaskPool

        settings = TracerSettings(needs, pool_size, memory)
        pool = DaskPool(self.client, self.device_of, scene, settings, self.size or 0)
        try:
            pool.wait_for_worker(self._while_waiting)
        except BaseException:
            pool.close()
            raise
        return pool


def _load_distributed():
    try:
        with deferred():
            import distributed
    except ImportError as error:
        raise UserError(f"a cluster needs Dask ({error}); install it with: pip install 'isonoise[cluster]'") from error
    raise_if_received()
    return distributed


def _connect(distributed, address):
    """A client that leaves Dask's defaults of this process as they are."""
    with deferred():
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    raise_if_received()
    return client


def _check_scheduler(distributed, address: str) -> None:
    """Raise an error for the user unless a scheduler answers: what `Client` does with one that does not is long."""

    async def identify() -> tuple[str, str | None]:
        """What answers, and its version of isonoise."""
        arguments = distributed.Security().get_connection_args("client")
        async with distributed.rpc(address, timeout=CONNECT_TIMEOUT_S, connection_args=arguments) as scheduler:
            kind = (await asyncio.wait_for(scheduler.identity(), 2 * CONNECT_TIMEOUT_S))["type"]
            return kind, (await scheduler.versions(packages=["isonoise"]))["packages"]["isonoise"]

    try:
        with deferred():
            kind, version = asyncio.run(identify())
    except (OSError, asyncio.TimeoutError, MemoryError) as error:  # MemoryError: another service answers
        raise DeviceError(
            f"no Dask scheduler answers at {address} ({_cause(error)}); check the address that `dask scheduler` "
            "has printed, and that this machine can reach it"
        ) from error
    except (ValueError, TypeError, LookupError) as error:
        secure = "; tls:// needs the certificates in Dask's configuration (distributed.comm.tls)"
        raise UserError(
            f"cannot connect to the Dask scheduler '{address}': {_first_line(error)}; give an address such as "
            f"tcp://127.0.0.1:8786{secure if address.startswith('tls:') else ''}"
        ) from error
    raise_if_received()
    if kind != "Scheduler":
        raise UserError(f"at {address} is no Dask scheduler but a {kind.lower()}; give the address of the scheduler")
    if version != __version__:
        raise UserError(f"the Dask scheduler at {address} {other_version(version)}")


def _cause(error: BaseException) -> str:
    """What the operating system said, if it said something: Dask wraps it several times."""
    text = "another service does" if isinstance(error, MemoryError) else _first_line(error)
    while error is not None:
        if isinstance(error, OSError) and error.strerror:
            text = error.strerror
        error = error.__cause__ or error.__context__
    return text


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def _split_device(device: str | None, workers: int) -> str | None:
    """The choice of devices for `workers` local workers: a single CPU in equal parts."""
    from isonoise.device.drivers import is_cpu
    from isonoise.device.selection import select_devices

    devices = select_devices(device)
    if len(devices) > 1 or workers == 1 or not is_cpu(devices[0].device):
        return device
    return f"{devices[0].number}/{min(workers, devices[0].device.max_compute_units)}"


def _kill_workers(cluster) -> None:
    """End the processes of a LocalCluster at once: they keep nothing, and one that compiles would end late."""
    for nanny in list(cluster.workers.values()):
        nanny.auto_restart = False
        if nanny.pid:
            with suppress(OSError):
                os.kill(nanny.pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _suppressed(function: Callable[..., None]) -> Callable[..., None]:
    """Errors while a connection is closed help nobody: its other end may be gone."""

    def call(**options) -> None:
        with suppress(Exception):
            function(**options)

    return call


@contextmanager
def _terminal_signals_blocked() -> Iterator[None]:
    """Ctrl-C reaches all processes of a terminal: the workers leave it to this one, which still needs them."""
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # else it is started by a thread, and unblocks the signals there
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _quiet_logs() -> Iterator[None]:
    """Dask logs each broken connection with a traceback; `DaskPool` says in a line what has happened."""
    names = [name for name in logging.Logger.manager.loggerDict if name.partition(".")[0] == "distributed"]
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in names}
    for logger in levels:
        logger.setLevel(_SILENT)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)
