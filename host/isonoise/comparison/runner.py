"""Runs a plan: renders the references, then every missing run to its own file; called by `isonoise compare`.

`run_order` says which runs are missing and in which order they are rendered; `local_runs` or `cluster.runs` renders
them.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from isonoise.comparison.checked_files import make_folder, packed_digest, unpack_npz, write_packed
from isonoise.comparison.folder_lock import FolderLock
from isonoise.comparison.local_batches import LocalBatches
from isonoise.comparison.local_runs import LocalRuns
from isonoise.comparison.plan import Plan, SceneEntry, run_path
from isonoise.comparison.reference_files import read_digests
from isonoise.comparison.references import ReferenceRenderer
from isonoise.comparison.run_images import ensure_image, image_path
from isonoise.comparison.run_inputs import RunInputs
from isonoise.comparison.run_order import (
    PlannedRun,
    find_invalid,
    invalid_run_messages,
    planned_runs,
    runs_by_scene,
    split_existing,
)
from isonoise.comparison.run_progress import RunProgress
from isonoise.comparison.strategy_specs import needs_variance
from isonoise.progress import ProgressBar, format_count, format_duration, format_number, format_percent

if TYPE_CHECKING:
    from isonoise.comparison.cluster.workers import ClusterWorkers


def run_plan(
    plan: Plan,
    lock: FolderLock,
    device: str | None,
    log: Callable[[str], None],
    warn: Callable[[str], None],
    workers: "ClusterWorkers | None" = None,
    objects: Mapping[str, object] | None = None,
) -> None:
    """Render the runs that the locked folder lacks, on `workers` or on `device`.

    `log` receives a line for every finished file. `objects` are the scenes that are objects of a Python program.

    Runs that are damaged, of something else, or measured against another reference are rendered again, before others;
    `warn` receives a line for each reason. Valid runs are not touched. An interrupt loses only the runs in progress.
    Raises UserError.
    """
    _Runner(plan, lock, device, log, warn, workers, objects or {}).run()


class _Runner:
    def __init__(
        self,
        plan: Plan,
        lock: FolderLock,
        device: str | None,
        log: Callable[[str], None],
        warn: Callable[[str], None],
        workers: "ClusterWorkers | None",
        objects: Mapping[str, object],
    ):
        self.plan, self.lock, self.log, self.warn = plan, lock, log, warn
        self.directory = lock.directory
        self.inputs = RunInputs(plan, self.directory, objects)
        self.execution, batches = LocalRuns(self.inputs, device), LocalBatches(self.inputs, device)
        self.has_cluster = workers is not None
        if workers is not None:
            from isonoise.comparison.cluster.batches import ClusterBatches
            from isonoise.comparison.cluster.data import ClusterData
            from isonoise.comparison.cluster.runs import ClusterRuns

            data = ClusterData(self.inputs, workers)
            self.execution = ClusterRuns(self.inputs, workers, data, self.execution, warn)
            batches = ClusterBatches(workers, data, warn)
        self.references = ReferenceRenderer(batches, plan, self.directory, log, warn)
        self.progress = RunProgress(self.inputs.stops)

    def run(self) -> None:
        existing, missing = split_existing(planned_runs(self.plan), self.directory)
        for run in existing:
            self._ensure_references(run.scene)
        invalid = find_invalid(existing, self.directory, self.inputs.identity)
        for message in invalid_run_messages(invalid):
            self.warn(message)
        if self.plan.keep_images:
            for run in existing:
                if run not in invalid:
                    self._keep_image(run, run_path(self.directory, *run).read_bytes())
        self.progress.total = len(invalid) + len(missing)
        for runs in (list(invalid), missing):
            self._render(runs)

    def _render(self, runs: Sequence[PlannedRun]) -> None:
        """On a cluster all references come first: workers would wait for each."""
        for group in [runs] if self.has_cluster else runs_by_scene(runs):
            for scene in dict.fromkeys(run.scene for run in group):
                self._ensure_references(scene)
            self.lock.check()
            self.execution.execute(group, self.progress, self._finish)

    def _ensure_references(self, scene: SceneEntry) -> None:
        """Render the reference, and the variance if a strategy is an oracle that needs it, unless they are valid."""
        if scene.slug in self.inputs.digests:
            return
        self.lock.check()
        start = time.perf_counter()
        with ProgressBar() as bar:
            self.references.ensure_reference(scene, bar.show)
            if any(needs_variance(strategy.spec) for strategy in self.plan.strategies):
                self.references.ensure_variance(scene, bar.show)
        self.inputs.digests[scene.slug] = read_digests(self.directory, self.plan, scene)
        self.progress.start += time.perf_counter() - start  # the remaining time is estimated from the runs alone

    def _finish(self, run: PlannedRun, content: bytes) -> None:
        """Write the file of a run."""
        path = run_path(self.directory, *run)
        file = unpack_npz(content, path, self.inputs.identity(run))
        last, facts = json.loads(str(file["rows"]))[-1], json.loads(str(file["facts"]))
        self.lock.check()
        make_folder(path.parent)
        write_packed(path, content)
        if self.plan.keep_images:
            self._keep_image(run, content)
        self.progress.finished += 1
        self.log(
            f"{run.scene.name}  {run.strategy.title}  seed {run.seed}  {format_duration(last['elapsed_s'])}  "
            f"{format_count(last['samples'])} samples  p99 {format_percent(last['true_p99'])}  "
            f"relMSE {format_number(last['true_rel_mse'])}  "
            f"image mean ratio {last['true_energy_ratio']:.4f}  "
            f"[{self.progress.finished} of {self.progress.total}{self.progress.remaining()}]"
            + (f"  {facts['worker']}" if facts.get("worker") else "")
        )

    def _keep_image(self, run: PlannedRun, content: bytes) -> None:
        """Write the image of a run, whose file has this content, unless it is there."""
        file = unpack_npz(content, run_path(self.directory, *run), self.inputs.identity(run))
        ensure_image(image_path(self.directory, *run), file, packed_digest(content))
