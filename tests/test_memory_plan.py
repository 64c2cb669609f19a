"""The memory that a render takes: computed, limited, and too little of it."""

import weakref

import numpy as np
import pytest
from small_scene import HEIGHT, WIDTH, assert_same_bits, lamp_over_floor

from isonoise import Renderer, argument_types
from isonoise.device.opencl import Device
from isonoise.errors import DeviceError, UserError
from isonoise.integrator import image_scratch, stages
from isonoise.integrator.memory_plan import PROCESS_BYTES, MemoryPlan, fit_pool, format_bytes
from isonoise.integrator.sample_list import SampleList
from isonoise.statistics import BASIC_NEEDS, Needs
from isonoise.strips import LARGE_IMAGE_PIXELS

RENDERS = (
    {},
    {"strategy": "relative-median"},
    {"strategy": "tsallis:q=1.5"},
    {"strategy": "dammertz", "sampler": "independent"},
    {"strategy": "uniform", "pool_size": 3000},
)


@pytest.mark.parametrize("options", RENDERS, ids=str)
def test_the_buffers_are_those_computed(monkeypatch, options):
    buffers = []
    allocate = Device.buffer

    def recorded(self, content, label):
        buffers.append(allocate(self, content, label))
        return buffers[-1]

    # no kernel is built, and none checked
    monkeypatch.setattr(stages, "stage_source", lambda *arguments: ("", ()))
    monkeypatch.setattr(Device, "build", lambda self, text, options: {})
    monkeypatch.setattr("isonoise.integrator.set_up.check_driver", lambda *arguments: None)
    monkeypatch.setattr(Device, "buffer", recorded)
    wavefront = Renderer(lamp_over_floor(), **options)._wavefront
    plan = wavefront.memory_plan
    kept = {id(argument) for argument in wavefront.stages.arguments.values()}
    kept |= {id(buffer) for buffer in wavefront.accumulator._summaries}
    assert sum(buffer.size for buffer in buffers if id(buffer) in kept) == plan.device
    assert wavefront.device.allocated == plan.device
    sizes = {name: getattr(wavefront.stages.arguments.get(name), "size", None) for name in plan.buffers}
    del sizes["summary"], sizes["per_pixel"]  # two of them; shared by arguments of other names
    assert sizes == {name: plan.buffers[name] for name in sizes}


def plan_of(pool_size: int, needs: Needs = BASIC_NEEDS, shape: tuple[int, int] = (64, 64), **options) -> MemoryPlan:
    off = ("INSTANCES", "VOLPATH", "MEDIA", "HETEROGENEOUS", "LIGHT_TREE", "LIGHT_LIST", "COUNT_TESTS")
    features = dict.fromkeys(off, False)
    features["NEXT_EVENT"] = True
    return MemoryPlan(0, 0, features, needs, shape, pool_size, 512, 2, **options)


def test_a_limit_makes_the_pool_smaller_and_changes_no_bit():
    free = Renderer(lamp_over_floor(), strategy="pooled:warmup=4", seed=1)
    limit = PROCESS_BYTES + (free._wavefront.memory_plan.shared - PROCESS_BYTES) // 16
    limited = Renderer(lamp_over_floor(), strategy="pooled:warmup=4", seed=1, memory=limit)
    assert limit / 1.1 < limited._wavefront.memory_plan.shared <= limit
    assert limited._wavefront.pool_size < free._wavefront.pool_size
    for renderer in (free, limited):
        for _ in range(3):
            renderer.step()
    assert_same_bits(free.statistics(), limited.statistics())


def test_too_little_memory_is_an_error_with_numbers():
    with pytest.raises(DeviceError, match=r"7x5 pixels and a pool of 1,024 paths need .* MiB .*100 KiB.*smaller image"):
        Renderer(lamp_over_floor(), memory=100 * 2**10)
    with pytest.raises(UserError, match="goes from 1 to"):
        Renderer(lamp_over_floor(), memory=0)


class SmallDevice:
    name, global_memory, max_buffer_size, shares_memory = "a small device", 2**30, 2**27, False


def test_the_pool_fits_the_device_and_its_largest_buffer():
    fitting = fit_pool(plan_of, 2**22, SmallDevice())
    assert fitting.device <= 2**30 < 2 * fitting.device or max(fitting.buffers.values()) > 2**26
    assert max(fitting.buffers.values()) <= 2**27
    assert fitting.pool_size == 2**19  # 12 bytes for 16 samples a path
    with pytest.raises(DeviceError, match=r"'sums' of 2048x2048 pixels needs 160 MiB.* at most 128 MiB"):
        fit_pool(lambda pool: plan_of(pool, shape=(2048, 2048)), 2**20, SmallDevice())
    with pytest.raises(DeviceError, match="a small device has 1 GiB"):
        fit_pool(lambda pool: plan_of(pool, shape=(8192, 8192)), 2**20, SmallDevice())


def test_a_device_of_its_own_memory_counts_no_host_arrays():
    plan = plan_of(2**10, Needs(nets=True, neighbours=5))
    assert plan.shared == PROCESS_BYTES + plan.device - 4 * plan.pixels + plan.host
    large = plan_of(2**10, Needs(nets=True, neighbours=5), (2**11, LARGE_IMAGE_PIXELS >> 11))
    assert large.device < large.shared < PROCESS_BYTES + large.device - 4 * large.pixels + large.host


@pytest.mark.parametrize("slice_samples", [1, 7, 100, 10**6])
def test_slices_cover_all_samples_once(slice_samples):
    random = np.random.default_rng(3)
    allocation = (random.integers(0, 9, 3 * 2**16) * (random.random(3 * 2**16) < 2e-3)).astype(np.uint32)
    remaining = allocation.copy()
    samples, pixels = SampleList(remaining), np.repeat(np.arange(allocation.size), allocation)
    assert samples.total == len(pixels)
    found = []
    while samples.total:
        pixel, offsets, number = samples.first_slice(slice_samples)
        assert 0 < number <= slice_samples
        assert len(offsets) <= slice_samples
        ends = np.append(offsets[1:], number)
        taken = random.integers(1, number + 1)  # a slice may end early
        found.append(np.repeat(pixel + np.arange(len(offsets)), ends - offsets)[:taken])
        samples.remove_first(taken)
        assert not remaining[:pixel].any()
    assert np.array_equal(np.concatenate(found), pixels)
    assert not remaining.any()


def test_sizes_as_text():
    assert [argument_types.memory_size(text) for text in ("4G", "512M", "1.5g", "100", "2KiB")] == [
        *(2**32, 2**29, 3 * 2**29, 100, 2**11)
    ]
    for text in ("", "4X", "-1G", "G", "0", "1e9", "0.0001"):
        with pytest.raises(Exception, match="is not a size of memory"):
            argument_types.memory_size(text)
    assert [format_bytes(size) for size in (2**32, 3 * 2**19, 512)] == ["4 GiB", "1.5 MiB", "0.5 KiB"]


def test_statistics_in_use_keep_their_image():
    first, other = (Renderer(lamp_over_floor(), strategy="uniform:wave_spp=2", seed=4) for _ in range(2))
    first.step(), other.step()
    in_use, expected = first.statistics(), other.image()
    first.step()
    assert np.array_equal(in_use.rgb, expected)
    assert not np.array_equal(first.image(), expected)


def test_a_closed_renderer_has_freed_its_buffers():
    with Renderer(lamp_over_floor(), strategy="uniform:wave_spp=2", seed=4) as renderer:
        renderer.step()
        expected, statistics = renderer.image().copy(), renderer.statistics()
        renderer.step()
        accumulator = weakref.ref(renderer._wavefront.accumulator)
        assert np.array_equal(renderer.statistics().count, np.full((HEIGHT, WIDTH), 4))
    assert accumulator() is None
    assert np.array_equal(statistics.rgb, expected)
    renderer.close()


def test_a_large_image_gives_memory_back_and_stays_the_same(monkeypatch):
    small = Renderer(lamp_over_floor(), strategy="pooled:warmup=4", seed=2)
    monkeypatch.setattr(image_scratch, "LARGE_IMAGE_PIXELS", 1)
    large = Renderer(lamp_over_floor(), strategy="pooled:warmup=4", seed=2)
    for _ in range(3):
        small.step(), large.step()
        errors = [renderer.error_distribution(0.01).quantiles((0.5, 0.99)) for renderer in (small, large)]
        assert np.array_equal(*errors)
    allocated = large._wavefront.device.allocated
    large.image()
    scratch = sum(image_scratch.scratch_bytes((5, 7), Needs(nets=True, neighbours=5)).values())
    assert large._wavefront.device.allocated == allocated - scratch
    assert np.array_equal(large.error_distribution(0.01).quantiles((0.5, 0.99)), errors[0])
    assert large._wavefront.device.allocated == allocated
    assert_same_bits(small.statistics(), large.statistics())
