"""The plan of a comparison: scenes, strategies, seeds, budget; stored in plan.json, so that a comparison can resume."""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from isonoise import __version__
from isonoise.comparison.strategy_specs import describe_spec, strategy_title
from isonoise.errors import UserError
from isonoise.film.exr import read_reference
from isonoise.film.files import write_atomically
from isonoise.input_files import read_json, read_regular_file
from isonoise.scene import compile_scene, load
from isonoise.scene.builtin import find_scene

PLAN_FILE = "plan.json"
FIRST_REFERENCE_SEED = 2**63
"""Seeds from here on are reserved for references; those of runs are below."""
MAX_SEEDS = 10**6
"""Runs of a strategy on a scene."""
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
    source: str  # name of a built-in scene, or an absolute path
    hash: str  # of the compiled scene, size and depth included
    width: int
    height: int
    reference: str  # absolute path if given, else relative to the comparison's folder
    reference_sha256: str | None  # if given


@dataclass(frozen=True)
class StrategyEntry:
    """A strategy of the plan."""

    slug: str
    title: str
    spec: str  # as the user wrote it
    parameters: str  # the spec with all parameters


@dataclass(frozen=True)
class Plan:
    """A comparison: every scene with every strategy and seed. Either `time` or `spp` is the budget of a run."""

    version: str
    scenes: tuple[SceneEntry, ...]
    strategies: tuple[StrategyEntry, ...]
    seeds: tuple[int, ...]
    time: float | None  # seconds
    spp: float | None  # mean samples per pixel
    size: tuple[int, int] | None  # (width, height), overrides the scenes'
    max_depth: int | None  # overrides the scenes'
    device: str  # its kind, see `SelectedDevice`; of all workers of a cluster, or SEVERAL_DEVICES
    reference_time: float | None  # seconds; None: REFERENCE_BUDGET_FACTOR times spp
    preset: str | None = None  # the report has its figures
    allow_outside: bool = False  # as for `isonoise.load`

    def scene(self, slug: str) -> SceneEntry:
        return next(scene for scene in self.scenes if scene.slug == slug)


@dataclass(frozen=True)
class Request:
    """The options of the command, before names are resolved."""

    scenes: Sequence[str]
    strategies: Sequence[str]
    first_seed: int
    seeds: int
    time: float | None
    spp: float | None
    size: tuple[int, int] | None = None
    max_depth: int | None = None
    device: str | None = None
    references: Sequence[str] = ()  # one file per scene, in order, or SCENE=FILE
    reference_time: float | None = None
    preset: str | None = None
    allow_outside: bool = False


def make_plan(request: Request, stored: Plan | None = None, device: str | None = None) -> Plan:
    """Resolves and checks a request. Scenes and strategies of the `stored` plan keep their slugs, and its preset stays.

    `device` is that of the workers of a cluster; None: the one that the request selects on this machine.

    Raises SceneError, DeviceError or UserError if something is unknown, named twice or contradictory.
    """
    if request.seeds > MAX_SEEDS:
        raise UserError(f"--seeds {request.seeds} is too many: at most {MAX_SEEDS:,} runs of a strategy on a scene")
    if request.first_seed + request.seeds > FIRST_REFERENCE_SEED:
        raise UserError(f"seeds go up to {FIRST_REFERENCE_SEED - 1}: larger ones are reserved for references")
    if request.time is not None and request.spp is not None:
        raise UserError("--time and --spp are both given: a run has one budget")
    sources = [_source(name) for name in request.scenes]
    specs = [spec.strip() for spec in request.strategies]
    for kind, names in (("scene", sources), ("strategy", specs)):
        if not names:
            raise UserError(f"nothing to compare: name a {kind}")
        for name in names:
            if not _is_encodable(name):
                raise UserError(f"{kind} '{name}' is not text in UTF-8; rename it")
            if names.count(name) > 1:
                raise UserError(f"{kind} '{name}' is named twice")
    if device is None:
        device = _local_device(request, stored)
    known = {entry.spec: entry.slug for entry in stored.strategies} if stored else {}
    strategies = tuple(
        StrategyEntry(slug, strategy_title(spec), spec, describe_spec(spec))
        for spec, slug in zip(specs, _slugs(specs, known, lambda spec: [spec]), strict=True)
    )
    reference_time = request.reference_time
    if reference_time is None and request.time is not None:
        reference_time = REFERENCE_BUDGET_FACTOR * request.time
    return Plan(
        version=__version__,
        scenes=_scenes(request, sources, stored),
        strategies=strategies,
        seeds=tuple(range(request.first_seed, request.first_seed + request.seeds)),
        time=request.time,
        spp=request.spp,
        size=request.size,
        max_depth=request.max_depth,
        device=device,
        reference_time=reference_time,
        preset=request.preset or (stored.preset if stored else None),
        allow_outside=request.allow_outside,
    )


def read_plan(directory: Path) -> Plan | None:
    """The plan in `directory`, None if there is none. Raises UserError if it is unreadable."""
    path = directory / PLAN_FILE
    if not path.exists():
        return None
    try:
        content = read_json(path)
        if content.pop("sha256", None) != _plan_sha256(content):
            raise ValueError("its SHA-256 is wrong or missing")
        content["scenes"] = tuple(SceneEntry(**entry) for entry in content["scenes"])
        content["strategies"] = tuple(StrategyEntry(**entry) for entry in content["strategies"])
        content["seeds"] = tuple(content["seeds"])
        content["size"] = content["size"] and tuple(content["size"])
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


def differences(stored: Plan, plan: Plan) -> list[str]:
    """Differences that prevent `plan` from resuming the runs of `stored`, as messages; additions are no difference."""
    messages = []
    for name in ("version", "time", "spp", "size", "max_depth", "device", "reference_time"):
        before, now = getattr(stored, name), getattr(plan, name)
        if before != now:
            messages.append(f"{name} was {_text(before)} and is {_text(now)}")
    for kind in ("scenes", "strategies"):
        now = {entry.slug: entry for entry in getattr(plan, kind)}
        for entry in getattr(stored, kind):
            if entry.slug not in now:
                messages.append(f"'{_title(entry)}' is missing")
                continue
            for field in fields(entry):
                old, new = getattr(entry, field.name), getattr(now[entry.slug], field.name)
                if old != new:
                    messages.append(f"{field.name} of '{_title(entry)}' was {_text(old)} and is {_text(new)}")
    missing = sorted(set(stored.seeds) - set(plan.seeds))
    if missing:
        messages.append(f"seeds are missing: {', '.join(map(str, missing))}")
    return messages


def additions(stored: Plan, plan: Plan) -> list[str]:
    """Scenes and strategies (their titles) and seeds that `plan` has and `stored` has not."""
    added = []
    for kind in ("scenes", "strategies"):
        before = {entry.slug for entry in getattr(stored, kind)}
        added += [_title(entry) for entry in getattr(plan, kind) if entry.slug not in before]
    return added + [f"seed {seed}" for seed in sorted(set(plan.seeds) - set(stored.seeds))]


def _plan_sha256(content: Mapping) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _local_device(request: Request, stored: Plan | None) -> str:
    from isonoise.device.selection import select_device

    kind = select_device(request.device).kind
    return SEVERAL_DEVICES if stored is not None and stored.device == SEVERAL_DEVICES else kind


def _scenes(request: Request, sources: list[str], stored: Plan | None) -> tuple[SceneEntry, ...]:
    known = {entry.source: entry.slug for entry in stored.scenes} if stored else {}
    slugs = _slugs(sources, known, _scene_names)
    given = _given_references(request, sources, slugs)
    entries = []
    for source, slug in zip(sources, slugs, strict=True):
        description = load(source, allow_outside=request.allow_outside, size=request.size)
        scene = compile_scene(description, size=request.size, max_depth=request.max_depth)
        path, digest = f"references/{slug}.exr", None
        if source in given:
            path, digest = _checked_reference(given[source], slug, (scene.width, scene.height))
        entries.append(SceneEntry(slug, slug, source, scene.hash, scene.width, scene.height, path, digest))
    return tuple(entries)


def _source(name: str) -> str:
    """The absolute path of a file, or the name of a built-in scene."""
    path = find_scene(name)
    return str(path.resolve()) if Path(name).is_file() else name


def _scene_names(source: str) -> list[str]:
    """Candidate names of a scene, the best first. For scene.xml, a common name, the folder's name is better."""
    path = Path(source)
    folder = [f"{path.parent.name}-{path.stem}"] if path.parent.name else []
    return [path.parent.name, *folder] if path.stem == "scene" and folder else [path.stem, *folder]


def _slugs(keys: Iterable[str], known: Mapping[str, str], names: Callable[[str], list[str]]) -> list[str]:
    """A unique folder name for each key; keys in `known` keep theirs."""
    slugs = dict(known)
    for key in keys:
        if key not in slugs:
            digest = hashlib.sha256(key.encode()).hexdigest()[:8]
            candidates = [_slug(name) for name in names(key)]
            candidates.append(f"{candidates[0]}-{digest}")
            slugs[key] = next(candidate for candidate in candidates if candidate not in slugs.values())
    return [slugs[key] for key in keys]


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", name).strip("-.")[:100] or "unnamed"


def _given_references(request: Request, sources: list[str], slugs: list[str]) -> dict[str, str]:
    """Reference files by the source of their scene."""
    by_name = {}
    for name, source, slug in zip(request.scenes, sources, slugs, strict=True):
        by_name |= {name: source, slug: source}
    named, in_order = {}, []
    for text in request.references:
        name, equals, file = text.partition("=")
        if equals and name in by_name:
            named[by_name[name]] = file
        else:
            in_order.append(text)
    if in_order and (named or len(in_order) != len(sources)):
        raise UserError(
            f"--reference {in_order[0]}: name one for each of the {len(sources)} scenes, in their order, "
            "or write SCENE=FILE"
        )
    return named or dict(zip(sources, in_order, strict=False))


def _checked_reference(path: str, scene: str, size: tuple[int, int]) -> tuple[str, str]:
    """Absolute path and SHA-256 of the file. Raises UserError if it is no reference or has another size."""
    height, width = read_reference(path)[0].shape[:2]
    if (width, height) != size:
        raise UserError(
            f"reference '{path}' is {width}x{height} and the image of {scene} {size[0]}x{size[1]}: "
            f"render with --size {width}x{height}, or give another reference"
        )
    return str(Path(path).resolve()), file_sha256(Path(path))


def _is_encodable(text: str) -> bool:
    """Whether UTF-8 has all characters of a text: a report could not name a file that has other bytes."""
    return text == text.encode("utf-8", "replace").decode("utf-8")


def _title(entry: SceneEntry | StrategyEntry) -> str:
    return entry.name if isinstance(entry, SceneEntry) else entry.title


def _text(value: object) -> str:
    return "x".join(map(str, value)) if isinstance(value, tuple) else "not given" if value is None else str(value)
