"""The error log: complete rows at any time, and a description of every column."""

import csv
import dataclasses
import math
import subprocess
import sys
import textwrap

import pytest

from isonoise.error.true_error import TrueError
from isonoise.errors import UserError
from isonoise.film.log import LogRow, LogWriter, columns, row_values


def row(wave, true=None):
    return LogRow(
        elapsed_s=wave / 3,
        wave=wave,
        kind="adaptive" if wave % 2 else "uniform",
        samples=10**12 + wave,
        spp=1e12 / 7,
        stated_p50=0.01,
        stated_p95=0.02,
        stated_p99=math.inf,
        true=true,
        rejected=0,
    )


def true_error(value=0.5):
    return TrueError(**{field.name: value + i for i, field in enumerate(dataclasses.fields(TrueError))})


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_every_column_is_described_and_filled():
    assert "true" not in columns(False)
    assert {"elapsed_s", "samples"} <= set(columns(False))
    assert all(columns(True).values())
    assert list(row_values(row(1))) == list(columns(False))
    assert list(row_values(row(1, true_error()))) == list(columns(True))
    assert set(columns(True)) - set(columns(False)) == {f"true_{f.name}" for f in dataclasses.fields(TrueError)}


def test_the_log_is_complete_after_every_row(tmp_path):
    path = tmp_path / "log.csv"
    log = LogWriter(path, true_errors=True)
    assert not path.exists()
    for wave in range(1, 6):
        log.write(row(wave, true_error(wave)))
        text = path.read_text()
        assert text.endswith("\n")
        found = read(path)
        assert [int(each["wave"]) for each in found] == list(range(1, wave + 1))
        assert list(found[-1]) == list(columns(True))
        assert int(found[-1]["samples"]) == 10**12 + wave
        assert float(found[-1]["elapsed_s"]) == pytest.approx(wave / 3, rel=1e-8)  # nine digits are written
        assert float(found[-1]["stated_p99"]) == math.inf
        assert float(found[-1]["true_p50"]) == wave
    log.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["log.csv"]


def test_an_existing_log_stays_until_the_first_row(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("old\n")
    log = LogWriter(path, true_errors=False)
    assert path.read_text() == "old\n"
    log.write(row(1))
    assert [each["wave"] for each in read(path)] == ["1"]


def test_an_unwritable_path_is_found_beforehand(tmp_path):
    with pytest.raises(UserError, match="no folder"):
        LogWriter(tmp_path / "no" / "log.csv", true_errors=False)


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
def test_a_full_disk_leaves_complete_rows(tmp_path):
    code = """
        import resource, signal, sys
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        from isonoise.errors import UserError
        from isonoise.film.log import LogRow, LogWriter
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
        log = LogWriter("log.csv", true_errors=False)
        for wave in range(1, 100):
            try:
                log.write(LogRow(0.1, wave, "uniform", wave, 1.0, 0.1, 0.2, 0.3, None, 0))
            except UserError as error:
                sys.exit(f"row {wave}: {error}")
        """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], cwd=tmp_path, capture_output=True, text=True)
    text = (tmp_path / "log.csv").read_text()
    rows = read(tmp_path / "log.csv")
    assert f"row {len(rows) + 1}: cannot write" in done.stderr
    assert 1 < len(rows) < 99
    assert len(text) <= 1000
    assert text.endswith("\n")
    assert all(None not in each.values() for each in rows)
