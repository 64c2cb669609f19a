"""The options of `isonoise render`. `add_render` is called by `cli`."""

from isonoise import argument_types
from isonoise.commands import shared_options
from isonoise.layers import LAYERS
from isonoise.samplers import SAMPLERS

DEFAULT_TEV_ADDRESS = ("127.0.0.1", 14158)
"""Where tev listens unless its option --host says otherwise."""


def add_render(commands) -> None:
    render = commands.add_parser(
        "render",
        help="render a scene until an error, a time or a number of samples is reached",
        description="Render a scene. --spp, --time and --error can be combined: the first one reached ends the\n"
        "render. Without them the scene's own sample_count does. Ctrl-C ends a render and writes the image so far;\n"
        "a second Ctrl-C ends the process at once.",
    )
    render.epilog_name = "render_epilog"
    render.add_argument(
        "scene", metavar="SCENE", help="a scene file (.xml, .gltf, .glb, .obj, .ply, .stl, .pbrt) or a built-in scene"
    )
    shared_options.add_images(render)
    _add_layers(render)
    limits = render.add_argument_group("when to stop")
    limits.add_argument("--spp", metavar="N", type=argument_types.positive, help="mean samples per pixel")
    limits.add_argument(
        "--time", metavar="S", type=argument_types.positive, help="seconds of rendering, without set-up"
    )
    limits.add_argument(
        "--error",
        metavar="E",
        type=argument_types.relative_error,
        help="until the true relative error of a share --quantile of the pixels is below E, such as 2%% or 0.02, with "
        "--confidence, as far as the samples show: light that no sample has found is in no estimate",
    )
    limits.add_argument(
        "--quantile",
        metavar="Q",
        type=argument_types.quantile,
        help="quantile of the pixels' errors that --error limits (default: 0.99)",
    )
    limits.add_argument(
        "--confidence",
        metavar="C",
        type=argument_types.confidence,
        help="probability that --error ends no render too early, over all its waves (default: 0.95)",
    )
    settings = render.add_argument_group("how to render")
    settings.add_argument(
        "--strategy", metavar="NAME[:k=v,..]", help="how samples are distributed over the image; listed below"
    )
    settings.add_argument(
        "--sampler", choices=SAMPLERS, help="how random numbers are distributed (default: the scene's, else sobol)"
    )
    settings.add_argument("--seed", metavar="K", type=argument_types.seed, help="same seed, same image (default: 0)")
    shared_options.add_scene_overrides(settings)
    shared_options.add_scene_parameters(settings)
    shared_options.add_allow_outside(settings)
    shared_options.add_device(settings, several=True)
    shared_options.add_cluster(settings)
    shared_options.add_memory(settings)
    shared_options.add_view(render)
    _add_checkpoints(render)
    render.set_defaults(parameters=None)
    reports = render.add_argument_group("what to report")
    reports.add_argument("--reference", metavar="REF.exr", help="converged image, to report the true error as well")
    reports.add_argument("--log", metavar="LOG.csv", help="write one row per wave; columns are listed below")
    reports.add_argument(
        "--save-every",
        metavar="S",
        type=argument_types.interval,
        help="write the images every S seconds during the render, too",
    )
    shared_options.add_output(reports)
    _add_viewers(render)


def _add_layers(parser) -> None:
    parser.add_argument(
        "--layers",
        metavar="NAME,..",
        type=argument_types.names,
        help=f"further layers of .exr files, made from the same camera samples: {', '.join(LAYERS)}",
    )
    parser.add_argument(
        "--denoise",
        action="store_true",
        help="add the layer denoised, by Open Image Denoise, and show it in .png files; the stated error is that of "
        "the noisy image",
    )


def _add_viewers(parser) -> None:
    viewers = parser.add_argument_group("how to watch the render")
    viewers.add_argument(
        "--preview",
        metavar="HOST:PORT",
        type=argument_types.address,
        nargs="?",
        const=DEFAULT_TEV_ADDRESS,
        help="show image, samples and error in the viewer tev, which has to run "
        f"(without an address: {':'.join(map(str, DEFAULT_TEV_ADDRESS))})",
    )
    viewers.add_argument(
        "--serve",
        metavar="PORT",
        type=argument_types.port,
        nargs="?",
        const=0,
        help="show the render on a web page of this machine, which can pause and end it; its address is printed "
        "(without PORT: a free one)",
    )


def _add_checkpoints(parser) -> None:
    checkpoints = parser.add_argument_group("checkpoints")
    checkpoints.add_argument(
        "--checkpoint", metavar="FILE", help="write all that is needed to continue, during the render and at its end"
    )
    checkpoints.add_argument(
        "--checkpoint-every",
        metavar="S",
        type=argument_types.interval,
        default=300.0,
        help="seconds between checkpoints (default: 300)",
    )
    checkpoints.add_argument(
        "--resume",
        metavar="FILE",
        help="continue from this checkpoint, and write further ones to it unless --checkpoint names another file; "
        "options that are not given are those of the checkpoint, limits may be changed and count from the beginning. "
        "With the same FILE as --checkpoint a missing one is no error",
    )
