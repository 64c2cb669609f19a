"""The workers of a Dask cluster that render runs: which of them are there, and with which device.

Called by `runs` and by `isonoise compare`.
"""

import asyncio
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError, Future, wait
from contextlib import suppress

from isonoise.comparison.cluster.run_worker import WorkerDescription, describe_worker
from isonoise.comparison.environment import program_version
from isonoise.comparison.plan import SEVERAL_DEVICES
from isonoise.distributed.cluster import Cluster
from isonoise.distributed.dask_worker import DeviceChoice
from isonoise.errors import DeviceError
from isonoise.signals import raise_if_received

START_TIMEOUT_S = 60.0
"""Longest wait for the workers of this machine to be ready, before the comparison begins without the others."""
_POLL_S = 0.5
"""Between looks at the scheduler's list of workers."""
_LISTED_PER_S = 100
"""Workers that a look may have for each second between looks, so that a large list is read less often."""


class ClusterWorkers:
    """Follows the workers of a cluster.

    Parameters
    ----------
    cluster : Cluster
        The cluster.
    warn : callable
        For a line about a worker that is not used.

    Attributes
    ----------
    devices : dict of str to str
        Address of a worker that is ready for runs -> its device.
    choices : dict of str to DeviceChoice
        Address of a worker -> how it selects its device.
    """

    def __init__(self, cluster: Cluster, warn: Callable[[str], None]):
        self.cluster, self._warn = cluster, warn
        self.devices: dict[str, str] = {}
        self.choices: dict[str, DeviceChoice] = {}
        self._describing: dict[str, Future] = {}
        self._refused: dict[str, str] = {}  # address -> why
        self._list: dict[str, dict] = {}  # of the scheduler
        self._required_device: str | None = None
        self._next_poll = 0.0

    @property
    def is_connected(self) -> bool:
        return self.cluster.client.status == "running"

    def start(self, coroutine: Coroutine) -> Future:
        """Run a coroutine in the thread of Dask's client."""
        return asyncio.run_coroutine_threadsafe(coroutine, self.cluster.client.loop.asyncio_loop)

    def common_device(self, stored: str | None) -> str:
        """Wait for the workers that are known, and return the device for the plan: that of all, or SEVERAL_DEVICES.

        `stored` is that of the plan that is continued. From now on workers with another device get no runs, unless it
        is SEVERAL_DEVICES. Raises DeviceError as `update` does.
        """
        size, has_warned, deadline = self.cluster.size or 0, False, time.monotonic() + START_TIMEOUT_S
        while True:
            self.update()
            is_complete = len(self.devices) + len(self._refused) >= size or time.monotonic() > deadline
            if self.devices and is_complete and not self._describing:
                break
            if size and time.monotonic() > deadline and not self._describing:
                raise DeviceError(f"no worker process has started within {START_TIMEOUT_S:.0f} s")
            if not (has_warned or size or self._describing or self._refused):
                has_warned = True
                self._warn("the cluster has no workers yet; waiting for the first one")
            self.wait(self._describing.values(), 0.1)
        kinds = set(self.devices.values())
        device = SEVERAL_DEVICES if len(kinds) > 1 or stored == SEVERAL_DEVICES else kinds.pop()
        self._required_device = None if device == SEVERAL_DEVICES else device
        return device

    def update(self) -> set[str]:
        """Look which workers have come or gone; return those that have gone.

        Raises DeviceError if the connection is lost, or all workers have been refused.
        """
        raise_if_received()
        gone: set[str] = set()
        if time.monotonic() >= self._next_poll:
            listed = self._read_list()
            gone = {*self.devices, *self._describing, *self._refused} - listed.keys()
            for address in gone:
                self._forget(address)
                self._refused.pop(address, None)
            known = {*self.devices, *self._describing, *self._refused}
            for address in [address for address in listed if address not in known]:
                self.choices[address] = self.cluster.device_of(listed[address]["name"])
                self._describing[address] = self.start(self._describe(address))
            self._next_poll = time.monotonic() + max(_POLL_S, len(listed) / _LISTED_PER_S)
        for address in [address for address, future in self._describing.items() if future.done()]:
            self._add(address, self._describing.pop(address))
        if self._refused and not self.devices and not self._describing:
            address, reason = next(iter(self._refused.items()))
            raise DeviceError(f"no worker of the cluster can render: {address}: {reason}")
        return gone

    def look_again(self) -> None:
        """Let the next `update` read the scheduler's list: a worker may just have gone."""
        self._next_poll = 0.0

    def refuse(self, address: str, reason: str) -> None:
        """Give a worker nothing more, unless it has failed because it is gone."""
        if address in self._read_list():
            self._forget(address)
            self._refused[address] = reason
            self._warn(f"worker {address} gets no runs: {reason}")

    def wait(self, futures, timeout_s: float) -> None:
        """Wait until one of the futures is done; Ctrl-C ends the wait."""
        futures = list(futures)
        if futures:
            wait(futures, timeout_s, return_when="FIRST_COMPLETED")
        else:
            time.sleep(timeout_s)

    def _read_list(self) -> dict[str, dict]:
        """The workers of the scheduler's list that take tasks, by address; the last list while there is no connection.

        Dask tries to connect again for as long as its timeout, and then closes the client.
        """
        client = self.cluster.client
        with suppress(OSError):
            if self.is_connected:
                workers = client.sync(client.scheduler.identity)["workers"]
                self._list = {name: each for name, each in workers.items() if each["status"] in ("running", "init")}
        if client.status not in ("running", "connecting"):
            raise DeviceError("the connection to the Dask scheduler is lost")
        return self._list

    def _forget(self, address: str) -> None:
        self.devices.pop(address, None)
        if address in self._describing:
            self._describing.pop(address).cancel()

    def _add(self, address: str, described: Future) -> None:
        try:
            description = described.result()
        except CancelledError:  # the worker is gone, or will be described once more
            return
        except Exception as error:
            self.refuse(address, first_line(error))
            return
        if description.version != program_version():
            self.refuse(address, f"it has isonoise {description.version}, and this machine {program_version()}")
        elif self._required_device not in (None, description.device):
            self.refuse(address, f"its device is {description.device}, and the comparison's {self._required_device}")
        else:
            self.devices[address] = description.device

    async def _describe(self, address: str) -> WorkerDescription:
        choice = self.choices[address]
        return await self.cluster.client.submit(describe_worker, choice, pure=False, workers=[address])


def first_line(error: BaseException) -> str:
    """The message of an error of a worker in a line."""
    line = next(iter(str(error).splitlines()), "")
    return line if isinstance(error, DeviceError) else f"{type(error).__name__}: {line}"
