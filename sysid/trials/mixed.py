"""Noise that rows share beside noise of their own: how much less information they hold than the fit states.

The fit takes noise for white or for an Ornstein-Uhlenbeck process. Of rows that hold both, as of 1/f noise or
of a room that drifts behind a sensor with noise, it makes one of a short memory, and of what is slow too
little. Their power at the frequency w (per row) is

    S(w) = s^2 (1 + r (1 - a^2)/(1 - 2 a cos w + a^2)),    a = exp(-step/time)

whose numbers are the likeliest by Whittle's approximation, sum log S + P/S over a periodogram P (Whittle,
Ark. Mat. 2, 423, 1953). The estimates of the fit are unbiased still, with the covariance of `projected`.
"""

from typing import NamedTuple

import numpy as np

from sysid.trials.noise import ODD
from sysid.trials.perturbed import LogResponse
from sysid.trials.projected import shared
from sysid.trials.trial import Trial
from sysid.trials.whitening import whitened

LEAST_ROWS = 100  # by which a periodogram tells two kinds of noise apart
EVEN = 0.01  # of a step between rows, by which these may differ
TIMES = np.geomspace(1.0, 1e4, 25)  # rows
PLANT = 2  # of the columns of a log: the response, and its change by the pole
RATIOS = np.geomspace(1e-2, 1e3, 26)  # of the two variances


class Mixed(NamedTuple):
    """The standard deviation of rows' own noise, the variance of what they share over that of it, and the
    time (rows) of that."""

    std: float
    ratio: float
    time: float


def mixed(trial: Trial, residual: np.ndarray) -> Mixed | None:
    """The noise of a log whose residual (n,) is far less likely of one kind alone; None of others, and where
    rows are not evenly spaced."""
    noise = trial.noise
    steps = np.diff(noise.clock[noise.used])
    if trial.steady or noise.levels or len(steps) < LEAST_ROWS or np.ptp(steps) > EVEN * np.median(steps):
        return None
    left = (residual * noise.weight)[noise.used]
    channels, n = 2 if np.iscomplexobj(left) else 1, len(left)
    lines = np.fft.fft(left - np.mean(left))[1 : n if channels == 2 else (n + 1) // 2]
    power = np.abs(lines) ** 2 / (channels * n)
    ratios = np.append(RATIOS, np.inf)
    costs = np.array([[_cost(power, _spectrum(n, len(power), r, time)) for r in ratios] for time in TIMES])
    t, r = np.unravel_index(np.argmin(costs[:, :-1]), costs[:, :-1].shape)
    if min(float(np.min(costs[:, -1])), _cost(power, np.ones(len(power)))) - costs[t, r] < ODD:
        return None
    level = np.mean(power / _spectrum(n, len(power), ratios[r], TIMES[t]))
    return Mixed(float(np.sqrt(level)), float(ratios[r]), float(TIMES[t]))


def _spectrum(n: int, lines: int, ratio: float, time: float) -> np.ndarray:
    """(lines,) S over s^2 of n rows; of an infinite ratio, that of what they share alone."""
    a = np.exp(-1 / time)
    slow = (1 - a**2) / (1 - 2 * a * np.cos(2 * np.pi * np.arange(1, lines + 1) / n) + a**2)
    return slow if np.isinf(ratio) else 1 + ratio * slow


def _cost(power: np.ndarray, spectrum: np.ndarray) -> float:
    """Negative log-likelihood, with its level at its best."""
    return float(len(power) * np.log(np.mean(power / spectrum)) + np.sum(np.log(spectrum)))


def efficiency(trial: Trial, model: np.ndarray, course: LogResponse) -> float:
    """Information about the plant in a log, relative to what the fit states: the least over what the response
    is in proportion to and how it is slower, at most 1."""
    found = mixed(trial, trial.residual(model)) if trial.noise.time > 0 and trial.signed else None
    if found is None:
        return 1.0
    noise, used = trial.noise, trial.noise.used
    now, before = noise.whitening()
    made = course.design()[used].T
    plant = np.flatnonzero(np.any(made != 0, axis=1)[:PLANT])
    made = made[np.any(made != 0, axis=1)]
    white = whitened(made / np.linalg.norm(made, axis=1, keepdims=True), now, before)
    unweighted = now * white
    unweighted[:, :-1] -= (before * white)[:, 1:]  # W J
    seen = unweighted * found.std / noise.weight[used]
    inverse = np.linalg.pinv(white @ white.conj().T, hermitian=True)
    steps = np.where(np.arange(seen.shape[1]) > 0, -1 / found.time, 0.0)
    noisy = seen + found.ratio * np.array([shared(steps, v) for v in seen])
    spread = inverse @ (seen.conj() @ noisy.T).conj() @ inverse
    return float(min(1.0, np.min((np.diag(inverse).real / np.diag(spread).real)[: len(plant)])))
