"""Options of `isonoise bench` that no other command has. Called by `cli.py`."""

from isonoise import argument_types
from isonoise.commands import shared_options


def add_modes(subjects) -> None:
    """Options for what to measure instead of speed and start-up."""
    modes = subjects.add_mutually_exclusive_group()
    modes.add_argument(
        "--peers",
        action="store_true",
        help="instead, measure the speed relative to Mitsuba 3 and, for rays, to Embree; see below",
    )
    modes.add_argument(
        "--tune",
        action="store_true",
        help="instead, find the fastest device form and number of paths in flight, for all later renders on the device",
    )
    modes.add_argument(
        "--specialisation",
        action="store_true",
        help="instead, measure the speed relative to kernels with more features than the scene uses; see below",
    )
    modes.add_argument(
        "--versus",
        metavar="OTHER",
        help="instead, measure the speed relative to another checkout, given by its folder, or to another device, "
        "given as device:D; see below",
    )


def add_results(bench) -> None:
    """Options for files and comparisons."""
    output = bench.add_argument_group("results")
    shared_options.add_json_file(output, "host/docs/benchmarks.md")
    shared_options.add_quiet(output)
    output.add_argument("--pytest-benchmark", metavar="FILE", help="write the times for `pytest-benchmark compare`")
    output.add_argument(
        "--trace", metavar="FILE", help="write a timeline of all launches of a run, for ui.perfetto.dev"
    )
    output.add_argument(
        "--dump", metavar="DIR", help="write every program's source, options, build log and binary to a new folder"
    )
    output.add_argument(
        "--against", metavar="FILE", help="compare with an earlier --json file; exit code 1 if something is slower"
    )
    output.add_argument(
        "--threshold",
        metavar="R",
        type=argument_types.positive,
        help="speed relative to the earlier or other one below which something is slower (default: 0.9)",
    )
