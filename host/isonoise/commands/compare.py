"""`isonoise compare`: check what can be checked, render what is missing, make tables, plots and report."""

import argparse
import importlib.util
import signal
import sys
from pathlib import Path

from isonoise.commands import EXIT_DONE
from isonoise.comparison.plan import Plan, Request, additions, differences, make_plan, read_plan, write_plan
from isonoise.comparison.presets import PRESETS
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS, needs_variance, split_specs, with_variance
from isonoise.errors import UserError
from isonoise.film.files import check_writable, remove_temporary_files

DEFAULT_TIME = 10.0
"""Seconds of a run."""
DEFAULT_SEEDS = 8
REPORT_PACKAGES = ("matplotlib", "jinja2")


def run(options: argparse.Namespace) -> int:
    """Compare as the options say; returns the exit code. Raises UserError for what is the user's to mend."""
    request = _request(options)
    _check_packages(request)
    directory = Path(options.output)
    stored = read_plan(directory)
    plan = make_plan(request, stored)
    if any(needs_variance(strategy.spec) for strategy in plan.strategies):
        with_variance("oracle", directory.resolve())
    _begin(directory, stored, plan)

    from isonoise.comparison.runner import run_plan

    code = EXIT_DONE
    try:
        run_plan(plan, directory.resolve(), options.device, _say)
    except KeyboardInterrupt:
        code = 128 + signal.SIGINT
        print(
            "isonoise: interrupted; what is finished is kept, and the same command goes on from there", file=sys.stderr
        )
        if not any((directory / "runs").glob("*/*/[0-9]*.npz")):
            return code
    from isonoise.comparison.report import write_report
    from isonoise.comparison.summary import summary_text

    write_report(directory)
    _say(summary_text(directory))
    _say(f"report  {directory / 'report.html'}")
    return code


def _request(options: argparse.Namespace) -> Request:
    """The preset's pieces, each replaced by the option that was given."""
    if options.preset and options.preset not in PRESETS:
        raise UserError(f"there is no preset '{options.preset}'; known are {', '.join(PRESETS)}")
    preset = PRESETS[options.preset] if options.preset else None
    strategies = [spec for text in options.strategies for spec in split_specs(text)]
    if not preset and not options.scenes:
        raise UserError("nothing to compare: name a SCENE, or a --preset")
    if not preset and not strategies:
        raise UserError("nothing to compare: name the --strategies, or a --preset")
    time = options.time
    if time is None and options.spp is None:
        time = preset.time if preset else DEFAULT_TIME
    return Request(
        scenes=options.scenes or preset.scenes,
        strategies=strategies or preset.strategies,
        first_seed=options.seed,
        seeds=options.seeds or (preset.seeds if preset else DEFAULT_SEEDS),
        time=time,
        spp=options.spp,
        size=options.size,
        max_depth=options.max_depth,
        device=options.device,
        references=options.reference,
        reference_time=options.reference_time,
        preset=options.preset,
    )


def _check_packages(request: Request) -> None:
    missing = [name for name in REPORT_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(f"the report needs {' and '.join(missing)}: pip install 'isonoise[compare]'")
    if set(request.strategies) & set(MITSUBA_SAMPLERS) and importlib.util.find_spec("mitsuba") is None:
        raise UserError(f"{' and '.join(MITSUBA_SAMPLERS)} need Mitsuba 3: pip install 'isonoise[peers]'")


def _begin(directory: Path, stored: Plan | None, plan: Plan) -> None:
    """Make the folder and write the plan, unless another comparison was begun there."""
    if stored is None:
        try:
            (directory / "references").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot write into '{directory}': {error.strerror}") from error
        check_writable(directory / "plan.json")
    else:
        found = differences(stored, plan)
        if found:
            raise UserError(
                f"'{directory}' holds another comparison: {'; '.join(found)}. Name the same, or more scenes, "
                "strategies and seeds, to go on with it; or choose another folder with -o"
            )
        added = additions(stored, plan)
        _say(f"going on in {directory}" + (f", with more: {', '.join(added)}" if added else ""))
    remove_temporary_files(directory)
    write_plan(directory, plan)


def _say(text: str) -> None:
    print(text, flush=True)
