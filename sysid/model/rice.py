"""Amplitudes of a plate in noise: Rice's distribution, for numpy and jax alike.

Of |A + n|, n normal of standard deviation s in d and in q, and u = A^2/s^2,

    mean^2 = A^2 + s^2 lifted(u),     lifted from pi/2 of noise alone to 1;     deviation from 0.655 s to s

(Rice, Bell Syst. Tech. J. 24, 46, 1945). `plate` (n,) is the response, complex, `floor` s^2.
"""

from typing import Any

import numpy as np
from scipy.special import i0e, i1e

from sysid.logs.log import Log

A, (P, Q, R, S) = np.pi / 2 - 1, (0.06086816, 0.01296187, 0.43944372, 0.08492763)
_AMPLITUDE = np.linspace(0, 12, 600)
_HALVED = _AMPLITUDE**2 / 4
_MEAN = np.sqrt(np.pi / 2) * ((1 + 2 * _HALVED) * i0e(_HALVED) + 2 * _HALVED * i1e(_HALVED))


def mean(plate: Any, floor: Any) -> Any:
    """(n,) the mean amplitude, right to 6e-5 of s."""
    square = plate.real**2 + plate.imag**2
    return (square + floor * _lifted(square / floor)[0]) ** 0.5


def towards(plate: Any, floor: Any) -> Any:
    """(n,) t: a small change z of the plate's response shows as Re t z in the mean amplitude."""
    square = plate.real**2 + plate.imag**2
    return plate.conj() * (1 + _lifted(square / floor)[1]) / mean(plate, floor)


def by_floor(plate: Any, floor: Any) -> Any:
    """(n,) derivative of the mean amplitude by the floor."""
    u = (plate.real**2 + plate.imag**2) / floor
    lifted, slope = _lifted(u)
    return 0.5 * (lifted - u * slope) / mean(plate, floor)


def spread(mean: np.ndarray) -> np.ndarray:
    """Standard deviation over s, by the mean over s."""
    variance = 2 + _AMPLITUDE**2 - _MEAN**2
    return np.sqrt(np.interp(mean, _MEAN, variance))


def _lifted(u: Any) -> tuple[Any, Any]:
    """`lifted`, a ratio of polynomials that was fitted to it, and its derivative."""
    above, below = 1 + u * (P + u * Q), 1 + u * (R + u * (S + u * 2 * A * Q))
    slope = (P + 2 * Q * u - above / below * (R + u * (2 * S + u * 6 * A * Q))) / below
    return 1 + A * above / below, A * slope


FEW = 8  # rows at rest, of which nothing is told
QUIET = 0.2  # of the largest response, no more than which rows at rest show


def rectified(log: Log) -> bool:
    """Whether a response of one sign is an amplitude: its rows at rest, before the first drive or last after it, are likelier by
    Rayleigh's law, of noise that has lost its sign, than normal about an offset. The noise is that of the other rows, by their
    second differences."""
    w, drive = log.response, log.drive
    if np.iscomplexobj(w) or drive is None or log.time is None or not np.any(drive) or np.any(w < 0):
        return False
    driven = np.flatnonzero(drive)
    rest, rows = w[: driven[0]], w[driven[0] + 1 : driven[-1] + 1]
    if len(rest) < FEW:
        after = w[driven[-1] + 1 :]
        rest = after[3 * len(after) // 4 :]
    if min(len(rest), len(rows) - 2) < FEW or np.mean(rest) > QUIET * np.max(w):
        return False
    variance = float(np.median(np.abs(np.diff(rows, 2))) / 0.6745) ** 2 / 6
    if variance == 0 or np.any(rest == 0):
        return False
    rayleigh = np.log(rest / variance) - rest**2 / (2 * variance)
    normal = -0.5 * np.log(2 * np.pi * variance) - (rest - np.mean(rest)) ** 2 / (2 * variance)
    return bool(np.sum(rayleigh - normal) > 0)
