"""A finger whose force is recorded: its damping and detuning are fitted beside the plate. The physics is
tests/reference.py."""

import dataclasses

import numpy as np
import pytest
import reference
from scipy.stats import chi2

import sysid
from sysid import Result
from sysid.scene.effects import FingerDamping, WhiteNoise

RHO, SHIFT = 0.8, -12.0  # damping that 1.5 N add, in units of the plate's own; Hz
PRESS = np.interp(np.arange(240), [110, 130], [0.0, 1.5])  # N, after the plate has settled


def ratio(force):
    """Contact, 1 at 1.5 N."""
    return reference.touched(reference.Plant(1.0, 1.0, 0.0, 0.0), force)[1] ** -1 - 1


def pressed(bench, seed, amplitude=False, force=PRESS, law=ratio):
    """A step of 24 ms that is touched on its way; what the finger shifts, the reference takes as warmth."""
    plant, time = bench.plant, 1e-4 * np.arange(240)
    volts, frequency = np.repeat([0.0, 100.0], [20, 220]), np.full(240, 32290.0)
    touch = law(0.5 * (force + np.append(force[1:], force[-1])))
    warmth = 24.0 + SHIFT * touch / plant.k_T
    clean = reference.ringing(plant, time, volts, frequency, warmth, plant.tau / (1 + RHO * touch))
    rows = np.exp(0.3j) * clean + reference.noise(240, 0.02, seed)
    given = {"drive": volts, "frequency": frequency, "temperature": np.full(240, 24.0), "sampling": "instant"}
    return sysid.Log("pressed", np.abs(rows) if amplitude else rows, time=time, force=force, **given)


def test_what_it_adds_is_told_beside_the_plate_s_own(bench):
    truth = {
        "G": bench.plant.G,
        "tau": bench.plant.tau,
        "f0": bench.plant.f0,
        "finger_damping": RHO,
        "finger_detuning": SHIFT,
    }
    total, count = 0.0, 0
    for seed in range(4):
        fit = sysid.fit([pressed(bench, seed)])
        assert fit.result is Result.successful
        assert set(fit.names) == set(truth)
        off = np.array([fit.parameters[n].value - truth[n] for n in fit.names])
        assert all(abs(d) < 4.5 * fit.parameters[n].std for d, n in zip(off, fit.names, strict=True))
        total, count = total + off @ np.linalg.solve(fit.covariance, off), count + len(off)
    assert 1e-3 < chi2.sf(total, count) < 1 - 1e-3


def swept(bench, seed, force, law=ratio):
    """Settled points under a finger."""
    damped = 1 + RHO * law(force)
    plant = dataclasses.replace(bench.plant, G=bench.plant.G / damped, tau=bench.plant.tau / damped)
    frequency = np.linspace(31800, 32800, 101)
    rows = reference.steady(plant, 100.0, frequency - SHIFT * law(force), 24.0) + reference.noise(
        101, 0.02, seed
    )
    inputs = {"drive": np.full(101, 100.0), "frequency": frequency, "temperature": np.full(101, 24.0)}
    return sysid.Log(f"{force} N", rows, force=np.full(101, force), **inputs)


def test_settled_points_with_and_without_it(bench):
    fit = sysid.fit([bench.sweep(), swept(bench, 1, 0.3), swept(bench, 2, 1.5)])
    assert fit.result is Result.successful
    assert "sweep: no force is recorded; taken as with nothing on the plate" in fit.warnings
    for name, truth in (("tau", bench.plant.tau), ("finger_damping", RHO), ("finger_detuning", SHIFT)):
        assert abs(fit.parameters[name].value - truth) < 4.5 * fit.parameters[name].std
    draws = sysid.sample(fit).draws
    assert np.std(draws["finger_damping"]) == pytest.approx(
        fit.parameters["finger_damping"].std, rel=0.15
    )  # of 1000 draws: 2 %


def power(force):
    """Contact by another law: it does not saturate, and halves that of the fitted one at a light touch."""
    return (force / 1.5) ** 0.6


ANOTHER = "the effect of the finger grows with its force by another law"


def test_another_law_of_the_force_is_named(bench, nuisances):
    stairs = np.interp(np.arange(240), [90, 110, 150, 170], [0.0, 0.4, 0.4, 3.0])
    settled = [bench.sweep(), *(swept(bench, i + 1, force, power) for i, force in enumerate((0.3, 1.5, 4.0)))]
    for logs in ([pressed(bench, 0, force=stairs, law=power)], settled):
        fit = sysid.fit(logs, nuisances=nuisances)
        assert fit.result is Result.misfit and any(w.startswith(ANOTHER) for w in fit.warnings)
    own = sysid.fit([pressed(bench, 0, force=stairs)])
    assert own.result is Result.successful and not any(ANOTHER in w for w in own.warnings)


def test_another_law_of_a_scene_is_named(nuisances):
    plate = sysid.Plant(0.02, 5e-3 / np.log(20), 32300.0, -10.16)
    stairs = sysid.Profile([0.0, 9e-3, 11e-3, 15e-3, 17e-3], [0.0, 0.0, 0.4, 0.4, 3.0], held=False)
    inputs = {
        "drive": sysid.Profile([0.0, 2e-3], [0.0, 100.0]),
        "frequency": sysid.Profile.constant(32290.0),
        "force": stairs,
    }
    effects = (FingerDamping(law="power", exponent=0.6), WhiteNoise(std=0.02))
    log = sysid.Scene(plate, inputs, 240, 1e4, effects, fidelity="envelope").simulate(seed=0)
    fit = sysid.fit([log], nuisances=nuisances)
    assert fit.result is Result.misfit and any(w.startswith(ANOTHER) for w in fit.warnings)


def test_a_light_touch_alone_says_from_where_it_is_carried(bench):
    """Its damping at 1.5 N follows by the law alone, which one force does not show: wrong here, and said."""
    fit = sysid.fit([bench.sweep(), swept(bench, 1, 0.3, power)])
    found = fit.parameters["finger_damping"]
    assert fit.result is Result.successful and abs(found.value - RHO) > 10 * found.std
    assert any("carried there from 0.3 N by the law of its" in w for w in fit.warnings)
    assert not any("carried there" in w for w in sysid.fit([bench.sweep(), swept(bench, 1, 1.5)]).warnings)


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
