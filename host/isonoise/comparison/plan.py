"""The plan of a comparison: scenes, strategies, seeds, budget; stored in plan.json, so that a comparison can resume.

`planning.make_plan` makes a plan; `plan_changes` compares two.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from isonoise.comparison.table_columns import DEFAULT_METRICS
from isonoise.errors import UserError
from isonoise.film.files import write_atomically
from isonoise.input_files import read_json, read_regular_file

PLAN_FILE = "plan.json"
FIRST_REFERENCE_SEED = 2**63
"""Seeds from here on are reserved for references; those of runs are below."""
SEVERAL_DEVICES = "several devices"
"""`Plan.device` of a comparison that began with workers of different devices: it may continue with any."""
REFERENCE_BUDGET_FACTOR = 20
"""Default budget of a reference, over the budget of a run. The number of samples alone reduces its standard error to
0.22 of a run's, below the quarter that `reference_too_noisy` of summary.json checks."""


@dataclass(frozen=True)
class SceneEntry:
    """A scene of the plan."""

    slug: str  # name of its folder and files
    name: str
    source: str  # name of a built-in scene, an absolute path, or OBJECT and a name: given by a Python program
    hash: str  # of the compiled scene, size and depth included
    width: int
    height: int
    reference: str  # absolute path if given, else relative to the comparison's folder
    reference_sha256: str | None  # if given
    size: tuple[int, int] | None = None  # (width, height), overrides the scene's
    max_depth: int | None = None  # overrides the scene's
    settings: dict = field(default_factory=dict, hash=False)  # `$name` or path of a parameter -> value


@dataclass(frozen=True)
class StrategyEntry:
    """A strategy of the plan."""

    slug: str
    title: str
    spec: str  # as the user wrote it
    parameters: str  # the spec with all parameters
    code: str | None = None  # what identifies its code, see `strategy_code`; None: it is part of isonoise
    settings: dict = field(default_factory=dict, hash=False)  # parameters that an experiment sets -> value


@dataclass(frozen=True)
class Plan:
    """A comparison: every scene with every strategy and seed. Either `time` or `spp` is the budget of a run."""

    version: str  # of isonoise and its source files, see `program_version`
    scenes: tuple[SceneEntry, ...]
    strategies: tuple[StrategyEntry, ...]
    seeds: tuple[int, ...]
    time: float | None  # seconds
    spp: float | None  # mean samples per pixel
    device: str  # its kind and its driver, see `device_identity`; of all workers of a cluster, or SEVERAL_DEVICES
    reference_time: float | None  # seconds; None: REFERENCE_BUDGET_FACTOR times spp
    preset: str | None = None  # the report has its figures
    allow_outside: bool = False  # as for `isonoise.load`
    metrics: tuple[str, ...] = DEFAULT_METRICS  # of the tidy tables
    keep_images: bool = False  # as EXR files

    def scene(self, slug: str) -> SceneEntry:
        return next(scene for scene in self.scenes if scene.slug == slug)


def read_plan(directory: Path) -> Plan | None:
    """The plan in `directory`, None if there is none. Raises UserError if it is unreadable."""
    path = directory / PLAN_FILE
    if not path.exists():
        return None
    try:
        content = read_json(path)
        if content.pop("sha256", None) != _plan_sha256(content):
            raise ValueError("its SHA-256 is wrong or missing")
        content["scenes"] = tuple(_scene_entry(entry) for entry in content["scenes"])
        content["strategies"] = tuple(StrategyEntry(**entry) for entry in content["strategies"])
        content["seeds"] = tuple(content["seeds"])
        content["metrics"] = tuple(content["metrics"])
        return Plan(**content)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(
            f"cannot read the plan '{path}' ({error}): it is damaged, or an earlier version wrote it. Delete it and "
            "give all scenes, strategies, seeds and the budget again: valid runs are kept. Or choose another folder "
            "with -o"
        ) from error


def write_plan(directory: Path, plan: Plan) -> None:
    """Raises UserError if the file cannot be written."""
    content = asdict(plan)
    text = json.dumps(content | {"sha256": _plan_sha256(content)}, indent=1) + "\n"
    write_atomically(directory / PLAN_FILE, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def run_path(directory: Path, scene: SceneEntry, strategy: StrategyEntry, seed: int) -> Path:
    """File of a finished run."""
    return directory / "runs" / scene.slug / strategy.slug / f"{seed}.npz"


def variance_path(directory: Path, scene: SceneEntry) -> Path:
    """File of the single-sample variance that the oracle reads."""
    return directory / "references" / f"{scene.slug}-variance.exr"


def file_sha256(path: Path) -> str:
    """SHA-256 of a file in hexadecimal digits."""
    return hashlib.sha256(read_regular_file(path)).hexdigest()


def _scene_entry(content: Mapping) -> SceneEntry:
    return SceneEntry(**{**content, "size": content["size"] and tuple(content["size"])})


def _plan_sha256(content: Mapping) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
