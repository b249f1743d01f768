"""Amplitudes of a plate in noise: Rice's distribution, for numpy and jax alike.

Of |A + n|, n normal of standard deviation s in d and in q, and u = A^2/s^2,

    mean^2 = A^2 + s^2 lifted(u),     lifted from pi/2 of noise alone to 1;     deviation from 0.655 s to s

(Rice, Bell Syst. Tech. J. 24, 46, 1945). `plate` (n,) is the response, complex, `floor` s^2.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import minimize
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


def linear(plate: Any, floor: Any) -> tuple[Any, Any, Any]:
    """(n,) the mean amplitude; t, by which a small change z of the plate's response shows in it as Re t z;
    and its derivative by the floor."""
    square = plate.real**2 + plate.imag**2
    u = square / floor
    lifted, slope = _lifted(u)
    size = (square + floor * lifted) ** 0.5
    return size, plate.conj() * (1 + slope) / size, 0.5 * (lifted - u * slope) / size


def towards(plate: Any, floor: Any) -> Any:
    """(n,) t of `linear`."""
    return linear(plate, floor)[1]


def by_floor(plate: Any, floor: Any) -> Any:
    """(n,) derivative of the mean amplitude by the floor."""
    return linear(plate, floor)[2]


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
# times the mean at rest, less than which rows after the drive rest as well; of FEW it scatters by a fifth
ALIKE = 1.5
QUIET = 0.2  # of the largest response, no more than which rows at rest show
# variance, times rows, of the logarithm of the noise's square by the median of second differences: in 20 000
# logs of 12 to 400 normal rows 8.3 to 7.9; that of the mean of exponential numbers is 1
MEDIAN = 8.0
ENOUGH = 1000  # rows, of which the law of their noise is told


def rectified(log: Log) -> bool:
    """Whether a response of one sign is an amplitude: its rows at rest, before the first drive or last after
    it, are likelier by Rayleigh's law, of noise that has lost its sign, than normal about an offset. The
    noise is that of rest and of the other rows, by their second differences. Without a drive, whether what
    dies away is."""
    w, drive = log.response, log.drive
    if np.iscomplexobj(w) or log.time is None or np.any(w < 0):
        return False
    if drive is None or not np.any(drive):
        return _dies_into_rice(log.time - log.time[0], w)
    driven = np.flatnonzero(drive)
    rest, rows, after = w[: driven[0]], w[driven[0] + 1 : driven[-1] + 1], w[driven[-1] + 1 :]
    after = after[3 * len(after) // 4 :]
    if len(rest) < FEW:
        rest = after
    elif len(after) >= FEW and np.mean(after) < ALIKE * np.mean(rest):
        rest = np.append(rest, after)
    if min(len(rest), len(rows) - 2) < FEW or np.mean(rest) > QUIET * np.max(w):
        return False
    noise = variance(rows)
    if noise == 0 or np.any(rest == 0) or np.ptp(rest) == 0:
        return False
    n, known = len(rest), len(rows) / MEDIAN

    def worth(law: Callable[[float], np.ndarray], square: float, told: float) -> float:
        """The log-likelihood of rest and of the noise beside the drive, with the noise that both tell: by
        rest, its `square`, as well as `told` exponential numbers do."""
        both = float(np.exp((known * np.log(noise) + told * np.log(square)) / (known + told)))
        return float(np.sum(law(both)) - 0.5 * known * np.log(noise / both) ** 2)

    rayleigh = worth(lambda s: np.log(rest / s) - rest**2 / (2 * s), float(np.mean(rest**2)) / 2, n)
    off = (rest - np.mean(rest)) ** 2
    normal = worth(lambda s: -0.5 * np.log(2 * np.pi * s) - off / (2 * s), float(np.mean(off)), n / 2)
    return rayleigh > normal


def variance(rows: np.ndarray) -> float:
    """Of the white noise of rows (n,) of a smooth response, by their second differences."""
    return float(np.median(np.abs(np.diff(rows, 2))) / 0.6745) ** 2 / 6


def _dies_into_rice(time: np.ndarray, w: np.ndarray) -> bool:
    """Whether rows (n,) that die away from `time` 0 on are likelier |A e^(-t/tau) + n|, by Rice's law, than
    normal about A e^(-t/tau) and an offset, which is one number more (BIC). Where they end above their noise
    both are alike: False."""
    skip = len(w) // ENOUGH + 1
    t, x = time[::skip], w[::skip] / (np.max(w) or 1.0)
    if len(x) < 2 * FEW or t[-1] == 0 or np.any(x == 0):
        return False
    taus = t[-1] / np.geomspace(0.3, len(t), 100)
    fits = [(np.exp(-t / tau)[:, None] ** [1, 0]) for tau in taus]
    left = [float(np.sum((x - shape @ np.linalg.lstsq(shape, x)[0]) ** 2)) for shape in fits]
    best = int(np.argmin(left))
    variance = left[best] / len(x)
    if variance == 0:
        return False

    def cost(p: np.ndarray) -> float:
        a, s = np.exp(p[0] - t * np.exp(-p[1])), np.exp(p[2])
        return float(-np.sum(np.log(x / s**2 * i0e(a * x / s**2)) - (x - a) ** 2 / (2 * s**2)))

    within = [(None, None), (np.log(taus[-1]), np.log(taus[0])), (None, None)]
    first = [0.0, np.log(taus[best]), 0.5 * np.log(variance)]
    rice = minimize(cost, first, method="Nelder-Mead", bounds=within, options={"maxfev": 400})
    size, tau, noise = np.exp(rice.x)
    normal = 0.5 * len(x) * (np.log(2 * np.pi * variance) + 1)
    return bool(size * np.exp(-t[-1] / tau) < noise and normal + 0.5 * np.log(len(x)) > rice.fun)
