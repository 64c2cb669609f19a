"""Quantiles of Student's t against closed forms, printed tables and, where it is installed, SciPy."""

import math

import numpy as np
import pytest

from isonoise.student_t import quantile

# to the three decimals that tables have; the last column is the normal quantile
PRINTED = {
    0.75: {1: 1.000, 2: 0.816, 5: 0.727, 10: 0.700, 30: 0.683, 120: 0.677, 2**32 - 2: 0.674},
    0.95: {1: 6.314, 2: 2.920, 5: 2.015, 10: 1.812, 30: 1.697, 120: 1.658, 2**32 - 2: 1.645},
    0.975: {1: 12.706, 2: 4.303, 5: 2.571, 10: 2.228, 30: 2.042, 120: 1.980, 2**32 - 2: 1.960},
    0.995: {1: 63.657, 2: 9.925, 5: 4.032, 10: 3.169, 30: 2.750, 120: 2.617, 2**32 - 2: 2.576},
    0.9995: {1: 636.619, 2: 31.599, 5: 6.869, 10: 4.587, 30: 3.646, 120: 3.373, 2**32 - 2: 3.291},
}
PROBABILITIES = [0.5 + 1e-6, 0.51, 0.6, 0.9, 0.975, 0.999, 1 - 1e-6, 1 - 1e-9]


@pytest.mark.parametrize("p", PRINTED)
def test_quantiles_are_those_of_the_printed_table(p):
    t = quantile(p, np.array(list(PRINTED[p])))
    assert t == pytest.approx(list(PRINTED[p].values()), abs=0.00051)


@pytest.mark.parametrize("p", PROBABILITIES)
def test_one_two_and_four_degrees_of_freedom_have_closed_forms(p):
    a = 4 * p * (1 - p)
    q = math.cos(math.acos(math.sqrt(a)) / 3) / math.sqrt(a)
    expected = [math.tan(math.pi * (p - 0.5)), (2 * p - 1) * math.sqrt(2 / a), 2 * math.sqrt(max(q - 1, 0))]
    # the third one loses its digits where p is near 1/2
    last = 3 if p > 0.505 else 2
    assert quantile(p, np.array([1, 2, 4]))[:last] == pytest.approx(expected[:last], rel=1e-6)


@pytest.mark.parametrize("p", PROBABILITIES)
def test_the_density_integrates_to_p(p):
    """Up to the quantile, by the trapezoidal rule in the angle atan(t / sqrt(dof)): closed forms, table and
    expansion alike, 1e-5 relative in t."""
    for dof in (1, 2, 3, 5, 10, 11, 40, 200, 1000):
        t = float(quantile(p, np.array(dof)[None])[0])
        scale = math.exp(math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2)) / math.sqrt(math.pi)
        # the tail from t on, in the angle from the far end: small probabilities keep their digits
        angle = np.linspace(0, math.atan2(math.sqrt(dof), t), 200_001)
        values = np.sin(angle) ** (dof - 1)
        tail = scale * angle[1] * (values.sum() - (values[0] + values[-1]) / 2)
        density = scale * math.cos(math.atan(t / math.sqrt(dof))) ** (dof + 1) / math.sqrt(dof)
        assert abs(tail - (1 - p)) / density < 1e-5 * t + 1e-10, dof


def test_quantiles_fall_with_the_degrees_of_freedom():
    """No step where the table ends."""
    for p in PROBABILITIES:
        t = quantile(p, np.arange(1, 2000))
        assert (np.diff(t) < 0).all()


def test_shapes_and_counts():
    dof = np.array([[1, 5], [2**32 - 2, 30]], dtype=np.uint32)
    t = quantile(0.975, dof)
    assert t.shape == dof.shape
    assert t.dtype == np.float64
    assert t == pytest.approx(np.array([[12.7062047, 2.57058184], [1.959963985, 2.04227246]]), rel=1e-5)
    assert quantile(0.9, np.zeros((0, 3), np.uint32)).shape == (0, 3)


def test_against_scipy():
    stats = pytest.importorskip("scipy.stats")
    dof = np.concatenate([np.arange(1, 3000), [10**4, 10**6, 2**32 - 2]])
    for p in PROBABILITIES[1:]:  # SciPy's own error is 4e-5 at 4 degrees of freedom next to 1/2
        assert quantile(p, dof) == pytest.approx(stats.t.isf(1 - p, dof), rel=1e-5)


@pytest.mark.parametrize(("p", "dof"), [(0.5, 1), (1.0, 1), (-0.1, 1), (np.nan, 1), (0.9, 0), (0.9, -1)])
def test_arguments_out_of_range(p, dof):
    with pytest.raises(ValueError, match=r"degrees of freedom|p must be in"):
        quantile(p, np.array([3, dof]))
