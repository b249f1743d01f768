"""Logs of one plate that differ by more than their errors, though not by so much that one of them must be wrong.

Log i has theta_k of its own, theta_k + u_i. With the score a and the information M of the u, all else eliminated, Cochran's Q is

    Q = a^T M^+ a,    of expectation  rank M + s^2 tr M  for u of variance s^2

so that s^2 = (Q - rank M)/tr M (DerSimonian & Laird, Controlled Clinical Trials 7, 177, 1986). Two logs that are 3 errors apart
are no misfit among all that is looked for, and their mean is then 2 of its own errors off if one of them is wrong. Where chance
makes such a Q in fewer than one of CHANCE fits, each log gets a u of its own with a prior of that size, and the error spans what
the logs show. What remains unseen is less than that: it puts the mean of two or three equal logs about 1.7 of its errors off.
A step beside a log that tells G can take a gain of its own for a feedthrough and a lateness that cancel: where they do
(`verdict.coincidence`), by what chance does as seldom, the logs differ by that gain.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sysid.minimum.minimise import State
from sysid.model.prior import NAMES
from sysid.trials.trial import Trial
from sysid.verdict.coincidence import cancelling
from sysid.verdict.view import View

CHANCE = 20  # as an interval of 95 % is believed: rarer ones would leave what is not seen larger than the intervals
TOLD = 1e-6  # of the best log's information, less than which a log says nothing of a parameter
COMPARED = 0.01  # of its information that others must tell: one log a temperature has f0 by k_T, told by what creeps in each
OWN = {"G": "gain", "tau": "damping", "f0": "tuning"}  # by parameter, the number of a log's own in `trials.extra`
SAID = (
    "{}: the logs differ by more than their errors, as by chance in one of {}: {}, {} {}; another log would tell which is right;"
    " its error "
)
SPANS, OMITS = "spans this", "does not span this, with which tau or G would not be determined"


class _Differ(NamedTuple):
    """By how much each of the logs `held` is off the others in one parameter, with its error; the size `std` that they show, 0 if
    none, and one over the probability of as much."""

    held: tuple[int, ...]
    off: np.ndarray
    error: np.ndarray
    std: float
    rare: float


def with_differences(state: State, reference: tuple[float, float], free: Sequence[str]) -> tuple[tuple[Trial, ...], list[str]]:
    """The trials, each with numbers of its own in which the logs differ; and sentences that say so, to be ended by what the error
    does about it."""
    held = tuple(i for i, t in enumerate(state.trials) if t.signed and t.driven)
    if len(held) < 2:
        return state.trials, []
    views = [View(t, m, state, reference, coloured=True) for t, m in zip(state.trials, state.models, strict=True)]
    trials, said = list(state.trials), []
    differing = dict(_differ(views, held, state, [n for n in NAMES if n in free]))
    if "G" in free and "G" not in differing and (found := _cancelling(views, held)) is not None:
        differing["G"] = found
    for name, found in differing.items():
        for i in found.held:
            narrow = trials[i].narrow | {OWN[name]: found.std}
            trials[i] = replace(trials[i], nuisances=(*trials[i].nuisances, OWN[name]), narrow=narrow)
        said.append(_said(name, found, [trials[i].log.name for i in found.held]))
    return tuple(trials), said


def _differ(views: Sequence[View], held: Sequence[int], state: State, names: Sequence[str]) -> Iterator[tuple[str, _Differ]]:
    """By name, the parameters in which they do."""
    index = [NAMES.index(n) for n in names]
    told = [np.sqrt(v.trial.noise.told) for v in views]  # of outliers, and noise of the phase, rows say less than their weights
    jacobians = [v.jacobian[:, index] * share for v, share in zip(views, told, strict=True)]
    slopes = [j.T @ v.r / share for j, v, share in zip(jacobians, views, told, strict=True)]
    grams = [j.T @ j for j in jacobians]
    gram = sum(grams) + state.prior.precision[np.ix_(index, index)]
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
    slope = sum(slopes) - state.prior.slope(state.theta)[index]
    for k, name in ((k, n) for k, n in enumerate(names) if n in OWN):
        least = TOLD * max(grams[i][k, k] for i in held)
        mine = [i for i in held if OWN[name] not in views[i].trial.nuisances and grams[i][k, k] > least]
        if len(mine) < 2:
            continue
        cross = np.stack([grams[i][:, k] for i in mine], axis=1)
        score = np.array([slopes[i][k] for i in mine]) - cross.T @ inverse @ slope
        found = _of(tuple(mine), score, np.diag(cross[k]) - cross.T @ inverse @ cross, cross[k])
        if found.rare > CHANCE and found.std > 0:
            yield name, found


def _cancelling(views: Sequence[View], held: tuple[int, ...]) -> _Differ | None:
    """The gain of the log in which a feedthrough and a lateness cancel most strikingly; a share 1/n of its square is the variance
    that n logs show."""
    own = {i: shown for i in held if "gain" not in views[i].trial.nuisances and (shown := cancelling(views[i])) is not None}
    if not own:
        return None
    i = max(own, key=lambda i: own[i][1])
    gain, worth = own[i]
    if worth < np.log(CHANCE):
        return None
    off = (gain - 1) * (np.array(held) == i)
    return _Differ(held, off, np.ones(len(held)), abs(gain - 1) / np.sqrt(len(held)), float(np.exp(worth)))


def _of(held: tuple[int, ...], score: np.ndarray, left: np.ndarray, own: np.ndarray) -> _Differ:
    """By the score of what each log has for itself and the information `left` of it, where it has `own` by itself."""
    size = np.sqrt(own)
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    told = values > COMPARED
    square = float(np.sum((vectors[:, told].T @ (score / size)) ** 2 / values[told]))
    rank, total = int(np.sum(told)), float(np.trace(left))
    std = np.sqrt(max(square - rank, 0.0) / total) if rank and total > 0 else 0.0
    diagonal = np.maximum(np.diag(left), TOLD * own)
    rare = 1 / max(float(gammaincc(0.5 * rank, 0.5 * square)), 1e-300) if rank else 1.0
    return _Differ(held, score / diagonal, 1 / np.sqrt(diagonal), float(std), rare)


def _said(name: str, found: _Differ, logs: Sequence[str]) -> str:
    """Of two logs either may be the one that is off."""
    i = int(np.argmax(np.abs(found.off / found.error)))
    about = f"{found.off[i]:+.2g} Hz" if name == "f0" else f"{100 * found.off[i]:+.2g} %"
    which, off = (logs[i], "off the others by") if len(logs) > 2 else (f"{logs[0]} and {logs[1]}", "apart by")
    return SAID.format(name, f"{min(found.rare, 1e6):.2g}", which, off, about if len(logs) > 2 else about[1:])
