"""The options of `isonoise compare`. `add_compare` is called by `cli`."""

from isonoise import argument_types
from isonoise.commands import shared_options


def add_compare(commands) -> None:
    compare = commands.add_parser(
        "compare",
        help="render scenes with several strategies and seeds, and report error against time",
        description="Render every SCENE with every strategy and seed, measure each wave against a reference, and\n"
        "write tables, plots and a report. Rerun the same command to resume a stopped comparison; scenes,\n"
        "strategies and seeds can be added. Ctrl-C drops the current run and reports the finished ones.",
    )
    compare.epilog_name = "compare_epilog"
    compare.add_argument(
        "scenes",
        metavar="SCENE",
        nargs="*",
        help="a scene file or a built-in scene; one or more; or an experiment's .toml file",
    )
    compare.add_argument("-o", "--output", metavar="DIR", required=True, help="output folder; files are listed below")
    subjects = compare.add_argument_group("what to compare")
    subjects.add_argument(
        "--strategies",
        metavar="A,B,..",
        action="append",
        default=[],
        help="as NAME[:k=v,..] of `isonoise render --help`, and those listed below; may be given more than once",
    )
    subjects.add_argument(
        "--preset", metavar="NAME", help="named settings, listed below; given scenes and options replace its own"
    )
    subjects.add_argument(
        "--seeds", metavar="N", type=argument_types.count, help="runs of each strategy on each scene (default: 8)"
    )
    subjects.add_argument(
        "--seed", metavar="K", type=argument_types.seed, default=0, help="seed of the first run (default: %(default)s)"
    )
    budget = compare.add_argument_group("budget of a run (one of them)")
    budget.add_argument("--time", metavar="S", type=argument_types.positive, help="seconds of rendering (default: 10)")
    budget.add_argument(
        "--spp",
        metavar="N[,N..]",
        type=argument_types.positives,
        help="mean samples per pixel; several numbers are several comparisons in DIR/spp-N with the same references",
    )
    settings = compare.add_argument_group("how to render")
    shared_options.add_scene_overrides(settings)
    shared_options.add_allow_outside(settings)
    shared_options.add_device(settings)
    shared_options.add_cluster(settings)
    settings.add_argument(
        "--rerun-changed",
        action="store_true",
        help="when a comparison is resumed with another version, driver or device, or an edited strategy or scene: "
        "render again what depends on it (default: refuse)",
    )
    _add_references(compare)
    _add_results(compare)
    shared_options.add_output(compare, "print the numbers of the tables, as in summary.json")


def _add_references(compare) -> None:
    references = compare.add_argument_group("references")
    references.add_argument(
        "--reference",
        metavar="[SCENE=]REF.exr",
        action="append",
        default=[],
        help="converged image, with stderr.R, .G, .B if known; one per scene in order, or by the scene's name "
        "(default: rendered)",
    )
    references.add_argument(
        "--reference-time",
        metavar="S",
        type=argument_types.positive,
        help="seconds to render a reference, and as many for the variances of an oracle (default: 20 times --time; "
        "with --spp 20 times its samples)",
    )


def _add_results(compare) -> None:
    results = compare.add_argument_group("results")
    results.add_argument(
        "--metrics",
        metavar="A,B,..",
        help="columns of runs.csv and waves.csv, listed below; `all` for all of them (default: all but flip)",
    )
    results.add_argument(
        "--keep-images",
        action="store_true",
        help="write the final image of every run to DIR/images, EXR with 16-bit floats; also of runs that are finished",
    )
