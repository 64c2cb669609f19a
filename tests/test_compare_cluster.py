"""Runs of `isonoise compare` on a cluster: which worker renders which run, and what the runs show."""

from isonoise.comparison.plan import SceneEntry, StrategyEntry
from isonoise.comparison.run_dealer import MAX_LOSSES, RunDealer
from isonoise.comparison.run_order import PlannedRun

SCENES = [SceneEntry(name, name, name, name, 4, 3, f"{name}.exr", None) for name in ("a", "b")]
STRATEGIES = [StrategyEntry(name, name, name, name) for name in ("uniform", "pooled", "tsallis")]


def planned(seeds, scenes=SCENES):
    """The runs in the order of the plan."""
    return [PlannedRun(scene, strategy, seed) for scene in scenes for seed in range(seeds) for strategy in STRATEGIES]


def simulate(dealer, workers, seconds):
    """Let workers, each with a device, render until all is done; return pairs of worker and run in order."""
    ends, done, now = {}, [], 0.0
    while not dealer.is_done:
        for worker, device in workers.items():
            if worker not in ends and (run := dealer.next_run(worker, device)):
                ends[worker] = now + seconds(worker, run)
        assert ends
        worker = min(ends, key=ends.get)
        now = ends.pop(worker)
        done.append((worker, dealer.finished(worker)))
    return done


def test_one_worker_renders_in_the_order_of_the_plan():
    runs = planned(3)
    assert [run for _, run in simulate(RunDealer(runs), {"w": "d"}, lambda *_: 1)] == runs


def test_all_strategies_of_a_seed_go_to_one_worker_while_others_are_left():
    """Three workers, one of them three times slower: only the last seeds may be shared."""
    runs = planned(20)
    seconds = {"x": 1.0, "y": 1.1, "z": 3.0}
    done = simulate(RunDealer(runs), dict.fromkeys(seconds, "d"), lambda worker, _: seconds[worker])
    assert len(done) == len(runs)
    assert {run for _, run in done} == set(runs)
    workers = {}
    for worker, run in done:
        workers.setdefault((run.scene.slug, run.seed), set()).add(worker)
    assert sum(len(each) > 1 for each in workers.values()) <= 2
    counts = [sum(worker == name for worker, _ in done) for name in seconds]
    assert counts[0] > counts[2] > 0


def test_strategies_alternate_on_every_worker():
    done = simulate(RunDealer(planned(8)), {"x": "d", "y": "e"}, lambda worker, _: 1 + (worker == "y"))
    for name in ("x", "y"):
        order = [run.strategy for worker, run in done if worker == name]
        assert order == STRATEGIES * (len(order) // 3)


def test_workers_with_another_device_do_not_share_a_seed():
    runs = planned(1, SCENES[:1])
    same, other = RunDealer(runs), RunDealer(runs)
    assert same.next_run("x", "d") == runs[0]
    assert same.next_run("y", "d") == runs[-1]
    assert other.next_run("x", "d") == runs[0]
    assert other.next_run("y", "e") is None
    assert not other.is_done


def test_what_a_lost_worker_has_not_finished_is_rendered_next():
    runs = planned(3, SCENES[:1])
    dealer = RunDealer(runs)
    assert dealer.next_run("x", "d") == runs[0]
    assert dealer.next_run("y", "d") == runs[3]
    assert dealer.finished("x") == runs[0]
    assert dealer.next_run("x", "d") == runs[1]
    assert dealer.lost("x") == runs[1]
    assert dealer.lost("x") is None
    assert dealer.next_run("z", "d") == runs[1]
    assert dealer.finished("z") == runs[1]
    assert dealer.next_run("z", "d") == runs[2]
    finished = [runs[0], runs[1], dealer.finished("y"), dealer.finished("z")]
    finished += [run for _, run in simulate(dealer, {"y": "d", "z": "d"}, lambda *_: 1)]
    assert len(finished) == len(runs)
    assert set(finished) == set(runs)


def test_a_run_that_ends_its_workers_fails():
    dealer = RunDealer(planned(1, SCENES[:1]))
    for number in range(MAX_LOSSES):
        run = dealer.next_run(f"w{number}", "d")
        assert not dealer.has_failed(run)
        dealer.lost(f"w{number}")
    assert dealer.has_failed(run)
