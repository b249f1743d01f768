"""What errors span of what a plate leaves of its logs, where it does not describe them.

What is left and is not noise has moved the plate as well: by as much, it is supposed, as its like along the
log moves it. With the score s_i = J_i^T r_i of each row and the information H of all, windows of L rows add
to the covariance of theta

    H^-1 (n/(n - L) sum_w S_w S_w^T / L) H^-1        S_w = sum of s_i in the window w

(Newey & West, Econometrica 55, 703, 1987: Bartlett's weights are those of all windows that overlap; n/(n - L)
as the scores of a log add up to nothing, by which n/L windows tell one less). Of noise
of each row's own it is the covariance, whatever L; of what is left it is most where windows are about as long
as that lasts, so that the largest of all L is taken. The rows follow one another by their time, or by their
frequency, whichever leaves more.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from sysid.minimum.minimise import State
from sysid.model.theta import NAMES
from sysid.verdict.linear import Linear
from sysid.verdict.linearised import LinearisedLog


def remains(state: State, reference: tuple[float, float], free: Sequence[str]) -> np.ndarray:
    """(6, 6) what is left of the logs adds to the covariance of theta."""
    names, found = [n for n in NAMES if n in free], np.zeros((len(NAMES), len(NAMES)))
    linear = Linear(LinearisedLog.each(state, reference), state, names, 0.0)
    index = np.ix_(*[[NAMES.index(n) for n in names]] * 2)
    for view, jacobian in zip(linear.views, linear.jacobians, strict=True):
        each = [_by_windows(s, length) for s in _scores(view, jacobian) for length in _lengths(len(s))]
        most = max(each, key=lambda v: float(np.sum(v * linear.inverse)))  # tr(H^-1 V), free of units
        found[index] += linear.inverse @ most @ linear.inverse
    return found


def _scores(view: LinearisedLog, jacobian: np.ndarray) -> Iterator[np.ndarray]:
    """(n, p) of a log's rows in the order of their time, and of their frequency."""
    channels = (len(view.r) - view.priors) // view.n
    rows = channels * view.n
    each = (jacobian[:rows] * view.r[:rows, None]).reshape(channels, view.n, -1).sum(axis=0)
    yield each
    if view.trial.resonant:
        yield each[np.argsort(view.trial.log.frequency[view.trial.noise.used], kind="stable")]


def _lengths(n: int) -> list[int]:
    """Of windows, in octaves up to half of the log."""
    return [1 << k for k in range(max(n.bit_length() - 1, 1))]


def _by_windows(scores: np.ndarray, length: int) -> np.ndarray:
    """(p, p) sum of the products of windows' scores, over their length."""
    n = len(scores)
    sums = np.cumsum(np.pad(scores, ((length, length - 1), (0, 0))), axis=0)
    windows = sums[length:] - sums[:-length]
    return windows.T @ windows / length * n / max(n - length, 1)
