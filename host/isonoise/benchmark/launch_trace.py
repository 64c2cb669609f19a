"""Timeline of the launches of profiled runs, for chrome://tracing and ui.perfetto.dev (`bench --trace`).

Trace Event Format, "JSON Object Format":
https://docs.google.com/document/d/1CvAClvFfyA5R-PhYUmn5OOQtYMH4h6I0nSsNHN8cKhk
"""

from collections.abc import Iterable, Mapping

from isonoise.device.opencl import Launch

WAVEFRONT_TRACK, QUEUE_TRACK = 1, 2
TRACKS = {WAVEFRONT_TRACK: "slices and bounces", QUEUE_TRACK: "queue"}
"""Thread numbers and their names. A scene is a process."""
SPANS = {"slice": ("list_samples", "reduce"), "bounce": ("intersect", "fill_holes")}
"""First and last kernel of each."""


def trace_json(header: Mapping, launches: Mapping[str, Iterable[Launch]]) -> dict[str, object]:
    """The content of a trace file.

    Parameters
    ----------
    header : mapping
        Fields of the report, without its scenes.
    launches : mapping
        Name of a scene -> the launches of one run.
    """
    events = []
    for number, (scene, run) in enumerate(launches.items(), start=1):
        events += _scene_events(scene, list(run), number)
    return {"traceEvents": events, "displayTimeUnit": "ms", "otherData": dict(header)}


def _scene_events(scene: str, launches: list[Launch], process: int) -> list[dict[str, object]]:
    """Events of a scene; time 0 is the start of the first launch."""
    zero = launches[0].start_ns if launches else 0
    events = [_metadata("process_name", scene, process, 0)]
    events += [_metadata("thread_name", name, process, track) for track, name in TRACKS.items()]
    starts: dict[str, Launch] = {}
    for launch in launches:
        for span, (first, last) in SPANS.items():
            if launch.kernel == first:
                starts[span] = launch
            elif launch.kernel == last and span in starts:
                begin = starts.pop(span)
                counts = {"items": begin.items}
                events.append(
                    _span(span, begin.start_ns - zero, launch.end_ns - zero, process, WAVEFRONT_TRACK, counts)
                )
        facts = {"items": launch.items, "queued_us": 1e-3 * (launch.start_ns - launch.queued_ns)}
        events.append(_span(launch.kernel, launch.start_ns - zero, launch.end_ns - zero, process, QUEUE_TRACK, facts))
    return events


def _metadata(kind: str, name: str, process: int, track: int) -> dict[str, object]:
    return {"name": kind, "ph": "M", "pid": process, "tid": track, "args": {"name": name}}


def _span(name: str, start_ns: int, end_ns: int, process: int, track: int, facts: Mapping) -> dict[str, object]:
    """A complete event; times in microseconds, with the nanoseconds as decimals."""
    return {
        "name": name,
        "cat": TRACKS[track],
        "ph": "X",
        "ts": start_ns / 1000,
        "dur": (end_ns - start_ns) / 1000,
        "pid": process,
        "tid": track,
        "args": dict(facts),
    }
