"""The command line: options and exit codes. Each command is a module of `isonoise.commands`.

Nothing slow is imported here, so that `isonoise --help` answers at once.
"""

import signal
import sys

from isonoise import __version__, argument_types
from isonoise.command_parser import CommandParser
from isonoise.commands import bench_options, compare_options, render_options, shared_options
from isonoise.run_command import run_command
from isonoise.signals import exit_code
from isonoise.standard_streams import safe_streams

SHELLS = ("bash", "zsh", "fish", "tcsh")
"""Shells that can complete the command line."""


def main(argv: list[str] | None = None) -> int:
    """Run the command in `argv` (default: the process's arguments); return the exit code."""
    try:
        with safe_streams() as output:
            return run_command(make_parser().parse_args(argv), output)
    except KeyboardInterrupt:  # before or after the command
        print("isonoise: interrupted", file=sys.stderr)
        return exit_code() or 128 + signal.SIGINT


def make_parser() -> CommandParser:
    """The parser of all commands."""
    parser = CommandParser(
        prog="isonoise",
        description="An OpenCL path tracer that measures the noise of every pixel and samples where it is needed.",
        epilog="`isonoise COMMAND --help` lists a command's options.",
    )
    parser.add_argument("--version", action="version", version=f"isonoise {__version__}", help="print the version")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=CommandParser)
    for add_command in (
        render_options.add_render, _add_merge, _add_convert, compare_options.add_compare, _add_bench, _add_selftest,
        _add_devices, _add_plugins, _add_formats, _add_info, _add_completion,
    ):  # fmt: skip
        add_command(commands)
    return parser


def _add_merge(commands) -> None:
    merge = commands.add_parser(
        "merge",
        help="add renders of one scene with different seeds, from their checkpoints",
        description="Add renders of the same scene, size and depth with different seeds, for example from several\n"
        "machines. Strategies, samplers, devices and numbers of samples may differ.",
        epilog="exit codes: 0 done; 2 bad input, or the renders do not belong together",
    )
    merge.add_argument(
        "checkpoints", metavar="CHECKPOINT", nargs="+", help="files of `isonoise render --checkpoint`, or merged ones"
    )
    shared_options.add_images(merge)
    merge.add_argument("--checkpoint", metavar="FILE", help="write the merged state, to merge it with further renders")
    shared_options.add_device(merge)
    shared_options.add_output(merge)


def _add_bench(commands) -> None:
    bench = commands.add_parser(
        "bench",
        help="measure how fast scenes render, kernel by kernel",
        description="Measure samples per second, start-up time, and the time of every kernel and bounce. Every run\n"
        "traces the same samples. Runs without OpenCL profiling (for samples per second) alternate with runs\n"
        "with it (for kernels). Keep the machine idle meanwhile.",
    )
    bench.epilog_name = "bench_epilog"
    bench.add_argument("scenes", metavar="SCENE", nargs="*", help="a scene file, a built-in scene, or one listed below")
    subjects = bench.add_argument_group("what to measure")
    subjects.add_argument(
        "--repeat", metavar="N", type=argument_types.count, default=5, help="runs of each kind (default: %(default)s)"
    )
    subjects.add_argument(
        "--spp", metavar="N", type=argument_types.positive, help="samples per pixel of a run; see below"
    )
    shared_options.add_scene_overrides(subjects)
    shared_options.add_allow_outside(subjects)
    shared_options.add_device(subjects)
    bench_options.add_modes(subjects)
    bench_options.add_results(bench)


def _add_selftest(commands) -> None:
    selftest = commands.add_parser(
        "selftest",
        help="check numerical accuracy on a device",
        description="Check statistics, allocation, geometry, light transport and adaptive rendering with numerically\n"
        "difficult inputs. A case compares a number from the device with a closed form or a float64 result.",
        epilog="exit codes: 0 all passed; 1 a case failed; 2 bad input; 70 internal error; 130 after Ctrl-C",
    )
    shared_options.add_device(selftest)
    shared_options.add_json_file(selftest, "host/docs/numerics.md")
    shared_options.add_quiet(selftest)
    selftest.add_argument(
        "--thorough",
        action="store_true",
        help="trace 10^8 rays at edges and vertices instead of 2 million; takes minutes",
    )


def _add_devices(commands) -> None:
    devices = commands.add_parser(
        "devices",
        help="list the OpenCL devices and the default one",
        description="List the OpenCL devices and the default one.",
    )
    shared_options.add_output(devices)


def _add_plugins(commands) -> None:
    plugins = commands.add_parser(
        "plugins",
        help="list the supported Mitsuba 3 plugins, or the parameters of one",
        description="List Mitsuba 3's plugins by kind: supported, ignored (they cannot change the image), or not\n"
        "supported and why. With the name of a plugin: its parameters.",
    )
    plugins.add_argument(
        "name", metavar="KIND|NAME", nargs="?", help="a kind such as bsdf, or a plugin such as plastic"
    )
    shared_options.add_output(plugins, "print the same as JSON, with all parameters")


def _add_formats(commands) -> None:
    formats = commands.add_parser(
        "formats",
        help="list what is supported of glTF, OBJ, PLY, STL and pbrt files",
        description="List what is supported of the formats other than Mitsuba 3 XML. With a format: what its features\n"
        "become, and what is missing.",
    )
    formats.add_argument("name", metavar="FORMAT", nargs="?", help="a file extension, such as obj")
    shared_options.add_output(formats)


def _add_info(commands) -> None:
    info = commands.add_parser(
        "info",
        help="show what a scene, an image or a checkpoint holds, and the memory that a render takes",
        description="For a scene: what its file has, what becomes of it, what is left out, and the memory that a\n"
        "render takes.\n"
        "For an .exr file: its layers and the settings it was rendered with. For a checkpoint: its render and arrays.",
    )
    info.add_argument("source", metavar="SCENE|OUT.exr|CHECKPOINT", help="a scene, an image, or a file of --checkpoint")
    shared_options.add_size(info)
    shared_options.add_scene_parameters(info)
    shared_options.add_allow_outside(info)
    shared_options.add_device(info)
    shared_options.add_view(info)
    shared_options.add_output(info)
    info.add_argument("--features", action="store_true", help="list what is compiled into kernels, and what it costs")


def _add_convert(commands) -> None:
    convert = commands.add_parser(
        "convert",
        help="write a scene as Mitsuba 3 XML",
        description="Write a scene of any format as a Mitsuba 3 XML file. Its meshes (PLY) and images go to a folder\n"
        "OUT_files beside it. Existing files with these names are replaced.",
    )
    convert.add_argument("scene", metavar="IN", help="a scene file or a built-in scene")
    convert.add_argument("output", metavar="OUT.xml", help="the file to write")
    shared_options.add_size(convert)
    shared_options.add_scene_parameters(convert)
    shared_options.add_allow_outside(convert)
    shared_options.add_view(convert)
    shared_options.add_output(convert)


def _add_completion(commands) -> None:
    completion = commands.add_parser(
        "completion",
        help="print a script with which a shell completes commands, options and file names",
        description="Print a script with which a shell completes commands, options and file names. For bash:\n"
        "  isonoise completion bash > ~/.local/share/bash-completion/completions/isonoise\n"
        "For zsh, into a folder of $fpath:\n"
        "  isonoise completion zsh > _isonoise",
    )
    completion.add_argument("shell", metavar="SHELL", choices=SHELLS, help=f"one of {', '.join(SHELLS)}")
    completion.set_defaults(make_parser=make_parser)
