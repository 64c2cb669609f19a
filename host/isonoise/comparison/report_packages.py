"""Which packages a comparison needs beside those of isonoise; called by the command and by `compare`."""

import importlib.util

from isonoise.comparison.request import Request
from isonoise.comparison.strategy_specs import MITSUBA_SAMPLERS
from isonoise.errors import UserError

REPORT_PACKAGES = ("matplotlib", "jinja2")


def check_packages(request: Request) -> None:
    """Raises UserError if the report, or a strategy, needs a package that is not installed."""
    missing = [name for name in REPORT_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(f"the report needs {' and '.join(missing)}: pip install 'isonoise[compare]'")
    specs = {strategy.spec for strategy in request.strategies}
    if specs & set(MITSUBA_SAMPLERS) and importlib.util.find_spec("mitsuba") is None:
        raise UserError(f"{' and '.join(MITSUBA_SAMPLERS)} need Mitsuba 3: pip install 'isonoise[peers]'")
