"""What a log alone shows against its rows: a range that was changed, a few clipped rows, damping that goes
with the amplitude."""

from dataclasses import replace

import numpy as np
import pytest
import reference

import sysid
from sysid import Result
from sysid.trials.trial import Trial
from sysid.verdict import recorder

PLANT = reference.Plant(G=1.0, tau=1.67e-3, f0=32300.0, k_T=0.0)
N, EARLY, DT = 220, 20, 1e-4


def step(seed, level=0.01, rows=N):
    """1 V from row EARLY on, at resonance, in white noise."""
    time, drive, frequency = DT * np.arange(rows), 1.0 * (np.arange(rows) >= EARLY), np.full(rows, PLANT.f0)
    response = reference.ringing(PLANT, time, drive, frequency, np.full(rows, 24.0)) + reference.noise(
        rows, level, seed
    )
    return sysid.Log(
        "step", response, time=time, drive=drive, frequency=frequency, kind="transient", sampling="instant"
    )


def scaled(log, row, by):
    return replace(log, response=log.response * np.where(np.arange(len(log)) < row, 1.0, by))


@pytest.mark.parametrize("row", [28, 40, 100])
@pytest.mark.parametrize("by", [0.1, 10.0, 1000.0])
def test_a_range_that_changes_amid_a_transient_is_named(row, by):
    """Eight rows after the change and later: it was called a late trigger, or a response that is not of one
    resonance."""
    fit = sysid.fit([scaled(step(row), row, by)])
    assert fit.result in (Result.misfit, Result.undetermined)
    said = [
        w
        for w in fit.warnings
        if f"from row {row} (counted from 0) on its response is {by:g} times as large" in w
    ]
    assert said, fit.warnings


def test_a_range_that_changes_between_a_step_up_and_one_down_is_named():
    """It was "restless", by which tau was that of the decay, in another range than the rows before."""
    log = step(0, 0.003)
    drive = log.drive * (np.arange(N) < 110)
    response = reference.ringing(PLANT, log.time, drive, log.frequency, np.full(N, 24.0))
    log = replace(log, drive=drive, response=response + reference.noise(N, 0.003, 1))
    fit = sysid.fit([scaled(log, 70, 10.0)])
    assert [f.key for f in fit.findings] == ["range"] and fit.result is Result.misfit
    assert not any(p.determined for p in fit.parameters.values())  # of rows that are to be scaled first


def test_no_range_changes_in_what_goes_on():
    """Steps and ring-downs of all kinds of noise, some in coarse steps, of two to sixty rows in one tau."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        level, rows = 10 ** rng.uniform(-4, -0.7), int(rng.integers(60, 400))
        log = step(seed, level, rows)
        if seed % 2:
            grid = 10 ** -rng.uniform(1, 3)
            coarse = grid * (np.round(log.response.real / grid) + 1j * np.round(log.response.imag / grid))
            log = replace(log, response=coarse)
        assert recorder.ranged(Trial.of(log, "transient")) is None


def decay(seed, softening):
    """|W| of dW/dt = -(1 + softening W^2) W/tau in noise, without drive and frequency: W^-2 + s = (1 + s)
    e^(2t/tau)."""
    time = DT * np.arange(150)
    w = ((1 + softening) * np.exp(2 * time / PLANT.tau) - softening) ** -0.5
    return sysid.Log("bare", np.abs(w + reference.noise(len(time), 0.005, seed)), time=time, kind="transient")


@pytest.mark.study
def test_damping_that_depends_on_the_amplitude_shows_in_a_bare_amplitude(among):
    """A fifth more damping at the first row: eleven errors of tau, which nothing said."""
    for seed in range(5):
        fit = sysid.fit([decay(seed, 0.2)], nuisances=among("amplitude_damping"))
        assert fit.result is Result.misfit
        assert any("damping depends on the amplitude, by about +" in w for w in fit.warnings)


def test_without_it_nothing_is_said():
    for seed in range(5):
        fit = sysid.fit([decay(seed, 0.0)])
        assert fit.result is Result.successful
        assert not any("damping" in w for w in fit.warnings)


def sweep(seed, limit):
    """|W| at 81 settled points of 10 Hz, none larger than `limit` of the peak."""
    frequency = PLANT.f0 + np.linspace(-400, 400, 81)
    clean = reference.steady(PLANT, np.ones(81), frequency, 24.0)
    w = np.minimum(np.abs(clean + reference.noise(81, 0.005, seed)), limit)
    return sysid.Log("sweep", w, drive=np.ones(81), frequency=frequency, kind="steady")


def test_a_few_clipped_rows_are_no_chance():
    """Three to five rows of a peak that is cut by 2 %: G and tau were 2.8 and 2.4 of their errors too
    small."""
    for seed in range(10):
        fit = sysid.fit([sweep(seed, 0.98)])
        assert fit.result is Result.misfit and "rows lie exactly at 0.98" in " ".join(fit.warnings)
        assert sysid.fit([sweep(seed, np.inf)]).result is Result.successful


def railed(level, most):
    """Two steps and a ring-down of 40 time constants each, of which no reading exceeds `most`; a file's ten
    digits."""
    rows, rng = 2000, np.random.default_rng(0)
    time, drive = DT * np.arange(rows), np.repeat([0.0, 1.0, 0.5, 1.0], rows // 4)
    w = reference.ringing(PLANT, time, drive, np.full(rows, PLANT.f0), np.full(rows, 24.0))
    w = np.minimum(w.real + level * rng.standard_normal(rows), most) + 1j * level * rng.standard_normal(rows)
    log = sysid.Log(
        "railed", np.round(w, 10), time=time, drive=drive, frequency=np.full(rows, PLANT.f0), kind="transient"
    )
    return recorder.clipped(Trial.of(log, "transient"))


def test_a_response_that_settles_without_noise_is_not_clipped():
    """It repeats itself for hundreds of rows; with noise nothing does, but at a rail."""
    assert railed(0.0, np.inf) is None
    assert railed(1e-4, np.inf) is None
    for most in (0.9, 0.9999):
        assert f"at {most:g} in d" in railed(1e-4, most)
