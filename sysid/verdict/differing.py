"""Logs of one plate that differ by more than their errors, though not by so much that one of them must be
wrong.

Log i has theta_k of its own, theta_k + u_i. With the score a and the information M of the u, all else
eliminated, Cochran's Q is

    Q = a^T M^+ a,    of expectation  rank M + s^2 tr M  for u of variance s^2

so that s^2 = (Q - rank M)/tr M (DerSimonian & Laird, Controlled Clinical Trials 7, 177, 1986). Two logs that
are 3 errors apart are no misfit among all that is looked for, and their mean is then 2 of its own errors off
if one of them is wrong. Where chance makes such a Q, for one parameter, in fewer than one of CHANCE fits, the
error spans what the logs show: u_i moves the joint estimate by g_i u_i, with g_i = d theta/d u_i, and so adds
to its covariance

    s^2 sum_i g_i g_i^T

The estimate stays what it was, each log weighed by its own errors: logs that differ by chance cost it no
accuracy. What remains unseen puts the mean of two equal logs up to 2 of its errors off, of three up to 1.7. A
step beside a log that tells G can take a gain of its own for a feedthrough and a lateness that cancel, or for
an offset and a start, in any size. So G is compared as each log would tell it alone, where these are as small
as they look (`verdict.gain_confounding`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sysid.minimum.minimise import State
from sysid.model.span import inverted
from sysid.model.theta import NAMES, PLANT
from sysid.verdict.gain_confounding import cancelling, may_cancel, tightened
from sysid.verdict.linearised import LinearisedLog

# as an interval of 95 % is believed: rarer ones would leave what is not seen larger than the intervals
CHANCE = 20
TOLD = 1e-6  # of the best log's information, less than which a log says nothing of a parameter
# of its information that others must tell: one log a temperature has f0 by k_T, told by what creeps in each
COMPARED = 0.01
# of three parameters: a warning in one good fit of a hundred; what is less rare is only noted, and spanned
ALARM = 300
SAID = "{}: the logs differ by more than their errors, by chance in one fit of {}: {}, {} {}"
SPANS = "; the error of {} includes this difference"
OMITS = "; the error of {} does not include it, as tau or G would then not be determined"
WHICH = "; another log would tell which is right"


class Differ(NamedTuple):
    """By how much each of the logs `held` is off the others in one parameter, with its error; the size `std`
    that they show; and one over the probability of as much."""

    held: tuple[int, ...]
    off: np.ndarray
    error: np.ndarray
    std: float
    rare: float


class Said(NamedTuple):
    """A sentence on a parameter in which logs differ; `rare`: rarer by chance than one in ALARM."""

    name: str
    sentence: str
    rare: bool

    def told(self, spanned: bool) -> str:
        """The whole of it; `spanned`: the errors include the difference."""
        return (
            self.sentence
            + (SPANS if spanned else OMITS).format(self.name)
            + WHICH * (self.rare or not spanned)
        )


def dispersion(
    state: State, reference: tuple[float, float], free: Sequence[str]
) -> tuple[np.ndarray, list[Said]]:
    """What logs that differ add to the covariance (6, 6) of theta; and a sentence for each parameter in which
    they do."""
    added, said = np.zeros((len(NAMES), len(NAMES))), list[Said]()
    if len(state.trials) < 2:
        return added, said
    names = [n for n in NAMES if n in free]
    logs = alone = _Compared(
        state, reference, names
    )  # `alone`: with what makes up for a gain as small as it looks
    if "G" in free and (pairs := may_cancel(state)):
        alone = _Compared(replace(state, trials=tightened(state, reference, pairs)), reference, names)
    for name in (n for n in names if n in PLANT and n != "k_T"):
        if (found := (alone if name == "G" else logs).differing(name)) is not None:
            found = _in_full(found, logs.views) if name == "G" else found
            moves = logs.moves(found.held, name)
            added += found.std**2 * moves.T @ moves
            about = sentence(name, found, [state.trials[i].log.name for i in found.held])
            said.append(Said(name, about, found.rare > ALARM))
    return added, said


class _Compared:
    """The logs at their fit, linearised: what each tells of the parameters `names`, and what all of them
    do."""

    def __init__(self, state: State, reference: tuple[float, float], names: Sequence[str]):
        self.views = views = LinearisedLog.each(state, reference, coloured=True)
        self.names, self.index = names, [NAMES.index(n) for n in names]
        told = [
            np.sqrt(v.trial.noise.told) for v in views
        ]  # of outliers, and noise of the phase, rows say less than weights do
        jacobians = [v.jacobian[:, self.index] * share for v, share in zip(views, told, strict=True)]
        self.slopes = [j.T @ v.r / share for j, v, share in zip(jacobians, views, told, strict=True)]
        self.grams = [j.T @ j for j in jacobians]
        self.inverse = inverted(sum(self.grams) + state.prior.precision[np.ix_(self.index, self.index)])
        self.slope = sum(self.slopes) - state.prior.slope(state.theta)[self.index]

    def differing(self, name: str) -> Differ | None:
        """Whether they do in this parameter."""
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
        return (
            Differ(held, score / diagonal, 1 / np.sqrt(diagonal), std, rare)
            if rare > CHANCE and std > 0
            else None
        )

    def moves(self, held: Sequence[int], name: str) -> np.ndarray:
        """(logs, 6) by what theta moves with the parameter of each of these logs."""
        k, moves = self.names.index(name), np.zeros((len(held), len(NAMES)))
        moves[:, self.index] = [self.inverse @ self.grams[i][:, k] for i in held]
        return moves


def _in_full(found: Differ, views: Sequence[LinearisedLog]) -> Differ:
    """Gains that differ, in the size that a feedthrough and a lateness have which cancel: as small as they
    look, they make up for a part. A share 1/n of its square is the variance that n logs show."""
    gains = {i: shown[0] - 1 for i in found.held if (shown := cancelling(views[i])) is not None}
    i = max(gains, key=lambda i: abs(gains[i]), default=-1)
    if i < 0 or abs(gains[i]) < np.sqrt(len(found.held)) * found.std:
        return found
    off = gains[i] * (np.array(found.held) == i)
    return found._replace(off=off, error=np.ones(len(off)), std=abs(gains[i]) / np.sqrt(len(off)))


def _size(score: np.ndarray, left: np.ndarray, own: np.ndarray) -> tuple[float, float]:
    """The standard deviation that logs show of what each has for itself, and how rare as much is by chance:
    from the score, the information `left` of it, and what each log has by itself, `own`."""
    size = np.sqrt(own)
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    told = values > COMPARED
    square = float(np.sum((vectors[:, told].T @ (score / size)) ** 2 / values[told]))
    rank, total = int(np.sum(told)), float(np.trace(left))
    if not rank or total <= 0:
        return 0.0, 1.0
    return float(np.sqrt(max(square - rank, 0.0) / total)), 1 / max(
        float(gammaincc(0.5 * rank, 0.5 * square)), 1e-300
    )


def sentence(name: str, found: Differ, logs: Sequence[str]) -> str:
    """Of two logs either may be the one that is off."""
    i = int(np.argmax(np.abs(found.off / found.error)))
    about = f"{found.off[i]:+.2g} Hz" if name == "f0" else f"{100 * found.off[i]:+.2g} %"
    which, off = (logs[i], "off the others by") if len(logs) > 2 else (f"{logs[0]} and {logs[1]}", "apart by")
    return SAID.format(name, f"{min(found.rare, 1e6):.2g}", which, off, about if len(logs) > 2 else about[1:])
