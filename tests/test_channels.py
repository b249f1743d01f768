"""Noise that differs between d and q, and outliers on top of coloured noise: levels, intervals, words,
against plain numpy."""

import numpy as np
import pytest
import reference
from scipy.optimize import least_squares

import sysid
from sysid.trials.noise import apart, spikes
from sysid.verdict.bench import nuisances

PLANT = reference.Plant(G=0.02, tau=1.669e-3, f0=32300.0, k_T=0.0)
FREQUENCY = np.linspace(31800, 32800, 101)
TURN, FEEDTHROUGH, VOLTS = 0.3, 1.6e-4 - 1.2e-4j, 100.0
SEEDS = 30


def coloured(rng, n, memory):
    """Unit noise (2, n) with the correlation `memory` from row to row, from its stationary distribution."""
    v = rng.standard_normal((2, n))
    for k in range(1, n):
        v[:, k] = memory * v[:, k - 1] + np.sqrt(1 - memory**2) * v[:, k]
    return v


def sweep(noise):
    clean = reference.steady(PLANT, VOLTS, FREQUENCY, 24.0)
    response = np.exp(1j * TURN) * clean + FEEDTHROUGH * VOLTS + noise
    return sysid.Log("sweep", response, drive=np.full(101, VOLTS), frequency=FREQUENCY, kind="steady")


def step(noise, rate=1e4):
    n = len(noise)
    drive = np.where(np.arange(n) < 20, 0.0, VOLTS)
    fixed = np.full(n, 32290.0)
    time = np.arange(n) / rate
    clean = reference.ringing(PLANT, time, drive, fixed, np.full(n, 24.0))
    response = np.exp(1j * TURN) * clean + noise
    return sysid.Log(
        "step", response, time=time, drive=drive, frequency=fixed, kind="transient", sampling="instant"
    )


def parted(d, q, seed, n=101):
    white = np.random.default_rng(seed).standard_normal((2, n))
    return d * white[0] + 1j * q * white[1]


def weighted_least_squares(log, std_d, std_q):
    """(log G, log tau, f0 - 32300) and standard deviations of a sweep whose noise is known, by scipy: eight
    real parameters."""

    def rows(p):
        w, w0 = 2 * np.pi * log.frequency, 2 * np.pi * (32300 + p[2])
        W = np.exp(p[0] + 1j * p[3]) * VOLTS * (w0 / w) / (1 - 1j * (w0**2 - w**2) * np.exp(p[1]) / (2 * w))
        u = (log.frequency - log.frequency.mean()) / 500
        left = log.response - W - (p[4] + 1j * p[5]) - (p[6] + 1j * p[7]) * u
        return np.concatenate([left.real / std_d, left.imag / std_q])

    begin = np.array([np.log(0.018), np.log(1.5e-3), 5.0, 0.2, 0, 0, 0, 0])
    scale = np.array([1, 1, 30.0, 1, 1, 1, 1, 1])
    found = least_squares(rows, begin, x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=2000)
    return found.x[:3], np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:3]


@pytest.mark.parametrize(("d", "q"), [(0.06, 0.02), (0.02, 0.2)])
def test_a_sweep_agrees_with_a_weighted_least_squares(d, q):
    fit = sysid.fit([sweep(parted(d, q, 1))])
    levels = fit.logs[0].levels
    # 101 rows less a few: a level is known to 1/sqrt(2 * 97) = 7 %
    assert [level.std for level in levels] == pytest.approx([d, q], rel=0.25)
    values, std = weighted_least_squares(fit.logs[0].log, *(level.std for level in levels))
    found = np.array([np.log(fit.plant.G), np.log(fit.plant.tau), fit.plant.f0 - 32300])
    # 1e-3 of a standard deviation: the rounds stop when the noise moves by less than that of itself; and the
    # nuisances' prior
    np.testing.assert_array_less(np.abs(found - values) / std, 1e-3)
    told = np.sqrt(np.diag(fit.covariance)) / [fit.plant.G, fit.plant.tau, 1.0]
    # each channel is given half of the degrees of freedom, of which the plant's three are taken in
    # proportion: 2 %
    np.testing.assert_allclose(told, std, rtol=0.03)


def scores(make):
    """(value - truth)/std of (tau, f0) over SEEDS logs, and the fits."""
    fits = [sysid.fit([make(seed)]) for seed in range(SEEDS)]
    assert all(f.result is sysid.Result.successful for f in fits)
    found = [
        [(f.parameters[n].value - getattr(PLANT, n)) / f.parameters[n].std for n in ("tau", "f0")]
        for f in fits
    ]
    return np.array(found), fits


def unit_normal(z):
    """Mean and spread of all within three and a half of their own errors; the two of one seed count as
    one."""
    return abs(z.mean()) < 3.5 / np.sqrt(SEEDS) and abs(z.std() - 1) < 3.5 / np.sqrt(2 * SEEDS)


@pytest.mark.study
def test_errors_with_one_bad_channel_are_those_of_the_estimates():
    z, fits = scores(lambda seed: step(parted(0.02, 0.06, [seed, 5], 220)))
    assert unit_normal(z) and all(len(f.logs[0].levels) == 2 for f in fits)


@pytest.mark.study
def test_errors_with_outliers_on_coloured_noise_are_those_of_the_estimates():
    def make(seed):
        rng = np.random.default_rng([seed, 6])
        v = coloured(rng, 420, 0.9) + np.where(rng.random(420) < 0.05, 10.0, 0.0) * rng.standard_normal(
            (2, 420)
        )
        return step(0.02 * (v[0] + 1j * v[1]))

    z, fits = scores(make)
    assert unit_normal(z) and all("outliers left out" in f.logs[0].noise for f in fits)
    # 21 of 420 rows on average, one in a hundred of which is within the noise; the level is not that of the
    # outliers
    assert 17 < np.mean([int(f.logs[0].noise.split(", ")[-1].split()[0]) for f in fits]) < 24
    assert np.median([f.logs[0].noise_std for f in fits]) == pytest.approx(0.02, rel=0.15)


def test_each_channel_has_its_own_correlation_time():
    rng = np.random.default_rng(2)
    noise = 0.02 * rng.standard_normal(800) + 0.06j * coloured(rng, 800, 0.9)[0]
    fit = sysid.fit([step(noise)])
    d, q = fit.logs[0].levels
    assert d.time == 0 and d.std == pytest.approx(0.02, rel=0.1)
    # rho 0.9 is 9.5 rows; of 800 rows it is known to about a quarter, and the level to an eighth
    assert q.time == pytest.approx(9.5e-4, rel=0.6) and q.std == pytest.approx(0.06, rel=0.4)
    assert fit.logs[0].noise.startswith(f"{d.std:.3g} um in d, white, {q.std:.3g} um in q, correlated over")


def test_what_was_found_is_told_and_sampled():
    log = sweep(parted(0.06, 0.02, 3))
    fit = sysid.fit([log, step(parted(0.02, 0.02, 4, 220))])
    told, other = nuisances(fit)
    assert (
        told["noise_d"].ci95[0] < 0.06 < told["noise_d"].ci95[1]
        and told["noise_q"].ci95[0] < 0.02 < told["noise_q"].ci95[1]
    )
    assert told["noise"].value == pytest.approx(
        np.sqrt((told["noise_d"].value ** 2 + told["noise_q"].value ** 2) / 2), rel=1e-12
    )
    assert "noise_d" not in other and fit.logs[1].noise == "white"
    assert np.all(np.isfinite([c.difference for c in sysid.compare(fit)]))
    drawn = sysid.sample(fit, seed=0).summary()
    for name, p in drawn.items():
        if p.determined:  # the posterior of a nearly linear model is the fit's normal
            assert p.std == pytest.approx(fit.parameters[name].std, rel=0.1)
            assert abs(p.value - fit.parameters[name].value) < 0.1 * p.std


def test_equal_channels_stay_one_noise_and_coloured_rows_stay():
    seeds = 200
    false = [apart(parted(1.0, 1.0, [s, 8]), np.ones(101)) != 1.0 for s in range(seeds)]
    # a gain of four in log-likelihood: chi-square of one parameter exceeds eight in 0.5 % of cases
    assert np.sum(false) <= 5
    rows = [np.array([1, 1j]) @ coloured(np.random.default_rng([s, 9]), 400, 0.9) for s in range(20)]
    assert all(spikes(v, np.arange(400.0)) is None for v in rows)


def test_a_ratio_is_found_beside_outliers_and_outliers_where_they_are():
    rng = np.random.default_rng(10)
    wild = np.where(rng.random(400) < 0.05, 10.0, 1.0)
    from sysid.trials.noise import tails

    residual = wild * parted(1.0, 3.0, 11, 400)
    # levels of 400 rows, each to 4 %
    assert apart(residual, tails(residual)[0]) == pytest.approx(3.0, rel=0.2)
    v = np.array([1, 1j]) @ coloured(rng, 400, 0.9)
    hit = np.zeros(400, bool)
    hit[[0, 50, 51, 200, 201, 202, 399, *range(220, 380, 12)]] = True
    kept = spikes(v + np.where(hit, 10 * np.exp(2j * np.pi * rng.random(400)), 0.0), np.arange(400.0))
    np.testing.assert_array_equal(~kept, hit)
