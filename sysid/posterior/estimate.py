"""Mean, standard deviation and interval of a parameter: those of the normal approximation N, corrected by
importance sampling.

    E_p f = E_N f + sum_k (p/q - N/q)(z_k) f(z_k)   ratios of sum one over the proposals z_k ~ q of the chains

E_N f comes from even quantiles of N. The Monte-Carlo error of the correction falls with the distance of p
from N: where the posterior is nearly normal it is a small part of that of a mean over as many draws (control
variates: Owen, Monte Carlo theory, methods and examples, ch. 8 and 9, 2013). Where the fit used averages of
neighbouring rows, the highest accuracy adds the same sum with the density of every row for p and that of the
averages for N, over as few z_k as their similarity allows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Estimate(NamedTuple):
    """Mean, standard deviation and ends of the central 95 % interval of one parameter; or the numerical error
    of each."""

    value: float
    std: float
    low: float
    high: float

    @classmethod
    def of(cls, x: np.ndarray, weight: np.ndarray) -> "Estimate":
        """Of points x (n,) with weights that sum to one; some may be negative."""
        mean = float(weight @ x)
        order = np.argsort(x, kind="stable")
        below = np.maximum.accumulate(np.cumsum(weight[order]) - 0.5 * weight[order])
        low, high = np.interp([0.025, 0.975], below, x[order])
        return cls(mean, float(np.sqrt(np.maximum(weight @ (x - mean) ** 2, 0.0))), float(low), float(high))

    def distance(self, other: "Estimate") -> float:
        """Largest difference of the means and of the intervals' ends, in standard deviations of `other`."""
        apart = np.abs([self.value - other.value, self.low - other.low, self.high - other.high])
        return float(np.max(apart)) / other.std if other.std > 0 else float("nan")


def moved(
    even: tuple[np.ndarray, np.ndarray], *corrections: tuple[np.ndarray, Sequence[np.ndarray]]
) -> Estimate:
    """The estimate from even points of N with their weights, and corrections: points, with the log ratios of
    p and of N to their proposal."""
    x, weights = [even[0]], [even[1]]
    for points, ratios in corrections:
        if len(points):
            shares = [np.exp(r - np.max(r)) for r in ratios]
            x.append(points)
            weights.append(shares[0] / shares[0].sum() - shares[1] / shares[1].sum())
    return Estimate.of(np.concatenate(x), np.concatenate(weights))
