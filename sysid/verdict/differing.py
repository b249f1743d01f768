"""Logs of one plate that differ by more than their errors, though not by so much that one of them must be wrong.

Log i has theta_k of its own, theta_k + u_i. With the score a and the information M of the u, all else eliminated, Cochran's Q is

    Q = a^T M^+ a,    of expectation  rank M + s^2 tr M  for u of variance s^2

so that s^2 = (Q - rank M)/tr M (DerSimonian & Laird, Controlled Clinical Trials 7, 177, 1986). Two logs that are 3 errors apart
are no misfit among all that is looked for, and their mean is then 2 of its own errors off if one of them is wrong. Where chance
makes such a Q, for one parameter, in fewer than one of CHANCE fits, the error spans what the logs show: u_i moves the joint
estimate by g_i u_i, with g_i = d theta/d u_i, and so adds to its covariance

    s^2 sum_i g_i g_i^T

The estimate stays what it was, each log weighed by its own errors: logs that differ by chance cost it no accuracy. What remains
unseen puts the mean of two equal logs up to 2 of its errors off, of three up to 1.7. A step beside a log that tells G can take a
gain of its own for a feedthrough and a lateness that cancel: where they do (`verdict.coincidence`), by what chance does as
seldom, the logs differ by that gain.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sysid.minimum.minimise import State
from sysid.model.prior import NAMES, PLANT
from sysid.model.span import inverted
from sysid.verdict.coincidence import cancelling
from sysid.verdict.view import View

CHANCE = 20  # as an interval of 95 % is believed: rarer ones would leave what is not seen larger than the intervals
TOLD = 1e-6  # of the best log's information, less than which a log says nothing of a parameter
COMPARED = 0.01  # of its information that others must tell: one log a temperature has f0 by k_T, told by what creeps in each
SAID = (
    "{}: the logs differ by more than their errors, by chance in one fit of {}: {}, {} {}; another log would tell which is right"
)
SPANS = "; the error of {} includes this difference"
OMITS = "; the error of {} does not include it, as tau or G would then not be determined"


class _Differ(NamedTuple):
    """By how much each of the logs `held` is off the others in one parameter, with its error; the size `std` that they show, 0 if
    none; by what theta moves with each, (logs, 6); and one over the probability of as much."""

    held: tuple[int, ...]
    off: np.ndarray
    error: np.ndarray
    std: float
    moves: np.ndarray
    rare: float


def dispersion(state: State, reference: tuple[float, float], free: Sequence[str]) -> tuple[np.ndarray, dict[str, str]]:
    """What logs that differ add to the covariance (6, 6) of theta; a sentence for each parameter in which they do, to be ended
    by SPANS or OMITS."""
    views = View.each(state, reference, coloured=True)
    added, said = np.zeros((len(NAMES), len(NAMES))), {}
    if len(views) > 1:
        for name, found in _Compared(views, state, [n for n in NAMES if n in free]).differing():
            added += found.std**2 * found.moves.T @ found.moves
            said[name] = _said(name, found, [state.trials[i].log.name for i in found.held])
    return added, said


class _Compared:
    """The logs at their fit, linearised: what each tells of the parameters `names`, and what all of them do."""

    def __init__(self, views: Sequence[View], state: State, names: Sequence[str]):
        self.views, self.names, self.index = views, names, [NAMES.index(n) for n in names]
        told = [np.sqrt(v.trial.noise.told) for v in views]  # of outliers, and noise of the phase, rows say less than weights do
        jacobians = [v.jacobian[:, self.index] * share for v, share in zip(views, told, strict=True)]
        self.slopes = [j.T @ v.r / share for j, v, share in zip(jacobians, views, told, strict=True)]
        self.grams = [j.T @ j for j in jacobians]
        self.inverse = inverted(sum(self.grams) + state.prior.precision[np.ix_(self.index, self.index)])
        self.slope = sum(self.slopes) - state.prior.slope(state.theta)[self.index]

    def differing(self) -> Iterator[tuple[str, _Differ]]:
        """The parameters in which they do, by name."""
        for name in (n for n in self.names if n in PLANT and n != "k_T"):
            found = self._by_score(name)
            if name == "G" and found is None:
                found = self._by_cancelling()
            if found is not None:
                yield name, found

    def _by_score(self, name: str) -> _Differ | None:
        k = self.names.index(name)
        own = np.array([gram[k, k] for gram in self.grams])
        held = tuple(np.flatnonzero(own > TOLD * np.max(own)).tolist())
        if len(held) < 2:
            return None
        cross = np.stack([self.grams[i][:, k] for i in held], axis=1)
        score = np.array([self.slopes[i][k] for i in held]) - cross.T @ self.inverse @ self.slope
        left = np.diag(cross[k]) - cross.T @ self.inverse @ cross
        std, rare = _size(score, left, cross[k])
        diagonal = np.maximum(np.diag(left), TOLD * cross[k])
        found = _Differ(held, score / diagonal, 1 / np.sqrt(diagonal), std, self._moves(held, k), rare)
        return found if rare > CHANCE and std > 0 else None

    def _by_cancelling(self) -> _Differ | None:
        """By the gain of the log in which a feedthrough and a lateness cancel most strikingly; a share 1/n of its square is the
        variance that n logs show."""
        own = {i: shown for i, v in enumerate(self.views) if (shown := cancelling(v)) is not None}
        if not own:
            return None
        i = max(own, key=lambda i: own[i][1])
        gain, worth = own[i]
        held = tuple(i for i, v in enumerate(self.views) if v.trial.driven)
        if worth < np.log(CHANCE) or len(held) < 2:
            return None
        std, off = abs(gain - 1) / np.sqrt(len(held)), (gain - 1) * (np.array(held) == i)
        return _Differ(held, off, np.ones(len(held)), std, self._moves(held, self.names.index("G")), float(np.exp(worth)))

    def _moves(self, held: Sequence[int], k: int) -> np.ndarray:
        """(logs, 6) of theta with the k-th parameter of each of these logs."""
        moves = np.zeros((len(held), len(NAMES)))
        moves[:, self.index] = [self.inverse @ self.grams[i][:, k] for i in held]
        return moves


def _size(score: np.ndarray, left: np.ndarray, own: np.ndarray) -> tuple[float, float]:
    """The standard deviation that logs show of what each has for itself, and how rare as much is by chance: from the score, the
    information `left` of it, and what each log has by itself, `own`."""
    size = np.sqrt(own)
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    told = values > COMPARED
    square = float(np.sum((vectors[:, told].T @ (score / size)) ** 2 / values[told]))
    rank, total = int(np.sum(told)), float(np.trace(left))
    if not rank or total <= 0:
        return 0.0, 1.0
    return float(np.sqrt(max(square - rank, 0.0) / total)), 1 / max(float(gammaincc(0.5 * rank, 0.5 * square)), 1e-300)


def _said(name: str, found: _Differ, logs: Sequence[str]) -> str:
    """Of two logs either may be the one that is off."""
    i = int(np.argmax(np.abs(found.off / found.error)))
    about = f"{found.off[i]:+.2g} Hz" if name == "f0" else f"{100 * found.off[i]:+.2g} %"
    which, off = (logs[i], "off the others by") if len(logs) > 2 else (f"{logs[0]} and {logs[1]}", "apart by")
    return SAID.format(name, f"{min(found.rare, 1e6):.2g}", which, off, about if len(logs) > 2 else about[1:])
