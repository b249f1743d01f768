"""The polynomial density against the exact one: where it is used, and what happens where it does not hold."""

import numpy as np
import pytest

import sysid
from sysid.posterior import surrogate
from sysid.posterior.mixture import Mixture
from sysid.posterior.target import Target
from sysid.precision import float64
from sysid.trials.experiment import group


def densities(fit, smooth):
    best = fit.modes[0]
    triangle = np.linalg.cholesky(best.covariance[: len(fit.names), : len(fit.names)])
    groups, _ = group(best.trials, fit.reference, low_q=best.low_q)
    p = len(fit.names)
    about = Mixture(np.zeros((1, p)), np.eye(p)[None], np.ones(1)) if smooth else None
    return surrogate.Density(
        lambda z: best.theta + np.pad(z @ triangle.T, ((0, 0), (0, 6 - p))), groups, about
    )


@pytest.fixture(scope="module")
def fit(bench):
    return sysid.fit([bench.sweep()])


@float64
def both(fit, z):
    fast = densities(fit, smooth=True)
    return fast, fast(z), densities(fit, smooth=False)(z)


def draws(n, p=3):
    rng = np.random.default_rng(4)
    return rng.standard_normal((n, p)) / np.sqrt(rng.chisquare(12, (n, 1)) / 12)


def test_it_is_the_exact_density_near_and_far(fit):
    z = draws(600)
    z[:40] *= 3
    fast, value, exact = both(fit, z)
    far = np.linalg.norm(z, axis=1) > surrogate.FAR
    assert fast.smooth and far.sum() > 10
    # where it is checked is as far out, in other directions: twice
    assert np.max(np.abs(value - exact)[~far]) <= 2 * fast.error < surrogate.FAITHFUL
    # evaluated by two programs: rounding of a sum of 600 squares
    np.testing.assert_allclose(value[far], exact[far], rtol=1e-9)


@float64
def test_each_of_two_minima_has_a_cubic(bench):
    """An amplitude does not tell on which side of the drive its resonance is."""
    fit = sysid.fit([bench.transient(amplitude=True, frequency=32450.0, noise=0.003)])
    fast, exact = Target(fit), Target(fit)
    exact.density.about = None
    z = fast.normal().heavy().draw(200, np.random.default_rng(0))
    off = np.max(np.abs(fast(z) - exact(z)))
    assert len(fit.modes) == 2 and None not in fast.density.cubics
    assert off <= 2 * fast.density.error < surrogate.FAITHFUL


@pytest.mark.study  # many rows
def test_many_rows_are_taken_log_by_log(bench, monkeypatch):
    fit, z = sysid.fit([bench.sweep(seed=1), bench.sweep(seed=2), bench.transient(seed=3)]), draws(50)
    _, together, _ = both(fit, z)
    monkeypatch.setattr(surrogate, "MANY", 100)
    fast, apart, _ = both(fit, z)
    assert fast.smooth
    np.testing.assert_allclose(apart, together, rtol=1e-9)  # another program: rounding of a sum of squares


def test_where_a_cubic_does_not_do_every_point_is_evaluated(fit, monkeypatch):
    monkeypatch.setattr(surrogate, "FAITHFUL", 1e-12)
    fast, value, exact = both(fit, draws(100))
    assert not fast.smooth
    np.testing.assert_array_equal(value, exact)
