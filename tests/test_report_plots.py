"""Plots of a comparison's report: what they show, their ticks and labels, their files."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from simulated_comparison import SNAPSHOTS, make_comparison

pytest.importorskip("matplotlib", reason="matplotlib is in the extra 'compare'")
pytest.importorskip("jinja2", reason="jinja2 is in the extra 'compare'")

from isonoise.comparison.report import figure_files
from isonoise.comparison.report.axes import set_log_scale, tick_number, tick_percent
from isonoise.comparison.report.calibration import calibration_plot
from isonoise.comparison.report.plots import ABSCISSAE, QUANTITIES, break_name, curve_lines, spread_apart
from isonoise.comparison.report.scene_section import figures as figures_of
from isonoise.comparison.report.wave_series import QUANTILES, read_wave_series
from isonoise.comparison.results import Results
from isonoise.comparison.summary import summarise

LONG = "relative-median:kappa=inf,batch=1,literal=true"
STRATEGIES = {"uniform": np.ones_like, "relative-median": lambda v: v, LONG: np.sqrt}
EFFICIENCY = next(quantity for quantity in QUANTITIES if quantity.is_efficiency)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_comparison(tmp_path_factory.mktemp("folder") / "out", ["a"], STRATEGIES, (1, 2, 3), warm_up_spp=4)


@pytest.fixture(scope="module")
def series(folder):
    runs = Results(folder).runs(Results(folder).plan.scenes[0])
    return {slug: read_wave_series(list(by_seed.values())) for slug, by_seed in runs.items()}


@pytest.fixture(scope="module")
def summary(folder):
    return summarise(folder)


@pytest.fixture(scope="module")
def figures(summary, series):
    with figure_files.figure_settings():
        drawn = dict(figures_of(summary, summary["scenes"][0], series))
        for figure in drawn.values():
            figure.draw_without_rendering()
        yield drawn


def test_series_are_those_of_the_waves(series):
    """The simulated waves end at 4 s / 2^k with 64 spp / 2^k; stated errors are 0.98 times the true ones."""
    waves = series["uniform"]
    share = 2.0 ** np.arange(1 - SNAPSHOTS, 1)
    np.testing.assert_allclose(waves.elapsed_s, 4 * share)
    np.testing.assert_allclose(waves.spp, 64 * share)
    np.testing.assert_allclose(waves.spp_at([1.0, 2.0**0.5, 3.0]), [16, 16 * 2**0.5, 48])
    assert waves.spp[waves.first] == 4
    for quantile in QUANTILES:  # the reference's own error changes a true error by 1e-4
        np.testing.assert_allclose(waves.stated[quantile], 0.98 * waves.true[quantile], rtol=1e-3)


def test_runs_may_have_different_waves():
    def run(scale, count):
        names = (
            "spp",
            "elapsed_s",
            *(f"{kind}_{q}{end}" for q in QUANTILES for kind, end in (("stated", ""), ("true", "_corrected"))),
        )
        rows = [dict.fromkeys(names, scale * (k + 1)) for k in range(count)]
        return type("Run", (), {"rows": rows, "facts": {"warm_up_spp": None}})

    waves = read_wave_series([run(1, 2), run(4, 3)])
    assert waves.spp.tolist() == [2.5, 5]
    assert waves.true["p50"].tolist() == pytest.approx([2, 4])  # geometric means of 1 and 4, 2 and 8
    assert waves.spp_at([12]) == pytest.approx([7])  # 2, its last, and 12


@pytest.mark.parametrize("abscissa", ABSCISSAE)
def test_efficiency_is_one_over_error_and_cost(summary, series, abscissa):
    scene = summary["scenes"][0]
    errors, start = curve_lines(scene, series, QUANTITIES[1], abscissa)
    efficiencies, _ = curve_lines(scene, series, EFFICIENCY, abscissa)
    for error, efficiency in zip(errors, efficiencies, strict=True):
        np.testing.assert_array_equal(error.x, efficiency.x)
        np.testing.assert_allclose(efficiency.y * error.y * error.x, 1)
        np.testing.assert_allclose(efficiency.low * error.high * error.x, 1)
    assert start == {"time": 0.25, "spp": 4}[abscissa]  # the end of the warm-up


def test_axes_begin_after_the_warm_up(figures):
    for name, figure in figures.items():
        if "calibration" not in name:
            low, high = figure.axes[0].get_xlim()
            first, last = (4, 64) if name.endswith("spp") else (0.25, 4)
            assert 0.8 * first < low < first
            assert last < high < 1.2 * last
    below = figures["a-calibration"].axes[3]
    assert below.get_xlim()[0] > 3


def test_strategies_without_stated_errors_are_not_calibrated(summary, series):
    """As Mitsuba's."""
    scene = summary["scenes"][0]
    silent = {slug: replace(waves, stated={q: np.full(6, np.nan) for q in QUANTILES}) for slug, waves in series.items()}
    assert not [name for name, _ in figures_of(summary, scene, silent) if "calibration" in name]
    figure = calibration_plot(summary, scene, {**silent, "uniform": series["uniform"]})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["uniform"]


def test_no_label_is_clipped(figures):
    for name, figure in figures.items():
        renderer = figure._get_renderer()
        texts = figure.findobj(
            lambda artist: hasattr(artist, "get_text") and artist.get_text() and artist.get_visible()
        )
        assert len(texts) > 8
        for text in texts:
            box = text.get_window_extent(renderer)
            within = (
                figure.bbox.x0 <= box.x0
                and box.x1 <= figure.bbox.x1
                and figure.bbox.y0 <= box.y0
                and box.y1 <= figure.bbox.y1
            )
            assert within, (name, text.get_text())


def test_names_beside_lines_do_not_overlap(figures):
    figure = figures["a-rms-p99"]
    boxes = sorted((text.get_window_extent() for text in figure.axes[0].texts), key=lambda box: box.y0)
    assert len(boxes) == len(STRATEGIES)
    assert all(below.y1 <= above.y0 for below, above in itertools.pairwise(boxes))


def test_long_names_are_broken_after_commas():
    assert break_name("uniform") == "uniform"
    lines = break_name(LONG).split("\n")
    assert "".join(lines) == LONG
    assert len(lines) == 2
    assert lines[0][-1] in ":,"


@pytest.mark.parametrize(("low", "high"), [(1e-7, 3e5), (0.5, 60), (0.21, 1.4), (0.98, 1.06), (1.0, 1.0001), (2, 2)])
def test_axes_have_distinct_ticks(low, high):
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    set_log_scale(axes, "y", low, high, tick_number)
    bottom, top = axes.get_ylim()
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert bottom < low <= high < top
    assert len(labels) == len(set(labels)) >= 3
    assert all(bottom <= tick <= top for tick in axes.get_yticks())


def test_ticks_as_text():
    assert [tick_number(value) for value in (1, 0.05, 1.025, 1500, 2e-7)] == [
        "1",
        "0.05",
        "1.025",
        "1,500",
        "2.000e-07",
    ]
    assert [tick_percent(value) for value in (1, 0.05, 0.00025)] == ["100 %", "5 %", "0.025 %"]


def test_a_figure_is_written_as_png_svg_and_pdf(figures, tmp_path):
    """Twice the same figure gives the same bytes."""
    from PIL import Image

    for folder in ("once", "again"):
        (tmp_path / folder).mkdir()
        svg = figure_files.write_figure(tmp_path / folder / "plot", figures["a-efficiency"])
    files = sorted((tmp_path / "once").iterdir())
    assert [path.name for path in files] == ["plot.pdf", "plot.png", "plot.svg"]
    assert [path.read_bytes() for path in files] == [
        path.read_bytes() for path in sorted((tmp_path / "again").iterdir())
    ]
    assert b"/Type3" not in files[0].read_bytes()  # publishers want TrueType fonts
    assert Image.open(files[1]).width > 800
    assert files[2].read_text() == svg
    assert "<text" in svg
    inline = figure_files.page_svg(svg, "plot")
    assert inline.startswith("<svg")
    assert figure_files.INK not in inline


def test_overlapping_labels_are_moved_apart():
    assert spread_apart([0.1, 0.5, 0.9], 0.1) == [0.1, 0.5, 0.9]
    assert spread_apart([0.5, 0.5], 0.1) == pytest.approx([0.45, 0.55])
    assert spread_apart([0.0, 0.0, 0.0], 0.1) == pytest.approx([0.0, 0.1, 0.2])
    heights = np.sort(np.random.default_rng(1).beta(1, 8, 20))
    moved = np.array(spread_apart(heights, 0.04))
    assert (np.diff(moved) >= 0.04 - 1e-9).all()
    assert moved[0] >= 0
    assert moved[-1] <= 1
