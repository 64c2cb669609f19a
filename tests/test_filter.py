"""Pixel filters: the table against the closed distribution, and renders of an edge."""

import math

import numpy as np
import pytest

from isonoise.integrator.pixel_filter import CELLS, inverse_cdf
from isonoise.render_scene import render


def box(x: float) -> float:
    return min(max(x + 0.5, 0.0), 1.0)


def tent(radius: float):
    """Returns the cumulative distribution of 1 - |x| / radius."""

    def cumulative(x: float) -> float:
        x = min(max(x / radius, -1.0), 1.0)
        return 0.5 * (1 + x) ** 2 if x < 0 else 1 - 0.5 * (1 - x) ** 2

    return cumulative


def gaussian(stddev: float):
    """Returns the cumulative distribution of exp(-x^2 / 2 s^2) minus its value at 4 s, by Simpson's rule."""
    radius = 4 * stddev
    x = np.linspace(-radius, radius, 8001)
    density = np.exp(-0.5 * (x / stddev) ** 2) - math.exp(-8.0)
    middle = np.exp(-0.5 * ((x[1:] + x[:-1]) / (2 * stddev)) ** 2) - math.exp(-8.0)
    steps = (density[1:] + 4 * middle + density[:-1]) * (x[1] - x[0]) / 6
    total = np.concatenate([[0.0], np.cumsum(steps)])
    return lambda at: float(np.interp(at, x, total / total[-1]))


TABLES = {
    "tent of radius 1": (("tent", 1.0, 0.0), tent(1.0)),
    "tent of radius 3.7": (("tent", 3.7, 0.0), tent(3.7)),
    "gaussian, stddev 0.5": (("gaussian", 2.0, 0.5), gaussian(0.5)),
    "gaussian, stddev 1.3": (("gaussian", 5.2, 1.3), gaussian(1.3)),
}


@pytest.mark.parametrize("name", TABLES)
def test_the_table_inverts_the_distribution(name):
    """At its nodes to 1e-6: interpolation over 16 points a cell, and float32. An offset is uniform within a cell, so
    between nodes the distribution is off by less than a cell's share, 1 / 4096."""
    (kind, radius, stddev), cumulative = TABLES[name]
    table = inverse_cdf(kind, radius, stddev)
    assert table.shape == (CELLS + 1,)
    assert table.dtype == np.float32
    assert (np.diff(table) > 0).all()
    assert table[[0, -1]].tolist() == [np.float32(-radius), np.float32(radius)]
    assert table + table[::-1] == pytest.approx(0, abs=1e-5 * radius)
    u = np.arange(CELLS + 1) / CELLS
    at_nodes = np.array([cumulative(float(x)) for x in table])
    assert np.abs(at_nodes - u).max() < 1e-6
    middles = 0.5 * (table[1:].astype(float) + table[:-1])
    assert np.abs(np.array([cumulative(x) for x in middles]) - (u[1:] + u[:-1]) / 2).max() < 1 / CELLS


def test_moments():
    """Moments of the piecewise uniform distribution that the kernels sample.

    A tent of radius r has the variance r^2 / 6. The two end cells hold 1 / 2048 and are 0.022 r wide; there the mean of
    |x| is off by a sixth of the width, and so the variance by 2 x 0.022 / 6 / 2048 x r^2, which is 2e-5 of it.
    """
    table = inverse_cdf("tent", 2.0, 0.0).astype(np.float64)
    a, b = table[:-1], table[1:]
    assert np.mean((a + b) / 2) == pytest.approx(0, abs=1e-7)
    assert np.mean((a * a + a * b + b * b) / 3) == pytest.approx(4 / 6, rel=4e-5)


COLUMNS = 9
SPP = 16384
EDGE = 4.3  # in pixels from the left; the light is right of it


@pytest.mark.parametrize(
    ("rfilter", "cumulative"),
    [
        ({"type": "box"}, box),
        ({"type": "tent", "radius": 1.5}, tent(1.5)),
        ({"type": "gaussian", "stddev": 0.6}, gaussian(0.6)),
    ],
    ids=["box", "tent", "gaussian"],
)
def test_an_edge_seen_through_the_filter(rfilter, cumulative):
    """A light fills the image to the right of an edge: pixel i, its centre at i + 1/2, sees the share
    F(i + 1/2 - EDGE) of it.

    Binomial noise: within 5 standard deviations, false alarms 6e-7 for each of 81 pixels, and float32's 1e-5.
    """
    camera = np.diag([-1.0, 1.0, -1.0, 1.0])  # looks along -z, x to the right
    camera[2, 3] = 1.0  # there a field of view of 4.5 to each side makes a pixel 1 x 1 on the plane z = 0
    light = np.diag([50.0, 99.0, 1.0, 1.0])
    light[0, 3] = 50.0 + EDGE - 4.5
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 1},
        "sensor": {
            "type": "perspective",
            "fov": float(np.rad2deg(2 * np.arctan(4.5))),
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": COLUMNS, "height": COLUMNS, "rfilter": rfilter},
        },
        "light": {
            "type": "rectangle",
            "to_world": light,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
        },
    }
    statistics = render(scene, spp=SPP, strategy=f"uniform:wave_spp={SPP}", seed=2).statistics
    share = np.array([cumulative(column + 0.5 - EDGE) for column in range(COLUMNS)])
    deviation = 5 * np.sqrt(share * (1 - share) / SPP) + 1e-5
    assert (np.abs(statistics.mean - share) <= deviation).all(), statistics.mean - share
    assert 0 < share[4] < 1
