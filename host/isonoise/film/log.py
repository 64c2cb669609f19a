"""The error log: one row per wave, the meaning of its columns, and the CSV file that a render writes as it runs."""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

from isonoise.errors import UserError
from isonoise.field_docs import document_fields
from isonoise.film.files import PathLock, check_writable, write_atomically

if TYPE_CHECKING:
    from isonoise.error.true_error import TrueError


def _column(meaning: str, **options: Any) -> Any:
    return field(metadata={"doc": meaning}, **options)


@document_fields
@dataclass(frozen=True)
class LogRow:
    """The state of a render after one wave. Each field is a column, except `true`: each of its fields is one."""

    elapsed_s: float = _column("seconds of rendering, without set-up, writing files and computing true errors")
    wave: int = _column("number of the wave, from 1")
    kind: Literal["uniform", "adaptive"] = _column("'uniform' (same count in every pixel) or 'adaptive'")
    samples: int = _column("samples taken so far, over the whole image")
    spp: float = _column("samples / pixels")
    stated_p50: float = _column(
        "stated error e at q = 0.5: mean over the pixels of P(|Z| s_i / max(mean_i, floor) <= e) = q"
    )
    stated_p95: float = _column("the same at q = 0.95")
    stated_p99: float = _column("the same at q = 0.99")
    true: "TrueError | None" = _column("errors against a reference; None without one")  # noqa: RUF009
    rejected: int = _column("samples so far that were negative or not finite; they enter no statistic")
    error_bound: float = _column(
        "with --error, the value that the true error at --quantile is below with --confidence, in all rows together, "
        "as far as the samples show; the render ends when it is below E; without --error nan",
        default=math.nan,
    )
    energy_loss: float = _column(
        "estimated loss of the image's mean luminance, because samples decide where the next ones go: 1 - mean / mean "
        "of the samples of uniform waves; below 0 by chance",
        default=math.nan,
    )
    energy_loss_se: float = _column("its standard error", default=math.nan)
    workers: int = _column("devices, or processes of a cluster, that traced samples of the wave", default=1)


def columns(true_errors: bool) -> dict[str, str]:
    """Name -> meaning of the CSV's columns, in order; with `true_errors` also those that need a reference."""
    result = {f.name: f.metadata["doc"] for f in fields(LogRow) if f.name != "true"}
    if true_errors:
        from isonoise.error.true_error import TrueError

        result |= {f"true_{f.name}": f.metadata["doc"] for f in fields(TrueError)}
    return result


class LogWriter:
    """Writes rows to a CSV file that other programs can read while the render runs.

    The first row replaces an existing file. Every further row is appended with one unbuffered write, so that the file
    always consists of complete rows, even after a crash. No other process can write it until `close`.

    Parameters
    ----------
    path : path
        The file. It is checked at once, so that a render does not start without a writable log.
    true_errors : bool
        Whether rows have true errors.
    rows : sequence of LogRow
        Rows of a render that is continued; the file begins with them.

    Raises
    ------
    UserError
        If the file cannot be written, here, in `write` or in `end`, or another process is writing it.
    """

    def __init__(self, path: str | os.PathLike, true_errors: bool, rows: Sequence[LogRow] = ()):
        self._name, self._path = os.fspath(path), check_writable(path)
        self._lock = PathLock(self._path)
        self._columns = columns(true_errors)
        self._has_rows = False
        self._earlier = b"".join(map(_line, rows))

    def write(self, row: LogRow) -> None:
        """Append one row. On an error the file stays as it was."""
        line = _line(row)
        if not self._has_rows:
            _write_rows(self._name, self._columns, self._earlier + line)
            self._has_rows = True
            return
        try:
            with open(self._path, "ab", buffering=0) as file:
                end = file.tell()
                if file.write(line) != len(line):
                    file.truncate(end)
                    raise UserError(f"cannot write '{self._name}': no space left")
        except OSError as error:
            raise UserError(f"cannot write '{self._name}': {error.strerror}") from error

    def end(self) -> None:
        """Write the earlier rows if the continued render has added none."""
        if self._earlier and not self._has_rows:
            _write_rows(self._name, self._columns, self._earlier)

    def close(self) -> None:
        """Let other processes write the file."""
        self._lock.release()


def write_log(path: str | os.PathLike, rows: Iterable[LogRow], true_errors: bool) -> None:
    """Write all rows to a new CSV file, atomically. Raises UserError if it cannot be written."""
    _write_rows(path, columns(true_errors), b"".join(map(_line, rows)))


def row_values(row: LogRow) -> dict[str, float | int | str]:
    """Column name -> value, in the order of `columns`."""
    values = {f.name: getattr(row, f.name) for f in fields(row) if f.name != "true"}
    if row.true is not None:
        values |= {f"true_{f.name}": getattr(row.true, f.name) for f in fields(row.true)}
    return values


def row_from_values(values: dict[str, float | int | str]) -> LogRow:
    """The row with these `row_values`."""
    own = {name: value for name, value in values.items() if not name.startswith("true_")}
    true = {name.removeprefix("true_"): value for name, value in values.items() if name not in own}
    if true:
        from isonoise.error.true_error import TrueError

        return LogRow(**own, true=TrueError(**true))
    return LogRow(**own, true=None)


def _write_rows(path: str | os.PathLike, names: Iterable[str], lines: bytes) -> None:
    header = (",".join(names) + "\n").encode()
    write_atomically(path, lambda temporary: temporary.write_bytes(header + lines))


def _line(row: LogRow) -> bytes:
    return (",".join(_text(value) for value in row_values(row).values()) + "\n").encode()


def _text(value: float | int | str) -> str:
    return format(value, ".9g") if isinstance(value, float) else str(value)
