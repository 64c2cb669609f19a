"""Where the runs of a comparison were timed: rows of summary.json, warnings and the table of workers.

Called by `summary` and `report_tables`.
"""

from collections.abc import Iterable, Mapping

from isonoise.progress import format_count
from isonoise.tables import LEFT, Cell, Column, Table


def timing_rows(facts_of_runs: Iterable[Mapping]) -> list[dict]:
    """A row per device and worker, from the facts of isonoise's own runs on a scene.

    | field | meaning |
    |---|---|
    | `device`, `parts` | device and driver; how many parts the device was split into, 1 if it was not |
    | `worker` | address of the worker of a cluster, None without one |
    | `runs`, `samples_per_s` | number of runs; their samples over their seconds |
    """
    rows: dict[tuple, dict] = {}
    for facts in facts_of_runs:
        device, worker = str(facts.get("device")), facts.get("worker")
        new = {"device": device, "parts": facts.get("parts", 1), "worker": worker, "runs": 0, "samples": 0, "s": 0.0}
        row = rows.setdefault((device, worker), new)
        row["runs"] += 1
        row["samples"] += facts["samples"]
        row["s"] += facts["elapsed_s"]
    for row in rows.values():
        samples, seconds = row.pop("samples"), row.pop("s")
        row["samples_per_s"] = samples / seconds if seconds > 0 else None
    return [rows[key] for key in sorted(rows, key=str)]


def timing_notes(scene: Mapping) -> list[str]:
    """What a reader of the times of a scene has to know; `scene` is that of summary.json."""
    timing = scene["timing"]
    runs: dict[str, int] = {}
    for row in timing:
        runs[row["device"]] = runs.get(row["device"], 0) + row["runs"]
    notes = []
    if len(runs) > 1:
        devices = "; ".join(f"{device}: {count}" for device, count in runs.items())
        notes.append(
            f"Warning: the runs of this scene were timed on different devices or drivers ({devices}), so times do not "
            "compare."
        )
    parts = max((row["parts"] for row in timing), default=1)
    if parts > 1:
        notes.append(
            f"A run had one of {parts} parts of the device while others had the rest: times are those of such a part."
        )
    has_others = set(scene["devices"]) - runs.keys()
    if has_others and any(row["worker"] for row in timing):
        notes.append("Mitsuba 3 was timed on the machine that began the comparison, not on a worker.")
    return notes


def worker_table(summary: Mapping) -> Table:
    """Runs and speed of every worker; no rows without workers."""
    scenes = summary["scenes"]
    cells: dict[tuple[str, str], dict[str, Cell]] = {}
    for scene in scenes:
        for row in scene["timing"]:
            if row["worker"] is not None:
                speed = "" if row["samples_per_s"] is None else f"({format_count(row['samples_per_s'])}/s)"
                cell = Cell(str(row["runs"]), speed, row["runs"])
                cells.setdefault((row["worker"], row["device"]), {})[scene["slug"]] = cell
    rows = [
        [Cell(worker), Cell(device), *(by_scene.get(scene["slug"], Cell()) for scene in scenes)]
        for (worker, device), by_scene in sorted(cells.items())
    ]
    columns = [Column("worker", LEFT), Column("device", LEFT), *(Column(scene["name"]) for scene in scenes)]
    return Table(columns, rows, "Workers", ["Runs of each worker, in brackets samples per second."])
