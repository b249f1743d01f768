"""Laws that hold whatever the numbers are: of the slowly varying model, of the order of logs, of the
information in them."""

from dataclasses import replace
from itertools import accumulate, pairwise, permutations

import jax
import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

import sysid
from sysid.model.course import by_program
from sysid.model.likelihood import linearised
from sysid.model.theta import NAMES
from sysid.trials.experiment import group
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

PLANT = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=-8.0)
TIME, ROWS = 1e-4 * np.arange(120), 120
WARM, STEPS = np.full(ROWS, 24.0), np.repeat([0.0, 100.0, -40.0], [20, 60, 40])
NUMBERS = {"allow_nan": False, "allow_infinity": False}


def transient(drive=STEPS, frequency=None, name="log", response=None, **given):
    frequency = np.full(ROWS, PLANT.f0) if frequency is None else frequency
    response = np.ones(ROWS, complex) if response is None else response
    return sysid.Log(
        name,
        response,
        time=TIME,
        drive=drive,
        frequency=frequency,
        kind="transient",
        sampling="instant",
        **given,
    )


def envelope(tau, offsets, around=PLANT.f0):
    """The slowly varying response of a plate whose resonance lies at `around` to a drive `offsets` (n,) above
    it."""
    trial = Trial.of(transient(frequency=around + offsets), "transient")
    theta = np.array([np.log(PLANT.G), np.log(tau), 0.0, 0.0, 0.0, 0.0])
    return LogResponse(trial, trial.hold((around, 24.0)), theta).envelope.forced


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-5, 1.0), st.lists(st.floats(-2000, 2000, **NUMBERS), min_size=1, max_size=4))
def test_mirrored_detunings_conjugate_the_slowly_varying_response(tau, levels):
    offsets = np.round(np.resize(np.repeat(levels, 30), ROWS), 3)
    # f - f0 is rounded to half a unit in the last place of 32300 Hz; over the log that turns the phase by as
    # much.
    turned = 2 * np.pi * np.spacing(PLANT.f0 + 2000.0) * TIME[-1]
    above, below = envelope(tau, offsets), envelope(tau, -offsets)
    assert np.max(np.abs(above - below.conj())) <= (turned + 1e-14) * 3 * PLANT.G * 100


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-5, 1.0), st.floats(-500, 500, **NUMBERS), st.sampled_from([1e3, 1e5, 1e7]))
def test_the_slowly_varying_response_depends_on_detunings_alone(tau, offset, around):
    offsets = np.full(ROWS, offset)
    rounded = (around + offsets) - around  # the detuning that a log of this frequency can state
    near, far = envelope(tau, rounded, 0.0), envelope(tau, offsets, around)
    assert np.max(np.abs(near - far)) <= 1e-13 * 3 * PLANT.G * 100


def bench(seed):
    """A step, a sweep and a fast sweep, of different lengths and temperatures."""
    rng = np.random.default_rng(seed)

    def noisy(clean):
        return clean + 0.02 * rng.standard_normal((2, len(clean))).T @ [1, 1j]

    f = PLANT.f0 + np.linspace(-400, 400, ROWS)
    step = reference.ringing(PLANT, TIME, STEPS, np.full(ROWS, PLANT.f0), WARM)
    fast = reference.ringing(PLANT, TIME, STEPS, f, WARM + 2)
    settled = PLANT.f0 + np.linspace(-500, 500, 61)
    sweep = reference.steady(PLANT, np.full(61, 100.0), settled, np.full(61, 29.0))
    given = {
        "drive": np.full(61, 100.0),
        "frequency": settled,
        "temperature": np.full(61, 29.0),
        "kind": "steady",
    }
    return [
        transient(name="step", response=noisy(step), temperature=WARM),
        transient(name="fast", frequency=f, response=noisy(fast), temperature=WARM + 2),
        sysid.Log("sweep", noisy(sweep), **given),
    ]


def test_the_order_of_the_logs_changes_nothing():
    logs = bench(1)
    first = sysid.fit(logs)
    for order in permutations(logs):
        again = sysid.fit(order)
        assert again.result is first.result
        for name, p in first.parameters.items():
            other = again.parameters[name]
            # The search ends where a sum of squares has 1e-7 left to gain, 3e-4 standard deviations; other
            # sums are less.
            assert other.value == pytest.approx(p.value, abs=1e-3 * p.std), name
            assert other.std == pytest.approx(p.std, rel=1e-3), name


def information(trial, reference, theta):
    """J^T J of a trial at theta, its noise as it is."""
    with jax.enable_x64(True):
        ((layout, stacked),) = group((trial,), reference)[0]
        _, rows = linearised(*by_program(theta, np.eye(len(NAMES)), stacked, layout), stacked, layout)
        return (rows[0] @ rows[0].conj().T).real


def test_another_log_never_lowers_the_information():
    found = sysid.fit(bench(2))
    trials, rng = found.modes[0].trials, np.random.default_rng(3)
    longer = replace(trials[2], nuisances=())  # with less that is unknown
    for _ in range(3):
        theta = found.modes[0].theta + np.append([0.1, 0.1, 20.0, 2.0], [0, 0]) * rng.standard_normal(6)
        scale = np.array([1, 1, 100.0, 10.0])
        known = [
            information(t, found.reference, theta)[:4, :4] * np.outer(scale, scale) for t in (*trials, longer)
        ]
        for less, more in pairwise(accumulate(known)):
            assert np.linalg.eigvalsh(more - less)[0] > -1e-12 * np.trace(more)  # a sum over 10 000 products
