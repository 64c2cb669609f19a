"""Progress bars, on a terminal or in a notebook, and numbers formatted for people."""

import html
import math
import re
import sys
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from typing_extensions import Self


class ProgressBar:
    """A progress bar during the `with` block: on stderr if that is a terminal, in a notebook below the cell.

    Elsewhere nothing is shown.

    Attributes
    ----------
    is_shown : bool
        Of the class: False hides all bars.
    """

    is_shown: ClassVar[bool] = True

    def __init__(self, description: str = "first samples") -> None:
        self._description = description

    def __enter__(self) -> "Self":
        self._progress = None
        if self.is_shown and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._progress = Progress(
                BarColumn(bar_width=None),
                TextColumn("{task.description}"),
                console=Console(stderr=True),
                transient=True,
                expand=True,
            )
            self._task = self._progress.add_task(self._description, total=None)
            self._progress.start()
        self._notebook = NotebookOutput() if self.is_shown and in_notebook() else None
        self.show(0, None, self._description)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._progress:
            self._progress.stop()
        if self._notebook:
            self._notebook.clear()

    @property
    def is_visible(self) -> bool:
        """Whether anything is shown."""
        return self._progress is not None or self._notebook is not None

    def show(self, completed: float, total: float | None, description: str) -> None:
        """Show that `completed` of `total` (None: unknown) is done, with `description` beside the bar."""
        if self._progress:
            self._progress.update(self._task, completed=completed, total=total, description=description)
        if self._notebook:
            share = "" if total is None else f' value="{completed / total:.4f}"'
            bar = f'<progress{share} aria-label="progress" style="width:40%"></progress>'
            self._notebook.show(f"{bar} {html.escape(description)}", description)

    def show_compilation(self, program: str, done: int, total: int) -> None:
        """Show that a kernel program is compiled, after `done` of `total` others."""
        self.show(done, total, f"compiling kernels, {done} of {total} done: {program}")


def in_notebook() -> bool:
    """Whether the code runs in a kernel of Jupyter, so that what it displays appears in a notebook."""
    ipython = sys.modules.get("IPython")
    return hasattr(ipython and ipython.get_ipython(), "kernel")


class NotebookOutput:
    """One output of a notebook's cell, whose content can be replaced."""

    def __init__(self) -> None:
        from IPython.display import DisplayHandle

        self._handle = DisplayHandle()  # type: ignore[no-untyped-call]
        self._is_shown = False

    def show(self, content: str, text: str) -> None:
        """Show HTML in place of what was shown before; `text` is for frontends without HTML."""
        display = self._handle.update if self._is_shown else self._handle.display
        display({"text/html": content, "text/plain": text}, raw=True)  # type: ignore[no-untyped-call]
        self._is_shown = True

    def clear(self) -> None:
        """Show nothing more."""
        if self._is_shown:
            self.show("", "")


class RenderProgressBar(ProgressBar):
    """Progress bar of a render."""

    def update(
        self, elapsed_s: float, samples: int, stated_error: float | None, remaining_s: float | None, workers: int = 0
    ) -> None:
        """Show the render loop's progress (`on_progress`; None is unknown), and how many workers there are, if any."""
        parts = [format_duration(elapsed_s), f"{format_count(samples)} samples"]
        if workers:
            parts.append(f"{workers:,} worker{'s' * (workers > 1)}")
        if stated_error is not None:
            parts.append(f"error {format_percent(stated_error)}")
        if remaining_s is not None:
            parts.append(f"{format_duration(remaining_s)} left")
        total = None if remaining_s is None else max(elapsed_s + remaining_s, 1e-9)
        self.show(elapsed_s, total, ", ".join(parts))


def format_duration(seconds: float) -> str:
    """Seconds as text: '0.31 s', '12.3 s', '4:05', '1:02:03'."""
    if seconds < 9.995:
        return f"{seconds:.2f} s"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def format_count(number: float) -> str:
    """A count with three digits: '950', '1.23 M', '45.6 G'."""
    for unit, size in (("T", 1e12), ("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= 0.9995 * size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.0f}"


def format_number(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits: '0.35', '2,270', '0.0000123'."""
    rounded = float(f"{value:.{digits}g}")
    if rounded == 0 or not 1e-9 <= abs(rounded) < 1e12:
        return f"{rounded:g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)
    text = f"{rounded:,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def shorten_numbers(text: str) -> str:
    """The text with its long decimal fractions rounded to 6 digits."""
    return re.sub(r"-?\d+\.\d{7,}(?:e[+-]?\d+)?", lambda match: format_number(float(match[0]), 6), text)


def format_percent(error: float) -> str:
    """A relative error as text: '1.98 %', '0.0123 %', '2,270 %'; 'unknown' if it is not finite."""
    return f"{format_number(100 * error)} %" if math.isfinite(error) else "unknown"
