"""Memory bandwidth of a device, measured by copies: the roof that kernels' rates are compared with."""

import time
from collections.abc import Callable

import numpy as np

from isonoise.benchmark.spread import spread
from isonoise.device.drivers import load_pyopencl
from isonoise.device.opencl import Device

MAX_COPY_BYTES = 2**28
"""Of each of the two buffers. They are smaller on a device with less than 16 times that memory."""
VECTOR_BYTES = 16
SOURCE = """\
__kernel void copy(__global const float4* source, __global float4* target, uint count)
{
    const size_t i = get_global_id(0);
    if (i < count) target[i] = source[i];
}
"""


def copy_gb_per_s(device: Device, repeat: int) -> dict[str, float]:
    """Spread of the bytes read and written per second, in 10^9, of the faster of two ways to copy a large buffer.

    The two are a kernel and `clEnqueueCopyBuffer`. Each has one run as a warm-up.
    """
    memory_bytes = min(device.device.global_mem_size // 16, device.device.max_mem_alloc_size)
    count = min(MAX_COPY_BYTES, memory_bytes) // VECTOR_BYTES
    source = device.buffer(np.ones(count * VECTOR_BYTES // 4, np.float32), "the copy")
    target = device.buffer(count * VECTOR_BYTES, "the copy")
    kernel = device.build(SOURCE, ("-cl-std=CL1.2",))["copy"]

    def copy_by_kernel() -> None:
        device.launch(kernel, count, (source, target, np.uint32(count)))

    def copy_by_driver() -> None:
        load_pyopencl().enqueue_copy(device.queue, target, source)

    def rate(copy: Callable[[], None]) -> float:
        start = time.perf_counter()
        copy()
        device.finish()
        return 2e-9 * count * VECTOR_BYTES / (time.perf_counter() - start)

    rates = [spread([rate(copy) for _ in range(1 + repeat)][1:]) for copy in (copy_by_kernel, copy_by_driver)]
    return max(rates, key=lambda each: each["median"])
