"""Owns the OpenCL context and queue of a device: builds programs, creates buffers, launches kernels."""

import atexit
import contextlib
import functools
import linecache
import threading
import warnings
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from isonoise.device import program_cache
from isonoise.device.drivers import build_options, driver_identity, is_cpu, is_pocl, load_pyopencl
from isonoise.device.failures import build_failure, device_failure, is_forked, refuse_after_fork, reports_failures
from isonoise.device.form import DeviceForm, choose_form
from isonoise.device.pocl_cache import full_disk, pocl_kernels
from isonoise.device.selection import SelectedDevice, select_device
from isonoise.errors import DeviceError
from isonoise.signals import raise_if_received

LOCAL_SIZE = 64
"""Work-items per work-group, the same for every launch of a kernel: PoCL compiles it anew for every local size."""
SMALL_LOCAL_SIZE = 8
"""Work-items per work-group of kernels whose work-items each do much work. PoCL gives a thread half of the remaining
groups, so with few large groups some threads are idle at the end."""

_ALIGNMENT = 4096
"""Bytes. Drivers use host memory of this alignment without a copy."""


@functools.cache
def _context(device):
    """One context per device and process: programs belong to a context, and successive renders share them."""
    return load_pyopencl().Context([device])


_programs: dict[tuple, object] = {}
"""(context, source, options) -> program built in this process."""

_build_lock = threading.Lock()
"""Held while a program is built: pyopencl and `warnings` change state of the whole process meanwhile."""

_programs_to_store: dict[str, object] = {}
"""Cache key -> program compiled in this process."""


@atexit.register
def store_programs() -> None:
    """Write the compiled programs to the cache; at exit, so that no image is delayed.

    By then the binaries include what some drivers compile at a kernel's first launch.
    """
    if program_cache.cache_folder() is None or is_forked():
        return
    with contextlib.suppress(KeyboardInterrupt):
        while _programs_to_store:
            key, program = _programs_to_store.popitem()
            if binary := _binary_of(program):
                program_cache.store(key, binary)


def _binary_of(program) -> bytes | None:
    """The compiled program; None if there is none, or the driver does not offer it."""
    try:
        return program and program.get_info(load_pyopencl().program_info.BINARIES)[0]
    except load_pyopencl().Error:
        return None


def _finish(queue) -> None:
    """Wait for a queue whose device may be lost, or not be there at all in a forked process."""
    if not is_forked():
        with contextlib.suppress(load_pyopencl().Error):
            queue.finish()


def _aligned_zeros(size_bytes: int) -> np.ndarray:
    """Host memory of zeros that a CPU driver uses as a buffer without a copy.

    From numpy, because it requests huge pages for large arrays: with small ones every step of a ray through a million
    triangles misses the TLB. Pages that are never written take no memory.
    """
    memory = np.zeros(size_bytes + _ALIGNMENT, np.uint8)
    begin = -memory.ctypes.data % _ALIGNMENT
    return memory[begin : begin + size_bytes]


def global_size(items: int, per_work_item: int, local_size: int) -> int:
    """Work-items of a launch over at least `items`: whole work-groups."""
    return -(-items // (per_work_item * local_size)) * local_size


class Launch(NamedTuple):
    """A launch in a profiling queue, with times of the device's clock."""

    kernel: str
    items: int
    queued_ns: int
    start_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        return 1e-9 * (self.end_ns - self.start_ns)


class Device:
    """Context, in-order queue, buffers and programs of one OpenCL device.

    Parameters
    ----------
    choice : str, int, None or SelectedDevice
        As for `select_device`, or one of `select_devices`.
    profile : bool
        Measure the launches that have been waited for: `launches` counts them by kernel name, `seconds` adds up their
        time on the device. `on_launch`, if set, is called for each in order.
    """

    def __init__(self, choice: str | int | SelectedDevice | None = None, profile: bool = False):
        self._cl = load_pyopencl()
        self.driver_error = self._cl.Error
        self.selected = choice if isinstance(choice, SelectedDevice) else select_device(choice)
        self.device = self.selected.device
        self.allocated = 0
        self.on_launch: Callable[[Launch], None] | None = None
        self._pending_launches: list[tuple] = []  # kernel, items and event since the last wait
        # Memory of the buffers, by the number of a weak reference that dies with the buffer; and the dead references
        # since the last wait. They are collected without Python code, in which Ctrl-C would be lost.
        self._memory: dict[int, tuple[weakref.ref, np.ndarray]] = {}
        self._dead_references: list[weakref.ref] = []
        self._open_context(profile)
        self.reset_profile()

    @reports_failures("opening the device")
    def _open_context(self, profile: bool) -> None:
        self.context = _context(self.device)
        self._open_queue(profile)

    def _open_queue(self, profile: bool) -> None:
        self.profile = profile
        properties = self._cl.command_queue_properties.PROFILING_ENABLE if profile else 0
        # PoCL's context of a sub-device names the whole device, which the queue would take by default
        self.queue = self._cl.CommandQueue(self.context, self.device, properties=properties)
        # launches must not outlive the memory that is freed with this object
        self._finalizer = weakref.finalize(self, _finish, self.queue)

    def set_profiling(self, on: bool) -> None:
        """Continue with a queue that measures launches, or with one that does not. Waits for the device."""
        self.finish()
        self._finalizer.detach()
        self._open_queue(on)

    @property
    def name(self) -> str:
        return self.selected.name

    @functools.cached_property
    def form(self) -> DeviceForm:
        """How kernels divide their work among work-items."""
        return choose_form(self.device)

    @property
    def is_pocl(self) -> bool:
        return is_pocl(self.device)

    @property
    def is_cpu(self) -> bool:
        return is_cpu(self.device)

    @property
    def shares_memory(self) -> bool:
        """Whether buffers can use the host's memory without a copy."""
        return self.is_cpu

    @property
    def global_memory(self) -> int:
        """Bytes of the device's memory."""
        return self.device.global_mem_size

    @property
    def max_buffer_size(self) -> int:
        """Bytes of the largest buffer that the device gives."""
        return self.device.max_mem_alloc_size

    @property
    def compute_units(self) -> int:
        return self.device.max_compute_units

    def build(self, source: str, options: tuple[str, ...]) -> dict[str, object]:
        """Build a program; return its kernels by name. Raises DeviceError with the compiler's log."""
        refuse_after_fork()
        raise_if_received()
        options = (*options, *build_options(self.device))
        with _build_lock:
            cached = _programs.get((self.context, source, options))
            if cached is None:
                cached = _programs[self.context, source, options] = self._compile(source, options)
            sources = set(linecache.cache)
            kernels = {kernel.function_name: kernel for kernel in cached.all_kernels()}
            for name in linecache.cache.keys() - sources:  # pyopencl generates a function for each and keeps its source
                del linecache.cache[name]
        return kernels

    def _compile(self, source: str, options: tuple[str, ...]):
        """The program from the cache, or compiled and registered for it.

        PoCL's kernels are cached as the files that it writes. Asked for a binary, it compiles every kernel once more,
        for work-groups of any size, which takes as long as the first time.
        """
        key = self.program_key(source, options)
        if self.is_pocl:
            with pocl_kernels(key):
                return self._compile_source(source, options)
        binary = program_cache.load(key) or _binary_of(_programs_to_store.get(key))  # of another device of this kind
        if binary:
            try:
                return self._build_program(self._cl.Program(self.context, [self.device], [binary]), options)
            except self._cl.Error:  # the driver rejects its own binary: compile the source
                pass
        program = self._compile_source(source, options)
        if program_cache.cache_folder() is not None:
            _programs_to_store[key] = program
        return program

    def _compile_source(self, source: str, options: tuple[str, ...]):
        try:
            return self._build_program(self._cl.Program(self.context, source), options)
        except self._cl.Error as error:
            reason = full_disk() if self.is_pocl else None
            raise build_failure(self.name, source, options, error, reason) from error

    def _build_program(self, program, options: tuple[str, ...]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", self._cl.CompilerWarning)  # some drivers report every success
            return program.build(options=list(options), cache_dir=False)

    def program_key(self, source: str, options: tuple[str, ...]) -> str:
        """Name in the program cache of a program with all its options."""
        return program_cache.program_key(source, options, self._cache_identity)

    @functools.cached_property
    def _cache_identity(self) -> tuple[str, ...]:
        """What a compiled program depends on besides its source and options."""
        return (*driver_identity(self.device), f"{LOCAL_SIZE} {SMALL_LOCAL_SIZE}")

    @reports_failures("creating a buffer")
    def buffer(self, content: int | np.ndarray, label: str):
        """A buffer of `content` bytes of zeros, or a copy of the array `content`. `label` names it in errors."""
        flags = self._cl.mem_flags
        is_array = isinstance(content, np.ndarray)
        size_bytes = content.nbytes if is_array else int(content)
        limit = min(self.device.max_mem_alloc_size, self.device.global_mem_size - self.allocated)
        if size_bytes > limit:
            raise DeviceError(
                f"{label} needs {size_bytes / 2**20:.0f} MiB, but {self.name} gives at most {limit / 2**20:.0f} MiB "
                "for one buffer; render a smaller image or scene, or choose another device with --device"
            )
        self.allocated += size_bytes
        padded_bytes = max(-(-size_bytes // 4), 1) * 4  # to whole words
        if self.shares_memory:
            memory = _aligned_zeros(padded_bytes)
            if is_array:
                memory[:size_bytes] = np.ascontiguousarray(content).reshape(-1).view(np.uint8)
            # pyopencl frees the array with the buffer, although launches may still use it: keep it until the next wait
            reference = weakref.ref(memory, self._dead_references.append)
            self._memory[id(reference)] = reference, memory.base
            return self._cl.Buffer(self.context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=memory)
        if is_array and size_bytes:
            return self._cl.Buffer(
                self.context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=np.ascontiguousarray(content)
            )
        buffer = self._cl.Buffer(self.context, flags.READ_WRITE, padded_bytes)
        self._cl.enqueue_fill_buffer(self.queue, buffer, np.zeros(1, np.uint32), 0, padded_bytes)
        return buffer

    def release(self, buffer) -> None:
        """Give the memory of a buffer back, after its launches."""
        self.allocated -= buffer.size
        buffer.release()

    def launch(
        self, kernel, items: int, arguments: tuple, per_work_item: int = 1, local_size: int = LOCAL_SIZE
    ) -> None:
        """Run a kernel over at least `items` items; kernels return early beyond their own bound."""
        refuse_after_fork()
        size = global_size(items, per_work_item, local_size)
        try:
            event = kernel(self.queue, (size,), (local_size,), *arguments)
        except self.driver_error as error:
            raise device_failure(self.name, f"launching `{kernel.function_name}`", error) from error
        if self.profile:
            self._pending_launches.append((kernel, items, event))

    @reports_failures("writing a buffer")
    def write(self, buffer, array: np.ndarray, offset: int = 0) -> None:
        """Copy the array into the buffer at `offset` bytes."""
        self._cl.enqueue_copy(self.queue, buffer, np.ascontiguousarray(array), dst_offset=offset)

    @reports_failures("reading a buffer")
    def read(self, buffer, dtype, count: int, offset: int = 0, out: np.ndarray | None = None) -> np.ndarray:
        """Elements `offset` to `offset` + `count` of the buffer, in `out` if given. Waits for the device."""
        dtype = np.dtype(dtype)
        array = np.empty(count, dtype) if out is None else out.reshape(-1)
        if count:
            self._cl.enqueue_copy(self.queue, array, buffer, src_offset=offset * dtype.itemsize)
            self._after_wait()
        return array

    @reports_failures("reading a buffer")
    def begin_read(self, buffer, dtype, count: int) -> Callable[[], np.ndarray]:
        """Enqueue a read of the first elements. The returned function waits for them, but not for later launches."""
        array = np.empty(count, np.dtype(dtype))
        event = self._cl.enqueue_copy(self.queue, array, buffer, is_blocking=False)

        def end_read() -> np.ndarray:
            try:
                event.wait()
            except self.driver_error as error:
                raise device_failure(self.name, "reading a buffer", error) from error
            return array

        return end_read

    @contextlib.contextmanager
    def mapped(self, buffer, dtype, count: int, writable: bool = False) -> Iterator[np.ndarray]:
        """The buffer's first `count` elements, readable or also writable in the `with` block. Waits for the device.

        Nothing is copied if host and device share their memory.
        """
        flags = self._cl.map_flags.READ | (self._cl.map_flags.WRITE if writable else 0)
        array = self._map(buffer, dtype, count, flags)
        try:
            yield array
        finally:
            self._unmap(array)

    @reports_failures("reading a buffer")
    def _map(self, buffer, dtype, count: int, flags: int) -> np.ndarray:
        array, _ = self._cl.enqueue_map_buffer(self.queue, buffer, flags, 0, (count,), dtype)
        self._after_wait()
        return array

    @reports_failures("reading a buffer")
    def _unmap(self, array: np.ndarray) -> None:
        array.base.release(self.queue)

    @reports_failures("starting its work")
    def flush(self) -> None:
        """Let the device begin with what has been enqueued."""
        self.queue.flush()

    @reports_failures("finishing its work")
    def finish(self) -> None:
        """Wait for the device."""
        self.queue.finish()
        self._after_wait()

    def reset_profile(self) -> None:
        """Set the counts of launches and seconds to 0."""
        self._pending_launches.clear()
        self.launches: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()

    def _after_wait(self) -> None:
        """The queue is in order, so all launches are done."""
        while self._dead_references:
            del self._memory[id(self._dead_references.pop())]
        for kernel, items, event in self._pending_launches:
            times = event.profile
            launch = Launch(kernel.function_name, items, times.queued, times.start, times.end)
            self.launches[launch.kernel] += 1
            self.seconds[launch.kernel] += launch.seconds
            if self.on_launch:
                self.on_launch(launch)
        self._pending_launches.clear()
