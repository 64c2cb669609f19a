"""What the workers of a cluster do for a comparison: say what they are, render a run. `cluster_runs` submits these."""

import pickle
import threading
from dataclasses import dataclass

from isonoise import __version__
from isonoise.comparison.run_task import RunTask, render_run, warm_up
from isonoise.distributed.dask_worker import DeviceChoice
from isonoise.distributed.packing import unpack_scene

_rendering = threading.Lock()
"""A process renders one run at a time, whatever the number of its threads, so that times are comparable."""


@dataclass(frozen=True)
class WorkerDescription:
    """A worker and its device.

    Attributes
    ----------
    version : str
        Of isonoise.
    device : str
        Name of the OpenCL device and its platform; the same for parts of equal size of a device.
    """

    version: str
    device: str


def describe_worker(choice: DeviceChoice) -> WorkerDescription:
    """Open the device of this worker, and describe it. Raises DeviceError if there is none."""
    from isonoise.device.opencl import Device

    return WorkerDescription(__version__, Device(choice.select()).selected.kind)


def render_on_worker(
    task: RunTask, scene: bytes, is_compressed: bool, reference: bytes, choice: DeviceChoice, is_first: bool
) -> bytes:
    """Render a run on this worker; the content of its file.

    Parameters
    ----------
    scene, reference : bytes
        Packed by `pack_scene` and by pickle.
    is_first : bool
        Whether it is the worker's first run of this strategy on this scene, before which it renders a second.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def is_cancelled() -> bool:
        """Whether the client is gone, or does not want the run any more."""
        state = worker.state.tasks.get(key)
        return state is None or state.state not in ("executing", "long-running")

    with _rendering:
        compiled, device = unpack_scene(scene, is_compressed), choice.select()
        if is_first:
            warm_up(task, compiled, device, is_cancelled)
        arrays = pickle.loads(reference)
        return render_run(task, compiled, arrays, device, should_stop=is_cancelled, worker=worker.address)
