"""A lock-in's filter that no log states: fitted where the logs show which it is, a misfit where they do not."""

import numpy as np
import pytest
from scipy.linalg import expm

import sysid

G, TAU, F0, DT = 0.02, 1.67e-3, 1.9e6, 1e-4


def filtered_step(seed, time, order, noise, beside=40.0, rows=220, late=0.0):
    """A step of 100 V after 20 rows, driven `beside` Hz off the resonance, behind `order` poles of `time`: W' = a W + b V and
    y_j' = (y_(j-1) - y_j)/time as one matrix exponential; white noise after the filter. Q is 10 000, so that the fast mode is
    nothing."""
    n, tau = 1 + order, TAU
    A = np.zeros((n + 1, n + 1), complex)
    A[0, 0], A[0, n] = -1 / tau - 2j * np.pi * beside, G / tau * 100
    for j in range(1, n):
        A[j, j - 1], A[j, j] = 1 / time, -1 / time
    t = DT * np.arange(rows)
    y = np.array([0.0 if s <= 0 else (expm(A * s) @ np.eye(n + 1)[n])[order] for s in t - t[20] - late])
    rng = np.random.default_rng([seed, order])
    y = y * np.exp(0.4j) + noise * 2.0 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    drive, frequency = np.where(np.arange(rows) < 20, 0.0, 100.0), np.full(rows, F0 + beside)
    return sysid.Log("step", y, time=t, drive=drive, frequency=frequency, kind="transient", sampling="instant")


@pytest.mark.parametrize(("time", "order"), [(3e-4, 1), (2e-4, 2), (1e-4, 4)])
def test_a_filter_that_the_log_shows_is_fitted(time, order):
    """Without it tau is 3 to 30 of its errors off, or the log is a misfit."""
    fits = [sysid.fit([filtered_step(seed, time, order, noise=1e-3)]) for seed in range(8)]
    good = [f for f in fits if f.result.name == "successful"]
    assert len(good) >= 6
    z = [(f.parameters[n].value - v) / f.parameters[n].std for f in good for n, v in (("tau", TAU), ("f0", F0))]
    assert np.sqrt(np.mean(np.square(z))) < 1.6  # of 12 numbers or more, known to a fifth: three of these
    for f in good:
        found = sysid.nuisances(f)[0]["filter"]
        assert "no lock-in's filter is stated" in " ".join(f.warnings)
        poles = f.modes[0].trials[0].smoothing[1]
        assert abs(poles * found.value - order * time) < 0.5 * order * time  # the delay; how it is made up is not told


def test_what_may_as_well_be_another_filter_is_not_fitted():
    """In noise of 3 % a filter of a tenth of tau is a lateness like any other."""
    for seed in range(4):
        fit = sysid.fit([filtered_step(seed, 1e-4, 2, noise=0.03)])
        tau = fit.parameters["tau"]
        assert "lock-in's filter is stated" not in " ".join(fit.warnings)
        assert fit.result.name != "successful" or abs(tau.value - TAU) < 4 * tau.std


def test_a_trigger_that_is_late_is_no_filter():
    fit = sysid.fit([filtered_step(0, 1e-4, 0, noise=1e-3, late=5.5 * DT)])
    assert fit.result.name == "misfit" and "begins late" in " ".join(fit.warnings)


def test_left_out_it_is_not_looked_for():
    names = ("rotation", "background", "offset", "start", "late")
    assert sysid.fit([filtered_step(0, 3e-4, 1, noise=1e-3)], nuisances=names).result.name == "misfit"
