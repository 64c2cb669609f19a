"""The one place that owns the OpenCL context and queue: picks a device, builds programs, makes buffers, launches."""

import atexit
import contextlib
import functools
import os
import platform
import tempfile
import warnings
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from isonoise.device import program_cache
from isonoise.errors import DeviceError

LOCAL_SIZE = 64
"""Work-items a group, the same at every launch of a kernel: PoCL compiles it anew for every local size."""
SMALL_LOCAL_SIZE = 8
"""Work-items a group where each does the work of many. PoCL gives a thread half of the groups that are left, which with
few large ones leaves the others idle at the end."""

_ALIGNMENT = 4096
"""Bytes: of what a driver takes without a copy."""


@functools.cache
def _opencl():
    _give_pocl_a_cache()
    # pyopencl's own cache would add nothing to the drivers' and fail in a read-only home
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"pyopencl cannot be loaded ({error}); install it with: pip install pyopencl") from error
    return pyopencl


def _give_pocl_a_cache() -> None:
    """Points PoCL to a folder for compiled kernels where its own cannot be made: without one it offers no device."""
    if "POCL_CACHE_DIR" in os.environ:
        return
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        (home / "pocl").mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=home / "pocl"):
            return
    except (OSError, RuntimeError):  # RuntimeError: there is no home at all
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = Path(tempfile.gettempdir()) / f"isonoise-pocl-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid != user:  # somebody else's: code must not be loaded from there
            folder = Path(tempfile.mkdtemp(prefix="isonoise-pocl-"))
        os.environ["POCL_CACHE_DIR"] = str(folder)


def driver_advice() -> str:
    """Which OpenCL driver to get on this system."""
    if platform.system() == "Linux" and platform.machine() in ("x86_64", "AMD64"):
        return "install PoCL for the CPU with: pip install pocl-binary-distribution; or the driver of your GPU's vendor"
    if platform.system() == "Linux":
        return "install PoCL from your distribution (package pocl-opencl-icd), or the driver of your GPU's vendor"
    if platform.system() == "Darwin":
        return "macOS brings OpenCL with it; install pyopencl from its wheel: pip install --force-reinstall pyopencl"
    return "install the driver of your GPU's vendor, or Intel's OpenCL runtime for the CPU"


def list_devices() -> list:
    """All OpenCL devices, GPUs first, in a stable order; the first is the default. Empty if there is none."""
    cl = _opencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error:
        return []
    devices = [device for each in platforms for device in each.get_devices()]
    return sorted(devices, key=lambda device: not device.type & cl.device_type.GPU)


def select_device(choice: str | int | None = None):
    """The device of the list's place `choice`, or the first whose name or platform contains it; the default if None.

    Raises DeviceError, with the list, if there is none.
    """
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {driver_advice()}")
    if choice is None:
        return devices[0]
    text = str(choice).strip()
    if text.isdigit() and int(text) < len(devices):
        return devices[int(text)]
    for device in devices:
        if text and text.lower() in f"{device.platform.name} {device.name}".lower() and not text.isdigit():
            return device
    names = "\n".join(f"  {place}: {device.name} ({device.platform.name})" for place, device in enumerate(devices))
    raise DeviceError(f"no OpenCL device matches '{choice}'; choose a number or a part of a name from:\n{names}")


def is_cpu(device) -> bool:
    return bool(device.type & _opencl().device_type.CPU)


def driver_identity(device) -> tuple[str, ...]:
    """Names and versions that tell a device with its driver from others."""
    platform = device.platform
    return platform.name, platform.version, device.name, device.version, device.driver_version


@functools.cache
def _context(device):
    """One context a device and process: programs are built for a context, and renders in a row share them."""
    return _opencl().Context([device])


_programs: dict[tuple, object] = {}
"""Programs built so far, by context, source and options."""

_to_keep: dict[str, object] = {}
"""Programs that were compiled in this process, by their key in the cache of programs."""


@atexit.register
def _keep_programs() -> None:
    """Puts what was compiled into the cache: last, when it delays no image.

    By now the binaries hold what some drivers compile at a kernel's first launch.
    """
    if program_cache.cache_folder() is None:
        return
    with contextlib.suppress(KeyboardInterrupt):  # nobody wants to wait
        while _to_keep:
            key, program = _to_keep.popitem()
            with contextlib.suppress(_opencl().Error):  # a driver without binaries
                program_cache.store(key, program.get_info(_opencl().program_info.BINARIES)[0])


def _host_memory(nbytes: int) -> np.ndarray:
    """Memory of zeros that a CPU's driver takes as a buffer's own. numpy asks the system for large pages where it is
    large: with small ones every step of a ray through a million triangles looks up where a page lies. Pages that nobody
    writes to are not there at all."""
    memory = np.zeros(nbytes + _ALIGNMENT, np.uint8)
    begin = -memory.ctypes.data % _ALIGNMENT
    return memory[begin : begin + nbytes]


class Device:
    """Context, in-order queue, buffers and programs on one OpenCL device.

    With `profile` it keeps how often every kernel was launched (`launches`, by name) and for how many seconds the
    device worked on it (`seconds`), of the launches that have been waited for. `on_launch`, if there is one, then gets
    every launch in its order: kernel, items, seconds.
    """

    def __init__(self, choice: str | int | None = None, profile: bool = False):
        self._cl = _opencl()
        self.device = select_device(choice)
        self.context = _context(self.device)
        self.allocated = 0
        self.on_launch: Callable[[str, int, float], None] | None = None
        self._running: list[tuple] = []  # kernel, items and event of the launches since the last wait
        self._given_up: list[np.ndarray] = []  # memory of the buffers that nobody holds since the last wait
        self._open_queue(profile)
        self.reset_profile()

    def _open_queue(self, profile: bool) -> None:
        self.profile = profile
        properties = self._cl.command_queue_properties.PROFILING_ENABLE if profile else 0
        self.queue = self._cl.CommandQueue(self.context, properties=properties)
        # nothing is at work on memory that goes with the device
        self._last_wait = weakref.finalize(self, self.queue.finish)

    def set_profiling(self, on: bool) -> None:
        """Goes on with a queue that keeps times, or with one that doesn't; waits for the device."""
        self.finish()
        self._last_wait.detach()
        self._open_queue(on)

    @property
    def name(self) -> str:
        return f"{self.device.name.strip()} ({self.device.platform.name.strip()})"

    @property
    def lanes(self) -> int:
        """Paths that a work-item takes where there is a choice: kernels/path/path_state.h.

        PoCL's loop over work-items becomes vector instructions in simple kernels only, a loop of the kernel's own more
        often. Other compilers, and GPUs, do it with work-items.
        """
        return 64 if self.is_cpu and self.is_pocl else 1

    @property
    def is_pocl(self) -> bool:
        return "portable computing language" in self.device.platform.name.lower()

    @property
    def is_cpu(self) -> bool:
        return is_cpu(self.device)

    @property
    def shares_memory(self) -> bool:
        """Whether the host's memory may be a buffer's own."""
        return self.is_cpu

    @property
    def compute_units(self) -> int:
        return self.device.max_compute_units

    def build(self, source: str, options: tuple[str, ...]) -> dict[str, object]:
        """Builds one text; returns its kernels by name. Raises DeviceError with the compiler's log."""
        cached = _programs.get((self.context, source, options))
        if cached is None:
            cached = _programs[self.context, source, options] = self._compile(source, options)
        return {kernel.function_name: kernel for kernel in cached.all_kernels()}

    def _compile(self, source: str, options: tuple[str, ...]):
        """The program from the cache, or built from its text and to be kept.

        Not with PoCL, which keeps what it compiles by itself: asked for a binary, it compiles every kernel once more,
        for work-groups of any size, which takes as long as the first time.
        """
        keeps = program_cache.cache_folder() is not None and not self.is_pocl
        key = program_cache.program_key(source, options, self._driver)
        binary = program_cache.load(key) if keeps else None
        if binary is not None:
            try:
                return self._built(self._cl.Program(self.context, [self.device], [binary]), options)
            except self._cl.Error:  # the driver no longer takes what it made: the text is there
                pass
        try:
            program = self._built(self._cl.Program(self.context, source), options)
        except self._cl.Error as error:
            raise DeviceError(f"the OpenCL compiler of {self.name} refused a kernel:\n{error}") from error
        if keeps:
            _to_keep[key] = program
        return program

    def _built(self, program, options: tuple[str, ...]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", self._cl.CompilerWarning)  # some drivers report every success
            return program.build(options=list(options), cache_dir=False)

    @functools.cached_property
    def _driver(self) -> tuple[str, ...]:
        """What a compiled program depends on beside its text."""
        return (*driver_identity(self.device), f"{LOCAL_SIZE} {SMALL_LOCAL_SIZE}")

    def buffer(self, size: int | np.ndarray, what: str):
        """A buffer of `size` bytes filled with zeros, or with the array's content; `what` names it in errors."""
        flags = self._cl.mem_flags
        nbytes = size.nbytes if isinstance(size, np.ndarray) else int(size)
        limit = min(self.device.max_mem_alloc_size, self.device.global_mem_size - self.allocated)
        if nbytes > limit:
            raise DeviceError(
                f"{what} needs {nbytes / 2**20:.0f} MiB, but {self.name} gives at most {limit / 2**20:.0f} MiB "
                "for one buffer; render a smaller image or scene, or choose another device with --device"
            )
        self.allocated += nbytes
        whole_words = max(-(-nbytes // 4), 1) * 4
        if self.shares_memory:
            content = _host_memory(whole_words)
            if isinstance(size, np.ndarray):
                content[:nbytes] = np.ascontiguousarray(size).reshape(-1).view(np.uint8)
            # pyopencl lets go of the array with the buffer, on whose memory launches may still be at work
            weakref.finalize(content, self._given_up.append, content.base).atexit = False
            return self._cl.Buffer(self.context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=content)
        if isinstance(size, np.ndarray) and nbytes:
            return self._cl.Buffer(
                self.context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=np.ascontiguousarray(size)
            )
        buffer = self._cl.Buffer(self.context, flags.READ_WRITE, whole_words)
        self._cl.enqueue_fill_buffer(self.queue, buffer, np.zeros(1, np.uint32), 0, whole_words)
        return buffer

    def launch(
        self, kernel, items: int, arguments: tuple, per_work_item: int = 1, local_size: int = LOCAL_SIZE
    ) -> None:
        """Runs a kernel over at least `items`; kernels return at once beyond their own bound."""
        groups = -(-items // (per_work_item * local_size))
        event = kernel(self.queue, (groups * local_size,), (local_size,), *arguments)
        if self.profile:
            self._running.append((kernel, items, event))

    def write(self, buffer, array: np.ndarray, offset: int = 0) -> None:
        self._cl.enqueue_copy(self.queue, buffer, np.ascontiguousarray(array), dst_offset=offset)

    def read(self, buffer, dtype, count: int, offset: int = 0) -> np.ndarray:
        """`count` numbers from the buffer, from number `offset` on; waits for the device."""
        dtype = np.dtype(dtype)
        array = np.empty(count, dtype)
        if count:
            self._cl.enqueue_copy(self.queue, array, buffer, src_offset=offset * dtype.itemsize)
            self._after_wait()
        return array

    @contextlib.contextmanager
    def mapped(self, buffer, dtype, count: int) -> Iterator[np.ndarray]:
        """The buffer's first `count` numbers, to be read within the context; waits for the device.

        Where host and device share their memory nothing is copied.
        """
        array, _ = self._cl.enqueue_map_buffer(self.queue, buffer, self._cl.map_flags.READ, 0, (count,), dtype)
        self._after_wait()
        try:
            yield array
        finally:
            array.base.release(self.queue)

    def finish(self) -> None:
        self.queue.finish()
        self._after_wait()

    def reset_profile(self) -> None:
        """Begins to count launches and seconds anew."""
        self._running.clear()
        self.launches: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()

    def _after_wait(self) -> None:
        """The queue is in order, so all that was launched is done."""
        self._given_up.clear()
        for kernel, items, event in self._running:
            name, seconds = kernel.function_name, 1e-9 * (event.profile.end - event.profile.start)
            self.launches[name] += 1
            self.seconds[name] += seconds
            if self.on_launch:
                self.on_launch(name, items, seconds)
        self._running.clear()
