"""Effective sample size and R-hat against closed forms."""

import warnings

import numpy as np
import pytest

from sysid.posterior.diagnostics import ess, rhat, split


def autoregressive(rho, chains, draws, seed=0):
    """x_k = rho x_{k-1} + sqrt(1 - rho^2) e_k, begun in its stationary distribution: unit variance."""
    x = np.random.default_rng(seed).standard_normal((chains, draws))
    for k in range(1, draws):
        x[:, k] = rho * x[:, k - 1] + np.sqrt(1 - rho**2) * x[:, k]
    return x


@pytest.mark.parametrize("rho", [-0.3, 0.0, 0.5, 0.9])
def test_ess_of_an_autoregressive_chain(rho):
    chains, draws = 16, 4000
    found = np.mean([ess(autoregressive(rho, chains, draws, seed)) for seed in range(5)])
    truth = chains * draws * (1 - rho) / (1 + rho)
    # the integrated time is a sum of estimated correlations: 3 % here, and Geyer's cut-off adds a little
    # noise to it
    assert found == pytest.approx(truth, rel=0.08)


def test_ess_falls_as_chains_disagree():
    x = autoregressive(0.0, 8, 500)
    apart = x + 3 * np.arange(8)[:, None]
    assert ess(apart) < 0.02 * ess(x)


def test_rhat_of_agreeing_chains_is_near_one():
    values = [rhat(autoregressive(0.0, 8, 500, seed)) for seed in range(20)]
    # between-chain variance of 16 halves of 250 draws: 1 + 1/(2 * 250) (chi2_15/15 - 1), within 1e-3 or so
    assert max(abs(v - 1) for v in values) < 0.005


def test_rhat_sees_shifted_and_drifting_chains():
    x = autoregressive(0.0, 4, 400)
    # shifts 0, 2, 4, 6: variance of the means 20/3 (each mean twice: 16 halves to 40/7), so R^2 = 1 + 40/7
    # for 8 halves
    assert rhat(x + 2 * np.arange(4)[:, None]) == pytest.approx(np.sqrt(1 + 40 / 7), rel=0.05)
    # all four drift alike: whole chains agree, their halves do not. Means -1 and 1 (variance 8/7), within
    # each 1 + 2^2/12
    assert rhat(x + np.linspace(0, 4, 400)) == pytest.approx(np.sqrt(1 + 8 / 7 / (4 / 3)), rel=0.05)


def test_rhat_and_ess_do_not_depend_on_units():
    x = autoregressive(0.5, 8, 500)
    assert rhat(1e-9 * x + 3e4) == pytest.approx(
        rhat(x), abs=1e-4
    )  # beside 3e4 a draw of 1e-9 keeps three digits
    assert ess(1e-3 * x + 5.0) == pytest.approx(ess(x), rel=1e-9)


def test_constant_chains_have_neither_and_warn_not():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        constant = np.full((4, 100), 3.7)
        assert np.isnan(rhat(constant))
        assert np.isnan(ess(constant))


def test_split_cuts_each_chain_in_two():
    halves = split(np.arange(14).reshape(2, 7))
    np.testing.assert_array_equal(halves, [[0, 1, 2], [7, 8, 9], [4, 5, 6], [11, 12, 13]])
