"""Measures what the live page costs a render: python tests/live_cost.py [PAIRS] [REDUCTION].

Waves of one render at 1920x1080 with and without a page, in turn, so that other programs on the machine affect both
alike. A client in another process asks for one picture after the other. Prints CPU time and time of a wave with the
page over those without, with standard errors. The first pictures come at once: take 30 pairs or more.
"""

import math
import statistics
import subprocess
import sys
import time

from live_client import LiveClient

from isonoise.live.budget import Budget
from isonoise.live.live_page import LivePage
from isonoise.loop import RenderLoop
from isonoise.renderer import Renderer
from isonoise.stops import Stops

SIZE = (1920, 1080)


class Clock:
    """Seconds of waves with the page."""

    def __init__(self):
        self.elapsed_s, self.start = 0.0, None

    def __call__(self) -> float:
        return self.elapsed_s + (0.0 if self.start is None else time.perf_counter() - self.start)


def measure(pairs: int, reduction: int) -> None:
    clock, times = Clock(), {True: [], False: []}
    with LivePage() as page, Renderer("cornell", size=SIZE, strategy="uniform") as renderer:
        loop, periodic = RenderLoop(renderer, Stops(spp=1e9)), page.periodic()
        periodic.action(loop)  # begins
        page._budget = Budget(clock)
        renderer.step(SIZE[0] * SIZE[1])
        client = subprocess.Popen([sys.executable, __file__, "look", page.url, str(reduction)])
        time.sleep(2)
        for index in range(2 * pairs):
            with_page = index % 4 in (1, 2)
            times[with_page].append(trace_wave(loop, periodic if with_page else None, clock))
        client.kill()
    for column, name in enumerate(("CPU time", "time")):
        ratios = [math.log(a[column] / b[column]) for a, b in zip(times[True], times[False], strict=True)]
        print(f"{name}: {math.exp(statistics.mean(ratios)):.4f} +- {statistics.stdev(ratios) / math.sqrt(pairs):.4f}")


def trace_wave(loop, periodic, clock) -> tuple[float, float]:
    """CPU time and time of a wave of one sample per pixel."""
    start, cpu_start = time.perf_counter(), time.process_time()
    clock.start = start if periodic else None
    loop.renderer.begin_wave(SIZE[0] * SIZE[1])
    while not loop.renderer.continue_wave(lambda samples: periodic is None or not periodic.is_wanted()):
        if periodic.is_wanted():
            periodic.action(loop)
    loop.renderer.end_wave()
    if periodic and periodic.is_wanted():
        periodic.action(loop)
    clock.elapsed_s, clock.start = clock(), None
    return time.process_time() - cpu_start, time.perf_counter() - start


def look(url: str, reduction: int) -> None:
    """Take picture after picture."""
    client, version = LiveClient(url), -1
    while True:
        picture = client.layer("image", version, reduction)
        version = version if picture is None else picture[0]["version"]


if __name__ == "__main__":
    if sys.argv[1:2] == ["look"]:
        look(sys.argv[2], int(sys.argv[3]))
    else:
        measure(*map(int, [*sys.argv[1:3], *("45", "2")[len(sys.argv) - 1 :]]))
