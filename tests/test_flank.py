"""A resonance outside of all frequencies at which it was driven: settled points say so or determine nothing,
a beat tells it."""

import numpy as np
import pytest
import reference
from conftest import study

import sysid

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=-10.0)
HALF = 1 / (2 * np.pi * PLANT.tau)  # half bandwidth, Hz
ROWS = 101


def swept(first, last, celsius=24.0, noise=1e-4, seed=0, **given):
    """Settled points from `first` to `last` half bandwidths above the resonance at 24 degC; noise of the
    largest response."""
    rng, frequency = np.random.default_rng(seed), PLANT.f0 + HALF * np.linspace(first, last, ROWS)
    drive, temperature = np.full(ROWS, 100.0), np.full(ROWS, celsius)
    clean = reference.steady(PLANT, drive, frequency, temperature)
    rows = clean + noise * np.max(np.abs(clean)) * (
        rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS)
    )
    columns = {"drive": drive, "frequency": frequency, "temperature": temperature, "kind": "steady"} | given
    return sysid.Log(f"sweep {first}", np.exp(0.7j) * rows, **columns)


def pulled(beside, seconds=0.02, noise=1e-3):
    """A step `beside` half bandwidths above the resonance, and its end, after which it rings down."""
    rng, time = np.random.default_rng(1), np.arange(0, seconds, 2e-5)
    drive = np.where((time > 1e-3) & (time < seconds / 2), 100.0, 0.0)
    frequency, temperature = np.full(len(time), PLANT.f0 + beside * HALF), np.full(len(time), 24.0)
    clean = reference.ringing(PLANT, time, drive, frequency, temperature)
    rows = clean + noise * np.max(np.abs(clean)) * (
        rng.standard_normal(len(time)) + 1j * rng.standard_normal(len(time))
    )
    return sysid.Log(
        "step", np.exp(0.7j) * rows, time=time, drive=drive, frequency=frequency, temperature=temperature
    )


def said(fit):
    return [warning for warning in fit.warnings if "half bandwidths" in warning]


def near(fit, *names):
    for name in names:
        found = fit.parameters[name]
        assert found.determined and abs(found.value - getattr(PLANT, name)) < 4 * found.std, (name, found)


@pytest.mark.parametrize(("first", "last"), [(-6, 6), (-0.5, 10), (0.8, 12), (-12, -0.8)])
def test_a_sweep_that_reaches_the_resonance_says_nothing(first, last):
    fit = sysid.fit([swept(first, last)])
    assert fit.result.name == "successful" and not said(fit)
    near(fit, "G", "tau", "f0")


@pytest.mark.parametrize(
    ("first", "last", "side"), [(1.5, 12, "below"), (2.5, 12, "below"), (-12, -1.5, "above")]
)
def test_a_flank_is_named(first, last, side):
    fit = sysid.fit([swept(first, last)])
    assert fit.result.name == "successful"
    near(fit, "G", "tau", "f0")
    (warning,) = said(fit)
    assert (
        f"{min(abs(first), abs(last)):.2g} half bandwidths, {side} all frequencies that were driven"
        in warning
    )


@pytest.mark.parametrize(("first", "last"), [(4, 14), (-20, -6), (10, 20)])
def test_a_tail_determines_nothing(first, last):
    """However small its noise is: more than noise may look like what it shows."""
    fit = sysid.fit([swept(first, last, noise=1e-6)])
    assert fit.result.name == "undetermined"
    for name in ("G", "tau", "f0"):
        assert not fit.parameters[name].determined
        assert (
            "all frequencies that were driven" in fit.parameters[name].why
            and "through it" in fit.parameters[name].why
        )
    assert said(fit)


@pytest.mark.parametrize("part", [np.array, np.abs])
def test_a_flank_in_noise_is_the_reason(part):
    """Points from 2.5 half bandwidths on that do not tell how wide the resonance is: a larger step, or a wider
    sweep about the peak of what was swept, would not hold its peak either."""
    log = swept(-8, -2.5, noise=0.02, seed=3)
    fit = sysid.fit([sysid.Log("sweep", part(log.response), None, log.drive, log.frequency)])
    assert fit.result.name == "undetermined"
    for name in ("G", "tau", "f0"):
        why = fit.parameters[name].why
        assert "above all frequencies that were driven" in why and "half bandwidths" not in why


def test_a_tail_recorded_with_its_time_determines_nothing():
    """Its points have settled by the time that they are read."""
    time = np.arange(ROWS) * 10 * PLANT.tau
    fit = sysid.fit([swept(5, 15, noise=1e-6, kind="transient", sampling="settled", time=time)])
    assert fit.result.name == "undetermined" and said(fit)


def test_each_log_is_judged_at_its_own_temperature():
    """Where it is warm the resonance lies 4 half bandwidths lower."""
    cold, warm = 24.0, 24.0 + 4 * HALF / 10.0
    assert not said(sysid.fit([swept(-3, 0.5, cold), swept(-6, -3.5, warm, seed=1)]))
    away = sysid.fit(
        [swept(5, 12, cold), swept(1, 12, warm, noise=1e-6, seed=1)]
    )  # driven where it lies in the cold
    assert away.result.name == "undetermined" and said(away)


@pytest.mark.parametrize("beside", [study(-12), -4, study(4), study(12)])
def test_a_beat_tells_how_far_the_resonance_is(beside):
    fit = sysid.fit([pulled(beside)])
    assert fit.result.name == "successful" and not said(fit)
    near(fit, "tau", "f0")
    both = sysid.fit([pulled(beside), swept(5, 15)])
    assert both.result.name == "successful" and not said(both)
    near(both, "G", "tau", "f0")
