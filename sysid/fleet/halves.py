"""A lot that is two: whether the values of one parameter lie about two places.

    one:  (1 - e) N(m, s^2) + e U        two:  (1 - e) [(1 - a) N(m1, s^2) + a N(m2, s^2)] + e U

with U even over all values: of a few that lie anywhere. Two counts where it is more likely by GAIN, the
places are APART and each has a good share of the plates.
"""

from typing import NamedTuple

import numpy as np

GAIN = 10.0  # log-likelihood, of two numbers more and of several parameters that are looked at
APART = 4.0  # standard deviations of one half, from which on hardly a plate lies between
SHARE, FEWEST = 0.05, 10  # of the plates, and how many: fewer are odd plates, and no half
STEPS = 200
ANYWHERE = 0.05  # of the plates, at first


class Halves(NamedTuple):
    """`places` of the larger and of the smaller half, and `second` (n,): which values belong to the
    smaller."""

    places: tuple[float, float]
    second: np.ndarray
    gain: float


def halves(x: np.ndarray) -> Halves | None:
    """Of values (n,), some of which may be NaN and belong to the larger; None where the lot is one."""
    here = np.isfinite(x)
    y = x[here]
    if len(y) < 2 * FEWEST or np.ptp(y) == 0:
        return None
    even = 1 / np.ptp(y)
    one, _ = _fitted(y, np.array([np.median(y)]), even)
    two, found = _fitted(y, _split(y), even)
    places, size, shares, belongs = found
    order = np.argsort(-shares)
    small = int(np.sum(belongs == order[1]))
    apart = abs(places[0] - places[1]) / size
    if two - one < GAIN or apart < APART or small < max(SHARE * len(y), FEWEST):
        return None
    second = np.zeros(len(x), bool)
    second[here] = belongs == order[1]
    return Halves((float(places[order[0]]), float(places[order[1]])), second, two - one)


def _split(y: np.ndarray) -> np.ndarray:
    """The means of two parts of sorted values, whose squares about them are least; neither part is smaller
    than a share of them."""
    z = np.sort(y)
    n, total = len(z), np.cumsum(z)
    k = np.arange(max(int(SHARE * n), 1), n - max(int(SHARE * n), 1))
    low, high = total[k - 1] / k, (total[-1] - total[k - 1]) / (n - k)
    best = int(np.argmax(k * (n - k) * (high - low) ** 2))
    return np.array([low[best], high[best]])


def _fitted(y: np.ndarray, places: np.ndarray, even: float) -> tuple[float, tuple]:
    """Log-likelihood of normals of one size about so many places with a few values anywhere; and places,
    size, shares and to which each value belongs."""
    shares = np.full(len(places), (1 - ANYWHERE) / len(places))
    size = 1.4826 * float(np.median(np.min(np.abs(y[:, None] - places), axis=1))) or 1 / even
    for _ in range(STEPS):
        parts = shares / (np.sqrt(2 * np.pi) * size) * np.exp(-0.5 * ((y[:, None] - places) / size) ** 2)
        whole = parts.sum(1) + (1 - shares.sum()) * even
        weight = parts / whole[:, None]
        count = np.maximum(weight.sum(0), 1e-9)
        places, shares = weight.T @ y / count, count / len(y)
        size = max(float(np.sqrt(np.sum(weight * (y[:, None] - places) ** 2) / count.sum())), 1e-9 / even)
    return float(np.sum(np.log(whole))), (places, size, shares, np.argmax(weight, axis=1))
