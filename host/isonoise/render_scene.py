"""`isonoise.render`: a scene in, an image with its statistics out."""

from isonoise.loop import render_loop
from isonoise.outcome import Outcome
from isonoise.renderer import Renderer
from isonoise.stops import Stops


def render(
    scene,
    spp: float | None = None,
    time: float | None = None,
    error: float | None = None,
    quantile: float = 0.99,
    confidence: float = 0.95,
    **options,
) -> Outcome:
    """Render a scene until a limit is reached.

    Parameters
    ----------
    scene : str, path or dict
        As for `Renderer`.
    spp, time, error, quantile, confidence
        As for `Stops`. Without spp, time and error the scene's sample_count is the limit.
    **options
        Further parameters of `Renderer`, such as `strategy`, `seed` and `size`.

    Returns
    -------
    Outcome
        Image, statistics and log.

    Raises
    ------
    UserError
        As for `Renderer` and `Stops`.

    Examples
    --------
    >>> outcome = isonoise.render("cornell", spp=32, size=(64, 48), strategy="pooled:window=7")
    >>> outcome.reason, outcome.rgb.shape, len(outcome.rows)
    ('spp', (48, 64, 3), 9)
    """
    with Renderer(scene, **options) as renderer:
        if spp is None and time is None and error is None:
            spp = float(renderer.scene.sample_count)
        return render_loop(renderer, Stops(spp, time, error, quantile, confidence))
