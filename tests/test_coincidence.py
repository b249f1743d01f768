"""G of a step beside which nothing tells a feedthrough and a lateness from it: as sure as its plateau and its rise agree."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import sysid
from sysid import Result

SEEDS = 16


def fits(bench, change):
    """Of lone steps, each changed: (G - truth)/std, and the relative std."""
    found = [sysid.fit([change(bench.transient(seed=300 + k))]).parameters["G"] for k in range(SEEDS)]
    G = bench.plant.G
    return np.array([(p.value - G) / p.std for p in found]), np.array([p.std / G for p in found])


def rise(bench, log):
    """Standard deviation of A - B over the amplitude, for noise of 0.02 um: least squares with tau and f0 free."""
    since = np.maximum(log.time - log.time[20], 0.0)
    pole = -1 / bench.plant.tau + 2j * np.pi * (bench.plant.f0 - 32290.0)
    decay = (since > 0) * np.exp(pole * since)
    shapes = np.stack([since > 0, decay, since * decay / bench.plant.tau, np.ones(len(since))], axis=1)
    difference = np.array([1, 1, 0, 0])
    error = 0.02 * np.sqrt(difference @ np.linalg.inv((shapes.conj().T @ shapes).real) @ difference)
    settled = abs(100 * bench.plant.G * (-1 / bench.plant.tau) / pole)
    return error / settled


def test_a_step_on_time_tells_its_gain(bench):
    scores, std = fits(bench, lambda log: log)
    # the sum of squares of unit normals, above in one of a thousand cases; the intervals are meant to be too wide rather than too
    # narrow, by no more than 2, which makes it four times smaller
    assert chi2.ppf(1e-3, SEEDS) / 4 < np.sum(scores**2) < chi2.ppf(0.999, SEEDS)
    # where a row's share of tau is 6 %
    assert np.median(std) < 2 * rise(bench, bench.transient(seed=300))


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_a_feedthrough_is_allowed_for(bench, share):
    leak = share * bench.plant.G * np.exp(0.7j)

    def leaking(log):
        return replace(log, response=log.response + leak * np.append(0.0, log.drive[:-1]))

    scores, std = fits(bench, leaking)
    assert np.max(np.abs(scores)) < 4  # the plate and the leak are the same in each: not the scores of independent draws
    assert np.median(std) > 0.2 * share


def test_a_step_half_a_row_late_is_allowed_for(bench):
    """The recorder's clock is half a row behind."""

    def late(log):
        fine = bench.transient(seed=1, volts=np.repeat(log.drive, 2), dt=5e-5, noise=0.0)
        noise = log.response - bench.transient(seed=1, noise=0.0).response
        return replace(log, response=np.append(0.0, fine.response[1:-1:2])[: len(log)] + noise)

    scores, std = fits(bench, late)
    assert np.max(np.abs(scores)) < 4
    assert np.median(std) > 0.005


@pytest.mark.parametrize("factor", [0.7071, 1.3])
def test_a_gain_that_looks_like_what_cancels_is_named(bench, factor):
    log = bench.transient(seed=320)
    fit = sysid.fit([replace(log, response=factor * log.response), bench.sweep(seed=321)])
    assert fit.result is Result.misfit
    assert any("G contradicts the other logs" in said for said in fit.warnings), fit.warnings
