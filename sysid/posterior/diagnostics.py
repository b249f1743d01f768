"""Convergence of Markov chains: effective sample size and split R-hat (Vehtari et al., Bayesian Analysis 16, 667, 2021)."""

import numpy as np


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
    """Effective sample size of (chain, draw): Geyer's initial positive, monotone sequence over split chains."""
    if np.ptp(chains) == 0:
        return float("nan")
    halves = split(chains)
    m, n = halves.shape
    centred = halves - halves.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1)
    total = within * (n - 1) / n + halves.mean(axis=1).var(ddof=1)
    rho = 1 - (within - covariance) / total
    pairs = rho[0 : n - 1 : 2] + rho[1:n:2]
    positive = np.flatnonzero(pairs <= 0)
    pairs = np.minimum.accumulate(pairs[: positive[0]] if len(positive) else pairs)
    return float(m * n / max(2 * pairs.sum() - 1, 1 / np.log10(m * n)))
