"""The section of a scene in the report: table, image viewer, crops, plots, maps; called by `page`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.metric_columns import format_number, format_percent
from isonoise.comparison.report import figure_files, map_grids, plots
from isonoise.comparison.report.calibration import calibration_plot
from isonoise.comparison.report.map_grids import data_uri, grid_values, map_png, png_bytes
from isonoise.comparison.report.regions import Region, worst_regions
from isonoise.comparison.report.strategy_images import StrategyImages, read_strategy_images
from isonoise.comparison.report.viewer_data import viewer_json
from isonoise.comparison.report.wave_series import WaveSeries, read_wave_series
from isonoise.comparison.report_tables import scene_table, single_image_table
from isonoise.comparison.results import Results
from isonoise.film.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP_SIDE = 256
"""Maximum side of a map or picture in the page, in pixels; the viewer has larger ones."""


def scene_section(results: Results, summary: Mapping, scene: Mapping, factor: int) -> dict:
    """A scene for the template; also writes its plots and maps to plots/.

    `scene` is one of `summary`, `factor` the reduction of the viewer's images (`viewer_factor`).
    """
    from markupsafe import Markup
    from PIL import Image

    from isonoise.film.png import automatic_exposure, tone_map

    slug = scene["slug"]
    folder = results.directory / "plots"
    reference = results.reference(results.plan.scene(slug)).rgb
    exposure = automatic_exposure(np.maximum(reference, 0))
    picture = Image.fromarray(tone_map(reference))
    write_atomically(folder / f"{slug}-reference.png", lambda temporary: picture.save(temporary, format="PNG"))
    curves = []
    for name, figure in figures(summary, scene, _series(results, scene)):
        svg = figure_files.write_figure(folder / name, figure)
        curves.append(Markup(figure_files.page_svg(svg, name)))
    images = read_strategy_images(results, summary, scene)
    grids = {
        "samples": map_grids.sample_maps({image.title: image.count for image in images}),
        "error": map_grids.error_maps({image.title: image.rms for image in images}),
    }
    seed = scene["seeds"][0]
    captions = {
        "samples": (f"samples per pixel, seed {seed}", format_number, "samples"),
        "error": ("RMS relative error over the seeds", format_percent, "errors"),
    }
    for name, grid in grids.items():
        caption, form, file = captions[name]
        figure_files.write_png(folder / f"{slug}-{file}.png", map_grids.grid_figure(grid, caption, form))
    regions = worst_regions([image.rms for image in images])
    picture.thumbnail((2 * MAP_SIDE, 2 * MAP_SIDE))
    return {
        "slug": slug,
        "table": scene_table(summary, scene),
        "single_images": single_image_table(summary, scene),
        "reference": data_uri(png_bytes(picture)),
        "curves": curves,
        "grids": {name: grid_values(grid, *captions[name][:2], MAP_SIDE) for name, grid in grids.items()},
        "seed": seed,
        "factor": factor,
        "viewer": Markup(viewer_json(reference, images, grids, factor)),
        "pictures": [(image.title, _picture(map_grids.shrink(image.rgb, MAP_SIDE), exposure)) for image in images],
        "size": (scene["width"], scene["height"]),
        "regions": [_region(region, reference, images, exposure, grids["error"]) for region in regions],
    }


def figures(summary: Mapping, scene: Mapping, series: Mapping[str, WaveSeries]) -> "Iterator[tuple[str, Figure]]":
    """The plots of a scene, each with the name of its files."""
    slug = scene["slug"]
    for quantity in plots.QUANTITIES:
        for abscissa in plots.ABSCISSAE:
            name = f"{slug}-{quantity.name}" + ("" if abscissa == "time" else f"-{abscissa}")
            yield name, plots.curve_plot(summary, scene, series, quantity, abscissa)
    if any(waves.has_stated_errors for waves in series.values()):
        yield f"{slug}-calibration", calibration_plot(summary, scene, series)


def _series(results: Results, scene: Mapping) -> dict[str, WaveSeries]:
    runs_of_strategies = results.runs(results.plan.scene(scene["slug"]))
    return {
        strategy: read_wave_series([runs[seed] for seed in scene["seeds"]])
        for strategy, runs in runs_of_strategies.items()
    }


def _region(
    region: Region,
    reference: np.ndarray,
    images: Sequence[StrategyImages],
    exposure: float,
    errors: map_grids.MapGrid,
) -> dict:
    """A region for the template: crops of the reference and of all strategies, with their errors."""
    crops = [{"title": "reference", "picture": _picture(region.crop(reference), exposure), "error": None}]
    for image in images:
        error = np.abs(region.crop(image.error), dtype=np.float64)
        crops.append(
            {
                "title": image.title,
                "picture": _picture(region.crop(image.rgb), exposure),
                "error": data_uri(map_png(map_grids.Map(image.title, error), errors, region.side)),
                "rms": float(np.sqrt(np.square(error).mean())),
                "spp": float(region.crop(image.count).mean()),
            }
        )
    return {"x": region.x, "y": region.y, "side": region.side, "crops": crops}


def _picture(rgb: np.ndarray, exposure: float) -> str:
    """Linear RGB as the address of a tone-mapped image."""
    from PIL import Image

    from isonoise.film.png import tone_map

    return data_uri(png_bytes(Image.fromarray(tone_map(rgb, exposure))))
