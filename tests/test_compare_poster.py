"""The poster's figures, from runs with simulated errors."""

import base64
import dataclasses
import re
import shutil

import numpy as np
import pytest
from simulated_comparison import make_comparison

from isonoise.comparison.metrics import chi_square_quantile, ideal_uniformity
from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.presets import POSTER, PRESETS
from isonoise.comparison.summary import summarise
from isonoise.strategies.registry import DEFAULT_STRATEGY

pytest.importorskip("matplotlib", reason="matplotlib is in the extra 'compare'")
pytest.importorskip("jinja2", reason="jinja2 is in the extra 'compare'")

from matplotlib.figure import Figure

from isonoise.comparison.report import write_report
from isonoise.comparison.report.poster import DESIGNS, draw, poster_figures
from isonoise.comparison.results import Results

PRESET = PRESETS[POSTER]
SEEDS = range(1, 9)
NEEDED = {(design.scene, spec) for design in DESIGNS for spec in design.panels}


def make(directory, **more):
    """Runs of the figures, with samples in proportion to the variance except for `uniform`."""
    shares = {spec: np.ones_like if spec == "uniform" else lambda v: v for spec in PRESET.strategies}
    options = {"seeds": SEEDS, "shape": (40, 50), "wanted": NEEDED} | more
    folder = make_comparison(directory, PRESET.scenes, shares, **options)
    write_plan(folder, dataclasses.replace(read_plan(folder), preset=POSTER))
    return folder


@pytest.fixture(scope="module", autouse=True)
def no_plots_of_scenes():
    """Reports have the poster's figures only; test_compare_report.py tests the others, which take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isonoise.comparison.report.scene_section.figures", lambda summary, scene, series: [])
        patch.setattr("isonoise.comparison.report.map_grids.grid_figure", lambda grid, caption, form: Figure())
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make(tmp_path_factory.mktemp("poster") / "out")


@pytest.fixture(scope="module")
def summary(folder):
    return write_report(folder)


@pytest.fixture(scope="module")
def figures(folder, summary):
    return poster_figures(Results(folder), summary)


def runs_of(folder, scene, spec):
    results = Results(folder)
    slug = next(s.slug for s in results.plan.strategies if s.spec == spec)
    return list(results.runs(results.plan.scene(scene))[slug].values())


def test_the_preset_has_exactly_the_runs_of_the_figures():
    assert {(scene, spec) for scene in PRESET.scenes for spec in PRESET.strategies} >= NEEDED
    assert {spec for _, spec in NEEDED} == set(PRESET.strategies)


def test_maps_are_those_of_the_runs(folder, figures):
    spots, penumbra, _ = figures
    for k, spec in enumerate(spots.design.panels):
        runs = runs_of(folder, "bright-spots", spec)
        rms, samples = (row.grid.maps[k].values for row in spots.rows)
        np.testing.assert_allclose(rms**2, np.mean([run.errors[-1].astype(float) ** 2 for run in runs], axis=0))
        np.testing.assert_array_equal(samples, runs[0].count)
    for k, spec in enumerate(penumbra.design.panels):
        single = penumbra.rows[0].grid.maps[k].values
        np.testing.assert_array_equal(single, abs(runs_of(folder, "penumbra", spec)[0].errors[-1].astype(float)))


def test_captions_have_the_numbers_of_the_tables(folder, figures):
    text = (folder / "tables.md").read_text()
    for figure in figures:
        section = text[text.index(f"### {figure.design.scene}\n") :].split("### ")[1]
        lines = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in section.splitlines() if "|" in line]
        by_title = {cells[0].removesuffix("` †"): dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]}
        row = next(row for row in figure.rows if row.title.startswith("RMS"))
        for spec, under in zip(figure.design.panels, row.captions, strict=False):
            cells = [f"{head} {by_title[spec][head]}" for head in figure.design.heads]
            assert under == [re.sub(r" \([^)]*\u2013[^)]*\)", "", cell) for cell in cells]  # without intervals


def test_the_errors_of_a_figure_share_a_scale(figures):
    scales = [
        [(row.grid.low, row.grid.high, row.grid.colours) for row in figure.rows if "error" in row.title]
        for figure in figures
    ]
    assert [len(set(scale)) for scale in scales] == [1, 1, 1]
    assert len(scales[1]) == 2


def test_a_single_run_has_its_own_numbers(folder, figures):
    single = figures[1].rows[0]
    assert single.title == "error, seed 1"
    last = runs_of(folder, "penumbra", "uniform")[0].rows[-1]
    p99, worst = (float(re.search(r"([\d.]+) %", line)[1]) for line in single.captions[0])
    assert (p99, worst) == (
        pytest.approx(100 * last["true_p99"], rel=0.005),
        pytest.approx(100 * last["true_max"], 0.005),
    )


def test_the_map_of_equal_errors_is_simulated(figures, summary):
    """Quantiles of 2,000 simulated pixels: p50 within 5 standard errors (1.5 %), p99/p50 within 4 (3 % each)."""
    row = figures[2].rows[0]
    ideal = row.grid.maps[-1].values
    rows = {row["strategy"]: row for row in summary["scenes"][2]["rows"]}
    assert len(row.grid.maps) == len(figures[2].design.panels) + 1
    assert np.median(ideal) == pytest.approx(rows[DEFAULT_STRATEGY]["rms"]["p50"], rel=0.075)
    assert np.quantile(ideal, 0.99) / np.median(ideal) == pytest.approx(ideal_uniformity(8), rel=0.12)
    assert np.mean(ideal**2) == pytest.approx(np.median(ideal) ** 2 * 8 / chi_square_quantile(0.5, 8), rel=0.1)
    assert row.captions[-1][-1] == "p99/p50 1.65"


@pytest.mark.usefixtures("summary")
def test_figures_are_written_and_shown(folder):
    from PIL import Image

    page = (folder / "report.html").read_text()
    assert "Not shown" not in page
    for k, design in enumerate(DESIGNS, start=1):
        with Image.open(folder / "plots" / f"poster-{k}.png") as picture:
            assert picture.width > 800
        assert f"<h3>{design.title}</h3>" in page
    section = page[page.index('id="poster-figures"') : page.index('id="bright-spots"')]
    images = re.findall(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]+)">', section)
    assert len(images) == 2 * 4 + 2 * 5 + 6
    assert all(base64.b64decode(data)[:4] == b"\x89PNG" for data, _ in images)


def test_without_the_preset_there_are_no_figures(tmp_path):
    folder = make_comparison(tmp_path / "out", ["cornell"], {"uniform": np.ones_like}, seeds=[1, 2])
    write_report(folder)
    assert not list((folder / "plots").glob("poster*"))
    assert "poster" not in (folder / "report.html").read_text()


def test_missing_runs_are_named(tmp_path):
    folder = make(tmp_path / "out", seeds=[1, 2], shape=(12, 16))
    (folder / "plots").mkdir()
    (folder / "plots" / "poster-1.png").touch()  # a figure of earlier runs
    shutil.rmtree(folder / "runs" / "bright-spots" / "relative-median-kappa-inf-batch-1")
    shutil.rmtree(folder / "runs" / "bright-spots" / "relative-mean")
    shutil.rmtree(folder / "runs" / "penumbra")
    (folder / "runs" / "cornell" / "tsallis" / "1.npz").unlink()
    (folder / "runs" / "cornell" / "uniform" / "2.npz").unlink()
    found = poster_figures(Results(folder), write_report(folder))
    assert [figure.missing for figure in found] == [
        "no run of bright-spots is finished with relative-mean, relative-median:kappa=inf,batch=1",
        "no run of penumbra is finished",
        "no seed of cornell is finished with every strategy",
    ]
    assert not list((folder / "plots").glob("poster*"))
    page = (folder / "report.html").read_text()
    for figure in found:
        assert f"Not shown: {figure.missing}." in page


def test_a_single_seed_is_enough(tmp_path):
    folder = make(tmp_path / "out", seeds=[3], shape=(12, 16))
    for figure in poster_figures(Results(folder), summarise(folder)):
        assert [row.title for row in figure.rows if "RMS" in row.title] == ["RMS error, 1 seed"]
        draw(figure)
