"""Compares a measurement with an earlier one (`bench --against`): speed ratios by scene and kernel."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from isonoise.benchmark.measure import SCHEMA, SCHEMA_VERSION
from isonoise.errors import UserError
from isonoise.input_files import read_json

MIN_JUDGED_SHARE = 0.05
"""Kernels with a smaller share of the kernels' time, now and before, are not judged."""


@dataclass(frozen=True)
class SpeedRatio:
    """A speed over the earlier one; below 1 it has become slower. `kernel` is None for the samples per second."""

    scene: str
    kernel: str | None
    ratio: float
    is_judged: bool
    is_significant: bool  # every repeat of one measurement was faster than every repeat of the other

    def __str__(self) -> str:
        return f"{self.scene} {f'kernel {self.kernel}' if self.kernel else 'samples/s'} {self.ratio:.3f}"


@dataclass(frozen=True)
class Comparison:
    """`removed` and `added` are the kernels, with their scene, that only one of the two measurements has."""

    ratios: list[SpeedRatio]
    removed: list[tuple[str, str]]
    added: list[tuple[str, str]]

    def slower(self, threshold: float) -> list[SpeedRatio]:
        """Judged ratios below the threshold that are significant."""
        return [r for r in self.ratios if r.is_judged and r.is_significant and r.ratio < threshold]


class Baseline:
    """A file that `isonoise bench --json` wrote earlier. Raises UserError if it is not such a file."""

    def __init__(self, path: str):
        self.path = path
        try:
            self._content = read_json(path)
        except OSError as error:
            raise UserError(f"cannot read '{path}': {error.strerror}") from error
        except ValueError as error:
            raise UserError(f"'{path}' is not a JSON file: {error}") from error
        if not isinstance(self._content, dict) or self._content.get("schema") != SCHEMA:
            raise UserError(f"'{path}' was not written by `isonoise bench --json`")
        if (version := self._content.get("schema_version")) != SCHEMA_VERSION:
            raise UserError(
                f"'{path}' has schema_version {version}, this program needs {SCHEMA_VERSION}; "
                "make a new file with --json"
            )
        with self._report_damage():
            self._scenes = {scene["scene"]: scene for scene in self._content["scenes"]}

    def check_device(self, now: Mapping) -> None:
        """Raise UserError unless the device is the same. Its driver may differ."""
        with self._report_damage():
            before = self._content["device"]["name"]
        if before != now["device"]["name"]:
            raise UserError(
                f"'{self.path}' was measured on {before}, this device is {now['device']['name']}: choose the same "
                "device with --device, or make a new file with --json"
            )

    def check_scene(self, now: Mapping) -> None:
        """Raise UserError unless the file has the same scene with the same size, depth and number of samples.

        `now` comes from `measure.scene_identity`.
        """
        name = now["scene"]
        if name not in self._scenes:
            raise UserError(f"'{self.path}' has no scene {name}; it has: {', '.join(map(str, self._scenes)) or 'none'}")
        with self._report_damage():
            before = {key: self._scenes[name][key] for key in now}
        option = {"width": "--size", "height": "--size", "max_depth": "--max-depth", "samples": "--spp"}
        for key in ("width", "height", "max_depth", "samples", "scene_hash"):
            if before[key] != now[key]:
                difference = f"{key} is {before[key]} in '{self.path}' and {now[key]} now"
                advice = f"give the same {option[key]}" if key in option else "the scene itself has changed"
                raise UserError(f"{name} cannot be compared: {difference}; {advice}, or make a new file with --json")

    def compare(self, now: Mapping) -> Comparison:
        """Speed ratios of all scenes of a measurement; each scene has passed `check_scene`."""
        ratios, removed, added = [], [], []
        with self._report_damage():
            for scene in now["scenes"]:
                name, before = scene["scene"], self._scenes[scene["scene"]]
                speed, speed_before = scene["samples_per_s"], before["samples_per_s"]
                ratio = speed["median"] / speed_before["median"]
                ratios.append(SpeedRatio(name, None, ratio, True, _is_disjoint(speed, speed_before)))
                rows_before = {row["kernel"]: row for row in before["kernels"]}
                for row in scene["kernels"]:
                    old = rows_before.pop(row["kernel"], None)
                    if old is None:
                        added.append((name, row["kernel"]))
                    elif row["time_s"]["median"] > 0:
                        ratio = old["time_s"]["median"] / row["time_s"]["median"]
                        is_judged = max(old["time_share"], row["time_share"]) > MIN_JUDGED_SHARE
                        is_significant = _is_disjoint(row["time_s"], old["time_s"])
                        ratios.append(SpeedRatio(name, row["kernel"], ratio, is_judged, is_significant))
                removed += [(name, kernel) for kernel in rows_before]
        return Comparison(ratios, removed, added)

    @contextlib.contextmanager
    def _report_damage(self) -> Iterator[None]:
        """Turns the errors of reading a damaged file into a UserError."""
        try:
            yield
        except (LookupError, TypeError, ArithmeticError) as error:
            raise UserError(f"'{self.path}' is damaged: {type(error).__name__}: {error}") from error


def _is_disjoint(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    """Whether two spreads do not overlap. Two times five repeats of equal speed do so with probability 1/126."""
    return a["max"] < b["min"] or b["max"] < a["min"]
