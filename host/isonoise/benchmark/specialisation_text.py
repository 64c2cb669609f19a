"""What specialising programs brings, for a terminal."""

from collections.abc import Mapping

from isonoise.benchmark.specialisation import SPECIALISED
from isonoise.benchmark.text import lines, spread, table
from isonoise.progress import format_count, format_duration


def specialisation_text(result: Mapping) -> str:
    """A row for every scene and program."""
    device = result["device"]
    head = lines(
        ("device", f"{device['name']}, {device['compute_units']} compute units"),
        ("driver", f"{device['platform']}, {device['opencl_version']}, driver {device['driver_version']}"),
        ("figures", f"medians of {result['repeat']} turns, in brackets the least and the most; ratios turn by turn"),
    )
    rows = [_row(scene["scene"], build) for scene in result["scenes"] for build in scene["builds"]]
    columns = ("scene", "program", "features", "samples/s", "ratio", "compile", "bytes a path", "launches", "image")
    return f"{head}\n\n{table(columns, rows, left=(0, 1, 8))}\nratio: the specialised program's speed over this one's"


def _row(scene: str, build: Mapping) -> tuple[str, ...]:
    first = build["build"] == SPECIALISED
    return (
        scene if first else "",
        build["build"],
        str(build["features"]),
        spread(build["samples_per_s"], format_count),
        "" if first else spread(build["specialised_ratio"], lambda ratio: f"{ratio:.2f}"),
        format_duration(build["compile_s"]),
        str(build["state_bytes_per_path"]),
        f"{build['launches']:,}",
        "" if first else _image(build),
    )


def _image(build: Mapping) -> str:
    if build["same_bits"]:
        return "the same bits"
    difference = build["largest_difference"]
    return "differs" if difference is None else f"differs by {difference:.1g} of the brightest pixel"
