"""`isonoise convert`: writes a scene as Mitsuba 3 XML."""

import argparse
import warnings

from isonoise.command_output import print_json
from isonoise.commands import EXIT_DONE
from isonoise.convert.convert import convert
from isonoise.convert.scaling import SCALING_REASON
from isonoise.scene.view import view_of


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code. Raises UserError if the scene cannot be read or written."""
    view, parameters = view_of(options), dict(options.parameters)
    converted = convert(options.scene, options.output, parameters, options.allow_outside, view, options.size)
    for text in converted.report.warnings() if converted.report else ():
        warnings.warn(text, stacklevel=1)
    files = converted.files
    if options.json:
        print_json({"output": options.output, "files": list(map(str, files)), "scale": converted.scale})
        return EXIT_DONE
    beside = f", {len(files)} file{'s' * (len(files) > 1)} in {files[0].parent.name}/" if files else ""
    print(f"written: {options.output}{beside}")
    if converted.scale != 1:
        print(f"lengths times {converted.scale:g}: {SCALING_REASON}")
    return EXIT_DONE
