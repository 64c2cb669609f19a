"""Renders runs one after the other in this process, and those of Mitsuba 3 in its own; called by `runner`."""

from collections.abc import Callable, Sequence

from isonoise.comparison.mitsuba_worker import MitsubaWorkers
from isonoise.comparison.run_inputs import RunInputs
from isonoise.comparison.run_order import PlannedRun, runs_by_scene
from isonoise.comparison.run_progress import RunProgress
from isonoise.comparison.run_task import render_run, warm_up
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.device.selection import select_device
from isonoise.progress import ProgressBar


class LocalRuns:
    """Renders on one device.

    Parameters
    ----------
    inputs : RunInputs
        Scenes, references and tasks.
    device : str or None
        As for `select_device`.
    """

    def __init__(self, inputs: RunInputs, device: str | None):
        self._inputs, self._device = inputs, device
        self._warmed_up: set[tuple[str, str]] = set()

    def execute(
        self, runs: Sequence[PlannedRun], progress: RunProgress, on_finished: Callable[[PlannedRun, bytes], None]
    ) -> None:
        """Render the runs; `on_finished` is called with each and the content of its file. Raises UserError."""
        for group in runs_by_scene(runs):
            with MitsubaWorkers(group[0].scene) as workers:
                for run in group:
                    with ProgressBar() as bar:
                        content = self._render(run, workers, progress.of_run(bar, run))
                    on_finished(run, content)

    def _render(self, run: PlannedRun, workers: MitsubaWorkers, on_progress: Callable[..., None]) -> bytes:
        inputs, reference = self._inputs, self._inputs.reference(run.scene)
        if run.strategy.spec in MITSUBA_SAMPLERS:
            identity = inputs.identity(run)
            return workers.run(run.strategy.spec, run.seed, inputs.stops, reference, identity, on_progress)
        task, scene, device = inputs.task(run), inputs.scene(run.scene), select_device(self._device)
        key = (run.scene.slug, run.strategy.slug)
        if key not in self._warmed_up:
            warm_up(task, scene, device)
            self._warmed_up.add(key)
        return render_run(task, scene, reference, device, on_progress)
