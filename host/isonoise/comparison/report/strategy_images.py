"""The images of a scene that the report shows: one seed of every strategy, with errors and samples."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from isonoise.comparison import metrics
from isonoise.comparison.report_tables import strategy_titles
from isonoise.comparison.results import Results


@dataclass(frozen=True)
class StrategyImages:
    """Images of a strategy, (height, width): those of the run with the first of the seeds, and `rms` over the seeds.

    `rgb` (height, width, 3) is float16, `error` the signed relative error (float16), `count` the samples, `rms` the
    root mean square of the errors of all seeds.
    """

    title: str
    rgb: np.ndarray
    error: np.ndarray
    count: np.ndarray
    rms: np.ndarray


def read_strategy_images(results: Results, summary: Mapping, scene: Mapping) -> list[StrategyImages]:
    """The images of all strategies of a scene of summary.json."""
    titles = strategy_titles(summary)
    images = []
    for strategy, runs in results.runs(results.plan.scene(scene["slug"])).items():
        final = np.stack([runs[seed].errors[-1] for seed in scene["seeds"]])
        first = runs[scene["seeds"][0]]
        images.append(StrategyImages(titles[strategy], first.rgb, final[0], first.count, metrics.rms_over_seeds(final)))
    return images
