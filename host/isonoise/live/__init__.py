"""What is shown of a render while it runs: a web page on loopback, and the viewer tev."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from isonoise.errors import UserError

if TYPE_CHECKING:
    from isonoise.live.live_page import LivePage
    from isonoise.loop import RenderLoop


def serve(
    title: str = "isonoise",
    port: int = 0,
    save: "Callable[[RenderLoop], Sequence[str]] | None" = None,
    stops: float = 0.0,
) -> "LivePage":
    """Serve a page on loopback that shows a render while it runs, until its `close` or the end of a `with` block.

    Parameters
    ----------
    title : str
        What the page calls the render.
    port : int
        Where it listens; 0: a free port.
    save : callable or None
        Called with the `RenderLoop` when the user asks to save; returns the paths that were written. None: the page has
        no button for it.
    stops : float
        Exposure that the page begins with: a factor of 2 to this power.

    Raises
    ------
    UserError
        If the port cannot be used, or the package aiohttp is missing.

    Examples
    --------
    >>> with isonoise.live.serve("cornell") as page, isonoise.Renderer("cornell", size=(64, 48)) as renderer:
    ...     page.url[:17]
    ...     outcome = isonoise.render_loop(renderer, isonoise.Stops(spp=4), periodic=[page.periodic()])
    ...     page.show(outcome)
    'http://127.0.0.1:'
    """
    try:
        from isonoise.live.live_page import LivePage
    except ModuleNotFoundError as error:
        if error.name != "aiohttp":
            raise
        raise UserError("the live page needs aiohttp: pip install 'isonoise[live]'") from error
    return LivePage(title, port, save, stops)
