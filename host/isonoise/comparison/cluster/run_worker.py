"""What the workers of a cluster do for a comparison: say what they are, render runs and batches.

`workers`, `runs` and `batches` submit these functions.
"""

import pickle
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from isonoise.comparison.environment import device_identity, program_version
from isonoise.comparison.reference_batch import Batch, Pilot, render_batch, render_pilot
from isonoise.comparison.run_task import RunTask, render_run, warm_up
from isonoise.comparison.strategy_code import code_of
from isonoise.distributed.dask_worker import DeviceChoice
from isonoise.distributed.packing import unpack_scene
from isonoise.errors import UserError

_rendering = threading.Lock()
"""A process renders one run at a time, whatever the number of its threads, so that times are comparable."""


@dataclass(frozen=True)
class WorkerDescription:
    """A worker and its device.

    Attributes
    ----------
    version : str
        Of isonoise, with its source files.
    device : str
        Name of the OpenCL device and its driver; the same for parts of equal size of a device.
    """

    version: str
    device: str


def describe_worker(choice: DeviceChoice) -> WorkerDescription:
    """Open the device of this worker, and describe it. Raises DeviceError if there is none."""
    from isonoise.device.opencl import Device

    return WorkerDescription(program_version(), device_identity(Device(choice.select()).selected))


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
    with _rendering:
        _check_code(task)
        compiled, device = unpack_scene(scene, is_compressed), choice.select()
        worker, is_dropped = _this_worker()
        if is_first:
            warm_up(task, compiled, device, is_dropped)
        arrays = pickle.loads(reference)
        return render_run(task, compiled, arrays, device, should_stop=is_dropped, worker=worker)


def render_batch_on_worker(
    allocation: np.ndarray, seed: int, scene: bytes, is_compressed: bool, choice: DeviceChoice
) -> Batch:
    """`render_batch` on this worker."""
    with _rendering:
        compiled, device = unpack_scene(scene, is_compressed), choice.select()
        return render_batch(allocation, seed, compiled, device, _this_worker()[1])


def render_pilot_on_worker(pilot: Pilot, scene: bytes, is_compressed: bool, choice: DeviceChoice) -> np.ndarray:
    """`render_pilot` on this worker."""
    with _rendering:
        return render_pilot(pilot, unpack_scene(scene, is_compressed), choice.select(), _this_worker()[1])


def _check_code(task: RunTask) -> None:
    """Raises UserError if a strategy of the user's own has other files here than where the comparison was planned."""
    code = code_of(task.strategy) if isinstance(task.strategy, str) else None
    if code != task.identity["code"]:
        raise UserError(f"the code of the strategy '{task.strategy}' is {code}, and {task.identity['code']} is needed")


def _this_worker() -> tuple[str, Callable[[], bool]]:
    """The worker's address; and whether the client is gone, or does not want this task any more."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def is_dropped() -> bool:
        state = worker.state.tasks.get(key)
        return state is None or state.state not in ("executing", "long-running")

    return worker.address, is_dropped
