"""Noise that rows share beside noise of their own: what it costs, and that it is told from either alone."""

import numpy as np
import pytest
from conftest import seeds, study
from scipy.signal import lfilter

import sysid
from sysid.logs.log import Log
from sysid.trials.mixed import mixed
from sysid.trials.trial import NUISANCES

TAU, GAIN = 12.0, 4.0


def process(rng, n, std, time):
    """Ornstein-Uhlenbeck, from its stationary start."""
    a = np.exp(-1 / time)
    kicks = rng.standard_normal(n) * np.sqrt(1 - a * a)
    kicks[0] = rng.standard_normal()
    return std * lfilter([1.0], [1.0, -a], kicks)


def heater(rng, own, slow, time, n=900):
    """Two pulses of a heater of first order, at rows half a second apart, in noise of both kinds."""
    t = 0.5 * np.arange(n)
    drive, y = np.zeros(n), np.zeros(n)
    for on, off in ((20, 150), (250, 360)):
        drive[2 * on : 2 * off] = 1.0
        for at, size in ((on, GAIN), (off, -GAIN)):  # a row is held until the next
            y -= size * np.expm1(-np.maximum(t - at, 0) / TAU)
    y += own * rng.standard_normal(n) + process(rng, n, slow, time)
    return Log("heater", y, time=t, drive=drive, kind="transient", sampling="instant")


@pytest.mark.study
@pytest.mark.parametrize("time", [study(30.0), 200.0])
@seeds(10, 60)
def test_errors_hold_where_slow_noise_lies_under_that_of_rows(seeds, time):
    """They were up to four times too small: the rows' own noise hid how long the other lasts."""
    z = []
    for seed in seeds:
        fit = sysid.fit(heater(np.random.default_rng([seed, 7]), 0.04, 0.04, time), nuisances=NUISANCES)
        tau = fit.parameters["tau"]
        z.append((tau.value - TAU) / tau.std)
    # the root mean square of 10 normal numbers is below 1.5 once in fifty, and their largest below 3.5
    assert np.sqrt(np.mean(np.square(z))) < 1.5 and np.max(np.abs(z)) < 3.5, z


@pytest.mark.study
@seeds(5, 40)
def test_either_alone_is_not_both(seeds):
    for seed in seeds:
        for own, slow, time in ((0.04, 0.0, 1.0), (0.0, 0.04, 6.0)):
            fit = sysid.fit(heater(np.random.default_rng(seed), own, slow, time), nuisances=NUISANCES)
            (trial,), (model,) = fit.modes[0].trials, fit.modes[0].models
            assert mixed(trial, trial.residual(model)) is None


@pytest.mark.study
def test_both_are_told_apart():
    found = []
    for seed in range(8):
        fit = sysid.fit(heater(np.random.default_rng(seed), 0.04, 0.04, 40.0), nuisances=NUISANCES)
        (trial,), (model,) = fit.modes[0].trials, fit.modes[0].models
        found.append(mixed(trial, trial.residual(model)))
    assert np.mean([x.std for x in found]) == pytest.approx(0.04, rel=0.1)
    assert np.median([x.ratio for x in found]) == pytest.approx(1.0, rel=0.5)
    assert np.median([x.time for x in found]) == pytest.approx(40.0, rel=0.5)
