"""The command line: options and exit codes. Each command is a module of `isonoise.commands`.

Nothing heavy is imported here, so that `isonoise --help` answers at once.
"""

import argparse
import importlib
import os
import signal
import sys

from isonoise import __version__, argument_types
from isonoise.commands import EXIT_BAD_INPUT, EXIT_DONE
from isonoise.errors import UserError


def main(argv: list[str] | None = None) -> int:
    """Run the command that `argv` (default: the process's own) names; returns the exit code."""
    try:
        options = _parser().parse_args(argv)
        code = importlib.import_module(f"isonoise.commands.{options.command}").run(options)
        sys.stdout.flush()
        return code
    except UserError as error:
        print(f"isonoise: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except MemoryError:
        print("isonoise: there is not enough memory for this input", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("isonoise: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT
    except BrokenPipeError:  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="isonoise",
        description="An OpenCL path tracer that spends its samples until the noise is the same everywhere.",
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_CommandParser)
    _add_render(commands)
    _add_compare(commands)
    _add_bench(commands)
    _add_selftest(commands)
    devices = "list the OpenCL devices and say which one is the default"
    commands.add_parser("devices", help=devices, description=devices.capitalize() + ".")
    plugins = commands.add_parser(
        "plugins",
        help="list what scenes may hold, or the parameters of one plugin",
        description="List Mitsuba 3's plugins by kind: which are supported, which are read over because they cannot "
        "change the image, which are not supported and why. For one plugin: its parameters.",
    )
    plugins.add_argument(
        "name", metavar="KIND|NAME", nargs="?", help="a kind such as bsdf, or a plugin such as plastic"
    )
    plugins.add_argument("--json", action="store_true", help="print the same as JSON, with all parameters")
    info = commands.add_parser(
        "info",
        help="say what a scene contains and which features it compiles to, or how an image was made",
        description="For a scene: its contents, which features are compiled in, which are left out and why. "
        "For an .exr file: its layers and how it was made.",
    )
    info.add_argument("source", metavar="SCENE|OUT.exr", help="a scene file, the name of a built-in scene, or an image")
    _add_definitions(info)
    return parser


def _add_render(commands) -> None:
    render = commands.add_parser(
        "render",
        help="render a scene until an error, a time or a number of samples is reached",
        description="Render a scene. --spp, --time and --error may be combined: the first one reached ends the\n"
        "render, and with none of them the scene's own sample_count. Ctrl-C ends a render with a valid image.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    render.make_epilog = _render_epilog
    render.add_argument(
        "scene", metavar="SCENE", help="a scene file (.xml, .obj, .ply, .stl, .glb) or a built-in scene"
    )
    render.add_argument(
        "-o",
        "--output",
        metavar="OUT.exr",
        action="append",
        required=True,
        help=".exr: all layers, float32; .png: tone-mapped for a look; may be given more than once",
    )
    limits = render.add_argument_group("when to stop")
    limits.add_argument("--spp", metavar="N", type=argument_types.positive, help="mean samples per pixel")
    limits.add_argument(
        "--time", metavar="S", type=argument_types.positive, help="seconds of rendering; set-up is not counted"
    )
    limits.add_argument("--error", metavar="E", type=argument_types.positive, help="stated relative error, as in 0.02")
    limits.add_argument(
        "--quantile",
        metavar="Q",
        type=argument_types.quantile,
        default=0.99,
        help="quantile over the pixels at which --error holds (default: %(default)s)",
    )
    how = render.add_argument_group("how to render")
    how.add_argument("--strategy", metavar="NAME[:k=v,..]", help="how samples are spread over the image; listed below")
    how.add_argument(
        "--seed", metavar="K", type=argument_types.seed, default=0, help="same seed, same image (default: %(default)s)"
    )
    how.add_argument(
        "--size", metavar="WxH", type=argument_types.size, help="image size in pixels instead of the scene's"
    )
    how.add_argument(
        "--max-depth", metavar="N", type=argument_types.max_depth, help="longest path: 1 is emitters only, -1 no end"
    )
    _add_definitions(how)
    how.add_argument("--device", metavar="D", help="an OpenCL device as `isonoise devices` lists them")
    reports = render.add_argument_group("what to report")
    reports.add_argument("--reference", metavar="REF.exr", help="converged image: the true error is reported as well")
    reports.add_argument("--log", metavar="LOG.csv", help="write a row a wave; the columns are listed below")
    reports.add_argument("--json", action="store_true", help="print the outcome as one JSON object")


def _add_compare(commands) -> None:
    compare = commands.add_parser(
        "compare",
        help="render scenes with several strategies and seeds, and report error against time",
        description="Render every SCENE with every strategy and seed, measure each wave against a reference, and make\n"
        "tables, plots and a report. A comparison that was stopped goes on when the same command is given again; more\n"
        "scenes, strategies and seeds may be added then. Ctrl-C drops the run in flight and reports what is finished.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    compare.make_epilog = _compare_epilog
    compare.add_argument("scenes", metavar="SCENE", nargs="*", help="a scene file or a built-in scene; one or more")
    compare.add_argument("-o", "--output", metavar="DIR", required=True, help="the folder; the files are listed below")
    what = compare.add_argument_group("what to compare")
    what.add_argument(
        "--strategies",
        metavar="A,B,..",
        action="append",
        default=[],
        help="as NAME[:k=v,..] of `isonoise render --help`, and those listed below; may be given more than once",
    )
    what.add_argument(
        "--preset",
        metavar="NAME",
        help="a whole plan, listed below; scenes and options that are given replace its pieces",
    )
    what.add_argument(
        "--seeds", metavar="N", type=argument_types.count, help="runs of each strategy on each scene (default: 8)"
    )
    what.add_argument(
        "--seed", metavar="K", type=argument_types.seed, default=0, help="seed of the first run (default: %(default)s)"
    )
    budget = compare.add_argument_group("budget of a run (one of them)")
    budget.add_argument("--time", metavar="S", type=argument_types.positive, help="seconds of rendering (default: 10)")
    budget.add_argument("--spp", metavar="N", type=argument_types.positive, help="mean samples per pixel")
    how = compare.add_argument_group("how to render")
    how.add_argument(
        "--size", metavar="WxH", type=argument_types.size, help="image size in pixels instead of the scenes'"
    )
    how.add_argument(
        "--max-depth", metavar="N", type=argument_types.max_depth, help="longest path: 1 is emitters only, -1 no end"
    )
    how.add_argument("--device", metavar="D", help="an OpenCL device as `isonoise devices` lists them")
    references = compare.add_argument_group("references")
    references.add_argument(
        "--reference",
        metavar="[SCENE=]REF.exr",
        action="append",
        default=[],
        help="converged image, with stderr.R, .G, .B if known; one for each scene in order, or by the scene's name; "
        "without it one is rendered",
    )
    references.add_argument(
        "--reference-time",
        metavar="S",
        type=argument_types.positive,
        help="seconds for a reference, and as many for what an oracle knows (default: 20 times --time; "
        "with --spp 20 times its samples)",
    )


def _add_bench(commands) -> None:
    bench = commands.add_parser(
        "bench",
        help="measure how fast scenes render, kernel by kernel",
        description="Measure scenes: samples per second, start-up, and where the time goes, kernel by kernel and\n"
        "bounce by bounce. Every run traces the same samples; throughput is measured without OpenCL's profiling,\n"
        "kernels with it, in turn. Keep the machine idle meanwhile.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    bench.make_epilog = _bench_epilog
    bench.add_argument("scenes", metavar="SCENE", nargs="*", help="a scene file, a built-in scene, or one listed below")
    what = bench.add_argument_group("what to measure")
    what.add_argument(
        "--repeat", metavar="N", type=argument_types.count, default=5, help="runs of each kind (default: %(default)s)"
    )
    what.add_argument("--spp", metavar="N", type=argument_types.positive, help="samples per pixel of a run; see below")
    what.add_argument(
        "--size", metavar="WxH", type=argument_types.size, help="image size in pixels instead of the scenes'"
    )
    what.add_argument(
        "--max-depth", metavar="N", type=argument_types.max_depth, help="longest path: 1 is emitters only, -1 no end"
    )
    what.add_argument("--device", metavar="D", help="an OpenCL device as `isonoise devices` lists them")
    instead = what.add_mutually_exclusive_group()
    instead.add_argument(
        "--peers",
        action="store_true",
        help="measure the speed over that of Mitsuba 3 and, for rays, of Embree, instead; see below",
    )
    instead.add_argument(
        "--tune",
        action="store_true",
        help="instead, measure how many paths in flight are fastest, and keep that for all later renders on the device",
    )
    instead.add_argument(
        "--specialisation",
        action="store_true",
        help="measure the speed over that of programs with more features than the scene uses, instead; see below",
    )
    output = bench.add_argument_group("what to do with it")
    output.add_argument("--json", metavar="FILE", help="write all figures; fields: host/docs/benchmarks.md")
    output.add_argument(
        "--against", metavar="FILE", help="compare with what --json wrote before; exit code 1 if slower"
    )
    output.add_argument(
        "--threshold",
        metavar="R",
        type=argument_types.positive,
        help="speed over the earlier speed below which something is slower (default: 0.9)",
    )


def _add_selftest(commands) -> None:
    selftest = commands.add_parser(
        "selftest",
        help="check kernels and allocation at the edge of their numbers, on a device",
        description="Check statistics, allocation, geometry, transport and adaptive rendering where numbers are\n"
        "stiff. A case is a number that the device arrived at beside what it should be by a closed form or in float64.",
        epilog="exit codes: 0 all passed; 1 a case failed; 2 bad input; 130 after Ctrl-C",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    selftest.add_argument("--device", metavar="D", help="an OpenCL device as `isonoise devices` lists them")
    selftest.add_argument("--json", metavar="FILE", help="write all cases; fields: host/docs/numerics.md")
    selftest.add_argument(
        "--thorough", action="store_true", help="send 10^8 rays through edges and vertices, for minutes, not 2 million"
    )


def _add_definitions(parser) -> None:
    parser.add_argument(
        "-D",
        dest="parameters",
        metavar="name=value",
        type=argument_types.definition,
        action="append",
        default=[],
        help="set a <default> parameter of the scene file; may be given more than once",
    )


def _render_epilog() -> str:
    import textwrap

    from isonoise.film.log import columns
    from isonoise.strategies import DEFAULT_STRATEGY, available_strategies, describe, make_strategy

    lines = [f"strategies (default: {DEFAULT_STRATEGY}), with their parameters:"]
    for name in available_strategies():
        try:
            lines.append(f"  {describe(make_strategy(name))}")
        except UserError as error:  # one that a package brings and that does not work
            lines.append(f"  {name}: {error}")
    lines += ["  module:Class for one of your own", ""]
    lines.append("columns of --log (those that begin with true_ only with --reference):")
    meanings = columns(true_errors=True)
    width = max(map(len, meanings))
    for name, meaning in meanings.items():
        lines += textwrap.wrap(meaning, 110, initial_indent=f"  {name:{width}}  ", subsequent_indent=" " * (width + 4))
    lines += ["", "exit codes: 0 done; 1 --error was not met within the other limits; 2 bad input; 130 after Ctrl-C"]
    return "\n".join(lines)


def _compare_epilog() -> str:
    from isonoise.comparison.presets import PRESETS

    lines = [
        "strategies beside those of `isonoise render`:",
        "  oracle                   without file=: what it knows comes from a long uniform run, made once a scene",
        "  mitsuba-independent      Mitsuba 3 with its sampler `independent`; needs the extra `peers`",
        "  mitsuba-multijitter      the same with `multijitter`; DRJIT_LIBLLVM_PATH may have to name its libLLVM",
        "",
        "presets:",
    ]
    for name, preset in PRESETS.items():
        lines.append(f"  {name}: {preset.description}")
        lines.append(f"    {preset.seeds} seeds, {preset.time:g} s a run; scenes {', '.join(preset.scenes)};")
        lines += [f"    {spec}" for spec in preset.strategies]
    lines += [
        "",
        "files below DIR:",
        "  report.html              tables and plots in one file",
        "  summary.json             the tables' numbers",
        "  tables.md                the tables as Markdown",
        "  waves.csv                one row a wave of every run: the columns of `isonoise render --help`, and device_s",
        "  plots/                   the plots alone",
        "  references/SCENE.exr     where none was given: R, G, B and standard errors stderr.R, .G, .B",
        "  runs/SCENE/STRATEGY/SEED.npz   one finished run; delete it to have it rendered again",
        "  plan.json                what is compared",
        "",
        "exit codes: 0 done; 2 bad input, or another plan than the one in DIR; 130 after Ctrl-C",
    ]
    return "\n".join(lines)


def _bench_epilog() -> str:
    from isonoise.benchmark.generated_scenes import MADE_SCENES
    from isonoise.commands.bench import DEFAULT_SCENES

    return "\n".join(
        [
            f"scenes beside files and built-in ones: {', '.join(MADE_SCENES)}: a mesh of as many triangles under an",
            "environment map, made on the spot; `python -m isonoise.benchmark.generated_scenes NAME FOLDER` writes it.",
            f"Without SCENE: {', '.join(DEFAULT_SCENES)}; with --peers mesh-1.3m as well; with --specialisation the",
            "built-in scenes.",
            "",
            "A run has about 2 million samples on a CPU and 16 million on a GPU unless --spp says otherwise.",
            "",
            "--against compares samples/s and every kernel's time by their medians. Kernels with at most 5 % of the",
            "time are shown but not judged; nor is what was as fast in one repeat as in one before. Device, scene,",
            "size, depth and samples have to be the same; the driver may differ.",
            "",
            "--peers takes turns with Mitsuba 3 (llvm_ad_rgb, path) on the same file, size, depth and roulette; and,",
            "where a scene is made of triangles alone, with Embree on one thread on the same rays: the camera's, and",
            "those after one diffuse bounce. It needs the extra `peers`; DRJIT_LIBLLVM_PATH may have to name a",
            "libLLVM, 19 or newer.",
            "",
            "--specialisation takes turns with programs that hold more than the scene uses: `path` what scenes of that",
            "integrator may use, `everything` what those of volpath may besides. It compares the images, too.",
            "What is compiled for the first time is compiled in processes of their own: that takes",
            "a minute a scene on a CPU.",
            "",
            "exit codes: 0 done; 1 --against found something slower; 2 bad input; 130 after Ctrl-C",
        ]
    )


class _CommandParser(argparse.ArgumentParser):
    """A parser whose epilog is made only when somebody reads it."""

    make_epilog = None

    def format_help(self) -> str:
        if self.make_epilog:
            self.epilog = self.make_epilog()
        return super().format_help()


class _Version(argparse.Action):
    """Prints the version."""

    def __init__(self, option_strings, dest):
        super().__init__(option_strings, dest, nargs=0, help="print the version")

    def __call__(self, parser, namespace, values, option_string=None):
        print(f"isonoise {__version__}")
        parser.exit()
