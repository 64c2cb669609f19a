"""What differs between the plan of a comparison and the one that it began with; called by `session`."""

from dataclasses import dataclass, fields

from isonoise.comparison.plan import Plan, SceneEntry, StrategyEntry


@dataclass(frozen=True)
class Differences:
    """Messages. Additional scenes, strategies and seeds are no difference.

    Attributes
    ----------
    settings : list of str
        The user asks for something else: another comparison.
    changes : list of str
        The same is asked for, but it would be rendered with another program, driver or device, or from a file that has
        been edited. What was rendered before cannot be mixed with it.
    """

    settings: list[str]
    changes: list[str]


def differences(stored: Plan, plan: Plan) -> Differences:
    """What prevents `plan` from resuming the runs of `stored`."""
    settings, changes = [], []
    for name, title in (("version", "isonoise"), ("device", "device")):
        before, now = getattr(stored, name), getattr(plan, name)
        if before != now:
            changes.append(f"{title} was {before} and is {now}")
    for name in ("time", "spp", "reference_time"):
        before, now = getattr(stored, name), getattr(plan, name)
        if before != now:
            settings.append(f"{name} was {_text(before)} and is {_text(now)}")
    for kind in ("scenes", "strategies"):
        entries = {entry.slug: entry for entry in getattr(plan, kind)}
        for entry in getattr(stored, kind):
            if entry.slug not in entries:
                settings.append(f"'{_title(entry)}' is missing")
            elif differing := _differing_settings(entry, entries[entry.slug]):
                settings += differing
            else:
                changes += _differing_content(entry, entries[entry.slug])
    missing = sorted(set(stored.seeds) - set(plan.seeds))
    if missing:
        settings.append(f"seeds are missing: {', '.join(map(str, missing))}")
    return Differences(settings, changes)


def additions(stored: Plan, plan: Plan) -> list[str]:
    """Scenes and strategies (their titles) and seeds that `plan` has and `stored` has not."""
    added = []
    for kind in ("scenes", "strategies"):
        before = {entry.slug for entry in getattr(stored, kind)}
        added += [_title(entry) for entry in getattr(plan, kind) if entry.slug not in before]
    return added + [f"seed {seed}" for seed in sorted(set(plan.seeds) - set(stored.seeds))]


_CONTENT = {"hash", "width", "height", "reference_sha256", "parameters", "code"}
"""Fields of scenes and strategies that follow from files and the program."""


def _differing_settings(old: SceneEntry | StrategyEntry, new: SceneEntry | StrategyEntry) -> list[str]:
    names = [field.name for field in fields(old) if field.name not in _CONTENT]
    return [
        f"{name} of '{_title(old)}' was {_text(before)} and is {_text(now)}"
        for name in names
        if (before := getattr(old, name)) != (now := getattr(new, name))
    ]


def _differing_content(old: SceneEntry | StrategyEntry, new: SceneEntry | StrategyEntry) -> list[str]:
    title = _title(old)
    if isinstance(old, SceneEntry):
        changes = [f"the scene '{title}' has been edited"] if old.hash != new.hash else []
        if old.reference_sha256 != new.reference_sha256:
            changes.append(f"the reference '{old.reference}' has been edited")
        return changes
    if old.code != new.code:
        return [f"the code of the strategy '{title}' was {old.code} and is {new.code}"]
    if old.parameters != new.parameters:
        return [f"the strategy '{title}' was {old.parameters} and is {new.parameters}"]
    return []


def _title(entry: SceneEntry | StrategyEntry) -> str:
    return entry.name if isinstance(entry, SceneEntry) else entry.title


def _text(value: object) -> str:
    return "x".join(map(str, value)) if isinstance(value, tuple) else "not given" if value is None else str(value)
