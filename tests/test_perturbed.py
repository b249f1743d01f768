"""The course of a log in plain numpy, and what small changes of the physics add to it, against the closed
form."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import seeds
from reference import REFERENCE_TEMPERATURE, Plant, noise, ringing

import sysid
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

PLANT = Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=-8.0)
WITHIN = {"G": 1e-4 * PLANT.G, "tau": 1e-4 * PLANT.tau, "f0": 0.01, "k_T": 1e-3}
THETA = np.array([np.log(PLANT.G), np.log(PLANT.tau), 0.0, PLANT.k_T, 0.0, 0.0])


def rows_far_apart(n=60, spacing=(0.3, 3.0), seed=0):
    """Times, drive, frequency and temperature that change from row to row, rows a good part of tau or more
    apart."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(PLANT.tau * rng.uniform(*spacing, n))
    return (
        time - time[0],
        rng.uniform(0, 100, n),
        PLANT.f0 + rng.uniform(-300, 300, n),
        24 + rng.uniform(-5, 5, n),
    )


def course(time, drive, frequency, temperature, **bench):
    given = {
        "drive": drive,
        "frequency": frequency,
        "temperature": temperature,
        "bench": bench,
        "sampling": "instant",
    }
    trial = Trial.of(
        sysid.Log("log", np.ones(len(time), complex), time=time, kind="transient", **given), "transient"
    )
    return LogResponse(trial, trial.hold((PLANT.f0, REFERENCE_TEMPERATURE)), THETA)


def changed(inputs, **step):
    """Central difference of the closed form by one parameter."""
    (name, size), *_ = step.items()
    sides = (replace(PLANT, **{name: getattr(PLANT, name) + sign * size}) for sign in (1, -1))
    above, below = (ringing(plant, *inputs) for plant in sides)
    return (above - below) / (2 * size)


def test_derivatives_of_rows_far_apart_are_those_of_the_closed_form():
    """Taken as straight lines from row to row they were off by a seventh."""
    inputs = rows_far_apart()
    found = course(*inputs).derivatives()
    scale = {"G": PLANT.G, "tau": PLANT.tau}  # theta has their logarithms
    for k, (name, size) in enumerate(WITHIN.items()):
        expected = changed(inputs, **{name: size}) * scale.get(name, 1.0)
        # two differences, of steps whose squares are below 1e-7
        np.testing.assert_allclose(
            found[1:, k], expected[1:], rtol=0, atol=1e-6 * np.max(np.abs(expected))
        )  # from rest


def test_a_resonance_that_drifts_is_one_that_is_held_from_row_to_row_at_its_value_halfway():
    time, drive, frequency, temperature = rows_far_apart()
    drift = np.linspace(-1.0, 1.0, len(time))
    halfway = np.append(0.5 * (drift[1:] + drift[:-1]), 0.0)
    found = course(time, drive, frequency, temperature).along(2j * np.pi * drift)
    step = 0.01 / PLANT.k_T  # degC of the plate, a hundredth of a hertz
    sides = [ringing(PLANT, time, drive, frequency, temperature + sign * step * halfway) for sign in (1, -1)]
    expected = (sides[0] - sides[1]) / 0.02
    np.testing.assert_allclose(found[1:], expected[1:], rtol=0, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.parametrize("order", [1, 4])
def test_what_a_change_adds_behind_a_filter_is_filtered(order):
    """Of rows a twentieth of the filter's time constant apart; the filter is that of tests/reference.py's
    rows, by exact steps from row to row of a response that is straight in between."""
    n, lockin = 3000, 2e-4
    time, drive = lockin / 20 * np.arange(n), np.where(np.arange(n) < 200, 0.0, 100.0)
    inputs = time, drive, np.full(n, PLANT.f0 + 40.0), np.full(n, 24.0)
    expected, decay = changed(inputs, f0=0.01), np.exp(-1 / 20)
    for _ in range(order):
        slope, passed = np.diff(expected) * 20, np.zeros(n, complex)
        for k in range(n - 1):
            passed[k + 1] = passed[k] * decay + (1 - decay) * (expected[k] - slope[k]) + slope[k] / 20
        expected = passed
    found = course(*inputs, lockin_tau_s=lockin, lockin_order=order)
    trial = found.trial
    at = np.searchsorted(
        time, trial.log.time
    )  # a long log's rows are means; that of an even number lies between two rows
    given = found.derivatives()[:, 2]
    np.testing.assert_allclose(
        given, expected[np.minimum(at, n - 1)], rtol=0, atol=5e-3 * np.max(np.abs(expected))
    )


def fast_sweep(degC, seed, rows=80, flicker=0.02):
    """A sweep of one tau at each frequency, of a plate of Q 17 000, read by a thermometer that flickers."""
    plant = Plant(G=1.0, tau=0.1, f0=50_000.0, k_T=-10.0)
    rng = np.random.default_rng([seed, int(degC)])
    f0 = plant.f0 + plant.k_T * (degC - 24.0)
    time, frequency = plant.tau * np.arange(rows), f0 + np.linspace(-8, 8, rows)
    clean = ringing(plant, time, np.ones(rows), frequency, np.full(rows, degC))
    read = degC + flicker * rng.standard_normal(rows)
    log = sysid.Log(f"{degC:g} degC", clean + noise(rows, 1e-3, 100 * seed + int(degC)), time=time, drive=np.ones(rows),
                    frequency=frequency, temperature=read, kind="transient", sampling="instant")  # fmt: skip
    return plant, log


@pytest.mark.study
@seeds(3, 12)
def test_a_thermometers_error_is_in_the_interval_of_fast_sweeps(seeds):
    """Its shape was off by a seventh, so that what the logs tell of f0 was taken to tell their thermometers'
    errors: f0 and k_T 20 standard deviations off."""
    scores = {"f0": [], "k_T": []}
    for seed in seeds:
        plant, logs = None, []
        for degC in (19.0, 24.0, 30.0):
            plant, log = fast_sweep(degC, seed)
            logs.append(log)
        found = sysid.fit(logs)
        assert found.result is sysid.Result.successful, found.warnings
        for name, truth in (("f0", plant.f0), ("k_T", plant.k_T)):
            p = found.parameters[name]
            scores[name].append((p.value - truth) / p.std)
    for z in scores.values():  # three standard deviations of the mean square of as many normal numbers
        assert np.mean(np.square(z)) < 1 + 3 * np.sqrt(2 / len(seeds)), z


@pytest.mark.study
def test_a_large_error_of_the_thermometer_is_taken_at_the_plates_own_temperature():
    """To first order alone about the reading, a fit may end twice as far off on the other side."""
    logs = []
    for degC, off in ((19.0, 0.03), (24.0, -0.05), (30.0, 0.04)):
        plant, log = fast_sweep(degC, 3, flicker=0.0)
        logs.append(replace(log, temperature=log.temperature + off, bench={"temperature_std_degC": 0.04}))
    found = sysid.fit(logs)
    assert found.result is sysid.Result.successful, found.warnings
    for name, truth in (("f0", plant.f0), ("k_T", plant.k_T)):
        p = found.parameters[name]
        assert abs(p.value - truth) < 3 * p.std
    drawn = sysid.sample(found).summary()
    for std in (found.parameters["f0"].std, drawn["f0"].std):
        assert std == pytest.approx(abs(plant.k_T) * 0.04 / np.sqrt(3), rel=0.1)
