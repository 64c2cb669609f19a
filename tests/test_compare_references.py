"""References, oracle variances and Mitsuba 3 in `isonoise compare`.

False-alarm rates, the chance that a correct program fails under other seeds: 1 % for the comparison of a reference by
values, 0.8 % for its image means, 6e-5 for each check of its stated variance.
"""

import importlib.util
import itertools
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import references
from compare_command import HEIGHT, WIDTH, compare, options, read_run, run_files, write_flat_reference

import isonoise
from isonoise.comparison.mitsuba_scene import mitsuba_xml
from isonoise.comparison.mitsuba_worker import MitsubaWorker, _rounded_spp
from isonoise.comparison.recorder import RUN_COLUMNS, SNAPSHOTS
from isonoise.comparison.reference_batch import reference_allocation
from isonoise.comparison.references import BatchSums
from isonoise.errors import UserError
from isonoise.film.exr import read_exr, read_reference
from isonoise.loop import Stops
from isonoise.luminance import luminance
from isonoise.statistics import Statistics
from isonoise.strategies.measures import image_floor

HAS_MITSUBA = importlib.util.find_spec("mitsuba") is not None

pytestmark = pytest.mark.usefixtures("in_tmp_path", "no_compare_report")


@pytest.fixture(scope="module")
def uniform_batches():
    """32 independent uniform renders, (batches, height, width, 3), 64 samples per pixel each."""
    render = {"spp": 64, "strategy": "uniform:wave_spp=64", "size": (WIDTH, HEIGHT)}
    return np.stack([isonoise.render("cornell", seed=100 + seed, **render).rgb for seed in range(32)]).astype(float)


@pytest.fixture(scope="module")
def reference_file(tmp_path_factory, no_compare_report):
    """Reference for runs of 64 samples per pixel: 1280 samples per pixel, half of them placed by a pilot run."""
    directory = tmp_path_factory.mktemp("reference") / "out"
    assert compare(*options(directory, ("uniform",), 1, 64)) == 0
    return directory / "references" / "cornell.exr"


def test_a_reference_is_unbiased(reference_file, uniform_batches, tmp_path):
    rgb, error = (image.astype(float) for image in read_reference(reference_file))
    image, truth = references.Estimate(rgb, error, 31), references.from_batches(uniform_batches)
    references.assert_agree(image, truth, tmp_path)
    references.assert_means_agree(image, truth)


def test_a_reference_states_its_variance(reference_file, uniform_batches):
    """The squared standard error times the samples is the variance of one sample, as estimated from uniform batches.

    Both are unbiased, so the sum of their differences over its standard error is a standard normal deviate.
    """
    channels, header = read_exr(reference_file)
    assert header["isonoise.batches"] == "32"
    error = np.stack([channels[f"stderr.{c}"] for c in "RGB"], axis=-1).astype(float)
    stated = error**2 * channels["samples"][..., None]
    measured = uniform_batches.var(axis=0, ddof=1) * 64
    differences = ((stated - measured) / np.maximum(uniform_batches.mean(axis=0), 1e-3) ** 2).sum(axis=-1)
    assert abs(differences.sum() / np.sqrt((differences**2).sum())) <= 4
    assert channels["samples"].mean() == 1280
    assert channels["samples"].min() >= 640
    assert channels["samples"].max() > 1600


def normal_statistics(rng, count, mean, sigma):
    """Statistics of `count` normal samples of each pixel, the same in all channels."""
    x = rng.normal(mean, sigma, (count, *mean.shape))
    rgb = np.repeat(x.mean(axis=0)[..., None], 3, axis=-1).astype(np.float32)
    counts = np.full(mean.shape, count, np.uint32)
    return Statistics(counts, np.zeros_like(counts), rgb, x.mean(axis=0), x.var(axis=0, ddof=1), None)


def test_batches_add_up():
    """20 batches of 5 normal samples: the variance between batches over the true one is chi-square with 19 degrees of
    freedom. So its means over 10,000 pixels have these relative standard errors; five are allowed.
    """
    rng = np.random.default_rng(5)
    sigma = rng.uniform(0.1, 1, (100, 100))
    mean = rng.uniform(1, 2, (100, 100))
    sums = BatchSums(np.full((100, 100), 5, np.uint32))
    for _ in range(20):
        sums.add(normal_statistics(rng, 5, mean, sigma), 0.5)
    assert (sums.batches, sums.seconds) == (20, 10.0)
    assert (sums.count == 100).all()
    error = sums.standard_error()[..., 0]
    assert np.mean(error**2 / (sigma**2 / 100)) == pytest.approx(1, abs=5 * np.sqrt(2 / 19 / 10_000))
    assert np.mean(sums.mean_m2 / 19 / (sigma**2 / 5)) == pytest.approx(1, abs=5 * np.sqrt(2 / 19 / 10_000))
    assert np.mean(((sums.rgb[..., 0] - mean) / sigma) ** 2 * 100) == pytest.approx(1, abs=5 * np.sqrt(2 / 10_000))
    np.testing.assert_allclose(sums.mean, sums.rgb[..., 1], rtol=1e-6)
    np.testing.assert_allclose(sums.relative_variance(), 5 * sums.mean_m2 / 19 / sums.mean**2, rtol=1e-12)


@pytest.mark.parametrize("spp", [2, 3, 7, 64])
def test_half_of_the_allocation_is_uniform_the_other_follows_the_errors(spp):
    count = np.full((20, 30), 16, np.uint32)
    variance = np.broadcast_to(np.geomspace(1e-3, 1e3, 30), count.shape)
    ones = np.ones(count.shape)
    pilot = Statistics(count, 0 * count, np.ones((20, 30, 3), np.float32), ones, variance, None)
    allocation = reference_allocation(pilot, spp)
    assert allocation.dtype == np.uint32
    assert allocation.sum() == spp * 600
    assert allocation.min() >= spp / 2
    assert allocation[:, -3:].mean() > 1.4 * allocation[:, :3].mean()


def test_the_variance_of_an_oracle_is_n_times_that_of_means_of_n_samples(capsys):
    """Compared with 32 other renders of as many samples as a batch has, with the same sampler.

    The ratio of two variances with 31 degrees of freedom has a standard deviation of 0.4, the median of 192 one of 4 %:
    four are allowed. The variance of single samples would be 1.7 times as large.
    """
    write_flat_reference("a.exr")
    given = ("--reference", "a.exr")
    assert compare(*options("out", ("uniform", "oracle:rule=sqrt"), 1, 64), *given) == 0
    channels, _ = read_exr("out/references/cornell-variance.exr")
    assert list(channels) == ["variance"]
    render = {"spp": 40, "strategy": "uniform:wave_spp=40", "size": (WIDTH, HEIGHT), "sampler": "sobol"}
    means = np.stack([luminance(isonoise.render("cornell", seed=200 + seed, **render).rgb) for seed in range(32)])
    mean = means.mean(axis=0)
    expected = 40 * means.var(axis=0, ddof=1) / np.maximum(mean, image_floor(mean)) ** 2
    ratio = channels["variance"].astype(float) / expected
    assert np.median(ratio) == pytest.approx(1, abs=0.16)
    assert channels["variance"].mean() == pytest.approx(expected.mean(), rel=0.3)

    facts = read_run("out/runs/cornell/oracle-rule-sqrt/0.npz")["facts"]
    assert facts["strategy"].startswith("oracle:rule=sqrt,")
    assert facts["strategy"].endswith("cornell-variance.exr,sampler=sobol")
    assert sorted(os.listdir("out/references")) == ["cornell-variance.exr"]


def test_a_folder_with_a_comma_is_a_message_with_an_oracle(capsys):
    assert compare(*options("a,b", ("oracle",))) == 2
    assert "comma" in capsys.readouterr().err
    assert not Path("a,b").exists()


def test_the_xml_for_mitsuba(tmp_path):
    from xml.etree.ElementTree import fromstring

    Path("sub").mkdir()
    Path("sub/a.ply").touch()
    source = tmp_path / "sub" / "scene.xml"
    text = isonoise.scene.builtin.find_scene("cornell").read_text()
    source.write_text(text)
    root = fromstring(mitsuba_xml(source, "multijitter", (20, 30), 4))
    values = {child.get("name"): child.get("value") for child in root.find("sensor/film")}
    assert (values["width"], values["height"], values["pixel_format"]) == ("20", "30", "rgb")
    assert root.find("sensor/film/rfilter").get("type") == "box"
    assert [sampler.get("type") for sampler in root.findall("sensor/sampler")] == ["multijitter"]
    (integrator,) = root.findall("integrator")
    assert {child.get("name"): child.get("value") for child in integrator} == {
        "max_depth": "4",
        "rr_depth": "5",
        "hide_emitters": "false",
    }
    with pytest.raises(UserError, match=r"reads \.xml scenes only"):
        mitsuba_xml(tmp_path / "sub" / "a.ply", "independent", None, None)


@pytest.mark.skipif(not HAS_MITSUBA, reason="needs Mitsuba 3: pip install 'isonoise[peers]'")
def test_mitsuba_renders_the_same_image(reference_file):
    """Image means of two samplers agree with the reference within five standard errors (false alarm: 5e-7)."""
    strategies = ("uniform", "mitsuba-independent", "mitsuba-multijitter")
    given = ("--reference", reference_file)
    assert compare(*options("out", strategies, 1, 1024), *given) == 0
    last_row = {}
    for strategy in strategies:
        with np.load(f"out/runs/cornell/{strategy}/0.npz") as run:
            rows, facts = (json.loads(str(run[name])) for name in ("rows", "facts"))
            assert (run["count"] == 1024).all()
            assert run["errors"].shape == (SNAPSHOTS, HEIGHT, WIDTH)
        assert rows[-1]["samples"] == facts["samples"] == 1024 * WIDTH * HEIGHT
        assert all(list(row) == list(RUN_COLUMNS) for row in rows)
        assert len(rows) > 4
        assert all(a["samples"] < b["samples"] for a, b in itertools.pairwise(rows))
        # every row of Mitsuba is an image of its own: equal if the smaller pass was the slower one
        assert all(a["elapsed_s"] <= b["elapsed_s"] for a, b in itertools.pairwise(rows))
        last_row[strategy] = rows[-1]
    error = last_row["uniform"]["true_energy_ratio_se"]
    for strategy in strategies[1:]:
        assert last_row[strategy]["true_energy_ratio"] == pytest.approx(1, abs=5 * error)
        assert last_row[strategy]["true_p99"] < 2 * last_row["uniform"]["true_p99"]
        assert np.isnan(last_row[strategy]["stated_p99"])
        assert np.isnan(last_row[strategy]["true_coverage"])


class FakeMitsuba(MitsubaWorker):
    """Renders 100 samples per pixel and second; rounds as multijitter does."""

    _max_spp = 2**20

    def __init__(self):
        self.rendered = []

    def render(self, spp, seed):
        self.rendered.append(spp)
        return np.zeros((1, 1, 3), np.float32), spp / 100

    def _request(self, name, spp):
        return _rounded_spp(self, spp, name == "rounded_down")

    def set_sample_count(self, spp):
        rows = math.isqrt(spp)
        self.count = rows * -(-spp // rows)

    def sample_count(self):
        return self.count


@pytest.mark.parametrize(
    ("stops", "images"),
    [
        (Stops(spp=64), [[2], [4], [8], [16], [35], [64]]),
        (Stops(spp=1024), [[35], [64], [132], [256], [528], [1024]]),
        (Stops(spp=128), [[4], [8], [16], [35], [64], [121, 6, 1]]),
        (Stops(spp=1), [[1]]),
        (Stops(time=10), [[35], [72], [132], [272], [528], [992]]),
    ],
)
def test_an_image_of_mitsuba_is_one_pass_of_a_size_that_multijitter_keeps(stops, images):
    mitsuba = FakeMitsuba()
    assert mitsuba.schedule(stops) == images
    assert {size for passes in images for size in passes} <= set(mitsuba.rendered)


def test_a_slower_size_of_a_pass_is_not_taken(monkeypatch):
    """Sizes that are no powers of two take 1.4 times as long: 32 x 32 samples take 10.24 s, 28 x 28 take 10.98 s."""
    mitsuba = FakeMitsuba()
    slow = FakeMitsuba.render
    monkeypatch.setattr(
        mitsuba, "render", lambda spp, seed: slow(mitsuba, spp * (1 if spp & (spp - 1) == 0 else 1.4), seed)
    )
    assert mitsuba.schedule(Stops(time=10.24))[-1] == [1024]
    assert mitsuba.schedule(Stops(time=9))[-1] == [650]  # 25 x 26 take 9.1 s


@pytest.mark.skipif(not HAS_MITSUBA, reason="needs Mitsuba 3: pip install 'isonoise[peers]'")
def test_a_scene_that_mitsuba_cannot_render_is_a_message(capsys, monkeypatch):
    monkeypatch.setattr("isonoise.comparison.mitsuba_worker.mitsuba_xml", lambda *_: "<scene version='3.0.0'><shape/>")
    write_flat_reference("a.exr")
    assert compare(*options("out", ("mitsuba-independent",), 1), "--reference", "a.exr") == 2
    err = capsys.readouterr().err
    assert "Mitsuba cannot render cornell: llvm_ad_rgb: " in err
    assert "; scalar_rgb: " in err
    assert "Traceback" not in err
    assert not run_files("out")
