"""An experiment: a comparison for each of its budgets and devices; made by the command, `experiment_file` and `api`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from isonoise.comparison.request import Request
from isonoise.errors import UserError


@dataclass(frozen=True)
class Member:
    """A comparison of an experiment.

    Attributes
    ----------
    folder : str
        Below the experiment's folder; empty if it is the only one.
    device, budget : str
        For tables; empty if all have the same.
    request : Request
        What it is asked to do.
    shares_with : str
        Folder of the member whose references it uses; itself if it renders them.
    """

    folder: str
    device: str
    budget: str
    request: Request
    shares_with: str


def members(request: Request, times: Sequence[float], spps: Sequence[float], devices: Sequence[str]) -> list[Member]:
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
    # the reference for the largest budget serves for all
    budgets = [(f"spp-{n:g}", f"{n:g} spp", {"spp": n}) for n in sorted(spps, reverse=True)]
    budgets += [(f"time-{s:g}", f"{s:g} s", {"time": s}) for s in sorted(times, reverse=True)]
    found = []
    for device in devices or [request.device]:
        prefix = f"device-{device}" if len(devices) > 1 else ""
        folders = [_join(prefix, name if len(budgets) > 1 else "") for name, _, _ in budgets]
        found += [
            Member(
                folder,
                f"device {device}" if prefix else "",
                label if len(budgets) > 1 else "",
                replace(request, device=device, **budget),
                folders[0],
            )
            for folder, (_, label, budget) in zip(folders, budgets, strict=True)
        ]
    return found


def _join(*names: str) -> str:
    return "/".join(name.replace("/", "-").replace(":", "-") for name in names if name)
