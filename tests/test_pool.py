"""How many paths are in flight: measured, kept for the device, used by renders, and never a reason to fail."""

import json

import pytest
from small_scene import assert_same_bits, lamp_over_floor

from isonoise.benchmark import tune
from isonoise.benchmark.measure import Settings
from isonoise.cli import main
from isonoise.device import opencl, pool_size, program_cache
from isonoise.renderer import Renderer
from isonoise.scene import compile_scene, load

USUAL = 1000


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Nothing is kept yet."""
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, str(tmp_path / "programs"))
    return tmp_path / "programs"


@pytest.fixture
def device():
    return opencl.select_device()


def pool_of(**options) -> tuple[int, Renderer]:
    renderer = Renderer(lamp_over_floor(), **options)
    return renderer._wavefront.pool_size, renderer


def test_what_is_kept_is_used_and_changes_no_image(device):
    usual, before = pool_of()
    assert usual == pool_size.untuned_pool_size(device)
    assert pool_size.store_tuned_pool_size(device, 4096)
    found, after = pool_of()
    assert found == 4096
    assert pool_of(pool_size=2048)[0] == 2048  # who says how many gets them
    for renderer in (before, after):
        renderer.step(200)
    assert_same_bits(before.statistics(), after.statistics())


def test_the_usual_size_is_not_kept(device, folder):
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
    + [json.dumps({"pool_size": size}) for size in (-4096, 2**40, None, True, [4096])],
)
def test_what_is_not_sound_counts_as_not_there(device, content):
    program_cache.store(pool_size._key(device), content.encode())
    assert pool_size.tuned_pool_size(device) is None
    assert pool_of()[0] == pool_size.untuned_pool_size(device)


def test_a_broken_file_counts_as_not_there(device, folder):
    pool_size.store_tuned_pool_size(device, 4096)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes().replace(b"4096", b"8192"))
    assert pool_size.tuned_pool_size(device) is None


def test_another_driver_has_a_size_of_its_own(device, monkeypatch):
    pool_size.store_tuned_pool_size(device, 4096)
    monkeypatch.setattr(pool_size, "driver_identity", lambda device: ("another",))
    assert pool_size.tuned_pool_size(device) is None


@pytest.mark.parametrize(
    ("speeds", "chosen"),
    [
        ({500: [2, 2, 2], USUAL: [2, 2, 2], 2000: [2, 2, 2]}, USUAL),
        ({500: [2.2, 2.3, 2.1], USUAL: [2, 2, 2], 2000: [2.3, 2.4, 2.2]}, 2000),
        ({500: [1, 1, 1], USUAL: [2, 2, 2], 2000: [9, 9, 1.99]}, USUAL),  # one turn says no
        ({500: [2.02, 2.02, 2.02], USUAL: [2, 2, 2], 2000: [2, 2, 2]}, USUAL),  # too little to care
        ({500: [1.1, 2.2, 4.4], USUAL: [1, 2, 4]}, 500),  # turn by turn, however the machine's speed drifts
    ],
)
def test_the_usual_size_stays_unless_another_wins_every_turn(speeds, chosen):
    assert tune.fastest(speeds, USUAL) == chosen


def test_pools_are_measured_in_turn(monkeypatch):
    monkeypatch.setattr(tune, "untuned_pool_size", lambda device: 256)
    scene = compile_scene(load(lamp_over_floor()))
    asked = []
    speeds = tune.measure_pools([scene, scene], Settings(repeat=2, spp=4.0), lambda done, what: asked.append(done))
    assert list(speeds) == [64, 128, 256, 512, 1024]
    assert all(len(turns) == 2 and min(turns) > 0 for turns in speeds.values())
    assert asked == sorted(asked)
    assert asked[0] == 0
    assert asked[-1] < 1


def test_only_pools_for_which_there_is_memory(monkeypatch):
    monkeypatch.setattr(tune, "untuned_pool_size", lambda device: 256)
    monkeypatch.setattr(tune, "MEMORY_SHARE", 0.0)
    scene = compile_scene(load(lamp_over_floor()))
    assert list(tune.measure_pools([scene], Settings(repeat=1, spp=1.0), lambda *_: None)) == [256]


def test_bench_tune_keeps_and_devices_says_so(device, monkeypatch, capsys):
    usual = pool_size.untuned_pool_size(device)
    speeds = {usual // 2: [1e6, 1e6], usual: [2e6, 2e6], 2 * usual: [3e6, 2.5e6]}
    monkeypatch.setattr(tune, "measure_pools", lambda *arguments: speeds)
    assert main(["bench", "--tune", "cornell"]) == 0
    said = capsys.readouterr().out
    assert f"{2 * usual:,}" in said
    assert "1.38 (1.25 to 1.50)" in said
    assert main(["devices"]) == 0
    assert f"{2 * usual:,} paths in flight, found by" in capsys.readouterr().out
    speeds[2 * usual] = [1e6, 1e6]
    assert main(["bench", "--tune", "cornell"]) == 0
    assert main(["devices"]) == 0
    assert f"{usual:,} paths in flight, the default" in capsys.readouterr().out


def test_bench_tune_says_when_it_cannot_keep(device, monkeypatch, capsys):
    usual = pool_size.untuned_pool_size(device)
    monkeypatch.setattr(tune, "measure_pools", lambda *arguments: {usual: [1.0], 2 * usual: [2.0]})
    monkeypatch.setenv(program_cache.FOLDER_VARIABLE, "off")
    assert main(["bench", "--tune", "cornell"]) == 2
    assert "cannot be stored" in capsys.readouterr().err
    assert main(["bench", "--tune", "--json", "x.json"]) == 2
    assert "--tune" in capsys.readouterr().err
