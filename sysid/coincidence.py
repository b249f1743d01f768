"""Feedthrough and lateness of a step, where nothing else in the logs tells them from the gain.

A step shows what it settles at, A = G + nu, and how it begins, B = G (1 + t/tau): a feedthrough nu, a response that is late by
t and the gain are three numbers for two. With a lateness of up to a row G would be known to a row's share of tau, though A = B
within the noise says that neither is there, or that they cancel. That they should cancel is the less likely the better A and B
agree: both are given normal priors of one size, s in the unit of the response, by what the log itself shows of their difference,

    2 s^2 = |A - B|^2/2 + variance(A - B)        of each of Wd and Wq,

so that G is known about as well as A and B agree (empirical Bayes, Efron & Morris, JASA 70, 311, 1975; with the noise added
where an unbiased s^2 would subtract it, for an s that is never much too small). Where other logs tell G the priors stay wide; a
feedthrough and a lateness that cancel there are taken for what is simpler, a gain of the log's own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.experiment import Trial
from sysid.minimise import NAMES, State
from sysid.view import View

MOSTLY = 0.5  # of the standard deviation of log G, below which it falls when nothing is late
REGULAR = 1e-10  # least eigenvalue of the scaled information of parameters that the logs tell apart


def tightened(state: State, reference: tuple[float, float], free: Sequence[str]) -> tuple[Trial, ...] | None:
    """The trials with priors of the size that they show, where the error of G is that of lateness; else None."""
    if (covariance := _punctual(state, reference, free)) is None:
        return None
    found = []
    for trial, model in zip(state.trials, state.models, strict=True):
        found.append(_tight(trial, _on_time(trial, model, state, reference), covariance) if _both(trial) else trial)
    return tuple(found)


def hangs(state: State, reference: tuple[float, float], free: Sequence[str]) -> bool:
    """Whether the error of G is that of lateness."""
    return _punctual(state, reference, free) is not None


def _punctual(state: State, reference: tuple[float, float], free: Sequence[str]) -> np.ndarray | None:
    """Covariance of theta if nothing were late; None where G would be known little better."""
    if "G" not in free or not any(_both(t) for t in state.trials):
        return None
    views = [_on_time(t, m, state, reference) for t, m in zip(state.trials, state.models, strict=True)]
    covariance = _covariance(views, [NAMES.index(n) for n in free])
    if covariance is None or covariance[0, 0] > MOSTLY**2 * state.covariance[0, 0]:
        return None
    return covariance


def _on_time(trial: Trial, model: np.ndarray, state: State, reference: tuple[float, float]) -> View:
    kept = tuple(n for n in trial.nuisances if n != "late")
    return View(replace(trial, nuisances=kept), model, state, reference, coloured=True)


def cancelling(view: View) -> tuple[float, float] | None:
    """The gain of a log over that of the others when its feedthrough and its lateness cancel: with what that is worth in
    log-likelihood, against a feedthrough of any phase and of the size that is seen."""
    if not (view.trial.signed and _both(view.trial)):
        return None
    values, covariance = np.array([c.value for c in view.columns]), view.covariance()
    names = [c.name for c in view.columns]
    late = float(np.max(np.abs(view.course.push))) * view.trial.lateness / view.trial.looseness  # response of one coefficient

    def complex_of(name: str, factor: complex) -> np.ndarray:
        return np.array([factor * (n == f"{name}_d") + 1j * factor * (n == f"{name}_q") for n in names])

    feedthrough, lateness = complex_of("feedthrough", np.conj(view.turn)), complex_of("late", late)
    seen, left = feedthrough @ values, feedthrough - lateness
    noise = np.sqrt((left @ covariance @ left.conj()).real / 2)
    worth = 2 * np.log(abs(seen) / noise) - 0.5 * abs(left @ values / noise) ** 2 + 0.5 * (view.late / view.trial.lateness) ** 2
    return 1 + float(seen.real) / float(np.max(np.abs(view.course.forced))), float(worth)


def _both(trial: Trial) -> bool:
    return trial.lateness > 0 and "feedthrough" in trial.shapes


def _covariance(views: Sequence[View], index: Sequence[int]) -> np.ndarray | None:
    """Of all numbers of theta, those at `index` free; None where the logs do not tell them apart."""
    gram = sum(v.jacobian[:, index].T @ v.jacobian[:, index] for v in views)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < REGULAR:
        return None
    full = np.zeros((len(NAMES), len(NAMES)))
    full[np.ix_(index, index)] = np.linalg.inv(scaled) / np.outer(size, size)
    return full


def _tight(trial: Trial, view: View, covariance: np.ndarray) -> Trial:
    """The trial with the feedthrough that the view, of nothing late, shows as the size of both."""
    errors = np.sqrt(np.diag(view.covariance(covariance)))
    shown = [(c.value, e) for c, e in zip(view.columns, errors, strict=True) if c.name.startswith("feedthrough")]
    size = float(np.sqrt(0.5 * np.mean([value**2 + error**2 for value, error in shown])))
    return replace(trial, feedthrough_std=size, late_std=size / float(np.max(np.abs(view.course.push))))
