"""Renders in processes of their own that are killed and continued, and checks of the files that they leave.

Used by test_kill.py and soak.py.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import PIL.Image

from isonoise.film.exr import read_exr
from isonoise.state.checkpoint import read_checkpoint
from isonoise.state.state import State

_KILLED_AT_FILE_OPERATION = """
import os, sys
from fnmatch import fnmatch
left, pattern = int(sys.argv[1]), sys.argv[2]
def count_down(event, arguments):
    global left
    if event in ("open", "os.rename", "os.remove") and fnmatch(str(arguments[0]), pattern):
        left -= 1
        if left == 0:
            os.kill(os.getpid(), 9)
sys.addaudithook(count_down)
from isonoise.cli import main
sys.exit(main(sys.argv[3:]))
"""
"""Runs isonoise until it is about to open, rename or remove a file that matches a pattern for the n-th time."""
_POLL_INTERVAL_S = 0.0005


@dataclass(frozen=True)
class Kill:
    """When a process is killed: after `delay_s`; or `delay_s` after a process has begun to write a file that
    matches `pattern`; or at its `operation`-th file operation on a file that matches."""

    delay_s: float = 0.0
    pattern: str = "*"
    operation: int = 0
    signal: int = signal.SIGKILL


@dataclass
class Job:
    """A render in a folder of its own. Its command is the same each time."""

    folder: Path
    scene: str = "cornell"
    strategy: str = "uniform"
    spp: float = 64
    size: tuple[int, int] = (64, 48)
    more: tuple[str, ...] = ()
    interval_s: float = 0.2
    save_every_s: float | None = None
    environment: dict[str, str] = field(default_factory=dict)

    NAMES = ("a.exr", "a.png", "a.csv", "a.npz")

    @property
    def arguments(self) -> list[str]:
        image, preview, log, checkpoint = (str(self.folder / name) for name in self.NAMES)
        save = [] if self.save_every_s is None else ["--save-every", str(self.save_every_s)]
        width, height = self.size
        return [
            *("render", self.scene, "-o", image, "-o", preview, "--log", log, "--checkpoint", checkpoint),
            *("--resume", checkpoint, "--checkpoint-every", str(self.interval_s), "--size", f"{width}x{height}"),
            *("--spp", str(self.spp), "--strategy", self.strategy, *save, *self.more),
        ]

    def start(self, kill: Kill | None = None) -> subprocess.Popen:
        program = ["-m", "isonoise"]
        if kill and kill.operation:
            program = ["-c", _KILLED_AT_FILE_OPERATION, str(kill.operation), str(self.folder / kill.pattern)]
        return subprocess.Popen(
            [sys.executable, *program, *self.arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=os.environ | self.environment,
        )

    def run(self) -> str:
        """Render to the end; return standard error."""
        process = self.start()
        err = process.communicate(timeout=600)[1].decode()
        assert process.returncode == 0, err
        return err

    def run_killed(self, kill: Kill) -> bool:
        """Start the render and kill it; whether it was killed before its end."""
        earlier = set(self.folder.iterdir())
        process = self.start(kill)
        if not kill.operation:
            self._wait(process, kill, earlier)
            process.send_signal(kill.signal)
        err = process.communicate(timeout=600)[1].decode()
        if "isonoise" in err or "Traceback" not in err:  # else Python itself was interrupted while it started
            assert "Traceback" not in err, err
            assert process.returncode in (0, -kill.signal, 128 + kill.signal), (process.returncode, err)
        return process.returncode != 0

    def _wait(self, process: subprocess.Popen, kill: Kill, earlier: set[Path]) -> None:
        while kill.pattern != "*" and process.poll() is None:
            with contextlib.suppress(FileNotFoundError):
                if any(path.stat().st_size for path in self.folder.glob(kill.pattern) if path not in earlier):
                    break
            time.sleep(_POLL_INTERVAL_S)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(kill.delay_s)


@dataclass
class Files:
    """What the files of a job hold. Reading them raises an exception if one is incomplete."""

    channels: dict[str, np.ndarray] | None
    header: dict[str, object]
    rows: list[list[str]]
    state: State | None

    @classmethod
    def read(cls, job: Job) -> "Files":
        image, preview, log, checkpoint = (job.folder / name for name in job.NAMES)
        channels, header = read_exr(image) if image.exists() else (None, {})
        if preview.exists():
            with PIL.Image.open(preview) as picture:
                picture.load()
        rows = []
        if log.exists():
            content = log.read_text()
            assert content.endswith("\n")
            rows = [line.split(",") for line in content.splitlines()]
            assert len({len(row) for row in rows}) == 1
            assert [row[1] for row in rows[1:]] == [str(k) for k in range(1, len(rows))]
        return cls(channels, header, rows, read_checkpoint(checkpoint) if checkpoint.exists() else None)

    @property
    def logged_s(self) -> float:
        """Seconds of rendering that the log shows."""
        return float(self.rows[-1][0]) if self.rows else 0.0

    @property
    def kept_s(self) -> float:
        """Seconds of rendering that the checkpoint keeps."""
        return 0.0 if self.state is None else self.state.values["loop"]["elapsed_s"]

    @property
    def kept_samples(self) -> int:
        return 0 if self.state is None else self.state.values["renderer"]["samples"]

    def assert_equal(self, other: "Files") -> None:
        """The same bits in image and state, the same log except for the times."""
        assert self.channels.keys() == other.channels.keys()
        for name, channel in self.channels.items():
            assert channel.tobytes() == other.channels[name].tobytes(), name
        assert [row[1:] for row in self.rows] == [row[1:] for row in other.rows]
        assert self.header["isonoise.samples"] == other.header["isonoise.samples"]
        assert self.state.arrays.keys() == other.state.arrays.keys()
        for name, array in self.state.arrays.items():
            assert array.tobytes() == other.state.arrays[name].tobytes(), name


def left_behind(job: Job) -> list[str]:
    """Kinds of the temporary files that a killed process has left, such as `.exr`."""
    return [path.suffix for path in job.folder.glob(".*.tmp*")]


def random_kill(rng: random.Random, job: Job, seconds: float, operations: int) -> Kill:
    """A random moment of a process that takes about `seconds` with this number of file operations."""
    match rng.randrange(8):
        case 0 | 1:
            return Kill(operation=rng.randint(1, operations))
        case 2:
            return Kill(pattern=".*.tmp.npz", delay_s=rng.choice((0.0, rng.uniform(0, 0.003))))
        case 3:
            return Kill(pattern=rng.choice((".*.tmp.exr", ".*.tmp.png", ".*.tmp.csv")), delay_s=rng.uniform(0, 0.003))
        case 4:
            return Kill(rng.uniform(0, 0.5))
    return Kill(rng.uniform(0, seconds))
