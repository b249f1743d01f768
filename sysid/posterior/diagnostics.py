"""Convergence of Markov chains: effective sample size and split R-hat, of the draws themselves and of
their normal scores (Vehtari et al., Bayesian Analysis 16, 667, 2021)."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

TAIL = (0.05, 0.95)  # quantiles whose effective sample size is that of the tails


class Convergence(NamedTuple):
    """Of one parameter: rank-normalised split `rhat` (the larger of location's and scale's), effective
    draws for the middle of the distribution, `ess_bulk`, and for its tails, `ess_tail`."""

    rhat: float
    ess_bulk: float
    ess_tail: float

    @classmethod
    def of(cls, chains: np.ndarray) -> "Convergence":
        """Of draws (chain, draw); NaN for constant ones."""
        folded = np.abs(chains - np.median(split(chains)))
        scores, scale = normal_scores(chains), normal_scores(folded)
        tails = [ess((chains <= q).astype(float)) for q in np.quantile(chains, TAIL)]
        return cls(max(rhat(scores), rhat(scale)), ess(scores), min(tails))


def normal_scores(chains: np.ndarray) -> np.ndarray:
    """Each draw's rank among those that `split` keeps, as a quantile of the normal distribution."""
    kept = split(chains)
    _, which, count = np.unique(kept, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - 0.5 * (count - 1))[which].reshape(kept.shape)  # those that are equal share one
    scores = ndtri((rank - 0.375) / (kept.size + 0.25))
    return np.concatenate(np.split(scores, 2), axis=1)


def split(chains: np.ndarray) -> np.ndarray:
    """Each chain (chain, draw) cut into its first and its second half."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def rhat(chains: np.ndarray) -> float:
    """Split R-hat of (chain, draw); 1 when chains agree, NaN for constant draws."""
    if np.ptp(chains) == 0:
        return float("nan")
    halves = split(chains)
    n = halves.shape[1]
    within = halves.var(axis=1, ddof=1).mean()
    between = n * halves.mean(axis=1).var(ddof=1)
    return float(np.sqrt((n - 1) / n + between / within / n)) if within > 0 else float("nan")


def ess(chains: np.ndarray) -> float:
    """Effective sample size of (chain, draw): Geyer's initial positive, monotone sequence over split
    chains."""
    if np.ptp(chains) == 0:
        return float("nan")
    halves = split(chains)
    m, n = halves.shape
    centred = halves - halves.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1)
    total = within * (n - 1) / n + halves.mean(axis=1).var(ddof=1)
    rho = np.append(1.0, 1 - (within - covariance[1:]) / total)
    pairs = rho[0 : n - 1 : 2] + rho[1:n:2]
    ends = np.flatnonzero(pairs <= 0)
    kept = ends[0] if len(ends) else len(pairs)
    last = (
        max(rho[2 * kept], 0.0) if len(ends) else 0.0
    )  # of the first pair that is none any more, its even half
    time = 2 * np.minimum.accumulate(pairs[:kept]).sum() + last - 1
    return float(m * n / max(time, 1 / np.log10(m * n)))
