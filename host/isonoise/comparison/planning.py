"""Makes the plan of a comparison from what is asked for: finds and compiles scenes, checks all names.

Called by `session`.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from isonoise.comparison.environment import device_identity, program_version
from isonoise.comparison.image_metrics import import_flip
from isonoise.comparison.plan import (
    FIRST_REFERENCE_SEED,
    REFERENCE_BUDGET_FACTOR,
    SEVERAL_DEVICES,
    Plan,
    SceneEntry,
    StrategyEntry,
    file_sha256,
)
from isonoise.comparison.request import Request, SceneRequest
from isonoise.comparison.scene_source import OBJECT, compile_request, is_object
from isonoise.comparison.strategy_code import code_of
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS, describe_spec, strategy_title
from isonoise.comparison.table_columns import DEFAULT_METRICS, checked_metrics
from isonoise.errors import UserError
from isonoise.film.exr import read_reference
from isonoise.scene.builtin import find_scene

MAX_SEEDS = 10**6
"""Runs of a strategy on a scene."""

Key = TypeVar("Key")
SceneKey = tuple[str, str, tuple[int, int] | None, int | None]
"""Source, settings as JSON, size, depth."""


def make_plan(request: Request, stored: Plan | None = None, device: str | None = None) -> Plan:
    """Resolves and checks a request. Scenes and strategies of the `stored` plan keep their slugs, and its preset stays.

    `device` is that of the workers of a cluster; None: the one that the request selects on this machine.

    Raises SceneError, DeviceError or UserError if something is unknown, named twice or contradictory.
    """
    _check_numbers(request)
    sources = [_source(scene) for scene in request.scenes]
    specs = [strategy.spec.strip() for strategy in request.strategies]
    _check_names(request.scenes, sources, specs)
    if device is None:
        device = _local_device(request, stored)
    known = {entry.spec: entry.slug for entry in stored.strategies} if stored else {}
    strategies = tuple(
        StrategyEntry(slug, strategy_title(spec), spec, describe_spec(spec), code_of(spec), dict(asked.settings))
        for asked, spec, slug in zip(request.strategies, specs, _slugs(specs, known, lambda spec: [spec]), strict=True)
    )
    if any(strategy.spec in MITSUBA_SAMPLERS for strategy in strategies):
        _check_scenes_for_mitsuba(request.scenes)
    reference_time = request.reference_time
    if reference_time is None and request.time is not None:
        reference_time = REFERENCE_BUDGET_FACTOR * request.time
    return Plan(
        version=program_version(),
        scenes=_scenes(request, sources, stored),
        strategies=strategies,
        seeds=tuple(request.seeds),
        time=request.time,
        spp=request.spp,
        device=device,
        reference_time=reference_time,
        preset=request.preset or (stored.preset if stored else None),
        allow_outside=request.allow_outside,
        metrics=_metrics(request, stored),
        keep_images=request.keep_images or (stored is not None and stored.keep_images),
    )


def scene_name(source: str) -> str:
    """Name of a scene file or built-in scene, for the names of its variants. Raises SceneError if there is none."""
    return _scene_names(_source(SceneRequest(source)), None)[0]


def _metrics(request: Request, stored: Plan | None) -> tuple[str, ...]:
    if request.metrics:
        metrics = checked_metrics(request.metrics)
    else:
        metrics = DEFAULT_METRICS if stored is None else stored.metrics
    if "flip" in metrics:
        import_flip()  # before runs are rendered, not after them
    return metrics


def scene_objects(request: Request) -> dict[str, object]:
    """The scenes of a request that are objects of a Python program, by `SceneEntry.source`."""
    return {_source(scene): scene.source for scene in request.scenes if is_object(scene.source)}


def _check_numbers(request: Request) -> None:
    if len(request.seeds) > MAX_SEEDS:
        raise UserError(f"{len(request.seeds)} seeds are too many: at most {MAX_SEEDS:,} runs of a strategy on a scene")
    if max(request.seeds, default=0) >= FIRST_REFERENCE_SEED:
        raise UserError(f"seeds go up to {FIRST_REFERENCE_SEED - 1}: larger ones are reserved for references")
    if request.time is not None and request.spp is not None:
        raise UserError("time and spp are both given: a run has one budget")


def _check_names(scenes: Sequence[SceneRequest], sources: Sequence[str], specs: Sequence[str]) -> None:
    keys = [_scene_key(source, scene) for source, scene in zip(sources, scenes, strict=True)]
    for kind, names, unique in (("scene", sources, keys), ("strategy", specs, specs)):
        if not names:
            raise UserError(f"nothing to compare: name a {kind}")
        for name, key in zip(names, unique, strict=True):
            if not _is_encodable(name):
                raise UserError(f"{kind} '{name}' is not text in UTF-8; rename it")
            if unique.count(key) > 1:
                raise UserError(f"{kind} '{name}' is named twice")


def _check_scenes_for_mitsuba(scenes: Sequence[SceneRequest]) -> None:
    for scene in scenes:
        if scene.settings or is_object(scene.source):
            raise UserError(
                f"{' and '.join(MITSUBA_SAMPLERS)} render scene files as they are: leave out the settings of scenes"
                if scene.settings
                else f"{' and '.join(MITSUBA_SAMPLERS)} render scene files: name one in place of a scene object"
            )


def _local_device(request: Request, stored: Plan | None) -> str:
    from isonoise.device.selection import select_device

    device = device_identity(select_device(request.device))
    return SEVERAL_DEVICES if stored is not None and stored.device == SEVERAL_DEVICES else device


def _scenes(request: Request, sources: list[str], stored: Plan | None) -> tuple[SceneEntry, ...]:
    keys = [_scene_key(source, scene) for source, scene in zip(sources, request.scenes, strict=True)]
    names = {key: _scene_names(key[0], scene.name) for key, scene in zip(keys, request.scenes, strict=True)}
    slugs = _slugs(keys, _known_scenes(stored, keys), names.__getitem__)
    given = _given_references(request.references, sources, slugs)
    entries = []
    for source, slug, scene in zip(sources, slugs, request.scenes, strict=True):
        compiled = compile_request(scene, request.allow_outside)
        path, digest = f"references/{slug}.exr", None
        if reference := scene.reference or given.get(source):
            path, digest = _checked_reference(reference, slug, (compiled.width, compiled.height))
        entry = SceneEntry(
            slug,
            scene.name or slug,
            source,
            compiled.hash,
            compiled.width,
            compiled.height,
            path,
            digest,
            size=scene.size,
            max_depth=scene.max_depth,
            settings=dict(scene.settings),
        )
        entries.append(entry)
    return tuple(entries)


def _known_scenes(stored: Plan | None, keys: Sequence[SceneKey]) -> dict[SceneKey, str]:
    """The slugs of the stored plan's scenes, by their keys in the new plan.

    A scene that has another size or depth now is still the same scene, so that the difference is named.
    """
    if stored is None:
        return {}
    slugs = {_key(entry.source, entry.settings, entry.size, entry.max_depth): entry.slug for entry in stored.scenes}
    for key in keys:
        others = [other for other in slugs if other[:2] == key[:2]]
        if len(others) == 1 and sum(each[:2] == key[:2] for each in keys) == 1:
            slugs[key] = slugs.pop(others[0])
    return slugs


def _scene_key(source: str, scene: SceneRequest) -> SceneKey:
    return _key(source, scene.settings, scene.size, scene.max_depth)


def _key(source: str, settings: Mapping, size: tuple[int, int] | None, max_depth: int | None) -> SceneKey:
    return source, json.dumps(settings, sort_keys=True), size, max_depth


def _source(scene: SceneRequest) -> str:
    """The absolute path of a file, the name of a built-in scene, or that of an object."""
    if is_object(scene.source):
        return f"{OBJECT}{scene.name}"
    name = os.fspath(scene.source)
    path = find_scene(name)
    return str(path.resolve()) if Path(name).is_file() else name


def _scene_names(source: str, name: str | None) -> list[str]:
    """Candidate names of a scene, the best first. For scene.xml, a common name, the folder's name is better."""
    if name is not None:
        return [name]
    path = Path(source)
    folder = [f"{path.parent.name}-{path.stem}"] if path.parent.name else []
    return [path.parent.name, *folder] if path.stem == "scene" and folder else [path.stem, *folder]


def _slugs(keys: Iterable[Key], known: Mapping[Key, str], names: Callable[[Key], list[str]]) -> list[str]:
    """A unique folder name for each key; keys in `known` keep theirs."""
    slugs = dict(known)
    for key in keys:
        if key not in slugs:
            digest = hashlib.sha256(str(key).encode()).hexdigest()[:8]
            candidates = [_slug(name) for name in names(key)]
            candidates.append(f"{candidates[0]}-{digest}")
            slugs[key] = next(candidate for candidate in candidates if candidate not in slugs.values())
    return [slugs[key] for key in keys]


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", name).strip("-.")[:100] or "unnamed"


def _given_references(references: Sequence[str], sources: list[str], slugs: list[str]) -> dict[str, str]:
    """Reference files by the source of their scene."""
    by_name = {}
    for source, slug in zip(sources, slugs, strict=True):
        by_name |= {source: source, slug: source}
    named, in_order = {}, []
    for text in references:
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
