"""The noise of one log, from its residual: a level, white or coloured by an Ornstein-Uhlenbeck process, with or without outliers.

OU noise has correlation exp(-|t - t'| / noise_time), on any time grid: what a first-order low-pass makes of white noise. A fit
takes slow noise for signal, so its residual looks whiter than the noise is: the likelihood of the correlation time is the
restricted one, in which what the fit can make of a log is integrated out (Harville, JASA 72, 320, 1977), and the time is the mean
of its posterior under a prior flat in its logarithm.

Outliers: a Student-t distribution, whose degrees of freedom are chosen from a few; a row's weight is what it expects of it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, i0e, i1e

Design = Callable[[], np.ndarray]
WORTH = 4.0  # log-likelihood that colour or tails must gain over white normal noise: less is within the chance of one more number
TIMES = 24  # correlation times that are tried
TAILS = np.array([1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0])  # degrees of freedom that are tried


class Level(NamedTuple):
    """The noise of one channel: its standard deviation and its correlation time (0: white)."""

    std: float
    time: float


def estimate(residual: np.ndarray, clock: np.ndarray, freedom: float, design: Design | None = None) -> tuple[float, float]:
    """Standard deviation per channel and correlation time (0: white) of a residual (n,), real or complex.

    `design()` (n, K): what the fit can make of a log, with coefficients of the residual's own kind; called when it is needed.
    """
    std, time, _ = _fitted(residual, clock, freedom, design)
    return std, time


def log_likelihood(residual: np.ndarray, clock: np.ndarray, freedom: float) -> float:
    """Log-likelihood of a residual at its best level and correlation time, up to a constant of `clock` and `freedom`."""
    std, _, gained = _fitted(residual, clock, freedom, None)
    return float(gained - freedom * np.log(max(std, 1e-300)))


def _fitted(residual: np.ndarray, clock: np.ndarray, freedom: float, design: Design | None) -> tuple[float, float, float]:
    """Level, correlation time, and what the determinant of its correlation adds to the log-likelihood."""
    channels = 2 if np.iscomplexobj(residual) else 1
    steps = np.diff(clock)
    power = float(np.sum(np.abs(residual) ** 2))
    white = float(np.sqrt(power / freedom))
    if power == 0 or len(residual) < 8 or not np.any(steps > 0):
        return white, 0.0, 0.0
    typical = np.median(steps[steps > 0])
    times = np.geomspace(0.2 * typical, max(0.3 * (clock[-1] - clock[0]), typical), TIMES)
    found, shrink = _whitened(residual, steps, times[:, None])
    shrunk = 0.5 * channels * np.sum(np.log(shrink), axis=-1)
    cost = shrunk + 0.5 * channels * len(residual) * np.log(power_of(found) / power)
    if np.min(cost) > -WORTH:
        return white, 0.0, 0.0
    if design is not None:
        made = design().T if channels == 2 else design().T.real
        cost = np.array([_restricted(u, made, steps, t, channels) for u, t in zip(found, times, strict=True)]) + shrunk
    share = np.exp(np.min(cost) - cost)
    time = float(np.exp(np.sum(share * np.log(times)) / np.sum(share)))
    whitened, shrink = _whitened(residual, steps, time)
    return float(np.sqrt(power_of(whitened) / freedom)), time, -0.5 * channels * float(np.sum(np.log(shrink)))


def _restricted(whitened: np.ndarray, design: np.ndarray, steps: np.ndarray, time: float, channels: int) -> float:
    """Minus the restricted log-likelihood, its level integrated out, less the determinant of the correlation; `design` (K, n)."""
    columns = _whitened(design, steps, time)[0].T
    unit = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    q, r = np.linalg.qr(unit)
    size = np.linalg.norm(columns, axis=0) * np.abs(np.diag(r))
    kept = np.abs(np.diag(r)) > 1e-6
    left = whitened - q[:, kept] @ (q[:, kept].conj().T @ whitened)
    free = len(whitened) - np.sum(kept)
    return channels * float(np.sum(np.log(size[kept])) + 0.5 * free * np.log(power_of(left)))


def power_of(v: np.ndarray) -> np.ndarray:
    """Sum of squares along the rows (..., n)."""
    return np.sum(v.real**2 + v.imag**2, axis=-1)


def _whitened(values: np.ndarray, steps: np.ndarray, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (..., n) less what each shares with the row before, of unit variance; and the variance (..., n - 1) left of each.
    `time` is one, or (T, 1) for as many answers."""
    rho = np.minimum(np.exp(-steps / time), 1 - 1e-9)
    shrink = 1 - rho**2
    new = (values[..., 1:] - rho * values[..., :-1]) / np.sqrt(shrink)
    first = np.broadcast_to(values[..., :1], (*new.shape[:-1], 1))
    return np.concatenate([first, new], axis=-1), shrink


def tails(residual: np.ndarray) -> tuple[np.ndarray, float]:
    """Weight (n,) of each row of a white residual, real or complex, and the information that a row holds over that of a normal
    one of the same level: 1 and 1 where the noise is normal.

    Student-t of nu degrees of freedom in d channels, by its EM: w = (nu + d)/(nu + |u|^2), u = residual/level (Lange, Little &
    Taylor, JASA 84, 881, 1989), expanded so that it takes few steps (Kent, Tyler & Vardi, Commun. Stat. 23, 441, 1994). The
    noise need not be of that kind: the information on a location is A^2/B with psi = w u, A = E psi' and B = E psi^2 (Huber,
    Robust Statistics, 1981).
    """
    n, channels = len(residual), 2 if np.iscomplexobj(residual) else 1
    square = np.abs(residual) ** 2
    normal = 0.5 * n * channels * (np.log(max(np.mean(square) / channels, 1e-300)) + 1)
    if n < 20 or not np.any(square):
        return np.ones(n), 1.0
    costs, weights = _student(square, TAILS[:, None], channels)
    best = int(np.argmin(costs))
    if costs[best] > normal - WORTH:
        return np.ones(n), 1.0
    weight = weights[best]
    u = weight * square / np.mean(weight * square) * channels  # w |u|^2
    slope = np.mean(weight) - 2 * np.mean(weight * u) / (channels * (TAILS[best] + channels))
    return weight, float(min(slope**2 / (np.mean(weight * u) / channels * np.mean(weight)), 1.0))


def _student(square: np.ndarray, nu: np.ndarray, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Minus the log-likelihood (T,) at the best level, and the weights (T, n) there, for degrees of freedom `nu` (T, 1)."""
    level = np.full(nu.shape, np.median(square) / channels + 1e-300)
    for _ in range(50):
        weight = (nu + channels) / (nu + square / level)
        expanded = np.sum(weight * square, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
        level, before = expanded / channels, level
        if np.all(np.abs(level / before - 1) < 1e-6):
            break
    norm = gammaln(0.5 * (nu + channels)) - gammaln(0.5 * nu) + 0.5 * channels * np.log(2 / nu)
    cost = 0.5 * (nu + channels) * np.log1p(square / (nu * level)) + 0.5 * channels * np.log(level) - norm
    return np.sum(cost, axis=1), weight


_AMPLITUDE = np.linspace(0, 12, 600)
_HALVED = _AMPLITUDE**2 / 4
_MEAN = np.sqrt(np.pi / 2) * ((1 + 2 * _HALVED) * i0e(_HALVED) + 2 * _HALVED * i1e(_HALVED))


def rice_spread(mean: np.ndarray) -> np.ndarray:
    """Standard deviation over level of Rice's distribution, by its mean over level: from 0.655 of pure noise to 1."""
    variance = 2 + _AMPLITUDE**2 - _MEAN**2
    return np.sqrt(np.interp(mean, _MEAN, variance))
