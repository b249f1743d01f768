"""A finger whose force is recorded: its damping and detuning are fitted beside the plate. The physics is tests/reference.py."""

import dataclasses

import numpy as np
import pytest
import reference
from scipy.stats import chi2

import sysid
from sysid import Result

RHO, SHIFT = 0.8, -12.0  # damping that 1.5 N add, in units of the plate's own; Hz
PRESS = np.interp(np.arange(240), [110, 130], [0.0, 1.5])  # N, after the plate has settled


def ratio(force):
    """Contact, 1 at 1.5 N."""
    return reference.touched(reference.Plant(1.0, 1.0, 0.0, 0.0), force)[1] ** -1 - 1


def pressed(bench, seed, amplitude=False):
    """A step of 24 ms that is touched on its way; what the finger shifts, the reference takes as warmth."""
    plant, time = bench.plant, 1e-4 * np.arange(240)
    volts, frequency = np.repeat([0.0, 100.0], [20, 220]), np.full(240, 32290.0)
    touch = ratio(0.5 * (PRESS + np.append(PRESS[1:], PRESS[-1])))
    warmth = 24.0 + SHIFT * touch / plant.k_T
    clean = reference.ringing(plant, time, volts, frequency, warmth, plant.tau / (1 + RHO * touch))
    rows = np.exp(0.3j) * clean + reference.noise(240, 0.02, seed)
    given = {"drive": volts, "frequency": frequency, "temperature": np.full(240, 24.0), "sampling": "instant"}
    return sysid.Log("pressed", np.abs(rows) if amplitude else rows, time=time, force=PRESS, **given)


def test_what_it_adds_is_told_beside_the_plate_s_own(bench):
    truth = {"G": bench.plant.G, "tau": bench.plant.tau, "f0": bench.plant.f0, "finger_damping": RHO, "finger_detuning": SHIFT}
    total, count = 0.0, 0
    for seed in range(4):
        fit = sysid.fit([pressed(bench, seed)])
        assert fit.result is Result.successful
        assert set(fit.names) == set(truth)
        off = np.array([fit.parameters[n].value - truth[n] for n in fit.names])
        assert all(abs(d) < 4.5 * fit.parameters[n].std for d, n in zip(off, fit.names, strict=True))
        total, count = total + off @ np.linalg.solve(fit.covariance, off), count + len(off)
    assert 1e-3 < chi2.sf(total, count) < 1 - 1e-3


def test_settled_points_with_and_without_it(bench):
    logs = [bench.sweep()]
    for seed, force in ((1, 0.3), (2, 1.5)):
        damped = 1 + RHO * ratio(force)
        plant = dataclasses.replace(bench.plant, G=bench.plant.G / damped, tau=bench.plant.tau / damped)
        frequency = np.linspace(31800, 32800, 101)
        rows = reference.steady(plant, 100.0, frequency - SHIFT * ratio(force), 24.0) + reference.noise(101, 0.02, seed)
        inputs = {"drive": np.full(101, 100.0), "frequency": frequency, "temperature": np.full(101, 24.0)}
        logs.append(sysid.Log(f"{force} N", rows, force=np.full(101, force), **inputs))
    fit = sysid.fit(logs)
    assert fit.result is Result.successful
    assert "sweep: no force is recorded; taken as with nothing on the plate" in fit.warnings
    for name, truth in (("tau", bench.plant.tau), ("finger_damping", RHO), ("finger_detuning", SHIFT)):
        assert abs(fit.parameters[name].value - truth) < 4.5 * fit.parameters[name].std
    draws = sysid.sample(fit).draws
    assert np.std(draws["finger_damping"]) == pytest.approx(fit.parameters["finger_damping"].std, rel=0.15)  # of 1000 draws: 2 %


def test_an_amplitude_does_not_tell_damping_from_detuning(bench):
    fit = sysid.fit([pressed(bench, 0, amplitude=True), bench.sweep(seed=1)])
    assert fit.parameters["tau"].determined
    finger = fit.parameters["finger_detuning"]
    assert finger.determined or "record wd and wq under the finger" in finger.why


def test_a_sensor_that_counts_pressure_below_zero_shows_the_same_finger(bench):
    log = pressed(bench, 0)
    either = [sysid.fit([dataclasses.replace(log, force=sign * PRESS)]).plant for sign in (1, -1)]
    assert either[0] == either[1]


def test_a_log_without_a_finger_has_no_finger(bench):
    assert set(sysid.fit([bench.sweep()]).parameters) == {"G", "tau", "f0", "k_T"}
