"""Noise of the phase: a reference that jitters turns the response by phi(t), and what that adds, j phi W, is no additive noise.

It lies across the response, is as large as that is, and rows share it: phi is taken for an Ornstein-Uhlenbeck process, seen in
white noise of one level sigma. In the frame of the modelled response, W = |W| u,

    Re(r u*) = e_1            Im(r u*) = |W| phi + e_2

so that the likelihood of a residual r is that of a Markov process in noise, and as in `trials.noise` the restricted one, in which
what the fit can make of a log is integrated out. It is found where it is likelier than additive noise of the colour that the fit
has.

The fit keeps the weights W of that. Its estimates have then no bias, and the covariance of `trials.projected`, with

    S = sigma^2 + std^2 |W| |W'| exp(-|t - t'|/time)        across the response, sigma^2 along it.
"""

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from sysid.model.span import orthonormal, times
from sysid.trials.noise import ROUNDING, WORTH, forgotten
from sysid.trials.perturbed import Course
from sysid.trials.projected import shared
from sysid.trials.trial import Trial
from sysid.trials.whitening import Jitter, whitened

ALIKE = 1e-4  # of a unit column, which is a sum of others but for as little
APART = 1e-9  # of the largest, an eigenvalue of the information of columns that are sums of others, as lateness and feedthrough
LEAST = 40  # rows, of which a colour that differs from channel to channel can be told
SUSPECT = 1.5  # standard deviations of the difference of the channels in white noise, below which the likelihood is not asked
TWO = 1.0  # log-likelihood more that two numbers, a size and a time, have to gain
SHORTEST, LONGEST, TIMES = 0.2, 0.3, 10  # rows, and share of the log, between which so many correlation times are tried
SIZES = np.geomspace(0.3, 100.0, 10)  # |W| phi of the largest response over sigma


def found(trial: Trial, model: np.ndarray, course: Course) -> Jitter | None:
    """What a log of d and q holds of it, of rows (n,) that the fit models; None where that is not worth two numbers."""
    seen = _likeliest(trial, model, course)
    return seen and seen._replace(left=_efficiency(trial, model, course, seen))


def _likeliest(trial: Trial, model: np.ndarray, course: Course) -> Jitter | None:
    """Its size and its time, of the information that it leaves nothing yet."""
    used = trial.noise.used
    size = np.abs(model[used])
    left = (trial.log.response - model)[used]
    if trial.channels == 1 or len(left) < LEAST or not np.any(left) or not np.any(size):
        return None
    weight, clock = trial.noise.weight[used], trial.noise.clock[used]
    towards = np.exp(-1j * np.angle(model[used])) * weight
    across = left * towards
    if not _suspect(across, size * weight):
        return None
    made = course.design()[used] * trial.turn * towards[:, None]
    real = np.concatenate([made, 1j * made], axis=1)
    basis = orthonormal(np.concatenate([real.real, real.imag]), ALIKE).T
    power = float(np.linalg.norm(across))
    both = np.concatenate([basis, [np.concatenate([across.real, across.imag]) / power]])
    rows = both[:, : len(left)] + 1j * both[:, len(left) :]
    typical = float(np.median(np.diff(clock)))
    longest = max(LONGEST * (clock[-1] - clock[0]) / (typical or 1.0), 1.0)
    grid = np.array([(s, t) for t in np.geomspace(SHORTEST, longest, TIMES) for s in SIZES])
    steps, share = np.diff(clock) / (typical or 1.0), size * weight / np.max(size * weight)
    grams, volume = _left(rows.imag, share, steps, grid)
    cost, scale = _restricted(rows.real @ rows.real.T + grams, len(left))
    cost = cost + volume
    plain = _plain(trial, rows / towards) + 2 * float(np.sum(np.log(weight)))
    best = int(np.argmin(cost))
    if plain - cost[best] < WORTH + TWO:
        return None
    level = power * float(scale[best])
    chance = np.exp(cost[best] - cost)
    chance /= np.sum(chance)
    ratio, time = np.exp(chance @ np.log(grid))
    return Jitter(float(ratio) * level / float(np.max(size * weight)), float(time) * typical, level)


def _efficiency(trial: Trial, model: np.ndarray, course: Course, jitter: Jitter) -> float:
    """Information about G, tau and f0 that a log holds over what is stated of it: the least of them, at most 1."""
    used = trial.noise.used
    made = (course.design() * trial.turn)[used].T
    made = np.concatenate([made, 1j * made])
    plant = [0, 1, len(made) // 2 + 1]  # by log G, the decay's rate and what turns with the resonance; not the rotation
    norm = np.linalg.norm(made, axis=1, keepdims=True)
    made = made / np.where(norm > 0, norm, 1.0)
    now, before = trial.noise.whitening()
    white = whitened(made, now, before)
    seen = times(now, white)
    seen[:, :-1] -= times(before, white)[:, 1:]  # W J
    inverse = np.linalg.pinv((white @ white.conj().T).real, rcond=APART, hermitian=True)
    across = (seen * np.exp(-1j * np.angle(model[used]))).imag * np.abs(model[used])
    steps = -np.diff(trial.noise.clock[used], prepend=trial.noise.clock[used][0]) / jitter.time
    turned = jitter.std**2 * across @ np.array([shared(steps, v) for v in across]).real.T
    own = seen * (jitter.level / trial.noise.weight[used])
    spread = inverse @ ((own @ own.conj().T).real + turned) @ inverse
    return float(min(1.0, np.min((np.diag(inverse) / np.diag(spread))[plant])))


def _suspect(across: np.ndarray, size: np.ndarray) -> bool:
    """Whether what lies across a strong response is larger than what lies along it, or is shared by more of its neighbours."""
    strong = size**2 / np.mean(size**2)
    power = np.stack([across.imag**2 - across.real**2, np.zeros(len(size))])
    power[1, 1:] = across.imag[1:] * across.imag[:-1] - across.real[1:] * across.real[:-1]
    chance = np.sqrt(np.sum((strong * power) ** 2, axis=1))
    return bool(np.any(power @ strong > SUSPECT * chance))


def _plain(trial: Trial, rows: np.ndarray) -> float:
    """`_restricted`, with its determinant, of rows (C, n) in additive noise of the colour and the channels that the fit has."""
    now, before = trial.noise.whitening()
    white = whitened(rows, now, before)
    both = now if np.iscomplexobj(now) else now * (1 + 1j)
    volume = float(np.sum(np.log(both.real)) + np.sum(np.log(both.imag)))
    return float(_restricted((white @ white.conj().T).real[None], rows.shape[1])[0][0]) - volume


def _left(rows: np.ndarray, share: np.ndarray, steps: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows y (C, n) that hold `share` (n,) of an OU process beside unit noise, of sizes and times (P, 2) of the process: their
    Gram matrices in the inverse of that covariance V, (P, C, C), and half the logarithm of its determinant, (P,).

    The inverse of an OU process' own covariance K is tridiagonal: with D = diag(share) and T = 1/K + D^2,

        y' V^-1 y = y' y - (D y)' T^-1 D y        det V = det T det K
    """
    seen = np.asfortranarray((share * rows).T)
    grams, volume = np.empty((len(grid), len(rows), len(rows))), np.empty(len(grid))
    for k, (size, time) in enumerate(grid):
        gap, shrink = forgotten(steps, time)
        memory, precision = 1 - gap, 1 / (size**2 * shrink)
        diagonal = np.append(1 / size**2, precision) + share**2
        diagonal[:-1] += memory**2 * precision
        diagonal, lower, _ = dpttrf(diagonal, -memory * precision)
        grams[k] = seen.T @ dpttrs(diagonal, lower, seen)[0]
        volume[k] = 0.5 * (np.sum(np.log(diagonal)) + np.sum(np.log(shrink))) + len(share) * np.log(size)
    return rows @ rows.T - grams, volume


def _restricted(grams: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Minus the restricted log-likelihood, its level integrated out, less the determinant, (P,), and the level (P,), of the Gram
    matrices (P, C, C) of whitened rows of two channels of n: a basis of what the fit can make and, last, the residual."""
    factors = np.linalg.cholesky(grams * (1 + ROUNDING * np.eye(grams.shape[1])))
    diagonal = np.diagonal(factors, axis1=1, axis2=2)
    freedom = 2 * n - grams.shape[1] + 1
    cost = np.sum(np.log(diagonal[:, :-1]), axis=1) + freedom * np.log(diagonal[:, -1])
    return cost, diagonal[:, -1] / np.sqrt(freedom)
