"""The physics of scenes a second time, in closed form and plain numpy: it shares no code with the package.

    v = Re[jV e^{j theta}],  w = Re[Z e^{j theta}],  Z = Wd + j Wq (peak),  theta' = omega = 2 pi f,  theta
    continuous

Each response is the exact one of a resonator  m w'' + ds w' + c w = N v(t)  to inputs that hold from row to
row. Lengths are in um, times in s, frequencies in Hz, voltages in V (peak), temperatures in degC, forces in
N.
"""

from dataclasses import dataclass

import numpy as np

REFERENCE_TEMPERATURE = 24.0


@dataclass(frozen=True)
class Plant:
    """A resonator: G (um/V), tau (s), f0 at 24 degC (Hz), k_T (Hz/degC)."""

    G: float
    tau: float
    f0: float
    k_T: float
    ripple: bool = False  # True: the fast mode rings too. False: it is settled, as behind a lock-in's filter.


def resonance(plant: Plant, temperature):
    """w0 = 2 pi (f0 + k_T (T - 24)), in rad/s."""
    return 2 * np.pi * (plant.f0 + plant.k_T * (temperature - REFERENCE_TEMPERATURE))


def touched(plant: Plant, force, rho=1.0, scale=0.6, exponent=2 / 3):
    """G and tau under a finger: both fall by 1 + r(F), r = rho (1 - e^{-(F/scale)^n}) / (1 - e^{-(1.5
    N/scale)^n})."""
    added = rho * (1 - np.exp(-((force / scale) ** exponent))) / (1 - np.exp(-((1.5 / scale) ** exponent)))
    return plant.G / (1 + added), plant.tau / (1 + added)


def steady(plant: Plant, voltage, frequency, temperature, G=None, tau=None):
    """Z = G V (w0/omega) / (1 - j (w0^2 - omega^2) tau / (2 omega)), exact; G and tau: those under a
    finger."""
    w0, omega = resonance(plant, temperature), 2 * np.pi * frequency
    G, tau = (plant.G, plant.tau) if G is None else (G, tau)
    return G * voltage * (w0 / omega) / (1 - 1j * (w0**2 - omega**2) * tau / (2 * omega))


def modes(plant: Plant, frequency: float, temperature: float, tau: float) -> tuple[complex, complex, float]:
    """Poles s1 (slow), s2 (fast) in the rotating frame and the gain b:  Z1' = s1 Z1 + b V,  Z2' = s2 Z2 - b
    V."""
    w0, omega = resonance(plant, temperature), 2 * np.pi * frequency
    wd = np.sqrt(w0**2 - tau**-2)
    return -1 / tau + 1j * (wd - omega), -1 / tau - 1j * (wd + omega), plant.G * w0 / (plant.tau * wd)


def advance(state: complex, pole: complex, push: complex, duration: float) -> complex:
    """The solution of  z' = pole z + push  after `duration`, push being constant."""
    target = -push / pole
    return target + (state - target) * np.exp(pole * duration)


def ringing(plant: Plant, time, voltage, frequency, temperature, tau=None) -> np.ndarray:
    """Z just before each row's inputs act, from rest; `tau` row by row, where a finger changes it (b = G/tau
    stays).

    With the ripple, w and w' are continuous whatever changes; without it, the slow mode is.
    """
    tau = np.full(len(time), plant.tau) if tau is None else tau
    response = np.zeros(len(time), complex)
    slow = fast = z = velocity = 0j  # velocity: w' = Re[velocity e^{j theta}]
    for k in range(len(time) - 1):
        s1, s2, b = modes(plant, frequency[k], temperature[k], tau[k])
        duration, turning = time[k + 1] - time[k], 2j * np.pi * frequency[k]
        if plant.ripple:
            slow = (velocity - (s2 + turning) * z) / (s1 - s2)
            fast = advance(z - slow, s2, -b * voltage[k], duration)
        else:
            fast = b * voltage[k] / s2
        slow = advance(slow, s1, b * voltage[k], duration)
        z, velocity = slow + fast, (s1 + turning) * slow + (s2 + turning) * fast
        response[k + 1] = z
    return response


def noise(n: int, std: float, seed: int, time=None, correlation: float = 0.0) -> np.ndarray:
    """Complex noise (n,) of `std` in each part: white, or with covariance std^2 exp(-|t|/correlation)."""
    real, imaginary = np.random.default_rng(seed).standard_normal((2, n))
    white = std * (real + 1j * imaginary)
    if not correlation:
        return white
    keep = np.exp(-np.diff(time) / correlation)
    coloured = white.copy()  # the first value is drawn from the stationary distribution
    for k in range(1, n):
        coloured[k] = keep[k - 1] * coloured[k - 1] + np.sqrt(1 - keep[k - 1] ** 2) * white[k]
    return coloured
