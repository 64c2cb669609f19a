"""Shared by the tests of `isonoise bench`: the command, a prepared scene, the documented fields of the JSON files."""

import re
from pathlib import Path

from small_scene import lamp_over_floor

from isonoise.benchmark.prepared_scene import MeasuredDevice, PreparedScene
from isonoise.cli import main
from isonoise.scene import compile_scene, load_description

CHECKOUT = Path(__file__).resolve().parent.parent


def run_isonoise(*arguments) -> int:
    """Exit code of a command, run in this process."""
    try:
        return main(list(arguments))
    except SystemExit as exit_:  # how argparse ends
        return exit_.code


def small_prepared_scene(pool_size: int = 64, samples: int = 400, **scene) -> PreparedScene:
    """`lamp_over_floor(**scene)`, ready to be measured."""
    compiled = compile_scene(load_description(lamp_over_floor(**scene)))
    return PreparedScene(compiled, MeasuredDevice(), samples, pool_size)


def json_fields(value, path: str = "") -> set[str]:
    """The fields of a JSON object as host/docs/benchmarks.md names them; spreads and plain lists are whole."""
    if isinstance(value, dict) and set(value) != {"median", "min", "max"} and not path.endswith("buffers_bytes"):
        return set().union(*(json_fields(item, f"{path}.{name}" if path else name) for name, item in value.items()))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(json_fields(item, f"{path}[]") for item in value))
    return {path}


def documented_fields() -> tuple[set[str], ...]:
    """Fields of `isonoise bench`, and of it with --versus, --peers and --specialisation; the first table is of all."""
    text = (CHECKOUT / "host" / "docs" / "benchmarks.md").read_text()
    tables = text.split("| field | what it is |")[1:]
    rows = [re.findall(r"^\| (`.*?) \|", table.split("\n\n")[0], re.MULTILINE) for table in tables]
    common, *others = (set(re.findall(r"`([^`]+)`", " ".join(names))) for names in rows)
    return tuple(common | fields for fields in others)
