"""Workers of a Dask cluster as a `WorkerPool`. `Cluster.pool` makes it.

The coroutines of this file run in the thread of Dask's client. Each known worker has one that prepares it: it makes a
`TracerActor` there. Each task has one that calls the actor. Tasks run on the worker that the caller has chosen: when a
worker is lost, its tasks are reported as lost, and the caller deals them anew.
"""

import asyncio
import queue
import time
import warnings
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
from distributed import Actor, Client, Future

from isonoise import __version__
from isonoise.distributed.dask_worker import DeviceChoice, TracerActor, TracerSettings, other_version
from isonoise.distributed.packing import PackingError, pack_scene, pack_task, unpack_result
from isonoise.distributed.task import Task
from isonoise.distributed.worker_pool import Finished, Lost, Worker
from isonoise.errors import DeviceError, UserError
from isonoise.scene.compiled_scene import CompiledScene

_POLL_S = 0.5
"""Longest time between looks at the scheduler's list of up to `_POLL_WORKERS` workers; more take longer."""
_POLL_WORKERS = 50
_MAX_FAILURES = 3
"""A worker that has failed so often in sequence gets nothing more."""
_ALIVE = ("running", "connecting")
"""States of Dask's client. It tries to connect again for as long as its timeout, then it is closed."""
_CLOSE_TIMEOUT_S = 2.0
_DIRECT_TIMEOUT_S = 2.0
_LOOPBACK_HOSTS = ("127.", "localhost", "[::1]", "::1")


_Form = dict[str, tuple[tuple[int, ...], np.dtype]]
"""Shape and type of the arrays of a state."""


@dataclass
class _KnownWorker:
    """A worker of the scheduler's list."""

    address: str
    preparation: asyncio.Task
    is_local: bool = False  # on this machine: compression would cost more than it saves
    future: Future | None = None  # of its `TracerActor`
    actor: Actor | None = None  # once it is ready
    tasks: dict[int, asyncio.Task] = field(default_factory=dict)
    failures: int = 0  # tasks in sequence


class DaskPool:
    """Prepares the workers of a cluster for a scene, sends them tasks, and follows which of them are there.

    Parameters
    ----------
    client : distributed.Client
        The connection to the cluster.
    device_of : callable
        What the worker with a name, that of the scheduler's list, renders on.
    scene : CompiledScene
        The scene.
    settings : TracerSettings
        What makes a tracer of the scene on a worker.
    starting_workers : int
        Workers that have been started, and may not be in the scheduler's list yet.
    """

    def __init__(
        self,
        client: Client,
        device_of: Callable[[object], DeviceChoice],
        scene: CompiledScene,
        settings: TracerSettings,
        starting_workers: int = 0,
    ):
        self._client, self._device_of = client, device_of
        self._scene, self._settings, self._starting_workers = scene, settings, starting_workers
        self._loop = self._client.loop.asyncio_loop
        self._known: dict[str, _KnownWorker] = {}
        self._ready: dict[str, Worker] = {}
        self._refused: dict[str, str] = {}  # worker -> why it cannot render
        self._interruptions: Counter[str] = Counter()  # of preparations, by worker
        self._submitted: dict[int, _Form] = {}
        self._stops = 0
        self._events: queue.SimpleQueue = queue.SimpleQueue()  # of calls, which `wait` makes
        self._failure: str | None = None
        self._scene_bytes: dict[bool, asyncio.Task] = {}  # compressed or not -> future of the bytes, on the cluster
        self._host_locks: dict[str, asyncio.Lock] = {}
        self._compiled_hosts: set[str] = set()
        self._workers_changed = asyncio.Event()
        self._following = asyncio.run_coroutine_threadsafe(self._follow_workers(), self._loop)

    def workers(self) -> list[Worker]:
        """Those that are ready now."""
        return list(self._ready.values())

    @property
    def known_workers(self) -> int:
        """Workers that are ready or being prepared."""
        return max(len(self._known), self._starting_workers)

    def wait_for_worker(self, on_wait: Callable[[int], None] = lambda workers: None) -> None:
        """Wait until a worker is ready. Raises DeviceError if no worker can render, or the connection is lost."""
        has_warned, start = False, time.monotonic()
        while not self._ready:
            on_wait(self.known_workers)
            self._check()
            time.sleep(0.05)
            if not has_warned and not self.known_workers and time.monotonic() > start + 2:
                has_warned = True
                warnings.warn("the cluster has no workers yet; waiting for the first one", stacklevel=2)

    def submit(self, worker: str, task: Task) -> None:
        """Send a task to a worker. Returns at once."""
        self._submitted[task.number] = _form(task.state)
        known = self._known.get(worker)
        data = pack_task(task, known is not None and not known.is_local)
        self._loop.call_soon_threadsafe(self._begin_task, worker, task.number, data, self._stops)

    def wait(self, timeout_s: float) -> list[Finished | Lost]:
        """What has happened since the last call, as in `WorkerPool`. Raises DeviceError if the connection is lost."""
        events, deadline = [], time.monotonic() + timeout_s
        while not events:
            with suppress(queue.Empty):
                call = self._events.get(timeout=max(deadline - time.monotonic(), 0))
                while True:
                    events += call()
                    call = self._events.get_nowait()
            if not events:
                self._check()
                if time.monotonic() >= deadline:
                    break
        return events

    def stop(self) -> None:
        """Ask the workers to end their tasks early."""
        self._stops += 1
        asyncio.run_coroutine_threadsafe(self._stop_tasks(self._stops), self._loop)

    def close(self) -> None:
        """Drop all tasks, and let the workers free the scene."""
        if self._client.status == "running":
            closing = asyncio.run_coroutine_threadsafe(self._close(), self._loop)
            with suppress(Exception):
                closing.result(_CLOSE_TIMEOUT_S)
        self._submitted.clear()
        self._ready.clear()

    # what `wait` does for an event, in the caller's thread

    def _take_result(self, worker: str, number: int, data: bytes) -> list[Finished | Lost]:
        form = self._submitted.get(number)
        if form is None:  # it arrives twice, or from a worker that was thought dead
            return []
        try:
            result = unpack_result(data)
            if result.number != number or _form(result.state) != form:
                raise PackingError("it is that of another task")
        except PackingError as error:
            return self._take_loss(worker, number, f"its result is refused: {error}")
        del self._submitted[number]
        return [Finished(worker, result)]

    def _take_loss(self, worker: str, number: int, reason: str) -> list[Finished | Lost]:
        return [] if self._submitted.pop(number, None) is None else [Lost(worker, number, reason)]

    def _say(self, message: str) -> list[Finished | Lost]:
        warnings.warn(message, stacklevel=4)
        return []

    def _check(self) -> None:
        """Raise DeviceError if the cluster is lost, or all its workers have refused the render."""
        if self._failure is None and self._client.status not in _ALIVE:
            self._failure = "the connection to the Dask scheduler is lost"
        if self._failure is not None:
            raise DeviceError(
                f"{self._failure}; restart the cluster, and continue from the last checkpoint, if there is one, with "
                "--resume"
            )
        if self._refused and not self._ready and self._refused.keys() >= self._known.keys():
            name, reason = next(iter(self._refused.items()))
            raise DeviceError(f"no worker can render: {name}: {reason}")

    # in the thread of the client

    async def _follow_workers(self) -> None:
        """Prepare workers that join, drop those that are gone, until the pool is closed or the connection is lost."""
        client, has_topic = self._client, False
        try:
            while client.status in _ALIVE:
                self._workers_changed.clear()
                if client.status == "running":
                    if not has_topic:
                        client.subscribe_topic("all", self._on_event)
                    with suppress(OSError):  # an interruption, or the end: the state of the client will tell
                        await self._update_workers()
                has_topic = client.status == "running"  # a new connection has none
                interval_s = _POLL_S * max(len(self._known) / _POLL_WORKERS, 1)
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._workers_changed.wait(), interval_s)
        finally:
            self._failure = "the connection to the Dask scheduler is lost"
            self._events.put(list)

    async def _update_workers(self) -> None:
        """Prepare the workers that are new in the scheduler's list; drop those that are gone or have lost the scene."""
        workers = (await self._client.scheduler.identity())["workers"]
        running = {address for address, each in workers.items() if each["status"] in ("running", "init")}
        for address, known in list(self._known.items()):
            if address not in running:
                self._drop(address, "it has left the cluster")
            elif known.actor is not None and known.future.status != "finished":
                self._drop(address, "the connection was interrupted")
        self._refused = {name: why for name, why in self._refused.items() if name in workers}
        for address in running - self._known.keys() - self._refused.keys():
            preparation = self._loop.create_task(self._prepare(address, workers[address]))
            self._known[address] = _KnownWorker(address, preparation)

    def _on_event(self, event: tuple[float, dict]) -> None:
        if event[1].get("action") in ("add-worker", "remove-worker"):
            self._workers_changed.set()

    def _drop(self, address: str, reason: str, effect: str = "is lost") -> None:
        """Forget a worker; its tasks are lost."""
        known = self._known.pop(address)
        known.preparation.cancel()
        again = "; its part is traced again" if self._ready.pop(address, None) else ""
        message = f"worker {address} {effect} ({reason}){again}"
        self._events.put(lambda: self._say(message))
        for number, running in known.tasks.items():
            running.cancel()
            self._lose(address, number, reason)

    def _lose(self, address: str, number: int, reason: str) -> None:
        self._events.put(lambda: self._take_loss(address, number, reason))

    def _refuse(self, address: str, reason: str) -> None:
        """Give a worker nothing more: it cannot render, or has failed."""
        self._refused[address] = reason
        if address in self._known:
            self._drop(address, reason, "is not used")

    async def _prepare(self, address: str, info: dict) -> None:
        """Make a worker ready: check its version, send the scene, compile it."""
        try:
            version = await self._version(address)
            if version != __version__:
                raise DeviceError(f"it {other_version(version)}")
            known = self._known[address]
            known.is_local = address.partition("://")[2].startswith(_LOOPBACK_HOSTS)
            if self._client.direct_to_workers is None:
                self._client.direct_to_workers = await self._is_reachable(address)
            compress = not known.is_local
            scene = await self._scene_on_cluster(compress)
            async with self._compilation(address):
                arguments = scene, compress, self._settings, self._device_of(info["name"])
                await self._make_actor(known, *arguments)
                device = await known.actor.device_name()
            self._ready[address] = Worker(address, device)
            self._events.put(list)
        except Exception as error:
            if self._client.status == "running":
                self._on_unprepared(address, error)

    def _on_unprepared(self, address: str, error: Exception) -> None:
        """A worker cannot render, or was killed meanwhile. If it is still there, it is prepared again."""
        self._interruptions[address] += 1
        is_interrupted = isinstance(error, OSError | CancelledError)
        if is_interrupted and self._interruptions[address] < _MAX_FAILURES:
            self._drop(address, _reason(error))
        else:
            self._refuse(address, _reason(error))

    @asynccontextmanager
    async def _compilation(self, address: str) -> AsyncIterator[None]:
        """The first worker of a machine compiles alone: the others then find the kernels in its cache."""
        host = address.rpartition(":")[0]
        async with self._host_locks.setdefault(host, asyncio.Lock()):
            if host not in self._compiled_hosts:
                yield
                self._compiled_hosts.add(host)
                return
        yield

    async def _version(self, address: str) -> str | None:
        """Of isonoise on a worker; None if it is not installed."""
        answers = await self._client.scheduler.broadcast(
            msg={"op": "versions", "packages": ["isonoise"]}, workers=[address], on_error="return"
        )
        answer = answers.get(address)
        if not isinstance(answer, dict):
            raise OSError(f"no answer: {answer}")
        return answer["packages"].get("isonoise")

    async def _make_actor(self, known: _KnownWorker, *arguments) -> None:
        """Make the `TracerActor` of a worker."""
        client = self._client
        known.future = client.submit(TracerActor, *arguments, actor=True, pure=False, workers=[known.address])
        await _done(known.future)
        if known.future.status != "finished":
            await known.future  # raises
        with client.as_current():
            known.actor = Actor(TracerActor, known.address, known.future.key)

    async def _is_reachable(self, address: str) -> bool:
        """Whether this machine can connect to the worker. If not, all data go through the scheduler."""
        try:
            await asyncio.wait_for(self._client.rpc(address).identity(), _DIRECT_TIMEOUT_S)
        except Exception:
            return False
        return True

    async def _scene_on_cluster(self, compress: bool):
        """The packed scene, sent once: workers fetch it from those that have it."""
        sending = self._scene_bytes.get(compress)
        if sending is None or (sending.done() and (sending.exception() or sending.result().status != "finished")):
            sending = self._scene_bytes[compress] = self._loop.create_task(self._send_scene(compress))
        return await asyncio.shield(sending)

    async def _send_scene(self, compress: bool) -> Future:
        data = await self._loop.run_in_executor(None, pack_scene, self._scene, compress)
        return await self._client.scatter(data, hash=False)  # Dask's hash takes 50 ns per byte

    def _begin_task(self, address: str, number: int, data: bytes, stops: int) -> None:
        known = self._known.get(address)
        if known is None or known.actor is None:
            self._lose(address, number, "it has left the cluster")
        else:
            known.tasks[number] = self._loop.create_task(self._run_task(known, number, data, stops))

    async def _run_task(self, known: _KnownWorker, number: int, data: bytes, stops: int) -> None:
        """Send a task and wait for its result."""
        address = known.address
        try:
            result = await known.actor.trace(data, stops, not known.is_local)
            known.failures = 0
            self._events.put(lambda: self._take_result(address, number, result))
        except Exception as error:  # no cancellation: `_drop` has reported the loss
            self._on_task_failure(known, number, _reason(error))
        finally:
            known.tasks.pop(number, None)

    def _on_task_failure(self, known: _KnownWorker, number: int, reason: str) -> None:
        self._lose(known.address, number, reason)
        if self._known.get(known.address) is not known:
            return
        if known.future.status != "finished":  # the connection was interrupted, or its process has begun anew
            self._drop(known.address, reason)
            return
        known.failures += 1
        if known.failures >= _MAX_FAILURES:
            self._refuse(known.address, reason)

    async def _stop_tasks(self, stops: int) -> None:
        """Tell all workers to end the tasks early that were submitted before this stop."""
        actors = [known.actor for known in self._known.values() if known.actor is not None]
        await asyncio.gather(*(actor.stop(stops) for actor in actors), return_exceptions=True)

    async def _close(self) -> None:
        self._following.cancel()
        self._client.unsubscribe_topic("all")
        await self._stop_tasks(self._stops + 1)
        for known in self._known.values():
            known.preparation.cancel()
            for running in known.tasks.values():
                running.cancel()
            known.actor = known.future = None  # Dask frees the tracer
        self._known.clear()
        self._scene_bytes.clear()


async def _done(future: Future) -> None:
    """Wait until a future has a result or an error, or is cancelled. Unlike `gather` this may be cancelled."""
    loop, event = asyncio.get_running_loop(), asyncio.Event()
    future.add_done_callback(lambda _: loop.call_soon_threadsafe(event.set))
    await event.wait()


def _reason(error: BaseException) -> str:
    """An error of a worker for people."""
    if isinstance(error, CancelledError):
        return "it has left the cluster"
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, OSError):
        return "it does not answer"
    lines = str(error).splitlines() or [type(error).__name__]
    return f"{type(error).__name__}: {lines[0]}"


def _form(state: Mapping[str, np.ndarray]) -> _Form:
    return {name: (array.shape, array.dtype) for name, array in state.items()}
