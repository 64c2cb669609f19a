"""What workers have done, as numbers, as text, and in the progress bar."""

from dataclasses import asdict

from isonoise.commands.render_result import MAX_WORKER_LINES, _print_workers
from isonoise.distributed.worker_pool import Worker
from isonoise.distributed.worker_report import WorkerReport, WorkerTally
from isonoise.progress import RenderProgressBar
from isonoise.wave import WaveRecord


def test_tasks_are_counted_by_worker():
    tally = WorkerTally()
    tally.update([Worker("0", "CPU"), Worker("1", "GPU")])
    tally.finished("1", 600, 2.0)
    tally.finished("1", 300, 1.0)
    tally.finished("0", 100, 0.5)
    tally.lost("0")
    assert [tally.count_active(), tally.count_active()] == [2, 0]
    tally.update([Worker("1", "GPU"), Worker("2", "GPU")])
    reports = tally.reports()
    assert reports == [
        WorkerReport("0", "CPU", False, 100, 0.5, 1, 1),
        WorkerReport("1", "GPU", True, 900, 3.0, 2, 0),
        WorkerReport("2", "GPU", True, 0, 0.0, 0, 0),
    ]
    assert [report.samples_per_s for report in reports] == [200.0, 300.0, None]
    assert WaveRecord("uniform", 10, 10, 1.0).workers == 1  # unless a renderer says otherwise


def lines(capsys, reports: list[WorkerReport], client_share: float | None) -> list[str]:
    _print_workers([asdict(report) | {"samples_per_s": report.samples_per_s} for report in reports], client_share)
    return [line.strip() for line in capsys.readouterr().out.splitlines()]


def test_workers_as_text(capsys):
    two = [WorkerReport("0", "CPU", True, 300_000, 2.0, 4, 0), WorkerReport("1", "GPU", False, 900_000, 0.5, 9, 3)]
    assert lines(capsys, two, 0.0123) == [
        "workers   2; the client was busy 1.23 % of the time",
        "1: 75 % of the samples, 1.8 M samples/s, 3 tasks lost, no longer there; GPU",
        "0: 25 % of the samples, 150 k samples/s; CPU",
    ]
    many = [WorkerReport(f"w{number}", "CPU", True, 10, 1.0, 1, 0) for number in range(1000)]
    text = lines(capsys, many, 0.5)
    assert text[0].startswith("workers   1,000;")
    assert text[1:2] == ["w0: 0.1 % of the samples, 10 samples/s"]
    assert text[-1] == f"and {1000 - MAX_WORKER_LINES} more: 99.2 % of the samples"
    assert lines(capsys, [WorkerReport("a", "CPU", True, 0, 0.0, 0, 0)], None)[1] == "a: 0 % of the samples"


def test_the_bar_shows_how_many_workers_there_are(monkeypatch):
    shown = []
    monkeypatch.setattr(RenderProgressBar, "show", lambda self, completed, total, text: shown.append(text))
    bar = RenderProgressBar()
    for workers in (0, 1, 1200):
        bar.update(1.0, 1000, None, None, workers)
    assert shown == ["1.00 s, 1 k samples", "1.00 s, 1 k samples, 1 worker", "1.00 s, 1 k samples, 1,200 workers"]
