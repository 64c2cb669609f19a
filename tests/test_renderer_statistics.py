"""A renderer's statistics as strategies need them, and the device's time."""

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise.device.opencl import Device
from isonoise.render_scene import render
from isonoise.renderer import Renderer
from isonoise.statistics import Needs, Statistics
from isonoise.strategies import make_strategy


def test_pool_size_and_waves_change_no_bit_of_optional_statistics():
    needs = Needs(median=True, chunk=3, batch=2, half=True, power=1.0)

    def statistics(pool_size: int | None, wave_spp: int) -> Statistics:
        strategy = make_strategy(f"uniform:wave_spp={wave_spp}")
        strategy.needs = needs
        return render(lamp_over_floor(), spp=30, strategy=strategy, pool_size=pool_size).statistics

    whole = statistics(None, 30)
    assert whole.half is not None
    for pool_size, wave_spp in ((10, 30), (None, 1), (100, 7)):
        assert_same_bits(statistics(pool_size, wave_spp), whole)


def test_statistics_are_read_once_per_wave():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=2")
    renderer.step()
    first = renderer.statistics()
    assert renderer.statistics() is first
    assert renderer.image() is first.rgb
    with pytest.raises(ValueError, match="read-only"):
        first.mean[0, 0] = 1  # shared with later callers
    renderer.step()
    assert (renderer.statistics().count == 4).all()
    assert (first.count == 2).all()


def test_device_seconds():
    renderer = Renderer(lamp_over_floor(), strategy="uniform:wave_spp=64", profile=True)
    assert renderer.device_seconds == 0  # set-up does not count
    before = 0.0
    for _ in range(3):
        record = renderer.step()
        # the device is busy for a part of the wave's time, with one kernel at a time; its clock may differ slightly
        assert 0 < renderer.device_seconds - before < 1.01 * record.seconds
        before = renderer.device_seconds
    renderer.image()  # RGB is read when it is used
    assert renderer.device_seconds > before
    assert Renderer(lamp_over_floor(), strategy="uniform").device_seconds is None


def test_kernel_profile():
    device = Device(profile=True)
    kernel = device.build("__kernel void nothing(uint n) {}", ())["nothing"]
    for _ in range(3):
        device.launch(kernel, 64, (np.uint32(0),))
    assert device.launches == {}  # they may still run
    device.finish()
    assert device.launches == {"nothing": 3}
    assert 0 < device.seconds["nothing"] < 1
    device.reset_profile()
    assert device.seconds == {}
