"""The noise of a residual: level and correlation time of simulated Ornstein-Uhlenbeck noise, and when it is
called white."""

from dataclasses import fields, replace
from functools import cached_property

import numpy as np
import pytest
from conftest import most, seeds, study

import sysid
from sysid import Log
from sysid.trials.noise import FEW_STEPS, _grams, _whitened, estimate, tails
from sysid.trials.record import Record
from sysid.trials.trial import Trial

ROWS = 400


def ornstein_uhlenbeck(clock, std, time, rng, channels=2):
    """Noise of `std` per channel with correlation exp(-|t|/time), by its exact recursion from the stationary
    start."""
    white = rng.standard_normal((channels, len(clock)))
    keep = np.exp(-np.diff(clock) / time)
    for k in range(1, len(clock)):
        white[:, k] = keep[k - 1] * white[:, k - 1] + np.sqrt(1 - keep[k - 1] ** 2) * white[:, k]
    return std * (white[0] + 1j * white[1]) if channels == 2 else std * white[0]


def irregular(rng):
    return np.cumsum(rng.exponential(1.0, ROWS))


@pytest.mark.parametrize("channels", [1, 2])
def test_level_and_time_of_coloured_noise_on_irregular_grids(channels):
    seeds = 80
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        clock = irregular(rng)
        found.append(estimate(ornstein_uhlenbeck(clock, 0.3, 5.0, rng, channels), clock, channels * ROWS))
    level, time = np.log(np.array(found) / [0.3, 5.0]).T
    assert np.all(np.isfinite(time))  # never called white
    for logs in (level, time):
        # the maximum of a likelihood is biased by the order of its variance: 400 rows are 40 independent ones
        bias = logs.var()
        assert abs(logs.mean()) < 4 * logs.std() / np.sqrt(seeds) + bias
    # 2 * 40 correlation times per channel: the level to 8 %, the time to twice that; a factor of two for
    # irregular steps
    assert level.std() < 0.2
    assert time.std() < 0.4


def test_white_noise_is_called_white():
    called = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        clock = irregular(rng)
        called.append(estimate(rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS), clock, 2 * ROWS))
    level, time = np.array(called).T
    # a gain of four in log-likelihood: chi-square of one parameter exceeds eight in 0.5 % of cases
    assert np.mean(time == 0) >= 0.95
    assert abs(level[time == 0].mean() - 1) < 4 / np.sqrt(
        2 * 2 * ROWS * 200
    )  # an exact mean of exact estimates


def test_the_level_of_white_noise_counts_degrees_of_freedom():
    residual = np.array([1.0, -1.0, 1.0, -1.0, 2.0, -2.0])
    assert estimate(residual, np.arange(6.0), 4.0) == (np.sqrt(12 / 4), 0.0)


def test_scaling_times_and_levels_scales_the_answer():
    rng = np.random.default_rng(1)
    clock = irregular(rng)
    residual = ornstein_uhlenbeck(clock, 1.0, 5.0, rng)
    level, time = estimate(residual, clock, 2 * ROWS)
    scaled = estimate(1e-9 * residual, 1e6 * clock, 2 * ROWS)
    assert scaled == pytest.approx(
        (1e-9 * level, 1e6 * time), rel=1e-2
    )  # the search stops within 1e-3 of the logarithm


def test_equal_time_stamps_and_tiny_inputs_stay_finite():
    rng = np.random.default_rng(2)
    for clock in (np.zeros(20), np.repeat(np.arange(10.0), 2), np.arange(20.0)):
        level, time = estimate(rng.standard_normal(20), clock, 20.0)
        assert np.isfinite(level) and level > 0 and np.isfinite(time) and time >= 0
    for n in (1, 2, 3, 7):
        level, time = estimate(np.ones(n), np.arange(float(n)), float(n))
        assert (level, time) == (1.0, 0.0)
    assert estimate(np.zeros(30), np.arange(30.0), 30.0) == (0.0, 0.0)


@pytest.mark.parametrize(("exact", "told"), [(0.3, True), (0.7, False)])
def test_rows_of_one_value_have_no_tails(exact, told):
    """A Student-t distribution has no level, and all rows but those of one value no weight, where that value
    has more of them than nu/(nu + channels): of 1.5 degrees of freedom, the fewest tried, 0.6 of one
    channel."""
    rng = np.random.default_rng(5)
    residual = rng.standard_t(1.5, size=400)
    residual[rng.permutation(400)[: int(exact * 400)]] = 0.0
    with np.errstate(all="raise"):
        weight, information = tails(residual)
    assert np.all(np.isfinite(weight)) and 0 < information <= 1
    assert bool(np.any(weight != 1)) is told


def test_whitening_undoes_the_recursion():
    rng = np.random.default_rng(3)
    clock = irregular(rng)
    white, shrink = _whitened(ornstein_uhlenbeck(clock, 1.0, 3.0, rng), np.diff(clock), 3.0)
    # a sum of 2 * 400 squares of unit normals: 800 +- 40
    assert abs(np.sum(np.abs(white) ** 2) - 2 * ROWS) < 4 * np.sqrt(4 * ROWS)
    np.testing.assert_allclose(shrink, 1 - np.exp(-2 * np.diff(clock) / 3.0), rtol=1e-9, atol=1e-15)


CLOCKS = {
    "steady": lambda rng: 0.1 * np.arange(60.0),
    "rows left out": lambda rng: 0.1 * np.flatnonzero(rng.random(90) < 0.7),
    "irregular": lambda rng: np.cumsum(rng.exponential(1.0, 60)),
}


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_whitened_products_are_those_of_the_inverse_covariance(clock):
    """x^H R^-1 y and log det R, of the covariance R = exp(-|t - t'|/time) written out, for real and complex
    rows."""
    rng = np.random.default_rng(7)
    clock = clock(rng)
    times, rows = (
        np.array([0.05, 0.7, 20.0]),
        rng.standard_normal((3, len(clock))) + 1j * rng.standard_normal((3, len(clock))),
    )
    for x in (rows, rows.real):
        grams, shrunk = _grams(x, np.diff(clock), times)
        for k, time in enumerate(times):
            covariance = np.exp(-np.abs(clock[:, None] - clock) / time)
            np.testing.assert_allclose(
                grams[k], x @ np.linalg.solve(covariance, x.conj().T), rtol=1e-8
            )  # of a condition of 1e3
            np.testing.assert_allclose(shrunk[k], np.linalg.slogdet(covariance)[1], rtol=1e-9)


def test_a_clock_whose_digits_end_is_steady():
    """Stamps of 1e-9 s: their differences are two numbers and more, and one step."""
    clock = np.round(np.cumsum(np.full(40, 1e-4 / 3)), 12)
    grams, _ = _grams(np.ones((1, 40)), np.diff(clock), np.array([1e-4]))
    assert len(np.unique(np.diff(clock))) > FEW_STEPS
    assert grams[0, 0, 0] == pytest.approx(
        np.sum(np.linalg.inv(np.exp(-np.abs(clock[:, None] - clock) / 1e-4))), rel=1e-6
    )


def short_step(seed, rho, rows=30, channels=2):
    """A step of `rows` rows over six tau after 8 at rest, in noise of 1 % that each row shares with the one
    before."""
    rng, n = np.random.default_rng([seed, 12]), rows + 8
    time, drive = 6 * 1.67e-3 / rows * np.arange(n), np.where(np.arange(n) < 8, 0.0, 100.0)
    noise = rng.standard_normal((2, n))
    for k in range(1, n):
        noise[:, k] = rho * noise[:, k - 1] + np.sqrt(1 - rho**2) * noise[:, k]
    clean, (d, q) = -2 * np.expm1(-np.maximum(time - time[8], 0) / 1.67e-3), 0.02 * noise
    given = {"time": time, "drive": drive, "kind": "transient", "sampling": "instant"}
    if channels == 1:
        return sysid.Log("short", clean + d, **given)
    return sysid.Log("short", clean + d + 1j * q, frequency=np.full(n, 32300.0), **given)


@pytest.mark.parametrize("channels", [study(1), 2])
@pytest.mark.parametrize("rho", [0.0, 0.5])
@seeds(4, 80)
def test_errors_of_a_log_too_short_to_show_its_colour_are_true(seeds, rho, channels):
    """Taken for white, 80 % of the intervals of tau hold the truth at 0.5, and its spread is 1.6 of what it
    is said to be."""
    tau = [sysid.fit([short_step(seed, rho, channels=channels)]).parameters["tau"] for seed in seeds]
    spread = np.std([(p.value - 1.67e-3) / p.std for p in tau])
    left = 3 / np.sqrt(
        2 * len(seeds)
    )  # of 80 seeds 0.24; of white noise the interval is a tenth wider than if that were known
    assert 0.89 - left < spread < 1.06 + left


@pytest.mark.study
def test_noise_that_may_be_white_is_not_called_coloured():
    said = [sysid.fit([short_step(seed, 0.0)]).logs[0].noise for seed in range(20)]
    assert sum(s == "white, as far as so few rows tell" for s in said) >= 15


def sweep(seed, jump=0.0):
    """200 points over ten half bandwidths, with noise of 3 % of the peak that is correlated by 0.9; and a
    `jump` of f0."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-5, 5, 200)
    place = np.where(np.arange(200) > 102, x + jump, x)
    rows = 20.0 / (1 + 1j * place) + ornstein_uhlenbeck(np.arange(200.0), 0.6, 9.5, rng)
    return sysid.Log("sweep", rows, drive=np.full(200, 40.0), frequency=32300.0 + 95.3 * x, kind="steady")


@seeds(2, 12)
def test_noise_that_many_rows_share_is_no_misfit_and_may_hide_one(seeds, nuisances):
    fits = [sysid.fit([sweep(seed)], nuisances=nuisances) for seed in seeds]
    assert sum(fit.result is sysid.Result.misfit for fit in fits) <= 1
    assert all("may hide" in " ".join(fit.warnings) for fit in fits if fit.result is sysid.Result.successful)
    z = [(fit.parameters["G"].value - 0.5) / fit.parameters["G"].std for fit in fits]
    assert np.sqrt(np.mean(np.square(z))) < most(seeds, 3)
    spoilt = [sysid.fit([sweep(seed, jump=0.4)], nuisances=nuisances) for seed in seeds]
    assert sum(fit.result is sysid.Result.misfit for fit in spoilt) >= len(seeds) - 1


TIME = np.arange(60) * 1e-4
TURNING = np.exp(1j * np.arange(60))
KINDS = {
    "step": Log("step", TURNING, TIME, np.where(TIME < 1e-3, 0.0, 2.0), np.full(60, 1e3)),
    "amplitudes": Log("amplitudes", 1 + TIME, TIME, np.ones(60), np.full(60, 1e3)),
    "sweep": Log("sweep", TURNING, drive=np.ones(60), frequency=np.linspace(1e3, 2e3, 60)),
}


@pytest.mark.parametrize("log", KINDS.values(), ids=KINDS)
def test_what_is_known_of_a_trial_stays_known_where_it_does_not_change(log):
    trial = Trial.of(log, "transient" if log.time is not None else "steady")
    names = [n for x in (Record, Trial) for n, of in vars(x).items() if isinstance(of, cached_property)]
    assert {"shapes", "columns", "spans", "scale"} < {n for n in names if getattr(trial, n) is not None}
    noise, bench = trial.noise.at(0.3, 2e-4, (), 0.0), trial.bench
    changes = [{f.name: 0.3} for f in fields(bench) if f.name not in ("under", "narrow", "filter", "extra")]
    changes.append({"narrow": {"feedthrough": 1e-3, "lateness": 1e-9}})
    pairs = [(trial.in_noise(noise), replace(trial, noise=noise))]
    pairs += [(trial.with_bench(**x), replace(trial, bench=replace(bench, **x))) for x in changes]
    for kept, anew in pairs:
        for name in names:
            assert str(getattr(kept, name)) == str(getattr(anew, name)), name
