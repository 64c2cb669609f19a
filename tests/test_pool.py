"""The pool size: default and tuned sizes, invalid cache files, tuning with `isonoise bench --tune`."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise.benchmark import tune
from isonoise.benchmark.measure import Settings
from isonoise.cli import main
from isonoise.device import drivers, form, pool_size, program_cache, tuned
from isonoise.device.form import FORM_VARIABLE, FORMS
from isonoise.device.opencl import Device
from isonoise.device.selection import max_parts, select_device, select_devices
from isonoise.errors import DeviceError, SceneError, UserError
from isonoise.integrator import accumulator, reduction_state, scene_buffers
from isonoise.integrator.features import FEATURES
from isonoise.integrator.kernel_table import path_bytes
from isonoise.limits import MAX_PIXELS
from isonoise.renderer import Renderer
from isonoise.scene import compile_scene, load_description
from isonoise.statistics import Needs

UNTUNED = 1000


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty program cache."""
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "programs"))
    return tmp_path / "programs"


@pytest.fixture
def device():
    return select_device().device


def pool_of(**options) -> tuple[int, Renderer]:
    renderer = Renderer(lamp_over_floor(), **options)
    return renderer._wavefront.pool_size, renderer


def test_a_tuned_size_is_used_and_does_not_affect_the_image(device):
    untuned, before = pool_of()
    assert untuned == pool_size.untuned_pool_size(device)
    assert pool_size.store_tuned_pool_size(device, 4096)
    tuned, after = pool_of()
    assert tuned == 4096
    assert pool_of(pool_size=2048)[0] == 2048
    for renderer in (before, after):
        renderer.step(200)
    assert_same_bits(before.statistics(), after.statistics())


def test_a_part_of_a_device_has_its_share_of_the_tuned_size(device):
    if max_parts(device) < 2:
        pytest.skip("the device cannot be split")
    assert pool_size.store_tuned_pool_size(device, 2**15)
    for part in select_devices("0/2"):
        share = part.device.max_compute_units / device.max_compute_units
        assert pool_size.default_pool_size(part.device) == int(2**15 * share)


@pytest.mark.parametrize(
    ("memory_gib", "buffer_gib", "size"),
    [
        (2, 1, 2**19),
        (8, 2, 2**21),
        (24, 6, 2**22),
        (80, 20, 2**24),
        (141, 35, 2**24),
        (24, 0.5, 2**21),
        (0.5, 0.1, 2**18),
    ],
)
def test_the_pool_of_a_gpu_fits_its_memory(monkeypatch, memory_gib, buffer_gib, size):
    monkeypatch.setattr(pool_size, "is_cpu", lambda device: False)
    gpu = SimpleNamespace(global_mem_size=int(memory_gib * 2**30), max_mem_alloc_size=int(buffer_gib * 2**30))
    assert pool_size.untuned_pool_size(gpu) == size


def test_a_path_takes_no_more_memory_than_assumed():
    bounce_and_state = sum(path_bytes(dict.fromkeys(FEATURES, True)).values())
    assert bounce_and_state + 16 * pool_size.SAMPLES_PER_PATH <= pool_size.BYTES_PER_PATH


def test_the_largest_pool_overflows_no_index():
    """The last float of the last sample, and the last path, have signed 32-bit numbers."""
    samples = pool_size.SAMPLES_PER_PATH * pool_size.MAX_POOL_SIZE
    assert 3 * samples - 1 < 2**31
    with pytest.raises(UserError, match=f"1 to {pool_size.MAX_POOL_SIZE}"):
        Renderer(lamp_over_floor(), pool_size=pool_size.MAX_POOL_SIZE + 1)


def test_tables_and_statistics_that_kernels_cannot_index_are_refused():
    table = np.broadcast_to(np.float32(0), (2**31 + 1,))
    with pytest.raises(SceneError, match="the triangles need 8"):
        scene_buffers._table(None, table, "the triangles")
    planes = reduction_state.state_planes(Needs(half=True, nets=True))
    assert max(planes.values()) * MAX_PIXELS < reduction_state.MAX_STATISTICS
    with pytest.raises(UserError, match="chunks of 31 entries"):
        accumulator.Accumulator(SimpleNamespace(device=None), (2**14, 2**14), Needs(median=True, chunk=31))


def test_the_untuned_size_is_not_stored(device, folder):
    assert pool_size.store_tuned_pool_size(device, 4096)
    assert len(list(folder.iterdir())) == 1
    assert pool_size.store_tuned_pool_size(device, pool_size.untuned_pool_size(device))
    assert not list(folder.iterdir())
    assert pool_size.tuned_pool_size(device) is None


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        "4096",
        "{}",
        '{"pool_size": "many"}',
        '{"pool_size": 0}',
        '{"pool_size": 1e6}',
        '{"pool_size": 1e99}',
    ]
    + [json.dumps({"pool_size": size}) for size in (-4096, 2**26, 2**40, None, True, [4096])],
)
def test_invalid_content_counts_as_missing(device, content):
    program_cache.store(tuned._key(device, "pool_size"), content.encode())
    assert pool_size.tuned_pool_size(device) is None
    assert pool_of()[0] == pool_size.untuned_pool_size(device)


def test_a_damaged_file_counts_as_missing(device, folder):
    pool_size.store_tuned_pool_size(device, 4096)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes().replace(b"4096", b"8192"))
    with pytest.warns(match="is damaged"):
        assert pool_size.tuned_pool_size(device) is None


def test_sizes_are_stored_per_driver(device, monkeypatch):
    pool_size.store_tuned_pool_size(device, 4096)
    monkeypatch.setattr(tuned, "driver_identity", lambda device: ("another",))
    assert pool_size.tuned_pool_size(device) is None


@pytest.mark.parametrize(
    ("speeds", "chosen"),
    [
        ({500: [2, 2, 2], UNTUNED: [2, 2, 2], 2000: [2, 2, 2]}, UNTUNED),
        ({500: [2.2, 2.3, 2.1], UNTUNED: [2, 2, 2], 2000: [2.3, 2.4, 2.2]}, 2000),
        ({500: [1, 1, 1], UNTUNED: [2, 2, 2], 2000: [9, 9, 1.99]}, UNTUNED),  # not faster in one turn
        ({500: [2.02, 2.02, 2.02], UNTUNED: [2, 2, 2], 2000: [2, 2, 2]}, UNTUNED),  # too small a gain
        ({500: [1.1, 2.2, 4.4], UNTUNED: [1, 2, 4]}, 500),  # compared turn by turn: the machine's speed drifts
    ],
)
def test_another_size_is_chosen_only_if_faster_in_every_turn(speeds, chosen):
    assert tune.choose_fastest(speeds, UNTUNED) == chosen


def test_pools_are_measured_in_turn(monkeypatch):
    monkeypatch.setattr(tune, "untuned_pool_size", lambda device: 256)
    scene = compile_scene(load_description(lamp_over_floor()))
    progress = []
    speeds = tune.measure_pools(
        [scene, scene], Settings(repeat=2, spp=4.0), lambda done, what: progress.append(done), FORMS["lanes"]
    )
    assert list(speeds) == [64, 128, 256, 512, 1024]
    assert all(len(turns) == 2 and min(turns) > 0 for turns in speeds.values())
    assert progress == sorted(progress)
    assert progress[0] == 0
    assert progress[-1] < 1


def test_forms_are_measured_on_cpus(device, monkeypatch):
    monkeypatch.setattr(tune, "untuned_pool_size", lambda device: 256)
    # its error estimate takes long to compile
    monkeypatch.setitem(FORMS, "cpu", FORMS["lanes"]._replace(name="cpu", lanes=1, shade_lanes=1))
    scene = compile_scene(load_description(lamp_over_floor()))
    speeds = tune.measure_forms([scene], Settings(repeat=2, spp=4.0), lambda *_: None)
    assert list(speeds) == (["lanes", "cpu"] if drivers.is_cpu(device) else [])
    monkeypatch.setattr(Device, "is_cpu", False)
    assert tune.measure_forms([scene], Settings(repeat=2, spp=4.0), lambda *_: None) == {}


def test_a_tuned_form_is_used(device, monkeypatch, folder):
    monkeypatch.delenv(FORM_VARIABLE, raising=False)
    default = form.default_form(device)
    other = FORMS["lanes" if default.name == "cpu" else "cpu"]
    assert Device().form == default
    assert form.store_tuned_form(device, other.name)
    assert Device().form == other
    program_cache.store(tuned._key(device, "form"), b'{"form": "wide"}')
    assert Device().form == default
    monkeypatch.setenv(FORM_VARIABLE, "gpu")
    assert Device().form == FORMS["gpu"]
    monkeypatch.setenv(FORM_VARIABLE, "wide")
    with pytest.raises(DeviceError, match="choose one of lanes, cpu, gpu"):
        _ = Device().form
    assert form.store_tuned_form(device, default.name)
    assert not list(folder.iterdir())


def test_pools_that_do_not_fit_in_memory_are_skipped(monkeypatch):
    monkeypatch.setattr(tune, "untuned_pool_size", lambda device: 256)
    monkeypatch.setattr(tune, "MEMORY_SHARE", 0.0)
    scene = compile_scene(load_description(lamp_over_floor()))
    assert list(tune.measure_pools([scene], Settings(repeat=1, spp=1.0), lambda *_: None, FORMS["lanes"])) == [256]


def test_bench_tune_stores_the_size_and_devices_shows_it(device, monkeypatch, capsys):
    untuned = pool_size.untuned_pool_size(device)
    speeds = {untuned // 2: [1e6, 1e6], untuned: [2e6, 2e6], 2 * untuned: [3e6, 2.5e6]}
    monkeypatch.setattr(tune, "measure_forms", lambda *arguments: {})
    monkeypatch.setattr(tune, "measure_pools", lambda *arguments: speeds)
    assert main(["bench", "--tune", "cornell"]) == 0
    out = capsys.readouterr().out
    assert f"{2 * untuned:,}" in out
    assert "1.38 (1.25 to 1.50)" in out
    assert drivers.describe_driver(device) in out
    assert main(["devices"]) == 0
    assert f"{2 * untuned:,} paths in flight, found by" in capsys.readouterr().out
    speeds[2 * untuned] = [1e6, 1e6]
    assert main(["bench", "--tune", "cornell"]) == 0
    assert main(["devices"]) == 0
    assert f"{untuned:,} paths in flight, the default" in capsys.readouterr().out


def test_bench_tune_fails_without_a_cache(device, monkeypatch, capsys):
    untuned = pool_size.untuned_pool_size(device)
    monkeypatch.setattr(tune, "measure_forms", lambda *arguments: {})
    monkeypatch.setattr(tune, "measure_pools", lambda *arguments: {untuned: [1.0], 2 * untuned: [2.0]})
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, "off")
    assert main(["bench", "--tune", "cornell"]) == 2
    assert "cannot be stored" in capsys.readouterr().err
    assert main(["bench", "--tune", "--json", "x.json"]) == 2
    assert "--tune" in capsys.readouterr().err
