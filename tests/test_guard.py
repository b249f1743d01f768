"""The guard at any sample time and delay: a sound plate passes it as it was promised, a faulty sensor does
not."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import sampled, study
from replay import in_arrays, in_c

import controller
from controller.ensemble import Ensemble
from controller.guard import FAULTS
from controller.machine import RUN
from controller.promise import Clock, Steps, promise

TAU = 5e-3 / math.log(20)
LATE = 1e-12  # of a sample


def designed(tau=TAU, T=1e-4, f0=32300.0, **given):
    given = {"voltage_limit": 350.0, "frequency_window": (0.9 * f0, 1.1 * f0), "amplitude": 2.0} | given
    return controller.design(SimpleNamespace(G=0.02, tau=tau, f0=f0, k_T=0.0), sample_time=T, **given)


def played(loop, reference, noise=0.0, spoil=lambda W, k: W, control=None):
    """W, V and the fault at each sample of a plate whose envelope is exact under held inputs, by hand: a
    command acts a latency after its sample, and the reading of sample k is late by the demodulator, on a
    straight line, and `spoil`ed."""
    control, T = control or loop.control, loop.sample_time
    late = math.floor(loop.latency / T + LATE)
    part = loop.latency - late * T
    state, Z, before, rng = control.init(), 0j, 0j, np.random.default_rng(1)
    lag = loop.demodulator.delay / T
    line, rows = [(0.0, loop.f0)] * (late + 2), []
    for k, asked in enumerate(reference):
        told = spoil(Z + lag * (before - Z) + noise * complex(*rng.standard_normal(2)), k)
        before = Z
        state, command, said = control.step(state, asked, told)
        rows.append((abs(Z), command.voltage, said.fault, getattr(said, "mode", 0.0), told))
        line = [tuple(command), *line[:-1]]
        for (voltage, f), duration in ((line[late + 1], part), (line[late], T - part)):
            pole = -1 / loop.tau + 2j * np.pi * (loop.f0 - f)
            settled = -loop.G / loop.tau * voltage / pole
            Z = settled + (Z - settled) * np.exp(pole * duration)
    return [np.array(column) for column in zip(*rows, strict=True)]


SLOW = {"tau": 2.0, "f0": 200.0}
SOUND = [  # sample times of a tenth of tau to six times it; latencies of up to a hundred samples, and of none
    *({"T": T, "method": m} for T in (1e-3, 5e-3, 1e-2) for m in ("pi", "paper", "pll")),
    *(SLOW | {"T": T, "method": m} for T in (1e-2, 0.1, 0.5, 2.0) for m in ("pi", "pll", "adaptive")),
    *({"tau": 0.1, "T": T, "method": m} for T in (5e-3, 2e-2) for m in ("pi", "pll", "adaptive")),
    *({"latency": late, "method": m} for late in (0.0, 4e-3, 5.04e-3, 1e-2) for m in ("pi", "paper")),
]


@pytest.mark.parametrize("given", [x if k % 3 == 0 else study(x) for k, x in enumerate(SOUND)], ids=str)
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_sound_plate_is_not_taken_for_a_fault_and_settles_as_promised(given, noise):
    loop = designed(**given)
    count = 100 + 2 * math.ceil(loop.promise.settling / loop.sample_time)
    W, _, fault, _, _ = played(loop, [2.0] * count, noise)
    assert not fault.any()
    if not noise:
        last = np.flatnonzero(np.abs(W - 2.0) > 0.1)[-1]
        assert (last + 1) * loop.sample_time <= loop.promise.settling * (1 + 1e-9)


@pytest.mark.parametrize("noise", [0.0, study(0.002), 0.02])
@pytest.mark.parametrize("given", [{}, study({"tau": 0.1, "T": 1e-3}), SLOW | {"T": 1e-2}], ids=str)
@pytest.mark.parametrize("low", [0.0, study(0.02), 0.2])
def test_a_plate_that_is_braked_is_not_dead_nor_stuck(given, low, noise):
    """After a rest in which readings without noise are the same to the last bit."""
    loop = designed(**given)
    rest = math.ceil(8 * loop.tau / loop.sample_time) + 200
    W, _, fault, _, _ = played(loop, [2.0] * rest + [low] * rest, noise)
    assert not fault.any() and abs(W[-1] - low) < 0.05 + 5 * noise


FAULTY = {
    "dead": lambda W, k, at: W if k < at else 0j,
    "missing": lambda W, k, at: W if k < at else complex(math.nan, 0.0),
}


@pytest.mark.parametrize(
    "given", [{}, {"T": 5e-3}, {"T": 1e-2}, SLOW | {"T": 1e-2}, SLOW | {"T": 1.0}], ids=str
)
@pytest.mark.parametrize("name", FAULTY)
def test_a_sensor_that_fails_ends_the_drive_within_the_patience(given, name):
    loop, at = designed(**given), 400
    patience = loop.control.patience
    _, V, fault, _, _ = played(
        loop, [2.0] * (at + 2 * int(patience)), 0.002, lambda W, k: FAULTY[name](W, k, at)
    )
    ends = int(np.argmax(fault > 0))
    # what is dead may first have to be driven: the loop had settled, and drives
    assert FAULTS[int(fault[-1])] == name and at < ends <= at + patience
    assert (V[ends:] == 0.0).all()
    stated = controller.as_dict(loop)["guard"]["patience_s"]
    assert stated == pytest.approx(patience * loop.sample_time)
    # 5 ms, or two time constants, or twice the delay and four samples
    assert stated < (max(5e-3, 2 * loop.tau, 6 * loop.sample_time) + loop.sample_time) * (1 + 1e-9)


def test_a_stuck_sensor_ends_the_drive_after_the_voltage_moved():
    loop, held = designed(), []

    def stuck(W, k):
        held.append(W)
        return W if k < 200 else held[200]

    _, V, fault, _, _ = played(loop, [2.0] * 1200, 0.002, stuck)
    # the error of the reading that is held drives the voltage by 0.1 % of its limit within a few samples
    assert (
        FAULTS[int(fault[-1])] == "stuck" and 200 <= int(np.argmax(fault > 0)) - 200 <= 300 and V[-1] == 0.0
    )


@pytest.mark.always
@pytest.mark.parametrize(
    "given", sampled([{"T": 5e-3}, {"T": 1e-2}, SLOW | {"T": 1.0}, SLOW | {"T": 0.1}]), ids=str
)
def test_what_switches_a_slow_loop_on_comes_to_run_in_python_and_in_c(tmp_path, given):
    loop = designed(**given)
    W, V, fault, mode, told = played(loop, [2.0] * 800, 0.002, control=loop.machine)
    assert not fault.any() and mode[-1] == RUN and W[-100:] == pytest.approx(2.0, rel=0.02)
    inputs = {"reference": 2.0, "share": 1.0, "wd": told.real, "wq": told.imag, "enable": 1, "reset": 0}
    inputs = {name: np.broadcast_to(value, (1, 800)) for name, value in inputs.items()}
    for theirs in (in_c(loop, tmp_path, inputs, "double", "-O2"), in_arrays(loop, inputs, "double")):
        np.testing.assert_array_equal(theirs["voltage"][0], V)
        np.testing.assert_array_equal(theirs["mode"][0], mode)


def test_a_sample_time_that_is_too_slow_is_said():
    assert not any("longer than the plate's time constant" in note for note in designed(T=1e-3).notes)
    assert any("longer than the plate's time constant, 0.00167 s" in note for note in designed(T=5e-3).notes)
    with pytest.raises(
        ValueError,
        match=r"sample_time = 0\.005 s cannot be had with method = 'adaptive'.*nearest.*0\.00167 s",
    ):
        designed(T=5e-3, method="adaptive")
    assert math.isfinite(designed(T=1.66e-3, method="adaptive").promise.settling)


def test_the_promise_is_that_of_what_runs():
    """A guard that takes a sound plate for a dead one is seen by the promise."""
    loop, one = designed(), np.ones(1)
    plants = Ensemble(0.02 / TAU * one, one / TAU, 0 * one)
    hasty = loop.control._replace(patience=1.0)
    given = loop.law, Steps(plants, Clock(1e-4, 1e-4, loop.demodulator.delay), 2.0, 32300.0)
    assert (
        math.isfinite(promise(*given).settling)
        and promise(*given, loop.control).settling == promise(*given).settling
    )
    assert math.isinf(promise(*given, hasty).settling)


def test_a_loop_that_is_slower_than_its_plate_is_looked_at_to_its_end():
    """A bandwidth of 5 Hz: e^{-t/32 ms}, within 5 % after three of these and the time in which the plate
    follows."""
    loop = designed(bandwidth_hz=5.0)
    assert loop.promise.settling == pytest.approx(math.log(20) / (2 * math.pi * 5.0), rel=0.02)


def test_a_frequency_that_is_none_is_not_put_out():
    loop = designed(method="adaptive", T=1e-3)
    state = loop.control.init()
    broken = state.control._replace(
        resonance=math.nan, frequencies=(math.nan,) * len(state.control.frequencies)
    )
    _, command, _ = loop.control.step(state._replace(control=broken), 2.0, 1.0 + 0j)
    assert command.frequency == loop.control.rest().frequency
