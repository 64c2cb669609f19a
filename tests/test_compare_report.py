"""Tables, files and HTML page of a comparison, from runs with simulated errors."""

import base64
import io
import itertools
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from compare_command import compare, options
from simulated_comparison import make_comparison

from isonoise.comparison.metric_columns import format_number, format_percent
from isonoise.comparison.metrics import ideal_uniformity
from isonoise.comparison.plan import read_plan, write_plan
from isonoise.comparison.summary import summarise, summary_text, write_summary
from isonoise.errors import UserError

SCENES = ("bright", "dim")
STRATEGIES = {"uniform": np.ones_like, "relative-median": lambda v: v, "oracle:rule=sqrt": np.sqrt}
FILES = ("waves.csv", "runs.csv", "summary.json", "tables.md")


@pytest.fixture(scope="module", autouse=True)
def one_plot_per_scene():
    """Reports have one plot of each scene; test_report_plots.py tests all."""
    pytest.importorskip("matplotlib", reason="matplotlib is in the extra 'compare'")
    pytest.importorskip("jinja2", reason="jinja2 is in the extra 'compare'")
    from isonoise.comparison.report import scene_section

    def first(summary, scene, series, figures=scene_section.figures):
        return itertools.islice(figures(summary, scene, series), 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_section, "figures", first)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a finished comparison with its report."""
    from isonoise.comparison.report import write_report

    directory = make_comparison(
        tmp_path_factory.mktemp("folder") / "out", SCENES, STRATEGIES, seeds=range(1, 9), shape=(60, 80)
    )
    write_report(directory)
    return directory


@pytest.fixture(scope="module")
def rows(folder):
    summary = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)  # rejects NaN and Infinity
    return {row["strategy"]: row for row in summary["scenes"][0]["rows"]}


def test_figures_agree_with_the_simulated_errors(rows):
    variance = np.geomspace(0.04, 4, 80)  # the simulated variance varies by 6 % within a column
    uniform, deficit, root = rows["uniform"], rows["relative-median"], rows["oracle-rule-sqrt"]
    assert (uniform["spp"], uniform["elapsed_s"], uniform["device_s"]) == pytest.approx((64, 4, 3.88))
    assert uniform["rms"]["p50"] == pytest.approx(np.sqrt(np.median(variance) / 64), rel=0.1)
    assert deficit["uniformity"] == pytest.approx(ideal_uniformity(8), rel=0.05)
    assert uniform["uniformity"] > 3
    bound = np.mean(np.sqrt(variance)) ** 2 / variance.mean()
    ratio = root["rel_mse_ratio"]
    assert ratio["value"] == pytest.approx(bound, rel=0.1)
    assert ratio["low"] < ratio["value"] < ratio["high"] < 1
    assert root["rms_ratio"]["p99"]["high"] < 1
    # stated errors are of the true image: the reference differs from it by 1e-4
    assert uniform["stated_over_true"]["p99"]["value"] == pytest.approx(0.98, rel=1e-3)
    assert uniform["stated_over_true"]["p99"]["lowest"] == pytest.approx(0.98, rel=1e-3)
    assert uniform["coverage"] == pytest.approx(0.95)


def test_time_to_equal_error_follows_the_samples(tmp_path):
    """Twice as many samples in the same time halve the time to equal error, by both metrics."""
    folder = make_comparison(
        tmp_path / "out", ["a"], {"uniform": np.ones_like, "twice": np.ones_like}, range(8), (60, 80), speed=2
    )
    baseline, twice = summarise(folder)["scenes"][0]["rows"]
    assert baseline["time_to_equal_error"]["rel_mse"]["low"] == 1
    for metric in ("rms_p99", "rel_mse"):
        ratio = twice["time_to_equal_error"][metric]
        assert ratio["low"] == ratio["high"] == pytest.approx(0.5, rel=0.15)
        assert ratio["at_common_error"]["low"] < 0.5 < ratio["at_common_error"]["high"]


def test_the_lower_bound_of_relmse(folder):
    variance = np.geomspace(0.04, 4, 80)
    expected = np.mean(np.sqrt(variance)) ** 2 / variance.mean()
    assert summarise(folder)["scenes"][0]["rel_mse_lower_bound"] == pytest.approx(expected, rel=0.02)


def test_a_dark_image_is_detected(tmp_path):
    strategies = {"uniform": np.ones_like, "dark": np.ones_like}
    folder = make_comparison(tmp_path / "out", ["a"], strategies, range(8), (60, 80), bias=-0.02)
    honest, dark = summarise(folder)["scenes"][0]["rows"]
    assert abs(honest["image_mean_ratio"]["value"] - 1) < 0.003  # 4 standard errors of the simulated errors
    assert abs(honest["bias"]["z"]) < 5.4  # 1 in 1000 at 7 degrees of freedom
    assert dark["image_mean_ratio"]["value"] == pytest.approx(0.98, abs=0.003)
    assert dark["image_mean_ratio"]["high"] < 1
    assert dark["bias"]["z"] < -dark["bias"]["critical"]


def test_a_noisy_reference_is_marked(tmp_path):
    folder = make_comparison(tmp_path / "out", ["a"], STRATEGIES, reference_se=0.1)
    scene = summarise(folder)["scenes"][0]
    assert [row["reference_too_noisy"] for row in scene["rows"]] == [True] * 3
    assert scene["reference"]["p99"] == pytest.approx(0.1 / (1 - 2.33 * 0.1), rel=0.05)  # over the noisy reference
    text = summary_text(folder)
    assert "† noisy reference" in text
    assert all("†" in line for line in text.splitlines() if line.startswith((" uniform", " relative-median")))
    exact = summarise(make_comparison(tmp_path / "exact", ["a"], STRATEGIES, reference_se=None))
    assert [row["reference_too_noisy"] for row in exact["scenes"][0]["rows"]] == [False] * 3


def test_strategies_without_samples_after_the_warm_up_are_named(tmp_path):
    folder = make_comparison(tmp_path / "out", ["a"], STRATEGIES, seeds=[1, 2], warm_up_spp=65)
    assert re.search(r"Warning: relative-median had 6\d[.\d]* samples .* its warm-up has 65", summary_text(folder))
    folder = make_comparison(tmp_path / "more", ["a"], STRATEGIES, seeds=[1, 2], warm_up_spp=60)
    assert "Warning" not in summary_text(folder)


def test_errors_over_those_of_independent_samples(tmp_path):
    """Four times as many samples stand for a better sampler."""
    strategies = {"uniform:sampler=independent": np.ones_like, "uniform": np.ones_like}
    folder = make_comparison(tmp_path / "out", ["a"], strategies, range(8), (60, 80), speed=4)
    independent, sobol = summarise(folder)["scenes"][0]["rows"]
    assert "sampler_ratio" not in independent
    ratio = sobol["sampler_ratio"]
    assert ratio["rel_mse"]["value"] == pytest.approx(0.25, rel=0.1)
    assert ratio["rms_p99"]["value"] == pytest.approx(0.5, rel=0.1)
    assert "Over independent samples" in summary_text(folder)


@pytest.mark.long
@pytest.mark.usefixtures("in_tmp_path")
def test_several_numbers_of_samples_share_references_and_have_common_tables(capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is in the extra 'compare'")
    pytest.importorskip("jinja2", reason="jinja2 is in the extra 'compare'")
    assert compare(*options("out", ("uniform", "uniform:sampler=independent"), 2, "4,16")) == 0
    assert sorted(path.name for path in Path("out").iterdir()) == ["spp-16", "spp-4", "tables.md"]
    folders = Path("out/spp-4"), Path("out/spp-16")
    few, many = ((folder / "references/cornell.exr").read_bytes() for folder in folders)
    assert few == many
    for folder, spp in zip(folders, (4, 16), strict=True):
        for name in ("uniform", "uniform-sampler-independent"):
            with np.load(folder / f"runs/cornell/{name}/1.npz") as run:
                assert (run["count"] == spp).all()
    text = Path("out/tables.md").read_text()
    assert "| cornell | 4 |" in text
    assert "| cornell | 16 |" in text
    files = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.npz")}
    capsys.readouterr()
    assert compare(*options("out", ("uniform", "uniform:sampler=independent"), 2, "4,16")) == 0
    assert "resuming" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.npz")} == files


def test_the_same_runs_give_the_same_files(folder):
    from isonoise.comparison.report import write_report

    files = [*FILES, "report.html", *(f"plots/{path.name}" for path in (folder / "plots").iterdir())]
    before = {name: (folder / name).read_bytes() for name in files}
    write_report(folder)
    assert [name for name in files if (folder / name).read_bytes() != before[name]] == []


def test_an_unfinished_comparison_uses_the_common_seeds(tmp_path):
    folder = make_comparison(tmp_path / "out", SCENES, STRATEGIES, seeds=range(1, 6))
    for name in ("bright/relative-median/5", "bright/oracle-rule-sqrt/4", "bright/oracle-rule-sqrt/5"):
        (folder / "runs" / f"{name}.npz").unlink()
    for path in (folder / "runs" / "dim" / "oracle-rule-sqrt").iterdir():
        path.unlink()
    bright, dim = summarise(folder)["scenes"]
    assert bright["seeds"] == [1, 2, 3]
    assert (bright["runs"], bright["planned_runs"]) == (12, 15)
    assert [row["seeds"] for row in bright["rows"]] == [5, 4, 3]
    assert bright["ideal_uniformity"] == pytest.approx(ideal_uniformity(3))
    assert dim["seeds"] == [1, 2, 3, 4, 5]
    assert [row["strategy"] for row in dim["rows"]] == ["uniform", "relative-median"]
    text = summary_text(folder)
    assert "Not finished: 12 of 15 runs. Figures are from the 3 of 5 seeds" in text


def test_a_scene_without_runs_is_remaining_out(tmp_path):
    folder = make_comparison(tmp_path / "out", SCENES, STRATEGIES, seeds=[1, 2])
    for path in (folder / "runs" / "dim").rglob("*.npz"):
        path.unlink()
    (folder / "references" / "dim.exr").unlink()
    assert [scene["slug"] for scene in summarise(folder)["scenes"]] == ["bright"]


@pytest.mark.parametrize("remaining", ["uniform", "relative-median"])
def test_ratios_need_the_baseline_and_two_seeds(tmp_path, remaining):
    folder = make_comparison(tmp_path / "out", ["a"], STRATEGIES, seeds=[1])
    for path in (folder / "runs" / "a").rglob("*.npz"):
        if path.parent.name != remaining:
            path.unlink()
    summary = summarise(folder)
    write_summary(folder, summary)
    (row,) = summary["scenes"][0]["rows"]
    if remaining == "uniform":
        assert row["rms_ratio"]["p99"] == {"value": 1.0, "low": None, "high": None}
    else:
        assert "rms_ratio" not in row
    assert remaining in summary_text(folder)


def test_unreadable_files_are_messages(tmp_path):
    from isonoise.comparison.report import write_report

    with pytest.raises(UserError, match=r"plan\.json"):
        summarise(tmp_path)
    folder = make_comparison(tmp_path / "out", ["a"], STRATEGIES, seeds=[1, 2])
    for path in (folder / "runs").rglob("*.npz"):
        path.unlink()
    with pytest.raises(UserError, match="nothing to report"):
        write_report(folder)
    assert not (folder / "report.html").exists()


def test_the_tables_of_the_terminal_are_aligned(folder):
    text = summary_text(folder)
    lines = text.splitlines()
    for line, after in itertools.pairwise(lines):
        if line.startswith(" uniform"):
            assert after.startswith(" relative-median")
            assert len(line) == len(after) < 160
    for name in ("Time to equal RMS p99, relative to uniform", "Time to equal relMSE", "bright", "dim"):
        assert any(line.startswith(name) for line in lines)
    first = text.index("Time to equal RMS p99")
    assert first < text.index("Time to equal relMSE") < text.index("\nbright\n") < text.index("\ndim\n")


class Page(HTMLParser):
    """Collects the URLs that a browser would load; checks that elements are closed in order."""

    VOID = ("meta", "link", "img", "br", "line", "use", "path", "input", "image", "rect")

    def __init__(self):
        super().__init__()
        self.open, self.urls, self.ids, self.images, self.text, self.tags = [], [], [], [], [], []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.tags.append(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attributes.items():
            if name in ("src", "href", "xlink:href", "srcset", "data", "action"):
                self.urls.append(value)
            if name == "id":
                self.ids.append(value)
        if tag == "img":
            self.images.append(attributes)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def page(folder):
    parser = Page()
    parser.feed((folder / "report.html").read_text(encoding="utf-8"))
    parser.close()
    assert parser.open == []
    return parser


def test_the_page_is_self_contained(folder, page):
    assert page.urls
    assert [url[:60] for url in page.urls if not url.startswith(("#", "data:"))] == []
    html = (folder / "report.html").read_text(encoding="utf-8")
    for name in ("http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"):
        html = html.replace(f'="{name}"', "")
    for outside in ("http:", "https:", "file:", "@import", "fetch(", "url(/", 'url("'):
        assert outside not in html


def test_the_page_has_every_picture(page):
    from PIL import Image

    maps, crops = 1 + 3 * len(STRATEGIES), 3 * (1 + 2 * len(STRATEGIES))
    assert len(page.images) == len(SCENES) * (maps + crops)
    for image in page.images:
        assert image["alt"]
        head, data = image["src"].split(",", 1)
        assert head == "data:image/png;base64"
        size = (16, 16) if "region" in image["alt"] or image["alt"] == "its error" else (80, 60)
        assert Image.open(io.BytesIO(base64.b64decode(data))).size == size
    assert page.tags.count("table") == 3 + 3 * len(SCENES)


def test_ids_are_unique_and_links_have_targets(page):
    assert sorted(set(page.ids)) == sorted(page.ids)
    assert {url[1:] for url in page.urls if url.startswith("#")} <= set(page.ids)


def test_the_time_to_equal_error_comes_first(page):
    text = "".join(page.text)
    assert text.index("Time to equal RMS p99") < text.index("RMS p50")
    for needed in ("a simulated device", "own relative error", "How it was measured", "95 % interval", "0.0100 %"):
        assert needed in text


def test_names_are_escaped(tmp_path):
    folder = make_comparison(
        tmp_path / "out", ["a"], {"uniform": np.ones_like, "relative-median": lambda v: v}, seeds=[1, 2]
    )
    plan = read_plan(folder)
    scenes = (replace(plan.scenes[0], name="<script>alert(1)</script>"),)
    strategies = (plan.strategies[0], replace(plan.strategies[1], title='a "b" <i>&'))
    write_plan(folder, replace(plan, scenes=scenes, strategies=strategies))
    from isonoise.comparison.report import write_report

    write_report(folder)
    html = (folder / "report.html").read_text()
    assert html.count("<script>") == 1
    assert "<i>" not in html


def test_plots_are_written(folder):
    from PIL import Image

    pictures = [f"{scene}-{kind}.png" for scene in SCENES for kind in ("reference", "samples", "errors", "rms-p99")]
    vectors = [f"{scene}-rms-p99.{ending}" for scene in SCENES for ending in ("pdf", "svg")]
    assert sorted(path.name for path in (folder / "plots").iterdir()) == sorted(pictures + vectors)
    for name in pictures:
        with Image.open(folder / "plots" / name) as picture:
            picture.verify()
    for name in vectors:
        assert (folder / "plots" / name).read_bytes().startswith(b"%PDF" if name.endswith("pdf") else b"<?xml")


def test_maps_share_a_scale_and_shrink_by_whole_blocks():
    from PIL import Image

    from isonoise.comparison.report.map_grids import map_png, sample_maps, shrink

    image = np.arange(6 * 9, dtype=float).reshape(6, 9)
    assert shrink(image, 9).tolist() == image.tolist()
    assert shrink(image, 5).shape == (3, 4)
    assert shrink(image, 5)[0, 0] == np.mean([0, 1, 9, 10])
    grid = sample_maps({"low": np.full((4, 4), 1), "middle": np.full((4, 4), 10), "high": np.full((4, 4), 100)})
    shades = [np.array(Image.open(io.BytesIO(map_png(m, grid)))) for m in grid.maps]
    assert [int(shade[0, 0]) for shade in shades] == [0, 32, 63]
    constant = sample_maps({"uniform": np.full((4, 4), 7)})
    assert constant.low < 7 < constant.high


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (0.99999, "1.00"),
        (1234.5, "1,234"),
        (0.01, "0.0100"),
        (99.99, "100"),
        (2e-7, "2.00e-07"),
        (None, "\u2013"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert format_number(value) == text


def test_percentages():
    assert format_percent(0.01) == "1.00 %"
    assert format_percent(1.44) == "144 %"
