"""Runs of `isonoise compare` on a cluster: which worker renders which run, what the tables show, lost workers."""

import re
from concurrent.futures import CancelledError, Future
from pathlib import Path
from types import SimpleNamespace

import pytest

from isonoise.comparison.checked_files import InvalidFileError
from isonoise.comparison.cluster.job_dealer import MAX_LOSSES, JobDealer
from isonoise.comparison.cluster.run_worker import WorkerDescription, describe_worker
from isonoise.comparison.cluster.runs import ClusterRuns
from isonoise.comparison.cluster.workers import ClusterWorkers
from isonoise.comparison.environment import device_identity, program_version
from isonoise.comparison.plan import SEVERAL_DEVICES, SceneEntry, StrategyEntry
from isonoise.comparison.run_order import PlannedRun
from isonoise.comparison.run_progress import RunProgress
from isonoise.comparison.run_task import RunStoppedError
from isonoise.comparison.timing import timing_notes, timing_rows, worker_table
from isonoise.device.selection import SelectedDevice, select_device
from isonoise.distributed.dask_worker import DeviceChoice
from isonoise.errors import DeviceError, UserError
from isonoise.loop import Stops

SCENES = [SceneEntry(name, name, name, name, 4, 3, f"{name}.exr", None) for name in ("a", "b")]
STRATEGIES = [StrategyEntry(name, name, name, name) for name in ("uniform", "pooled", "tsallis")]


def planned(seeds, scenes=SCENES):
    """The runs in the order of the plan."""
    return [PlannedRun(scene, strategy, seed) for scene in scenes for seed in range(seeds) for strategy in STRATEGIES]


def scene_and_seed(run):
    return run.scene, run.seed


def simulate(dealer, workers, seconds):
    """Let workers, each with a device, render until all is done; return pairs of worker and run in order."""
    ends, done, now = {}, [], 0.0
    while not dealer.is_done:
        for worker, device in workers.items():
            if worker not in ends and (run := dealer.next_job(worker, device)):
                ends[worker] = now + seconds(worker, run)
        assert ends
        worker = min(ends, key=ends.get)
        now = ends.pop(worker)
        done.append((worker, dealer.in_progress[worker]))
        dealer.finished(worker)
    return done


def test_one_worker_renders_in_the_order_of_the_plan():
    runs = planned(3)
    assert [run for _, run in simulate(JobDealer(runs, scene_and_seed), {"w": "d"}, lambda *_: 1)] == runs


def test_all_strategies_of_a_seed_go_to_one_worker_while_others_are_left():
    """Three workers, one of them three times slower: only the last seeds may be shared."""
    runs = planned(20)
    seconds = {"x": 1.0, "y": 1.1, "z": 3.0}
    done = simulate(JobDealer(runs, scene_and_seed), dict.fromkeys(seconds, "d"), lambda worker, _: seconds[worker])
    assert len(done) == len(runs)
    assert {run for _, run in done} == set(runs)
    workers = {}
    for worker, run in done:
        workers.setdefault((run.scene.slug, run.seed), set()).add(worker)
    assert sum(len(each) > 1 for each in workers.values()) <= 2
    counts = [sum(worker == name for worker, _ in done) for name in seconds]
    assert counts[0] > counts[2] > 0


def test_strategies_alternate_on_every_worker():
    done = simulate(JobDealer(planned(8), scene_and_seed), {"x": "d", "y": "e"}, lambda worker, _: 1 + (worker == "y"))
    for name in ("x", "y"):
        order = [run.strategy for worker, run in done if worker == name]
        assert order == STRATEGIES * (len(order) // 3)


def test_workers_with_another_device_do_not_share_a_seed():
    runs = planned(1, SCENES[:1])
    same, other = JobDealer(runs, scene_and_seed), JobDealer(runs, scene_and_seed)
    assert same.next_job("x", "d") == runs[0]
    assert same.next_job("y", "d") == runs[-1]
    assert other.next_job("x", "d") == runs[0]
    assert other.next_job("y", "e") is None
    assert not other.is_done


def test_what_a_lost_worker_has_not_finished_is_rendered_next():
    runs = planned(3, SCENES[:1])
    dealer = JobDealer(runs, scene_and_seed)
    assert dealer.next_job("x", "d") == runs[0]
    assert dealer.next_job("y", "d") == runs[3]
    dealer.finished("x")
    assert dealer.next_job("x", "d") == runs[1]
    assert dealer.lost("x") == runs[1]
    assert dealer.lost("x") is None
    assert dealer.next_job("z", "d") == runs[1]
    dealer.finished("z")
    assert dealer.next_job("z", "d") == runs[2]
    finished = [runs[0], runs[1], *dealer.in_progress.values()]
    dealer.finished("y")
    dealer.finished("z")
    finished += [run for _, run in simulate(dealer, {"y": "d", "z": "d"}, lambda *_: 1)]
    assert len(finished) == len(runs)
    assert set(finished) == set(runs)


def test_a_run_that_ends_its_workers_fails():
    dealer = JobDealer(planned(1, SCENES[:1]), scene_and_seed)
    for number in range(MAX_LOSSES):
        run = dealer.next_job(f"w{number}", "d")
        assert not dealer.has_failed(run)
        dealer.lost(f"w{number}")
    assert dealer.has_failed(run)


def facts(device, worker=None, parts=1, samples=1000, seconds=0.5):
    return {"device": device, "worker": worker, "parts": parts, "samples": samples, "elapsed_s": seconds}


def scene_of_summary(*facts_of_runs, devices=()):
    timing = timing_rows(facts_of_runs)
    return {"slug": "a", "name": "a", "timing": timing, "devices": [*{row["device"] for row in timing}, *devices]}


def test_the_table_of_workers_counts_runs_and_samples_per_second():
    runs = [facts("d", "tcp://x"), facts("d", "tcp://x", seconds=1.5), facts("d", "tcp://y", samples=5_000_000)]
    (first, second) = worker_table({"scenes": [scene_of_summary(*runs)]}).rows
    assert [str(cell) for cell in first] == ["tcp://x", "d", "2 (1 k/s)"]
    assert [str(cell) for cell in second] == ["tcp://y", "d", "1 (10 M/s)"]
    assert worker_table({"scenes": [scene_of_summary(facts("d"))]}).rows == []


def test_different_devices_or_drivers_are_a_warning():
    assert timing_notes(scene_of_summary(facts("d, driver 1", "x"), facts("d, driver 1", "y"))) == []
    (note,) = timing_notes(scene_of_summary(facts("d, driver 1"), *3 * [facts("d, driver 2")]))
    assert note.startswith("Warning: the runs of this scene were timed on different devices or drivers")
    assert "(d, driver 1: 1; d, driver 2: 3)" in note


def test_parts_of_a_device_and_mitsuba_beside_workers_are_notes():
    assert timing_notes(scene_of_summary(facts("d"), devices=["CPU (Mitsuba 3)"])) == []
    notes = timing_notes(scene_of_summary(facts("d", "x", parts=2), devices=["CPU (Mitsuba 3)"]))
    assert [note[:20] for note in notes] == ["A run had one of 2 p", "Mitsuba 3 was timed "]


def test_a_worker_describes_itself_and_parts_of_a_device_are_of_one_kind():
    description = describe_worker(DeviceChoice())
    assert description == WorkerDescription(program_version(), device_identity(select_device()))
    device = select_device().device
    one, other = (SelectedDevice(device, 0, part, 2) for part in (0, 1))
    assert one.kind == other.kind == one.name.replace("part 1 of 2", "one of 2 parts") != select_device().kind


class FakeClient:
    """The scheduler's list of workers, as Dask's client returns it."""

    status = "running"
    scheduler = SimpleNamespace(identity=None)

    def __init__(self):
        self.workers = {}

    def sync(self, _):
        return {"workers": {address: {"name": address, "status": "running"} for address in self.workers}}


class FakeWorkers(ClusterWorkers):
    """Workers that describe themselves at once: `client.workers` has the description, or the error, of each."""

    def __init__(self, warnings, **workers):
        client = FakeClient()
        client.workers = workers
        super().__init__(SimpleNamespace(client=client, device_of=lambda name: name, size=None), warnings.append)

    def start(self, found):
        future = Future()
        if isinstance(found, Exception):
            future.set_exception(found)
        else:
            future.set_result(found)
        return future

    def _describe(self, address):
        return self.cluster.client.workers[address]

    def update(self):
        self._next_poll = 0.0
        return super().update()


def test_workers_with_another_device_than_the_plan_get_no_runs():
    warnings = []
    workers = FakeWorkers(warnings, x=WorkerDescription(program_version(), "gpu"))
    assert workers.common_device(None) == "gpu"
    workers.cluster.client.workers["y"] = WorkerDescription(program_version(), "cpu")
    workers.cluster.client.workers["z"] = WorkerDescription(program_version(), "gpu")
    assert workers.update() == set()
    assert workers.devices == {"x": "gpu", "z": "gpu"}
    assert warnings == ["worker y gets no runs: its device is cpu, and the comparison's gpu"]
    del workers.cluster.client.workers["x"]
    assert workers.update() == {"x"}
    assert workers.devices == {"z": "gpu"}


def test_a_comparison_that_begins_with_several_devices_takes_any():
    descriptions = {name: WorkerDescription(program_version(), name) for name in ("gpu", "cpu")}
    workers = FakeWorkers([], **descriptions)
    assert workers.common_device(None) == SEVERAL_DEVICES
    assert workers.devices == {"gpu": "gpu", "cpu": "cpu"}
    assert FakeWorkers([], cpu=descriptions["cpu"]).common_device(SEVERAL_DEVICES) == SEVERAL_DEVICES


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (WorkerDescription("0.0.1", "gpu"), "it has isonoise 0.0.1, and this machine"),
        (DeviceError("no OpenCL device found"), "no OpenCL device found"),
        (ModuleNotFoundError("No module named 'isonoise'"), "ModuleNotFoundError: No module named 'isonoise'"),
    ],
)
def test_a_worker_that_cannot_render_is_named(found, reason):
    with pytest.raises(DeviceError, match=f"no worker of the cluster can render: x: {re.escape(reason)}"):
        FakeWorkers([], x=found).common_device(None)
    warnings = []
    workers = FakeWorkers(warnings, x=found, y=WorkerDescription(program_version(), "gpu"))
    assert workers.common_device(None) == "gpu"
    assert reason in warnings[0]


def test_a_lost_connection_is_a_message():
    workers = FakeWorkers([], x=WorkerDescription(program_version(), "gpu"))
    workers.cluster.client.status = "closed"
    with pytest.raises(DeviceError, match="connection to the Dask scheduler is lost"):
        workers.common_device(None)


class FakeRuns(ClusterRuns):
    """Workers answer at once with what `answers` has for their runs, the last answer again and again."""

    def __init__(self, workers, answers, warnings):
        local = SimpleNamespace(execute=lambda runs, *_: self.rendered.extend(("here", run) for run in runs))
        super().__init__(None, workers, SimpleNamespace(forget=lambda worker: None), local, warnings.append)
        self.answers, self.rendered, self.finished = answers, [], []

    def _begin(self, worker, run):
        self.rendered.append((worker, run))
        answers = self.answers.get(worker, [b"content"])
        return answers.pop(0) if len(answers) > 1 else answers[0]

    def run(self, runs):
        def on_finished(run, content):
            if content == b"damaged":
                raise InvalidFileError(Path("0.npz"), "it is damaged")
            self.finished.append(run)

        self.execute(runs, RunProgress(Stops(time=1)), on_finished)
        return self.finished


def fake_runs(answers, *names):
    warnings = []
    workers = FakeWorkers(warnings, **{name: WorkerDescription(program_version(), "gpu") for name in names})
    workers.wait = lambda *_: None
    workers.common_device(None)
    return FakeRuns(workers, answers, warnings), warnings


@pytest.mark.parametrize("answer", [b"damaged", CancelledError(), RunStoppedError("the run was stopped")])
def test_a_run_without_a_sound_result_is_rendered_again(answer):
    runs = planned(2)
    cluster, warnings = fake_runs({"x": [b"content", answer, b"content"]}, "x", "y")
    assert set(cluster.run(runs)) == set(runs)
    assert len(cluster.rendered) == len(runs) + 1
    (lost, again) = (run for _, run in cluster.rendered if [run for _, run in cluster.rendered].count(run) == 2)
    assert lost == again
    assert warnings[0].startswith(f"{lost.title} is rendered again: worker x is lost, ")


@pytest.mark.parametrize("answer", [DeviceError("the device is lost"), RuntimeError("driver")])
def test_a_worker_that_fails_gets_no_more_runs(answer):
    runs = planned(2)
    cluster, warnings = fake_runs({"x": [answer]}, "x", "y")
    assert set(cluster.run(runs)) == set(runs)
    assert [worker for worker, _ in cluster.rendered].count("x") == 1
    assert warnings[0].startswith("worker x gets no runs: ")
    cluster, _ = fake_runs({"x": [answer]}, "x")
    with pytest.raises(DeviceError, match="no worker of the cluster can render: x: "):
        cluster.run(runs)


def test_a_worker_that_is_gone_loses_its_run():
    runs = planned(2)
    cluster, warnings = fake_runs({}, "x", "y")
    pending, start = Future(), cluster._workers.start

    def start_with_pending(content):
        cluster._workers.start = start
        return pending

    cluster._workers.start = start_with_pending  # the first run, on x, does not end
    cluster._workers.wait = lambda *_: cluster._workers.cluster.client.workers.pop("x", None)
    assert set(cluster.run(runs)) == set(runs)
    assert pending.cancelled()
    assert warnings == [f"{runs[0].title} is rendered again: worker x is lost, it has left the cluster"]


def test_a_lost_scheduler_is_no_failure_of_its_workers():
    cluster, warnings = fake_runs({"x": [OSError("timed out")]}, "x")

    def lose_connection(*_):
        cluster._workers.cluster.client.status = "closed"

    cluster._workers.wait = lose_connection
    with pytest.raises(DeviceError, match="connection to the Dask scheduler is lost"):
        cluster.run(planned(1))
    assert [text.partition(" is rendered again: ")[2] for text in warnings] == [
        "worker x is lost, there is no connection to it"
    ]


def test_errors_that_every_worker_would_have_end_the_comparison():
    cluster, _ = fake_runs({"x": [UserError("strategy oracle: it is 4x3")]}, "x", "y")
    with pytest.raises(UserError, match="seed 0, worker x: strategy oracle: it is 4x3"):
        cluster.run(planned(2))
    cluster, _ = fake_runs({"x": [b"damaged"]}, "x")
    with pytest.raises(UserError, match=f"{MAX_LOSSES} workers were lost while they rendered it"):
        cluster.run(planned(2))


def test_mitsuba_renders_after_the_workers():
    of_mitsuba = StrategyEntry("m", "m", "mitsuba-independent", "m")
    runs = [PlannedRun(SCENES[0], of_mitsuba, 0), *planned(1, SCENES[:1])]
    cluster, _ = fake_runs({}, "x")
    cluster.run(runs)
    assert cluster.rendered == [*(("x", run) for run in runs[1:]), ("here", runs[0])]
