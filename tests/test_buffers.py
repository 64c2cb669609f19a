"""Buffers: initial content, and lifetime of their memory."""

import numpy as np
import pyopencl
import pytest

from isonoise.device.opencl import Device

# Reads its input at the end, after some 0.1 s.
SLOW_COPY = """
__kernel void slow_copy(__global const uint* in, __global uint* out, uint steps)
{
    uint x = (uint)get_global_id(0);
    for (uint i = 0; i < steps; ++i) x = x * 1664525u + in[x & 63u];
    out[get_global_id(0)] = in[get_global_id(0)] + (x == 0xffffffffu);
}
"""
COUNT = 2**16


@pytest.fixture(scope="module")
def device():
    return Device()


@pytest.mark.parametrize("nbytes", [1, 3, 4, 4097, 2**22 + 5])
def test_a_new_buffer_is_zero(device, nbytes):
    assert not device.read(device.buffer(nbytes, "zeros"), np.uint8, nbytes).any()


@pytest.mark.parametrize("count", [0, 1, 5, 2**20 + 3])
def test_a_buffer_copies_the_array(device, count):
    array = np.arange(count, dtype=np.uint8)
    buffer = device.buffer(array, "numbers")
    array += 1
    assert np.array_equal(device.read(buffer, np.uint8, count) + np.uint8(1), array)


def test_memory_is_kept_until_its_launches_are_done(device):
    """The buffer is released during a launch, and numpy reuses freed memory of its size at once."""
    kernel = device.build(SLOW_COPY, ())["slow_copy"]
    out = device.buffer(4 * COUNT, "results")
    for seven in (7, 77, 777):
        inputs = device.buffer(np.full(COUNT, seven, np.uint32), "inputs")
        device.launch(kernel, COUNT, (inputs, out, np.uint32(2000)))
        del inputs
        _others = [np.full(COUNT + 1024, 5, np.uint32) for _ in range(8)]
        assert np.all(device.read(out, np.uint32, COUNT) == seven)


def test_a_deleted_device_waits_for_its_launches():
    device = Device()
    kernel = device.build(SLOW_COPY, ())["slow_copy"]
    out, queue = device.buffer(4 * COUNT, "results"), device.queue
    device.launch(kernel, COUNT, (device.buffer(np.full(COUNT, 3, np.uint32), "inputs"), out, np.uint32(2000)))
    del device
    copied = np.empty(COUNT, np.uint32)
    pyopencl.enqueue_copy(queue, copied, out)
    assert np.all(copied == 3)
