"""Renders that a signal ends after the paths in flight, by KeyboardInterrupt; for `run_task` and `reference_batch`.

The signal is deferred while the device works: Python drops a KeyboardInterrupt in callbacks of drivers.
"""

from collections.abc import Callable

from isonoise.loop import Outcome, Stops, render_loop
from isonoise.renderer import Renderer, WaveRecord
from isonoise.signals import deferred, raise_if_received


def interruptible_render(
    renderer: Renderer, stops: Stops, should_stop: Callable[[], bool] = lambda: False, **options
) -> Outcome:
    """`render_loop`."""
    with deferred() as received:
        outcome = render_loop(renderer, stops, should_stop=lambda: bool(received) or should_stop(), **options)
    raise_if_received()
    return outcome


def interruptible_step(renderer: Renderer, should_stop: Callable[[], bool] = lambda: False) -> WaveRecord:
    """`Renderer.step`."""
    with deferred() as received:
        record = renderer.step(should_continue=lambda _: not (received or should_stop()))
    raise_if_received()
    return record
