"""Measurements as text for a terminal; every function takes the content of a JSON file, or a part of it."""

from collections.abc import Callable, Hashable, Mapping, Sequence

from isonoise.benchmark.baseline import Comparison, SpeedRatio
from isonoise.benchmark.specialisation import SPECIALISED
from isonoise.benchmark.spread import spread
from isonoise.progress import format_count, format_duration, format_number
from isonoise.tables import Table, columns, label_lines, text_table

WIDTH = 110
"""Characters of a line; longer values are wrapped."""
LABEL_WIDTH = 9
MAX_BOUNCES = 8
MAX_BUFFERS = 5
BUSY_LOAD = 0.3
"""Load average per compute unit before the measurement from which on the text warns."""


def header_text(result: Mapping, *more: tuple[str, str]) -> str:
    """Device, driver, program; `more` are further labels with their values."""
    device, load = result["device"], result["load_average"]
    lines = [
        ("device", f"{device['name']}, {device['compute_units']} compute units, {_bytes(device['memory_bytes'])}"),
        ("driver", driver_text(device)),
        ("machine", ", ".join(filter(None, (result["host"], result["cpu_model"], result["system"])))),
        (
            "isonoise",
            f"{_version(result)}; kernels in the form {device['form']}, {device['local_size']} work-items a group",
        ),
        *more,
        ("figures", f"medians of {_plural(result['repeat'], 'repeat')}, in brackets minimum and maximum"),
    ]
    if load is not None and load > BUSY_LOAD * device["compute_units"] and device["is_cpu"]:
        lines.append(("note", f"the machine is busy (load average {load:.1f}): the figures are less accurate"))
    return _labels(lines)


def driver_text(device: Mapping) -> str:
    """Platform, versions and the compiler's target."""
    text = f"{device['platform']}, {device['opencl_version']}, driver {device['driver_version']}"
    return f"{text}, code for {device['compiler_target']}" if device["compiler_target"] else text


def _version(fields: Mapping) -> str:
    """Version and commit of isonoise."""
    if not fields["commit"]:
        return fields["isonoise_version"]
    changes = " with local changes" if fields["has_local_changes"] else ""
    return f"{fields['isonoise_version']}, commit {fields['commit'][:12]}{changes}"


def bandwidth_text(result: Mapping) -> str:
    """The bandwidth that kernels are compared with."""
    return f"{_spread(result['copy_gb_per_s'], lambda rate: f'{rate:.3g}')} GB/s read and written"


def scene_text(scene: Mapping) -> str:
    """One scene of a measurement."""
    return "\n" + "\n\n".join([_scene_lines(scene), _kernel_table(scene), _ray_table(scene), _memory_lines(scene)])


def summary_text(result: Mapping) -> str:
    """A row per scene; empty for a single scene."""
    if len(result["scenes"]) < 2:
        return ""
    rows = [
        (
            scene["scene"],
            _spread(scene["samples_per_s"], format_count),
            _spread(scene["startup"]["cached"]["process_s"], format_duration),
            ", ".join(f"{row['kernel']} {100 * row['time_share']:.0f} %" for row in scene["kernels"][:3]),
        )
        for scene in result["scenes"]
    ]
    return "\n" + text_table(
        Table(columns("scene", "samples/s", "first image after", "most time in", left=(0, 3)), rows)
    )


def comparison_text(comparison: Comparison, threshold: float) -> str:
    """All speed ratios to a baseline; those that are too low are marked."""
    slower = comparison.slower(threshold)
    rows = [
        (r.scene, r.kernel or "samples/s", f"{r.ratio:.3f}", _verdict(r, r in slower, r.ratio < threshold))
        for r in comparison.ratios
    ]
    rows += [(scene, kernel, "", "new") for scene, kernel in comparison.added]
    rows += [(scene, kernel, "", "removed") for scene, kernel in comparison.removed]
    table = text_table(Table(columns("scene", "kernel", "ratio", "", left=(0, 1, 3)), rows))
    return f"\nspeed over the earlier speed; below {threshold:g} is slower\n{table}"


def tuning_text(heading: str, speeds: Mapping[Hashable, Sequence[float]], default: Hashable, chosen: Hashable) -> str:
    """Samples per second of forms or pool sizes, the gain over the default per turn, and the choice."""
    rows = []
    for choice, turns in speeds.items():
        gain = spread(speed / reference for speed, reference in zip(turns, speeds[default], strict=True))
        note = ", ".join(
            word for word, applies in (("default", choice == default), ("chosen", choice == chosen)) if applies
        )
        gain_text = "" if choice == default else _spread(gain, _two_decimals)
        choice_text = f"{choice:,}" if isinstance(choice, int) else str(choice)
        rows.append((choice_text, _spread(spread(turns), format_count), gain_text, note))
    return text_table(Table(columns(heading, "samples/s", "over the default", "", left=(3,)), rows))


def peers_text(result: Mapping) -> str:
    """Samples per second over Mitsuba's, rays per second over Embree's."""
    variants = {scene["mitsuba_variant"] for scene in result["scenes"]}
    peers = f"Mitsuba {result['mitsuba_version']} ({', '.join(sorted(variants))})"
    peers += f"; embreex {result['embreex_version']}, one thread"
    parts = [header_text(result, ("peers", peers)), "", _mitsuba_table(result["scenes"])]
    if variants - {"llvm_ad_rgb"}:
        parts.append(
            "* by a scalar variant of Mitsuba, which is several times slower: the compiled one found no libLLVM 19\n"
            "  or newer; install one (Debian: apt install libllvm19) and name it with DRJIT_LIBLLVM_PATH"
        )
    if result["meshes"]:
        builds = ", ".join(
            f"{mesh['scene']} {format_duration(mesh['build_s'])} / {format_duration(mesh['embree_build_s'])}"
            for mesh in result["meshes"]
        )
        parts += ["", _embree_table(result["meshes"]), f"BVH built in, isonoise / Embree: {builds}"]
    return "\n".join(parts)


def _mitsuba_table(scenes: Sequence[Mapping]) -> str:
    rows = [
        (
            scene["scene"] + ("" if scene["mitsuba_variant"] == "llvm_ad_rgb" else " *"),
            f"{scene['width']}x{scene['height']}, {scene['max_depth']}, {scene['rr_depth']}",
            _spread(scene["samples_per_s"], format_count),
            _spread(scene["mitsuba_samples_per_s"], format_count),
            _spread(scene["speedup"], _two_decimals),
            "" if scene["image_mean_ratio"] is None else f"{scene['image_mean_ratio']:.4f}",
        )
        for scene in scenes
    ]
    heads = ("samples/s", "size, depth, roulette", "isonoise", "Mitsuba", "ratio", "image means")
    return text_table(Table(columns(*heads, left=(0, 1)), rows))


def _embree_table(meshes: Sequence[Mapping]) -> str:
    rows = [
        (
            mesh["scene"],
            f"{mesh['triangles']:,}",
            row["kind"],
            f"{100 * row['hit_share']:.0f} %",
            _spread(row["mrays_per_s"], _two_decimals),
            _spread(row["embree_mrays_per_s"], _two_decimals),
            _spread(row["speedup"], _two_decimals),
            f"{100 * row['embree_overhead_share']['median']:.0f} %",
            _spread(row["speedup_per_core"], _two_decimals),
            f"{100 * row['same_triangle_share']:.3f} %",
        )
        for mesh in meshes
        for row in mesh["rays"]
    ]
    heads = (
        "Mrays/s",
        "triangles",
        "rays",
        "hits",
        "isonoise",
        "Embree",
        "ratio",
        "embreex",
        "ratio per core",
        "same triangle",
    )
    return text_table(Table(columns(*heads, left=(0, 2)), rows))


def versus_text(result: Mapping, threshold: float, slower: Sequence[str]) -> str:
    """A row per scene; `slower` are the scenes whose ratio is too low."""
    other = result["other"]
    where = other["checkout"] or "the same program on another device"
    rows = [
        (
            scene["scene"],
            _spread(scene["samples_per_s"], format_count),
            _spread(scene["other_samples_per_s"], format_count),
            _spread(scene["speedup"], lambda ratio: f"{ratio:.3f}"),
            _spread(scene["cpu_speedup"], lambda ratio: f"{ratio:.3f}"),
            "" if scene["image_mean_ratio"] is None else f"{scene['image_mean_ratio']:.4f}",
            "slower" if scene["scene"] in slower else "",
        )
        for scene in result["scenes"]
    ]
    heads = ("scene", "samples/s", "other", "ratio", "by CPU time", "image means", "")
    table = text_table(Table(columns(*heads, left=(0, 6)), rows))
    labels = [("other", f"{where}: {_version(other)}"), ("", driver_text(other["device"]))]
    return f"{header_text(result, *labels)}\n\nspeed over that of the other; below {threshold:g} is slower\n{table}"


def specialisation_text(result: Mapping) -> str:
    """A row for every scene and program."""
    heads = ("scene", "program", "features", "samples/s", "ratio", "compile", "bytes/path", "launches", "image")
    rows = [_program_row(scene["scene"], program) for scene in result["scenes"] for program in scene["programs"]]
    table = text_table(Table(columns(*heads, left=(0, 1, 8)), rows))
    return f"{header_text(result)}\n\n{table}\nratio: speed of the specialised program over this program's"


def _program_row(scene: str, program: Mapping) -> tuple[str, ...]:
    is_first = program["program"] == SPECIALISED
    return (
        scene if is_first else "",
        program["program"],
        str(program["feature_count"]),
        _spread(program["samples_per_s"], format_count),
        "" if is_first else _spread(program["specialised_speedup"], _two_decimals),
        format_duration(program["compile_s"]),
        str(program["state_bytes_per_path"]),
        f"{program['launches']:,}",
        "" if is_first else _image_difference(program),
    )


def _image_difference(program: Mapping) -> str:
    if program["bit_identical"]:
        return "the same bits"
    difference = program["max_relative_difference"]
    return "differs" if difference is None else f"differs by {difference:.1g} of the brightest pixel"


def _scene_lines(scene: Mapping) -> str:
    depth = "no max_depth" if scene["max_depth"] < 0 else f"max_depth {scene['max_depth']}"
    counts = [(scene["triangles"], "triangle"), (scene["analytic_shapes"], "analytic shape")]
    counts += [(scene["instances"], "instance"), (scene["lights"], "light")]
    contents = ", ".join(_plural(*count) for count in counts if count[0])
    cached, uncached = scene["startup"]["cached"], scene["startup"]["uncached"]
    spp = scene["samples"] / (scene["width"] * scene["height"])
    phases = [
        f"{name} {format_duration(cached[f'{name}_s']['median'])} / {format_duration(uncached[f'{name}_s'])}"
        for name in ("load", "build", "compile")
    ]
    speed = f"{_spread(scene['samples_per_s'], format_count)}; "
    speed += f"{format_duration(scene['run_s']['median'])} for {format_number(spp, 4)} samples per pixel"
    return _labels(
        [
            ("scene", scene["scene"]),
            ("", f"{scene['width']}x{scene['height']}, {depth}, roulette from depth {scene['rr_depth']}; {contents}"),
            ("features", ", ".join(scene["features"])),
            ("samples/s", speed),
            ("start", f"{_spread(cached['process_s'], format_duration)} to the first image"),
            ("", f"{format_duration(uncached['process_s'])} with empty program caches; with full / empty caches:"),
            ("", ", ".join(phases)),
            ("waves", _wave_costs(scene["wave_costs"])),
            ("busy", f"{_spread(scene['device_busy_share'], _percent)} of a profiled run the device is busy"),
        ]
    )


def _wave_costs(costs: Mapping) -> str:
    """The share of a wave's time that is not tracing, and its parts."""
    parts = ", ".join(
        f"{name} {_percent(costs[f'{name}_share']['median'])}" for name in ("statistics", "errors", "allocation")
    )
    wave = f"{costs['strategy']}, {costs['samples_per_pixel']} samples per pixel"
    return f"{_spread(costs['total_share'], _percent)} of an adaptive wave ({wave}) is not tracing: {parts}"


def _kernel_table(scene: Mapping) -> str:
    rows = [
        (
            row["kernel"],
            _percent(row["time_share"]),
            _spread(row["time_s"], lambda seconds: f"{1e3 * seconds:.4g}"),
            f"{row['launches']:,}",
            f"{row['items']:,}",
            f"{row['ns_per_item']:.4g}",
            "" if row["gb_per_s"] is None else f"{row['bytes_per_item'] + (row['traversal_bytes_per_item'] or 0):,.0f}",
            "" if row["gb_per_s"] is None else f"{row['gb_per_s']:.3g}",
            "" if row["copy_share"] is None else _percent(row["copy_share"]),
        )
        for row in scene["kernels"]
    ]
    heads = ("kernel", "share", "ms per run", "launches", "items", "ns/item", "bytes/item", "GB/s", "of a copy")
    return text_table(Table(columns(*heads), rows))


def _ray_table(scene: Mapping) -> str:
    rays = scene["rays"]
    rows = [
        (
            row["kind"],
            f"{row['rays']:,}",
            _rate(row["mrays_per_s"]),
            _per_ray(row["node_tests_per_ray"]),
            _per_ray(row["triangle_tests_per_ray"]),
            "",
            "",
        )
        for row in rays["kinds"]
    ]
    for row in rays["bounces"][:MAX_BOUNCES]:
        shadow = (f"{row['shadow_rays']:,}", _rate(row["shadow_mrays_per_s"]))
        rows.append((f"depth {row['depth']}", f"{row['rays']:,}", _rate(row["mrays_per_s"]), "", "", *shadow))
    heads = ("rays", "number", "Mrays/s", "nodes/ray", "triangles/ray", "shadow rays", "Mrays/s")
    text = text_table(Table(columns(*heads), rows))
    if rest := rays["bounces"][MAX_BOUNCES:]:
        text += f"\nand {sum(row['rays'] for row in rest):,} rays to depth {rest[-1]['depth']}"
    return text


def _memory_lines(scene: Mapping) -> str:
    bvh, memory = scene["bvh"], scene["memory"]
    leaves = f"{bvh['leaves']:,} lea{'f' if bvh['leaves'] == 1 else 'ves'}"
    if bvh["triangles_per_block"] is not None:
        leaves += f" ({bvh['triangles_per_block']:.3g} triangles per block)"
    cost = "" if bvh["sah_cost"] is None else f", SAH cost {bvh['sah_cost']:.4g}"
    largest = list(memory["buffers_bytes"].items())[:MAX_BUFFERS]
    return _labels(
        [
            ("pool", f"{scene['pool_size']:,} paths, {_percent(scene['pool_occupancy'] or 0)} in use"),
            ("bvh", f"{_plural(bvh['nodes'], 'node')} ({bvh['children_per_node']:.3g} children), {leaves}{cost}"),
            ("", f"depth {bvh['depth']}, {bvh['stack_entries']} stack entries, {_bytes(bvh['size_bytes'])}"),
            ("memory", f"{_bytes(memory['total_bytes'])}, {memory['state_bytes_per_path']:g} bytes of state per path"),
            ("", ", ".join(f"{name} {_bytes(size)}" for name, size in largest)),
        ]
    )


def _verdict(ratio: SpeedRatio, is_slower: bool, is_below_threshold: bool) -> str:
    if is_slower:
        return "slower"
    if not ratio.is_judged:
        return "too short to judge"
    return "within the spread" if is_below_threshold else ""


def _labels(lines: Sequence[tuple[str, str]]) -> str:
    return label_lines(lines, min_width=LABEL_WIDTH, wrap=WIDTH)


def _spread(figure: Mapping[str, float], form: Callable[[float], str]) -> str:
    """The median, with minimum and maximum in brackets if they differ."""
    if figure["min"] == figure["max"]:
        return form(figure["median"])
    return f"{form(figure['median'])} ({form(figure['min'])} to {form(figure['max'])})"


def _plural(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'s' * (number != 1)}"


def _rate(figure: Mapping | None) -> str:
    return "" if figure is None else _spread(figure, lambda rate: f"{rate:.3g}")


def _per_ray(tests: float | None) -> str:
    return "" if tests is None else f"{tests:.3g}"


def _two_decimals(value: float) -> str:
    return f"{value:.2f}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _bytes(number: float) -> str:
    for unit, size in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.0f} bytes"
