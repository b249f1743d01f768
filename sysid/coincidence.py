"""What the bench adds to a step, where nothing else in the logs tells it from the gain: two things that would have to cancel.

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

In the same way a rest before the step that is short beside tau shows the sum of an offset and of a plate that still rings, and
neither alone: both get priors of the size of that sum. And settled points at one frequency show the sum of the plate's response
and of a feedthrough: that is as large, per volt, as those of the other logs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimise import State
from sysid.prior import NAMES
from sysid.trial import Trial
from sysid.view import View

SEEN = 2.0  # errors of a feedthrough, from which it may be there
MOSTLY = 0.5  # of the standard deviation of log G, below which it falls when nothing is late
REGULAR = 1e-10  # least eigenvalue of the scaled information of parameters that the logs tell apart


def tightened(state: State, reference: tuple[float, float], names: Sequence[str]) -> tuple[Trial, ...]:
    """The trials with priors of the size that they show, for a state in which the error of G is that of `names`."""
    found = []
    for trial, model in zip(state.trials, state.models, strict=True):
        view, narrow = View(trial, model, state, reference, coloured=True), dict(trial.narrow)
        for name in names:
            narrow |= PAIRS[name].size(view, state.covariance) if PAIRS[name].held(trial, view.course.tau) else {}
        found.append(replace(trial, narrow=narrow))
    return tuple(found)


def with_feedthroughs(state: State, reference: tuple[float, float]) -> tuple[Trial, ...]:
    """The trials, those of settled points at one frequency with a feedthrough, whose prior is of the size that the others show;
    as they are where none can show one."""
    if not any(t.at_one_frequency for t in state.trials):
        return state.trials
    squares = []
    for trial, model in zip(state.trials, state.models, strict=True):
        if "feedthrough" not in trial.shapes:
            continue
        view = View(trial, model, state, reference, coloured=True)
        through = complex_of(view, "feedthrough", 1 / float(np.max(np.abs(trial.shapes["feedthrough"]))))
        value = abs(through @ np.array([c.value for c in view.columns]))
        squares.append(0.5 * value**2 + 0.5 * float((through @ view.covariance(state.covariance) @ through.conj()).real))
    if not squares:
        return state.trials
    size = float(np.sqrt(np.mean(squares)))
    return tuple(
        replace(t, narrow={**t.narrow, "feedthrough": size * float(np.max(np.abs(t.log.drive)))}) if t.at_one_frequency else t
        for t in state.trials
    )


def loosened(trial: Trial) -> Trial:
    """The trial with the priors that it has beside others."""
    return replace(trial, narrow={})


def hangs(state: State, reference: tuple[float, float], free: Sequence[str]) -> tuple[str, ...]:
    """Whether the error of G is that of not knowing how "late" the response is, or the "start": without it, G would be known
    much better."""
    if "G" not in free:
        return ()
    tau = float(np.exp(state.theta[1]))
    held = [name for name, pair in PAIRS.items() if any(pair.held(t, tau) for t in state.trials)]
    return tuple(name for name in held if _hangs_on(name, state, reference, free))


def _hangs_on(name: str, state: State, reference: tuple[float, float], free: Sequence[str]) -> bool:
    views = []
    for trial, model in zip(state.trials, state.models, strict=True):
        without = replace(trial, nuisances=tuple(n for n in trial.nuisances if n != name))
        views.append(View(without, model, state, reference, coloured=True))
    index = [NAMES.index(n) for n in free]
    variance = _variance(views, index, state.prior.precision[np.ix_(index, index)])
    return variance is not None and variance < MOSTLY**2 * state.covariance[0, 0]


def cancelling(view: View) -> tuple[float, float] | None:
    """The gain of a log over that of the others when its feedthrough and its lateness cancel: with what that is worth in
    log-likelihood, against a feedthrough of any phase and of the size that is seen. None where the feedthrough is not seen."""
    if not (view.trial.signed and _step(view.trial, view.course.tau)):
        return None
    both = _Both.of_step(view)
    if abs(both.first.real) < SEEN * both.own:
        return None
    worth = 2 * np.log(abs(both.first) / both.error) - 0.5 * abs(both.left / both.error) ** 2
    gain = 1 + both.first.real / float(np.max(np.abs(view.course.forced)))
    return gain, float(worth + 0.5 * (view.late / view.trial.lateness) ** 2)


def _step(trial: Trial, tau: float) -> bool:
    return trial.lateness > 0 and "feedthrough" in trial.shapes


def _rest(trial: Trial, tau: float) -> bool:
    """A rest that is short beside tau, before a step."""
    shared = trial.signed and trial.start_free and "offset" in trial.shapes
    return shared and trial.changes > 0 and bool(trial.inputs.duration[0] < tau)


class _Both(NamedTuple):
    """Two things that may cancel: the first of them, in the unit of the response; what is `left` of their sum, in which the gain
    has no part; the error of that per channel. With the plant's parameters of the covariance `plant` of theta, or held."""

    first: complex
    left: complex
    error: float
    own: float  # the error of the first's real part

    @classmethod
    def of_step(cls, view: View, plant: np.ndarray | None = None) -> "_Both":
        """A feedthrough in the plate's frame, and less what the lateness adds: A - B."""
        through = complex_of(view, "feedthrough", np.conj(view.turn))
        late = complex_of(view, "late", _rise(view) * view.trial.lateness / view.trial.looseness)
        return cls._of(view, plant, through, through - late)

    @classmethod
    def of_rest(cls, view: View, plant: np.ndarray | None = None) -> "_Both":
        """An offset, and with what the plate still rings by."""
        offset = complex_of(view, "offset", 1.0)
        return cls._of(view, plant, offset, offset + complex_of(view, "start", 1.0))

    @classmethod
    def _of(cls, view: View, plant: np.ndarray | None, first: np.ndarray, both: np.ndarray) -> "_Both":
        values = np.array([c.value for c in view.columns])
        covariance = view.covariance(plant)
        error, own = np.sqrt((both @ covariance @ both.conj()).real / 2), np.sqrt(first.real @ covariance @ first.real)
        return cls(complex(first @ values), complex(both @ values), float(error), float(own))

    @property
    def size(self) -> float:
        return float(np.sqrt(0.5 * abs(self.left) ** 2 + self.error**2))


def complex_of(view: View, name: str, factor: complex) -> np.ndarray:
    """What makes a complex coefficient of the columns of d and q, as a linear form."""
    return np.array([factor * (c.name == f"{name}_d") + 1j * factor * (c.name == f"{name}_q") for c in view.columns])


def _rise(view: View) -> float:
    """Rate of the response after the largest step, per second."""
    return float(np.max(np.abs(view.course.push)))


def _variance(views: Sequence[View], index: Sequence[int], prior: np.ndarray) -> float | None:
    """Of log G, the numbers of theta at `index` free, with a prior of that precision; None where the logs do not part them."""
    gram = sum(v.jacobian[:, index].T @ v.jacobian[:, index] for v in views) + prior
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < REGULAR:
        return None
    return float(np.linalg.inv(scaled)[0, 0] / size[0] ** 2)


def _narrow_step(view: View, plant: np.ndarray) -> dict[str, float]:
    size = _Both.of_step(view, plant).size
    return {"feedthrough": size, "lateness": size / _rise(view)}


def _narrow_rest(view: View, plant: np.ndarray) -> dict[str, float]:
    return dict.fromkeys(("offset", "start"), _Both.of_rest(view, plant).size)


class _Pair(NamedTuple):
    """Two nuisances that may cancel: whether a log may hold both, and the standard deviations that it shows them to have."""

    held: Callable[[Trial, float], bool]  # by tau
    size: Callable[[View, np.ndarray], dict[str, float]]


PAIRS = {"late": _Pair(_step, _narrow_step), "start": _Pair(_rest, _narrow_rest)}
