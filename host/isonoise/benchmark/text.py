"""A measurement for a terminal, in the order in which a person asks: how fast, how soon, where the time goes."""

import io
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence

from isonoise.benchmark.baseline import Comparison, Ratio
from isonoise.benchmark.spread import Spread
from isonoise.progress import format_count, format_duration

WIDTH = 100
"""Letters of a line of text."""
SHOWN_BOUNCES = 8
SHOWN_BUFFERS = 5
BUSY = 0.3
"""Load average over the device's compute units, before the measurement begins, from which on it says so."""


def head_text(result: Mapping) -> str:
    """Device, driver, program."""
    device, load = result["device"], result["load_average"]
    others = load is not None and load > BUSY * device["compute_units"] and device["is_cpu"]
    note = (("note", f"others keep the machine busy (load average {load:.1f}): the figures suffer"),) if others else ()
    return lines(
        ("device", f"{device['name']}, {device['compute_units']} compute units, {_bytes(device['memory_bytes'])}"),
        ("driver", f"{device['platform']}, {device['opencl_version']}, driver {device['driver_version']}"),
        ("isonoise", f"{result['isonoise_version']}, {device['local_size']} work-items a group; {result['system']}"),
        (
            "figures",
            f"medians of {_number(result['repeat'], 'repeat')} after a warm-up, in brackets the least and the most",
        ),
        *note,
    )


def scene_text(scene: Mapping) -> str:
    """The block of one scene."""
    return "\n" + "\n\n".join([_scene_lines(scene), _kernel_table(scene), _ray_table(scene), _memory_lines(scene)])


def summary_text(result: Mapping) -> str:
    """A line a scene, where there is more than one."""
    if len(result["scenes"]) < 2:
        return ""
    rows = []
    for scene in result["scenes"]:
        first = ", ".join(f"{row['kernel']} {100 * row['share']:.0f} %" for row in scene["kernels"][:3])
        start = scene["start"]["cached"]["process_s"]
        rows.append(
            (scene["scene"], spread(scene["samples_per_s"], format_count), spread(start, format_duration), first)
        )
    return "\n" + table(("scene", "samples/s", "first image after", "most time in"), rows, left=(0, 3))


def against_text(comparison: Comparison, threshold: float) -> str:
    """Every ratio; those that are too low are marked."""
    slower = comparison.slower(threshold)
    rows = [
        (r.scene, r.kernel or "samples/s", f"{r.ratio:.3f}", _verdict(r, r in slower, r.ratio < threshold))
        for r in comparison.ratios
    ]
    rows += [(scene, kernel, "", "was not there before") for scene, kernel in comparison.new]
    rows += [(scene, kernel, "", "is not there any more") for scene, kernel in comparison.gone]
    title = f"\nspeed now over before; below {threshold:g} is slower"
    return f"{title}\n{table(('scene', 'what', 'ratio', ''), rows, left=(0, 1, 3))}"


def pools_text(speeds: Mapping[int, Sequence[float]], usual: int, chosen: int) -> str:
    """Samples per second by pool size, the gain over the usual one turn by turn, and what is chosen."""
    rows = []
    for size, turns in speeds.items():
        gain = Spread.of(mine / its for mine, its in zip(turns, speeds[usual], strict=True)).json()
        note = ", ".join(word for word, is_so in (("usual", size == usual), ("chosen", size == chosen)) if is_so)
        shown = "" if size == usual else spread(gain, lambda ratio: f"{ratio:.2f}")
        rows.append((f"{size:,}", spread(Spread.of(turns).json(), format_count), shown, note))
    return table(("paths in flight", "samples/s", "over the usual", ""), rows, left=(3,))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Aligned columns; those of the numbers in `left` begin at their left edge."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    drawn = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, title in enumerate(head):
        drawn.add_column(title, justify="left" if number in left else "right", no_wrap=True)
    for row in rows:
        drawn.add_row(*row)
    stream = io.StringIO()
    Console(file=stream, width=300, color_system=None, markup=False, highlight=False, emoji=False).print(drawn)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines() if line.strip())


def lines(*pairs: tuple[str, str]) -> str:
    """A label and what it says, a line each."""
    return "\n".join(f"{label:9}  {text}" for label, text in pairs)


def spread(figure: Mapping[str, float], show: Callable[[float], str]) -> str:
    """A median with what is around it, if anything is."""
    if figure["min"] == figure["max"]:
        return show(figure["median"])
    return f"{show(figure['median'])} ({show(figure['min'])} to {show(figure['max'])})"


def _scene_lines(scene: Mapping) -> str:
    depth = "no max_depth" if scene["max_depth"] < 0 else f"max_depth {scene['max_depth']}"
    parts = [(scene["triangles"], "triangle"), (scene["analytic_shapes"], "analytic shape")]
    parts += [(scene["instances"], "instance"), (scene["lights"], "light")]
    holds = ", ".join(_number(*part) for part in parts if part[0])
    features = textwrap.wrap(", ".join(scene["features"]), WIDTH)
    start, uncached = scene["start"]["cached"], scene["start"]["uncached"]
    spp = scene["samples"] / (scene["width"] * scene["height"])
    phases = [
        f"{name} {format_duration(start[f'{name}_s']['median'])} / {format_duration(uncached[f'{name}_s'])}"
        for name in ("load", "build", "compile")
    ]
    speed = f"{spread(scene['samples_per_s'], format_count)}, "
    speed += f"{format_duration(scene['run_s']['median'])} for {spp:.4g} per pixel"
    return lines(
        ("scene", scene["scene"]),
        ("", f"{scene['width']}x{scene['height']}, {depth}, roulette from {scene['rr_depth']}; {holds}"),
        *zip(("built in", *[""] * len(features)), features, strict=False),
        ("samples/s", speed),
        ("start", f"{spread(start['process_s'], format_duration)} to the first image"),
        ("", f"{format_duration(uncached['process_s'])} where nothing was compiled before; with / without a cache:"),
        ("", ", ".join(phases)),
        ("busy", f"{spread(scene['busy_share'], _percent)} of the time, with times kept, the device is at work"),
    )


def _kernel_table(scene: Mapping) -> str:
    rows = [
        (
            row["kernel"],
            _percent(row["share"]),
            spread(row["time_s"], _milliseconds),
            f"{row['launches']:,}",
            f"{row['items']:,}",
            f"{row['ns_per_item']:.4g}",
        )
        for row in scene["kernels"]
    ]
    return table(("kernel", "share", "ms a run", "launches", "items", "ns/item"), rows)


def _ray_table(scene: Mapping) -> str:
    rays = scene["rays"]
    rows = [
        (
            row["kind"],
            f"{row['rays']:,}",
            _rate(row["mrays_per_s"]),
            _per_ray(row["node_tests_per_ray"]),
            _per_ray(row["triangle_tests_per_ray"]),
            *("", ""),
        )
        for row in rays["kinds"]
    ]
    for row in rays["bounces"][:SHOWN_BOUNCES]:
        shadow = (f"{row['shadow_rays']:,}", _rate(row["shadow_mrays_per_s"]))
        rows.append((f"depth {row['depth']}", f"{row['rays']:,}", _rate(row["mrays_per_s"]), "", "", *shadow))
    text = table(("rays", "number", "Mrays/s", "nodes/ray", "triangles/ray", "shadow rays", "Mrays/s"), rows)
    rest = rays["bounces"][SHOWN_BOUNCES:]
    if rest:
        text += f"\nand {sum(row['rays'] for row in rest):,} rays to depth {rest[-1]['depth']}"
    return text


def _memory_lines(scene: Mapping) -> str:
    tree, memory = scene["hierarchy"], scene["memory"]
    filled = tree["triangles_per_block"]
    largest = list(memory["buffers_bytes"].items())[:SHOWN_BUFFERS]
    cost = "" if tree["sah_cost"] is None else f", SAH cost {tree['sah_cost']:.4g}"
    leaves = f"{tree['leaves']:,} lea{'f' if tree['leaves'] == 1 else 'ves'}" + (
        "" if filled is None else f" ({filled:.3g} triangles a block)"
    )
    return lines(
        ("pool", f"{scene['pool_paths']:,} paths, {_percent(scene['occupancy'] or 0)} of them in use"),
        ("hierarchy", f"{_number(tree['nodes'], 'node')} ({tree['children_per_node']:.3g} children), {leaves}{cost}"),
        ("", f"depth {tree['depth']}, {tree['stack_entries']} stack entries, {_bytes(tree['size_bytes'])}"),
        ("memory", f"{_bytes(memory['total_bytes'])}, {memory['state_bytes_per_path']:g} bytes of state a path"),
        ("", ", ".join(f"{name} {_bytes(size)}" for name, size in largest)),
    )


def _verdict(ratio: Ratio, slower: bool, below: bool) -> str:
    if slower:
        return "slower"
    if not ratio.counts:
        return "too short to count"
    return "within the spread" if below else ""


def _number(number: int, what: str) -> str:
    return f"{number:,} {what}{'s' * (number != 1)}"


def _rate(figure: Mapping | None) -> str:
    return "" if figure is None else spread(figure, lambda rate: f"{rate:.3g}")


def _per_ray(tests: float | None) -> str:
    return "" if tests is None else f"{tests:.3g}"


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _bytes(number: float) -> str:
    for unit, size in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.0f} bytes"
