"""Progress bars (on a terminal only), and numbers formatted for people."""

import math
import re
import sys


class ProgressBar:
    """A progress bar on stderr during the `with` block. Nothing is shown if stderr is not a terminal."""

    def __init__(self, description: str = "first samples"):
        self._description = description

    def __enter__(self):
        self._progress = None
        if sys.stderr.isatty():
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
        return self

    def __exit__(self, *exception) -> None:
        if self._progress:
            self._progress.stop()

    def show(self, completed: float, total: float | None, description: str) -> None:
        """Show that `completed` of `total` (None: unknown) is done, with `description` beside the bar."""
        if self._progress:
            self._progress.update(self._task, completed=completed, total=total, description=description)


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
