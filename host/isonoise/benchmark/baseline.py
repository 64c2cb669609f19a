"""A measurement against an earlier one: speed ratios by scene and kernel, and which of them are too low."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from isonoise.benchmark.measure import SCHEMA, SCHEMA_VERSION
from isonoise.errors import UserError

WEIGHTY = 0.05
"""Share of the kernels' time, now or before, from which on a slower kernel counts as slower."""


@dataclass(frozen=True)
class Ratio:
    """A speed over an earlier one: below 1 is slower than it was. `kernel` is None for the samples a second."""

    scene: str
    kernel: str | None
    ratio: float
    counts: bool  # whether it is judged
    apart: bool  # whether every repeat of one measurement was faster than every one of the other

    def __str__(self) -> str:
        return f"{self.scene} {f'kernel {self.kernel}' if self.kernel else 'samples/s'} {self.ratio:.3f}"


@dataclass(frozen=True)
class Comparison:
    """`gone` and `new` are kernels that only one of the two measurements has, with their scene."""

    ratios: list[Ratio]
    gone: list[tuple[str, str]]
    new: list[tuple[str, str]]

    def slower(self, threshold: float) -> list[Ratio]:
        """What is slower, beyond the spread of both measurements."""
        return [ratio for ratio in self.ratios if ratio.counts and ratio.apart and ratio.ratio < threshold]


class Earlier:
    """A file that an earlier `isonoise bench --json` has written. Raises UserError if it is none."""

    def __init__(self, path: str):
        self.path = path
        try:
            self._content = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise UserError(f"cannot read '{path}': {error.strerror}") from error
        except ValueError as error:
            raise UserError(f"'{path}' is no JSON file: {error}") from error
        if not isinstance(self._content, dict) or self._content.get("schema") != SCHEMA:
            raise UserError(f"'{path}' was not written by `isonoise bench --json`")
        if (found := self._content.get("schema_version")) != SCHEMA_VERSION:
            raise UserError(f"'{path}' has version {found} of the format, and this program compares {SCHEMA_VERSION}")
        with self._sound():
            self._scenes = {scene["scene"]: scene for scene in self._content["scenes"]}

    def check_device(self, now: Mapping) -> None:
        """Raise UserError unless the device is the same; its driver may be another."""
        with self._sound():
            before = self._content["device"]["name"]
        if before != now["device"]["name"]:
            raise UserError(
                f"'{self.path}' was measured on {before}, and this is {now['device']['name']}: such times cannot be "
                "compared; choose the same device with --device, or make a new file with --json"
            )

    def check_scene(self, now: Mapping) -> None:
        """Raise UserError unless the file has the scene, unchanged, at the same size, depth and number of samples.

        `now`: what `measure.identity` returns.
        """
        name = now["scene"]
        if name not in self._scenes:
            raise UserError(f"'{self.path}' has no scene {name}; it has: {', '.join(self._scenes) or 'none'}")
        with self._sound():
            before = {key: self._scenes[name][key] for key in now}
        option = {"width": "--size", "height": "--size", "max_depth": "--max-depth", "samples": "--spp"}
        for key in ("width", "height", "max_depth", "samples", "scene_hash"):
            if before[key] != now[key]:
                was = f"{key} {before[key]} in '{self.path}' and {now[key]} now"
                advice = f"give the same {option[key]}" if key in option else "the scene itself has changed"
                raise UserError(f"{name} cannot be compared: {was}; {advice}, or make a new file with --json")

    def compare(self, now: Mapping) -> Comparison:
        """Ratios for all scenes of a measurement, each of which has passed `check_scene`."""
        ratios, gone, new = [], [], []
        with self._sound():
            for scene in now["scenes"]:
                name, before = scene["scene"], self._scenes[scene["scene"]]
                speed, earlier_speed = scene["samples_per_s"], before["samples_per_s"]
                ratio = speed["median"] / earlier_speed["median"]
                ratios.append(Ratio(name, None, ratio, True, _apart(speed, earlier_speed)))
                earlier = {row["kernel"]: row for row in before["kernels"]}
                for row in scene["kernels"]:
                    old = earlier.pop(row["kernel"], None)
                    if old is None:
                        new.append((name, row["kernel"]))
                    elif row["time_s"]["median"] > 0:
                        ratio = old["time_s"]["median"] / row["time_s"]["median"]
                        counts = max(old["share"], row["share"]) > WEIGHTY
                        ratios.append(Ratio(name, row["kernel"], ratio, counts, _apart(row["time_s"], old["time_s"])))
                gone += [(name, kernel) for kernel in earlier]
        return Comparison(ratios, gone, new)

    def _sound(self) -> "_Sound":
        return _Sound(self.path)


def _apart(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    """Whether two spreads don't overlap. Of two times five repeats of the same that is so once in 126 times."""
    return a["max"] < b["min"] or b["max"] < a["min"]


class _Sound:
    """Turns what goes wrong with a damaged file within the `with` block into a UserError."""

    def __init__(self, path: str):
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, trace) -> None:
        if kind and issubclass(kind, LookupError | TypeError | ArithmeticError):
            raise UserError(f"'{self._path}' is damaged: {kind.__name__}: {error}") from error
