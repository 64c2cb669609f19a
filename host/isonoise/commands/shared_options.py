"""Options that several commands have. Each function `add_*` adds some to a parser, called by `cli`."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from isonoise import argument_types
from isonoise.command_output import STANDARD_OUTPUT


def add_output(parser, json_help: str = "print the result as one JSON object") -> None:
    """--json and --quiet, which every command has."""
    parser.add_argument("--json", action="store_true", help=json_help)
    add_quiet(parser)


def add_json_file(parser, fields: str) -> None:
    """--json with a file, for commands with much to write; `fields` says where its fields are explained."""
    parser.add_argument(
        "--json",
        metavar="FILE",
        nargs="?",
        const=STANDARD_OUTPUT,
        help=f"write all figures to a file, or without FILE print them in place of the text; fields: {fields}",
    )


def add_quiet(parser) -> None:
    parser.add_argument(
        "-q", "--quiet", action="store_true", help="print no text and no progress; warnings and errors stay"
    )


def add_size(parser) -> None:
    parser.add_argument(
        "--size", metavar="WxH", type=argument_types.size, help="image size in pixels instead of the scene's"
    )


def add_view(parser) -> None:
    """The fields of `isonoise.View`."""
    view = parser.add_argument_group("what to see, in place of the scene's own camera and environment")
    view.add_argument(
        "--sensor",
        "--camera",
        dest="camera",
        metavar="NAME|N",
        help="a camera of the file, by its name or its number from 0",
    )
    view.add_argument(
        "--crop",
        metavar="X,Y,WxH",
        type=argument_types.crop_window,
        help="only this window of the image, W x H pixels from column X and row Y on; its pixels are those of the "
        "image",
    )
    view.add_argument(
        "--fov", metavar="DEG", type=argument_types.angle_of_view, help="horizontal angle of view, degrees"
    )
    view.add_argument(
        "--look-at",
        metavar="[X,Y,Z:]X,Y,Z",
        type=argument_types.look_at,
        help="turn the camera to a point; of two points, the first one is its new position",
    )
    view.add_argument(
        "--up",
        metavar="AXIS",
        type=argument_types.direction,
        help="direction that is up: x, y, z, -x, -y, -z, or X,Y,Z (default for models: y, for STL z)",
    )
    view.add_argument(
        "--env", metavar="FILE", help="an image in latitude-longitude format, .hdr or .exr, around the scene"
    )


def add_images(parser) -> None:
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT.exr",
        action="append",
        required=True,
        help=".exr: all layers, float32; .png: tone-mapped preview; may be given more than once",
    )
    parser.add_argument(
        "--exposure",
        metavar="EV",
        type=argument_types.stops,
        default=0.0,
        help="make .png files brighter by so many stops, each a factor of 2; less than 0: darker",
    )


def add_scene_overrides(parser) -> None:
    add_size(parser)
    parser.add_argument(
        "--max-depth",
        metavar="N",
        type=argument_types.max_depth,
        help="longest path instead of the scene's: 1 is emitters only, -1 no limit",
    )


def add_allow_outside(parser) -> None:
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="let the scene read files outside its folder: includes, meshes, images",
    )


def add_scene_parameters(parser) -> None:
    parser.add_argument(
        "-D",
        dest="parameters",
        metavar="name=value",
        type=argument_types.definition,
        action="append",
        default=[],
        help="set a <default> parameter of the scene file; may be given more than once",
    )


def add_memory(parser) -> None:
    parser.add_argument(
        "--memory",
        metavar="SIZE",
        type=argument_types.memory_size,
        help="most memory to take, such as 4G or 512M: on the device, on a CPU with the host's arrays of the image",
    )


def add_device(parser, several: bool = False) -> None:
    """Adds the option; `several`: the command takes more than one device."""
    more = "; several as D,D; D/N is device D split into N; all" if several else ""
    parser.add_argument(
        "--device",
        metavar="D",
        help="number or part of the name of a device of `isonoise devices`, or its type: gpu, cpu, accelerator"
        f"{more} (default: PYOPENCL_CTX if set, else the first)",
    )


def add_cluster(parser) -> None:
    cluster = parser.add_mutually_exclusive_group()
    cluster.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="render on the workers of the Dask scheduler at this address, such as tcp://10.0.0.1:8786; --device is "
        "that of each worker",
    )
    cluster.add_argument(
        "--workers",
        metavar="N",
        type=argument_types.count,
        help="render on N worker processes on this machine, one for each of the devices of --device; a CPU is split",
    )


@contextmanager
def cluster_of(options: argparse.Namespace) -> Iterator:
    """The `Cluster` that the options name, during the `with` block; None if they name none."""
    if options.dask is None and options.workers is None:
        yield None
        return
    from isonoise.distributed.cluster import Cluster

    if options.dask is not None:
        cluster = Cluster.connect(options.dask, options.device)
    else:
        cluster = Cluster.local(options.workers, options.device)
    with cluster:
        yield cluster
