"""Small checkpoints made without a device, and damaged ones; for test_damaged_checkpoints.py."""

import dataclasses
import io
import json
import random
import zipfile
from pathlib import Path

import numpy as np
from fuzz_mutations import mutate_bytes

from isonoise.error.stopping import ErrorStop
from isonoise.state.checkpoint import write_checkpoint
from isonoise.state.state import State
from isonoise.statistics import Needs
from isonoise.stops import Stops

HEIGHT, WIDTH = 5, 7
SHAPE = HEIGHT, WIDTH
_OF_A_RENDER = {"seed": 3, "strategy": "pooled", "sampler": "independent", "device": "d"}
_VIEW = {"camera": None, "fov": 40.0, "look_at": [[1.0, 2.0, 3.0]], "up": None, "env": None, "crop": None}
_SETTINGS = {
    "version": "1", "scene": "s.xml", "size": [WIDTH, HEIGHT], "max_depth": 4, "parameters": {"a": "1"},
    "scene_hash": "ab", "scene_parts": {"faces": "cd"}, "files": {"s.xml": "ef"}, "radiance_scale": 0.5,
    "film_window": [[9, HEIGHT], [2, 0], [WIDTH, HEIGHT]], "exposure": None,
    "overrides": {"size": None, "max_depth": None, "sampler": None, "parameters": {"a": "1"}, "view": _VIEW},
    "needs": dataclasses.asdict(Needs(uniform=True)) | {"layers": []}, "layers": [],
}  # fmt: skip


def render_state(seed: int = 0) -> State:
    """In the middle of the third wave, with everything that a state may have."""
    random = np.random.default_rng(seed)
    count = random.integers(3, 9, (1, *SHAPE)).astype(np.uint32)
    rejected = np.zeros_like(count)
    rejected[0, 2, 2] = 1
    remaining = random.integers(0, 4, SHAPE).astype(np.uint32)
    samples, traced = int(count.sum() + rejected.sum()), 20
    rows = [
        {
            "elapsed_s": 0.5 * wave, "wave": wave, "kind": "uniform", "samples": wave, "spp": wave / 35,
            "stated_p50": 0.1, "stated_p95": 0.2, "stated_p99": float("inf"), "rejected": 1,
            "error_bound": float("nan"), "energy_loss": 0.0, "energy_loss_se": 0.0, "workers": 2,
        }
        for wave in (1, 2)
    ]  # fmt: skip
    values = {
        "renderer": {
            "samples": samples,
            "planner": {"waves_taken": 3, "unfinished_spp": None, "wave_index": 3, "max_pixel_samples": 20},
            "wave": {"kind": "adaptive", "planned": traced + int(remaining.sum()), "traced": traced, "seconds": 0.1},
        },
        "strategy": {"_last_samples": 12, "_weights": None},
        "loop": {
            "rows": rows, "elapsed_s": 1.25, "samples_per_s": 1e6, "error": 0.3,
            "error_stop": vars(ErrorStop(0.01, 0.99, 0.95)), "energy_loss_control": float("nan"),
            "reference_floor": None, "stops": dataclasses.asdict(Stops(spp=64)),
        },
    }  # fmt: skip
    arrays = {
        "reduction/count": count,
        "reduction/rejected": rejected,
        "reduction/sums": random.random((10, *SHAPE), np.float32),
        "reduction/sample_block_sums": random.random((2, *SHAPE), np.float32),
        "strategy/_last_image": random.random((*SHAPE, 3), np.float32),
        "wave/remaining": remaining,
        "uniform/sums": random.random((3, *SHAPE)),
        "energy_loss/uniform": random.random((2, *SHAPE)),
    }
    return State(_SETTINGS | _OF_A_RENDER, values, arrays)


def merged_state(seed: int = 0) -> State:
    random = np.random.default_rng(seed)
    count = random.integers(3, 9, SHAPE).astype(np.uint32)
    renders = [_OF_A_RENDER | {"seed": seed, "samples": seed, "elapsed_s": 1.0} for seed in (1, int(count.sum()) - 1)]
    arrays = {
        "count": count,
        "rejected": np.zeros(SHAPE, np.uint32),
        "rgb": random.random((*SHAPE, 3), np.float32),
        "mean": random.random(SHAPE),
        "variance": random.random(SHAPE),
    }
    arrays = {f"statistics/{name}": array for name, array in arrays.items()}
    return State(dict(_SETTINGS), {"merged": {"renders": renders}}, arrays)


def content(state: State) -> tuple:
    """Comparable; JSON makes nan equal to nan."""
    arrays = {name: (array.dtype.str, array.shape, array.tobytes()) for name, array in state.arrays.items()}
    return json.dumps([state.settings, state.values], sort_keys=True), arrays


def file_bytes(state: State, folder: Path) -> bytes:
    path = folder / "sound.npz"
    write_checkpoint(path, state)
    return path.read_bytes()


def damaged(sound: bytes, other: bytes, rng: random.Random) -> bytes:
    """A sound checkpoint with random damage; `other` is another checkpoint of the same render."""
    match rng.randrange(10):
        case 0:
            return sound[: rng.randrange(len(sound))]
        case 1 | 2 | 3:
            position = rng.randrange(len(sound))
            return sound[:position] + bytes([sound[position] ^ 1 << rng.randrange(8)]) + sound[position + 1 :]
        case 4:
            length, position = rng.randint(1, 5000), rng.randrange(len(sound))
            return sound[:position] + rng.choice((bytes(length), rng.randbytes(length))) + sound[position + length :]
        case 5:  # a part of another checkpoint, as after a write that was not flushed
            position = rng.randrange(min(len(sound), len(other)))
            return sound[:position] + other[position:]
        case 6 | 7:
            members = read_members(sound)
            first, second = rng.sample(sorted(members), 2)
            change = rng.randrange(4)
            if change == 0:
                members[first], members[second] = members[second], members[first]
            elif change == 1:
                members[first] = read_members(other)[first]
            elif change == 2:
                del members[first]
            else:
                members[first] = mutate_bytes(members[first], rng)
            return archive_bytes(members, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    return mutate_bytes(sound, rng)


def read_members(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def archive_bytes(members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A zip archive with valid checksums."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()
