"""Feedthrough and lateness of a step, where nothing else in the logs tells them from the gain.

A step shows what it settles at, A = G + nu, and how it begins, B = G (1 + t/tau): a feedthrough nu, a response that is late by
t and the gain are three numbers for two. With a lateness of up to a row G would be known to a row's share of tau, though A = B
within the noise says that neither is there, or that they cancel. That they should cancel is the less likely the better A and B
agree: both are given normal priors of one size, s in the unit of the response, by what the log itself shows of their difference,

    s^2 = |A - B|^2/2 + variance(A - B)        of each of Wd and Wq,

so that G is known about as well as A and B agree (empirical Bayes, Efron & Morris, JASA 70, 311, 1975). That is twice what an
unbiased s^2 is, with the noise added where it would be subtracted: the size of two numbers is hardly known from one, and an s
that is too small is worse than one that is too large. Of 60 logs each, with lateness drawn from a row and a feedthrough of its
own 97 % of the intervals held the truth (with half of s^2: 85 %); of a bench without either, all. Where other logs tell G the
priors stay wide; a feedthrough and a lateness that cancel there are taken for what is simpler, a gain of the log's own.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.experiment import Trial
from sysid.minimise import NAMES, State
from sysid.view import View

MOSTLY = 0.5  # of the standard deviation of log G, below which it falls when nothing is late
REGULAR = 1e-10  # least eigenvalue of the scaled information of parameters that the logs tell apart


def tightened(state: State, reference: tuple[float, float]) -> tuple[Trial, ...]:
    """The trials with priors of the size that they show; for a state in which the error of G is that of lateness."""
    found = []
    for trial, model in zip(state.trials, state.models, strict=True):
        view = View(trial, model, state, reference, coloured=True)
        found.append(_tight(view, _Both.of(view, state.covariance)) if _both(trial) else trial)
    return tuple(found)


def loosened(trial: Trial) -> Trial:
    """The trial with the priors that it has beside others."""
    return replace(trial, feedthrough_std=np.inf, late_std=np.inf)


def hangs(state: State, reference: tuple[float, float], free: Sequence[str]) -> bool:
    """Whether the error of G is that of lateness: without it, G would be known much better."""
    if "G" not in free or not any(_both(t) for t in state.trials):
        return False
    views = []
    for trial, model in zip(state.trials, state.models, strict=True):
        punctual = replace(trial, nuisances=tuple(n for n in trial.nuisances if n != "late"))
        views.append(View(punctual, model, state, reference, coloured=True))
    variance = _variance(views, [NAMES.index(n) for n in free])
    return variance is not None and variance < MOSTLY**2 * state.covariance[0, 0]


def cancelling(view: View) -> tuple[float, float] | None:
    """The gain of a log over that of the others when its feedthrough and its lateness cancel: with what that is worth in
    log-likelihood, against a feedthrough of any phase and of the size that is seen."""
    if not (view.trial.signed and _both(view.trial)):
        return None
    both = _Both.of(view)
    worth = 2 * np.log(abs(both.feedthrough) / both.error) - 0.5 * abs(both.left / both.error) ** 2
    gain = 1 + both.feedthrough.real / float(np.max(np.abs(view.course.forced)))
    return gain, float(worth + 0.5 * (view.late / view.trial.lateness) ** 2)


def _both(trial: Trial) -> bool:
    return trial.lateness > 0 and "feedthrough" in trial.shapes


class _Both(NamedTuple):
    """A log's feedthrough in the plate's frame and unit; what is `left` of it when what its lateness adds is taken off, A - B;
    the error of that per channel. The gain has no part in it."""

    feedthrough: complex
    left: complex
    error: float

    @classmethod
    def of(cls, view: View, plant: np.ndarray | None = None) -> "_Both":
        """With the plant's parameters of the covariance `plant` of theta, or held."""
        names, values = [c.name for c in view.columns], np.array([c.value for c in view.columns])

        def complex_of(name: str, factor: complex) -> np.ndarray:
            return np.array([factor * (n == f"{name}_d") + 1j * factor * (n == f"{name}_q") for n in names])

        through = complex_of("feedthrough", np.conj(view.turn))
        left = through - complex_of("late", _rise(view) * view.trial.lateness / view.trial.looseness)
        error = np.sqrt((left @ view.covariance(plant) @ left.conj()).real / 2)
        return cls(complex(through @ values), complex(left @ values), float(error))


def _rise(view: View) -> float:
    """Rate of the response after the largest step, per second."""
    return float(np.max(np.abs(view.course.push)))


def _variance(views: Sequence[View], index: Sequence[int]) -> float | None:
    """Of log G, the numbers of theta at `index` free; None where the logs do not tell them apart."""
    gram = sum(v.jacobian[:, index].T @ v.jacobian[:, index] for v in views)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < REGULAR:
        return None
    return float(np.linalg.inv(scaled)[0, 0] / size[0] ** 2)


def _tight(view: View, both: _Both) -> Trial:
    size = float(np.sqrt(0.5 * abs(both.left) ** 2 + both.error**2))
    return replace(view.trial, feedthrough_std=size, late_std=size / _rise(view))
