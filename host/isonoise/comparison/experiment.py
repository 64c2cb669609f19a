"""An experiment: a comparison for each of its budgets and devices; made by the command, `experiment_file` and `api`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from isonoise.comparison.request import Request
from isonoise.errors import UserError


@dataclass(frozen=True, eq=False)
class Member:
    """A comparison of an experiment.

    Attributes
    ----------
    folder : str
        Below the experiment's folder; empty if it is the only one.
    device : str
        As for `select_device`; empty: the default.
    budget : float
        Of a run.
    unit : str
        Of the budget: `spp` or `s`.
    request : Request
        What it is asked to do.
    shares_with : str
        Folder of the member whose references it uses; its own if it renders them.
    """

    folder: str
    device: str
    budget: float
    unit: str
    request: Request
    shares_with: str


def make_members(
    request: Request, times: Sequence[float], spps: Sequence[float], devices: Sequence[str] = ()
) -> list[Member]:
    """The comparisons of an experiment, in the order in which they are rendered.

    Parameters
    ----------
    request : Request
        What they have in common.
    times, spps : sequence of float
        Budgets of a run: seconds, or samples per pixel. One of them is empty.
    devices : sequence of str
        As for `select_device`; empty: that of the request.

    Raises
    ------
    UserError
        If there are both kinds of budgets, or none.
    """
    if times and spps:
        raise UserError("time and spp are both given: a run has one budget")
    if not (times or spps):
        raise UserError("there is no budget: give time, the seconds of a run, or spp, its samples per pixel")
    key, unit = ("spp", "spp") if spps else ("time", "s")
    budgets = sorted(spps or times, reverse=True)  # the reference for the largest one serves for all
    found = []
    for device in devices or [request.device]:
        prefix = f"device-{device}" if len(devices) > 1 else ""
        folders = [_join(prefix, f"{key}-{budget:g}" if len(budgets) > 1 else "") for budget in budgets]
        for folder, budget in zip(folders, budgets, strict=True):
            member = replace(request, device=device, **{key: budget})
            found.append(Member(folder, device or "", budget, unit, member, folders[0]))
    return found


def _join(*names: str) -> str:
    return "/".join(re.sub(r"[^A-Za-z0-9.+-]+", "-", name) for name in names if name)
