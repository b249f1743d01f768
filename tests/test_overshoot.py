"""A plant of second order, seen without a frequency: it overshoots, or its own oscillation is what was
recorded."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import seeds, study
from scipy import signal

import sysid
from sysid import Log, Result
from sysid.model.plant import SECOND, respond
from sysid.rows.hold import hold_inputs

HERTZ, ROWS = 170.0, 440


def stepped(zeta, seed, gain=3.0):
    """A step of a second-order plant, by its closed form, with 0.5 % of noise."""
    w, time = 2 * np.pi * HERTZ, 1e-4 * (np.arange(ROWS) - 20)
    x, s = np.maximum(time, 0), np.sqrt(1 - zeta**2)
    clean = np.where(
        time > 0, 1 - np.exp(-zeta * w * x) * (np.cos(s * w * x) + zeta / s * np.sin(s * w * x)), 0.0
    )
    noise = 0.005 * np.random.default_rng(seed).standard_normal(ROWS)
    drive = np.where(time < -1e-12, 0.0, 2.0)
    return Log("step", gain * (clean + noise), time=time, drive=drive, kind="transient", sampling="instant")


def decaying(seed):
    """An oscillation of 1.9 Hz that decays with 2.9 s, begun at any phase, sampled unevenly 20 times a
    second."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0, 4, 80))
    clean = np.cos(2 * np.pi * 1.9 * time + rng.uniform(0, 2 * np.pi)) * np.exp(-time / 2.9)
    return Log("raw", 50 + clean + 0.02 * rng.standard_normal(80), time=time, kind="transient")


def found(fit):
    return next((f for f in fit.findings if f.key == "overshoot"), None)


@pytest.mark.parametrize("damping", [0.04, 0.5, 0.999999999, 1.0, 3.0])
def test_the_response_is_that_of_the_differential_equation(damping):
    """Against scipy's, also where both poles coincide."""
    rng, time, own = np.random.default_rng(1), np.linspace(0, 0.05, 400), 1 / (2 * np.pi * HERTZ)
    drive = np.repeat(rng.standard_normal(8), 50)
    hold = hold_inputs(time, drive, None, None, settled=False, reference=(0.0, 24.0), at_rest=True)
    tau = 2 * damping * own
    had = respond(
        np.float64(tau), np.zeros(len(hold.drive)), hold._replace(smoothing=own), order=SECOND, xp=np
    )
    system = signal.StateSpace(*signal.tf2ss([1.0], [own**2, tau, 1.0]))
    _, want, _ = signal.lsim(system, drive, time, interp=False)
    np.testing.assert_allclose(
        had.forced.real, want, atol=2e-7
    )  # six digits of sixteen are lost where the poles coincide
    assert np.max(np.abs(had.forced.imag)) < 1e-7
    start = (
        np.array([0.0, own**2]) if system.C[0, 1] == system.C.max() else None
    )  # a unit displacement at rest
    _, free, _ = signal.lsim(system, 0 * time, time, X0=start)
    np.testing.assert_allclose(had.free.real, free, atol=2e-7)


@pytest.mark.parametrize("zeta", [study(0.05), 0.3, study(0.6)])
@seeds(1, 20)
def test_a_step_that_overshoots_is_called_that(zeta, seeds, among):
    off = []
    for seed in seeds:
        fit = sysid.fit(stepped(zeta, seed), nuisances=among("overshoot"))
        assert fit.result is Result.misfit and found(fit).outcome == "refused", fit.warnings
        assert not any(
            fit.parameters[n].determined for n in ("G", "tau")
        )  # of the first order, which this is not
        numbers = found(fit).numbers
        truth = {"natural_Hz": HERTZ, "damping_ratio": zeta}
        off += [(numbers[n].value - true) / numbers[n].std for n, true in truth.items()]
    assert np.max(np.abs(off)) < 4.5, off


@seeds(2, 20)
def test_an_oscillation_that_was_not_demodulated_is_called_that(seeds, among):
    for seed in seeds:
        fit = sysid.fit(decaying(seed), nuisances=among("overshoot"))
        assert not any(p.determined for p in fit.parameters.values())
        if fit.result is Result.misfit:
            assert found(fit).numbers["natural_Hz"].value == pytest.approx(
                1.9, abs=4.5 * found(fit).numbers["natural_Hz"].std
            )
            assert found(fit).numbers["damping_ratio"].value == pytest.approx(
                1 / (2.9 * 2 * np.pi * 1.9), rel=0.5
            )
        else:  # sampled so few times a period that it looks like noise
            assert "an oscillation that was not demodulated" in fit.parameters["tau"].why


@pytest.mark.parametrize("tau", [0.3e-3, 2e-3])
@seeds(2, 40)
def test_a_plant_of_first_order_does_not_overshoot(tau, seeds):
    for seed in seeds:
        log = stepped(0.5, seed)
        time = np.maximum(log.time, 0)
        noise = 0.01 * np.random.default_rng(seed).standard_normal(ROWS)
        fit = sysid.fit(replace(log, response=-np.expm1(-time / tau) + noise))
        assert found(fit) is None and fit.result is Result.successful, fit.warnings
