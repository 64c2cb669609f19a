"""What a stored run, reference or variance is: all settings that determine its content; made by `runner`, `references`.

An identity is a dict of JSON values. It is stored in the file and checked when the file is read, so that a file of
another comparison, or one that was copied from another seed, strategy or scene, is not taken for the expected one.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from isonoise.comparison.plan import REFERENCE_BUDGET_FACTOR, Plan, SceneEntry, StrategyEntry, file_sha256
from isonoise.comparison.strategy_specs import needs_variance, oracle_file

FORMATS = {"run": 2, "reference": 1, "variance": 1}
"""Of each kind of file. Goes up when it gets other arrays or channels, or these another meaning."""

_AT_LEAST = ("reference_time", "reference_spp")
"""A reference may have more than it needs: comparisons of a series share the one with the most samples."""
_MISMATCHES = {
    "kind": "it is another kind of file",
    "code": "the code of its strategy was another one",
    "format": "another version of isonoise wrote it",
    "scene": "its scene, size or depth is another one",
    "reference": "it was measured against another reference",
    "variance": "it was allocated by another variance",
    "reference_time": "its budget is another one",
    "reference_spp": "its budget is another one",
}
"""Field -> reason; for the other fields both values are named."""


@dataclass(frozen=True)
class ImageDigests:
    """SHA-256 of a scene's reference, and of its variance if there is one."""

    reference: str
    variance: str | None


def run_identity(plan: Plan, scene: SceneEntry, strategy: StrategyEntry, seed: int, digests: ImageDigests) -> dict:
    if needs_variance(strategy.spec):
        variance = digests.variance
    else:
        path = oracle_file(strategy.spec)
        variance = file_sha256(path) if path and path.is_file() else None
    return _common(plan, scene, "run") | {
        "strategy": strategy.parameters,
        "code": strategy.code,
        "seed": seed,
        "time": plan.time,
        "spp": plan.spp,
        "reference": digests.reference,
        "variance": variance,
    }


def reference_identity(plan: Plan, scene: SceneEntry, kind: str) -> dict:
    """`kind` is "reference" or "variance"."""
    spp = REFERENCE_BUDGET_FACTOR * plan.spp if plan.reference_time is None else None
    return _common(plan, scene, kind) | {"reference_time": plan.reference_time, "reference_spp": spp}


def find_mismatch(stored: Mapping, expected: Mapping) -> str | None:
    """Why a file with the identity `stored` is not the `expected` one; None if it is."""
    for name, value in expected.items():
        found = stored.get(name)
        if found == value or (name in _AT_LEAST and None not in (found, value) and found > value):
            continue
        return _MISMATCHES.get(name, f"its {name} is {found} instead of {value}")
    return None


def _common(plan: Plan, scene: SceneEntry, kind: str) -> dict:
    return {"kind": kind, "format": FORMATS[kind], "version": plan.version, "scene": scene.hash, "device": plan.device}
