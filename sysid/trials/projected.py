"""Coloured noise in amplitudes: how much less information they hold than the fit assumes.

A demodulator's filter colours the noise n(t) of Wd + j Wq, an Ornstein-Uhlenbeck process. An amplitude shows
only Re n e^{-j phi}, the part along the response, whose phase phi turns through a resonance. Two rows then
share

    exp(-|t - t'|/noise_time) cos(phi - phi')

while the fit assumes the first factor alone. Its estimates are those of generalized least squares with
weights W for another covariance than the true one, S: they are unbiased, with the covariance (White,
Econometrica 50, 1, 1982)

    (J^T W J)^-1 J^T W S W J (J^T W J)^-1        instead of (J^T W J)^-1
"""

import numpy as np

from sysid.model.carry import accumulated
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial
from sysid.trials.whitening import whitened


def efficiency(trial: Trial, course: LogResponse) -> float:
    """Information about the plant in a log of amplitudes, relative to what the fit states: the least over the
    parameters, at most 1."""
    noise, used = trial.noise, trial.noise.used
    now, before = noise.whitening()
    made = course.design()[used].T
    made = made[np.any(made != 0, axis=1)]
    if not len(made):
        return 1.0  # as of a decay that may not begin anywhere but at rest
    white = whitened(made / np.linalg.norm(made, axis=1, keepdims=True), now, before)
    unweighted = now * white
    unweighted[:, :-1] -= (before * white)[:, 1:]  # W J
    plate = course.plate[used]
    seen = unweighted * np.exp(-1j * np.angle(plate)) * (noise.std / noise.weight[used])
    inverse = np.linalg.pinv(white @ white.T, hermitian=True)
    steps = -np.diff(noise.clock[used], prepend=noise.clock[used][0]) / noise.time
    spread = inverse @ (seen.conj() @ np.array([shared(steps, v) for v in seen]).T).real @ inverse
    return float(min(1.0, np.min(np.diag(inverse) / np.diag(spread))))


def shared(steps: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The covariance of an Ornstein-Uhlenbeck process of variance 1 times v (n,); `steps` to each row, in
    correlation times."""
    memory = np.exp(steps)
    backward = accumulated(np.append(0.0, memory[:0:-1]), v[::-1])[::-1]
    return accumulated(memory, v) + backward - v
