"""`isonoise.render`: a scene in, an image with its statistics out."""

from __future__ import annotations  # `help` shows the names of types

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

from isonoise.argument_checks import check_callable, check_keywords
from isonoise.film.log import LogRow
from isonoise.loop import RenderLoop
from isonoise.outcome import Outcome
from isonoise.progress import RenderProgressBar
from isonoise.reference_image import Reference, check_reference_size, reference_image
from isonoise.renderer import Renderer
from isonoise.renderer_options import RendererOptions
from isonoise.scene.load_compiled import SceneSource
from isonoise.statistics import Statistics
from isonoise.stops import Stops

if TYPE_CHECKING:
    from typing_extensions import Unpack

OnProgress: TypeAlias = Callable[[float, int, float | None, float | None], object]
"""Called with elapsed seconds, samples, the last stated error and the estimated seconds left."""


def render(
    scene: SceneSource,
    spp: float | None = None,
    time: float | None = None,
    error: float | None = None,
    quantile: float = 0.99,
    confidence: float = 0.95,
    reference: Reference | None = None,
    on_wave: Callable[[LogRow, Statistics], object] | None = None,
    progress: bool | OnProgress | None = None,
    **options: Unpack[RendererOptions],
) -> Outcome:
    """Render a scene until a limit is reached.

    Parameters
    ----------
    scene : str, path, dict, Scene or CompiledScene
        As for `Renderer`.
    spp, time, error : float or None
        Limits: mean samples per pixel, seconds, relative error at `quantile`, such as 0.02 (`Stops`). The first one
        reached ends the render. Without any, the scene's sample_count is the limit of spp.
    quantile, confidence : float
        Of `error`: quantile over the pixels, and the probability that the true error is below it (`Stops`).
    reference : path, array, pair or Outcome
        A converged image, with which `rows` hold true errors: an .exr file, linear RGB (height, width, 3), a pair of
        linear RGB and its standard error (or None), or an outcome of `render`.
    on_wave : callable or None
        Called after every wave with its `LogRow` and the `Statistics`. What it returns is ignored. The clock of `time`
        stands still meanwhile.
    progress : None, bool or callable
        None or True: a progress bar, if standard error is a terminal or in a notebook. False: none. A function is
        called a few times per second with elapsed seconds, samples, the last stated error and the estimated seconds
        left; the last two are None while unknown.
    **options
        Further parameters of `Renderer`, such as `strategy`, `seed` and `size`.

    Returns
    -------
    Outcome : image, statistics and log

    Raises
    ------
    UserError : if an argument is wrong, and as for `Renderer`

    Examples
    --------
    >>> outcome = isonoise.render("cornell", spp=32, size=(64, 48), strategy="pooled:window=7")
    >>> outcome.reason, outcome.rgb.shape, len(outcome.rows)
    ('spp', (48, 64, 3), 9)

    >>> def show(row, statistics):
    ...     print(row.wave, statistics.samples, row.true.p99 < 1)
    >>> outcome = isonoise.render("cornell", spp=16, size=(64, 48), reference=outcome, on_wave=show)
    1 49152 True
    """
    check_keywords(options, render, Renderer)
    is_free = spp is None and time is None and error is None
    stops = Stops(1 if is_free else spp, time, error, quantile, confidence)
    on_wave = None if on_wave is None else check_callable("on_wave", on_wave)
    image = None if reference is None else reference_image(reference)
    with contextlib.ExitStack() as stack:
        on_progress = _show_progress(progress, options, stack)
        renderer = stack.enter_context(Renderer(scene, **options))
        if image is not None:
            check_reference_size(image, (renderer.scene.height, renderer.scene.width))
        if is_free:
            stops = replace(stops, spp=renderer.scene.sample_count)
        return RenderLoop(renderer, stops, on_wave=on_wave, on_progress=on_progress, reference=image).run()


def _show_progress(
    progress: bool | OnProgress | None, options: RendererOptions, stack: contextlib.ExitStack
) -> OnProgress | None:
    """What shows the progress of the loop; a bar, which also shows that of the set-up, is closed with the stack."""
    if progress is False:
        return None
    if progress is not None and not isinstance(progress, bool):
        check_callable("progress", progress)
        return progress
    bar: RenderProgressBar = stack.enter_context(RenderProgressBar("loading"))

    def show_compilation(renderer: Renderer, program: str, done: int, total: int) -> None:
        if program:
            bar.show_compilation(program, done, total)

    options.setdefault("on_compile", show_compilation)
    return bar.update
