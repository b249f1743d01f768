"""The reference physics, against direct integration of the differential equations."""

import ast
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import reference
from reference import Plant
from scipy.integrate import solve_ivp

EXACT = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13}
PLATE = Plant(G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=-10.16)
PLANTS = {
    "plate": PLATE,
    "quartz": Plant(G=0.07, tau=50_000 / (np.pi * 5e6), f0=4_999_999.0, k_T=1.0),
    "low_q": Plant(G=0.5, tau=8 / (np.pi * 900), f0=900.0, k_T=0.0, ripple=True),
}


def test_it_shares_no_code_with_the_package():
    tree = ast.parse(Path(reference.__file__).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert names == {"dataclasses", "numpy"}


def mechanics(plant, w0):
    """ds, c, N for m = 1:  tau = 2 m/ds,  w0^2 = c/m,  G = N/(ds w0)  (w0: 2 pi f0 at 24 degC, where G is
    stated)."""
    ds = 2 / plant.tau
    return ds, w0**2, plant.G * ds * w0


def stretches(*inputs):
    """(first, last) rows between which no input changes; `last` is the row at which the next one acts."""
    changes = np.flatnonzero(np.any([np.diff(column) != 0 for column in inputs], axis=0)) + 1
    edges = [0, *changes, len(inputs[0]) - 1]
    return [(a, b) for a, b in pairwise(edges) if b > a]


def rotating_frame(plant, time, voltage, frequency):
    """m Z'' + (2 j omega m + ds) Z' + (c - m omega^2 + j omega ds) Z = j N V  from rest, omega constant."""
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    omega = 2 * np.pi * frequency
    state, out = np.zeros(2, complex), np.zeros(len(time), complex)
    for a, b in stretches(voltage):

        def slope(_, y, push=1j * N * voltage[a]):
            return [y[1], push - (2j * omega + ds) * y[1] - (c - omega**2 + 1j * omega * ds) * y[0]]

        path = solve_ivp(slope, (time[a], time[b]), state, t_eval=time[a : b + 1], **EXACT).y
        out[a : b + 1], state = path[0], path[:, -1]
    return out


def step_and_release():
    """At Q = 8: 10 ms on and 6.5 ms off, 40 Hz below resonance."""
    voltage = np.repeat([0.0, 10.0, 0.0], [20, 200, 130])
    return 5e-5 * np.arange(350), voltage, np.full(350, 860.0), np.full(350, 24.0)


def test_low_q_solves_the_rotating_frame_equation():
    time, voltage, frequency, temperature = step_and_release()
    expected = rotating_frame(PLANTS["low_q"], time, voltage, 860.0)
    got = reference.ringing(PLANTS["low_q"], time, voltage, frequency, temperature)
    # 1e-8 of the final amplitude: ten times the integrator's accumulated error at rtol 1e-10.
    assert np.max(np.abs(got - expected)) < 1e-8 * np.max(np.abs(expected))


def test_low_q_needs_its_fast_mode():
    """The check above can fail: with the fast mode settled, the error is the ripple, about 1/(4 Q) = 3 %."""
    plant = PLANTS["low_q"]
    error = reference.ringing(replace(plant, ripple=False), *step_and_release()) - reference.ringing(
        plant, *step_and_release()
    )
    assert np.max(np.abs(error)) > 0.02 * plant.G * 10


def complex_carrier(plant, time, voltage, frequency, tau, w0):
    """Z from  m w'' + ds w' + c w = N jV e^{j theta}, whose real part is the bench's carrier; theta is
    continuous."""
    _, _, N = mechanics(plant, 2 * np.pi * plant.f0)
    theta = np.append(0.0, np.cumsum(2 * np.pi * frequency[:-1] * np.diff(time)))
    state, out = np.zeros(2, complex), np.zeros(len(time), complex)
    for a, b in stretches(voltage, frequency, tau, w0):

        def slope(t, y, a=a):
            push = 1j * N * w0[a] / w0[0] * voltage[a]
            carrier = np.exp(1j * (theta[a] + 2 * np.pi * frequency[a] * (t - time[a])))
            return [y[1], push * carrier - 2 / tau[a] * y[1] - w0[a] ** 2 * y[0]]

        path = solve_ivp(slope, (time[a], time[b]), state, t_eval=time[a : b + 1], **EXACT).y
        out[a : b + 1], state = path[0] * np.exp(-1j * theta[a : b + 1]), path[:, -1]
    return out


def changing(columns):
    """Voltage, frequency, tau and temperature of 61 rows, of which the named ones change on the way."""
    voltage = np.repeat([0.0, 100.0, 40.0], [5, 40, 16])
    frequency = np.repeat([32200.0, 32350.0, 32280.0], [20, 15, 26])
    tau = PLATE.tau / np.repeat([1.0, 2.0, 1.3], [25, 20, 16])
    temperature = np.repeat([24.0, 30.0], [31, 30])
    given = {"voltage": voltage, "frequency": frequency, "tau": tau, "temperature": temperature}
    still = {"voltage": 100.0, "frequency": 32290.0, "tau": PLATE.tau, "temperature": 24.0}
    return [given[name] if name in columns else np.full(61, still[name]) for name in given]


@pytest.mark.parametrize(
    "columns", [("voltage", "frequency"), ("voltage", "tau"), ("voltage", "temperature")]
)
def test_changes_of_the_inputs_and_of_the_plate_match_the_carrier(columns):
    """Both modes: w and w' are continuous across changes of voltage, frequency, damping and resonance, and so
    is the phase."""
    plant, time = replace(PLATE, ripple=True), 1e-4 * np.arange(61)
    voltage, frequency, tau, temperature = changing(columns)
    got = reference.ringing(plant, time, voltage, frequency, temperature, tau)
    expected = complex_carrier(plant, time, voltage, frequency, tau, reference.resonance(plant, temperature))
    # 1e-6 of G V: the integrator's error over 200 cycles of the carrier at rtol 1e-10, with a margin of ten.
    assert np.max(np.abs(got - expected)) < 1e-6 * plant.G * 100


def phase_space_pair(plant, time, voltage, frequency):
    """Z of the real carrier  m w'' + ds w' + c w = N V Re[j e^{j theta}]:  2 e^{-j theta} times its mode e^{j
    wd t}."""
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    omega, wd = 2 * np.pi * frequency, np.sqrt(c - 1 / plant.tau**2)

    def slope(t, y):
        return [y[1], -N * voltage * np.sin(omega * t) - ds * y[1] - c * y[0]]

    w, w_dot = solve_ivp(slope, (time[0], time[-1]), [0.0, 0.0], t_eval=time, **EXACT).y
    return (w_dot - (-1 / plant.tau - 1j * wd) * w) / (1j * wd) * np.exp(-1j * omega * time)


@pytest.mark.parametrize("detuning", [-40.0, 0.0, 30.0])
def test_detuned_step_matches_the_real_carrier_within_its_ripple(detuning):
    plant, time = PLATE, 2.3e-5 * np.arange(400)  # 2.3e-5 s is no multiple of the carrier's period
    columns = np.ones(400), np.full(400, plant.f0 + detuning), np.full(400, 24.0)
    error = reference.ringing(plant, time, *columns) - phase_space_pair(plant, time, 1.0, plant.f0 + detuning)
    ripple = 1 / (
        2 * np.pi * plant.f0 * plant.tau
    )  # 1/(2 Q): 1/(4 Q) of the pair, 1/(4 Q) of the settled fast mode
    # The bound holds when the start has decayed; before that, what is left of it adds at most a few per cent.
    assert np.max(np.abs(error)) < 1.05 * ripple * plant.G
    assert np.max(np.abs(error)) > 0.9 * ripple * plant.G  # and it is the ripple that one sees


def test_signs_below_and_above_resonance():
    plant = replace(PLATE, G=1.0)
    below, above = (
        complex(reference.steady(plant, 1.0, plant.f0 + detuning, 24.0)) for detuning in (-50, 50)
    )
    # Numbers demodulated from an integration of the carrier, to three decimals: its ripple 1/(2 Q) = 3e-3 is
    # in them.
    assert below == pytest.approx(0.785 + 0.412j, abs=3e-3)
    assert above == pytest.approx(0.785 - 0.411j, abs=3e-3)
    assert below.imag > 0 > above.imag


@pytest.mark.parametrize("name", PLANTS)
def test_the_steady_response_is_the_transfer_function(name):
    """Z = j N V / (c - m omega^2 + j omega ds), far from resonance and at it."""
    plant = PLANTS[name]
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    frequency = plant.f0 + np.linspace(-5, 5, 11) / (2 * np.pi * plant.tau)
    omega = 2 * np.pi * frequency
    # Differences of squares lose Q, here up to 5e4, of the last bits (1e-16).
    expected = 3j * N / (c - omega**2 + 1j * omega * ds)
    np.testing.assert_allclose(reference.steady(plant, 3.0, frequency, 24.0), expected, rtol=1e-10)


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("half_bandwidths", [-3.0, 0.0, 1.0])
@pytest.mark.parametrize("force", [0.0, 1.5])
def test_a_step_settles_on_the_steady_response(name, half_bandwidths, force):
    plant = PLANTS[name]
    G, tau = reference.touched(plant, force)
    frequency = plant.f0 + half_bandwidths / (2 * np.pi * plant.tau)
    columns = np.ones(2), np.full(2, frequency), np.full(2, 24.0)
    limit = reference.ringing(plant, np.array([0.0, 60 * plant.tau]), *columns, tau=np.full(2, tau))[-1]
    # w0^2 - omega^2 loses Q, here up to 5e4, of the last bits (1e-16): 1e-10 leaves a margin of ten.
    assert limit == pytest.approx(complex(reference.steady(plant, 1.0, frequency, 24.0, G, tau)), rel=1e-10)


def test_a_step_at_resonance_rises_as_one_exponential():
    plant, time = PLATE, 1e-4 * np.arange(200)
    got = reference.ringing(plant, time, np.full(200, 50.0), np.full(200, plant.f0), np.full(200, 24.0))
    Q = np.pi * plant.f0 * plant.tau
    expected = plant.G * 50 * (1 - np.exp(-time / plant.tau))
    # Wd differs in second order of 1/Q (3.5e-5), Wq by the 1/(4 Q) of the fast mode (1.5e-3).
    assert np.max(np.abs(got.real - expected)) < plant.G * 50 / Q**2
    assert np.max(np.abs(got.imag)) < plant.G * 50 / (2 * Q)


def test_the_resonance_moves_with_temperature():
    """k_T (T - 24) in Hz moves the peak: the plate 4 degC warmer, at its old resonance, loses 8 %."""
    loss = 1 - abs(
        reference.steady(PLATE, 1.0, PLATE.f0, 28.0) / reference.steady(PLATE, 1.0, PLATE.f0, 24.0)
    )
    assert loss == pytest.approx(0.08, abs=0.002)  # "8 %" has one digit; w0/omega adds 0.1 %
    assert reference.steady(PLATE, 1.0, PLATE.f0, 28.0).imag < 0  # warmer: the resonance is below the drive


def test_the_finger_takes_half_at_one_and_a_half_newton():
    G, tau = reference.touched(PLATE, np.array([0.0, 0.5, 1.0, 1.5]))
    np.testing.assert_allclose(
        G / PLATE.G, [1, 0.59, 0.53, 0.5], atol=0.005
    )  # the law's table has two digits
    np.testing.assert_allclose(G / tau, PLATE.G / PLATE.tau, rtol=1e-15)  # b = G/tau holds no damping
