"""Phase noise: a reference that jitters by phi(t) turns the response, adding j phi W, which is not additive
noise.

It lies across the response, grows with it, and is shared by neighbouring rows. phi is modelled as an
Ornstein-Uhlenbeck process in white noise of level sigma. In the frame of the modelled response, W = |W| u,

    Re(r u*) = e_1            Im(r u*) = |W| phi + e_2

so the likelihood of a residual r is that of a Markov process in noise. As in `trials.noise` it is the
restricted likelihood, in which all that the fit can adjust is integrated out. Jitter is reported where it is
likelier than additive noise of the fitted colour.

The fit keeps its weights W. Its estimates stay unbiased, with the covariance of `trials.projected` for

    S = sigma^2 + std^2 |W| |W'| exp(-|t - t'|/time)        across the response, sigma^2 along it.
"""

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from sysid.model.span import orthonormal, times
from sysid.trials.noise import ALIKE, ODD, ROUNDING, forgotten
from sysid.trials.perturbed import LogResponse
from sysid.trials.projected import shared
from sysid.trials.trial import Trial
from sysid.trials.whitening import Jitter, whitened

# of the largest eigenvalue of the information: smaller ones belong to columns that are sums of others
APART = 1e-9
LEAST = 40  # rows: the least that show a colour differing between the channels
# standard deviations of the channels' difference in white noise, below which the likelihood is not evaluated
SUSPECT = 1.5
TWO = 1.0  # further log-likelihood to be gained by two numbers, a size and a time
SHORTEST, LONGEST, TIMES = (
    0.2,
    0.3,
    10,
)  # range of correlation times, in rows and as a share of the log, and how many are tried
SIZES = np.geomspace(0.3, 100.0, 10)  # tried ratios of |W| phi at the largest response to sigma


def found(trial: Trial, model: np.ndarray, course: LogResponse) -> Jitter | None:
    """The phase noise of a d/q log whose modelled rows are `model` (n,); None where it is not worth two
    numbers."""
    seen = _likeliest(trial, model, course)
    return seen and seen._replace(left=_efficiency(trial, model, course, seen))


def _likeliest(trial: Trial, model: np.ndarray, course: LogResponse) -> Jitter | None:
    """The likeliest size and time of the phase noise; its cost in information is not yet computed."""
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
    made = course.design()[used] * trial.bench.turn * towards[:, None]
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
    if plain - cost[best] < ODD + TWO:
        return None
    level = power * float(scale[best])
    chance = np.exp(cost[best] - cost)
    chance /= np.sum(chance)
    ratio, time = np.exp(chance @ np.log(grid))
    return Jitter(float(ratio) * level / float(np.max(size * weight)), float(time) * typical, level)


def _efficiency(trial: Trial, model: np.ndarray, course: LogResponse, jitter: Jitter) -> float:
    """The share of the stated information on G, tau and f0 that is left; the least of those that the log
    shows at all (no decay shows G), at most 1."""
    used = trial.noise.used
    made = (course.design() * trial.bench.turn)[used].T
    made = np.concatenate([made, 1j * made])
    plant = [
        0,
        1,
        len(made) // 2 + 1,
    ]  # by log G, the decay's rate and what turns with the resonance; not the rotation
    norm = np.linalg.norm(made, axis=1, keepdims=True)
    made = made / np.where(norm > 0, norm, 1.0)
    plant = [row for row in plant if norm[row, 0] > 0]
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
    return float(np.min(np.diag(inverse)[plant] / np.diag(spread)[plant], initial=1.0))


def _suspect(across: np.ndarray, size: np.ndarray) -> bool:
    """Whether a strong response has more residual across it than along it, or neighbours that share more of
    it."""
    strong = size**2 / np.mean(size**2)
    power = np.stack([across.imag**2 - across.real**2, np.zeros(len(size))])
    power[1, 1:] = across.imag[1:] * across.imag[:-1] - across.real[1:] * across.real[:-1]
    chance = np.sqrt(np.sum((strong * power) ** 2, axis=1))
    return bool(np.any(power @ strong > SUSPECT * chance))


def _plain(trial: Trial, rows: np.ndarray) -> float:
    """`_restricted`, with its determinant, of rows (C, n) in additive noise of the colour and the channels
    that the fit has."""
    now, before = trial.noise.whitening()
    white = whitened(rows, now, before)
    both = now if np.iscomplexobj(now) else now * (1 + 1j)
    volume = float(np.sum(np.log(both.real)) + np.sum(np.log(both.imag)))
    return float(_restricted((white @ white.conj().T).real[None], rows.shape[1])[0][0]) - volume


def _left(
    rows: np.ndarray, share: np.ndarray, steps: np.ndarray, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of rows y (C, n) that hold `share` (n,) of an OU process beside unit noise, of sizes and times (P, 2)
    of the process: their Gram matrices in the inverse of that covariance V, (P, C, C), and half the logarithm
    of its determinant, (P,).

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
    """Minus the restricted log-likelihood, its level integrated out, less the determinant, (P,), and the
    level (P,), of the Gram matrices (P, C, C) of whitened rows of two channels of n: a basis of what the fit
    can make and, last, the residual."""
    factors = np.linalg.cholesky(grams * (1 + ROUNDING * np.eye(grams.shape[1])))
    diagonal = np.diagonal(factors, axis1=1, axis2=2)
    freedom = 2 * n - grams.shape[1] + 1
    cost = np.sum(np.log(diagonal[:, :-1]), axis=1) + freedom * np.log(diagonal[:, -1])
    return cost, diagonal[:, -1] / np.sqrt(freedom)
