"""A lock-in's filter that no log states, fitted where the logs cannot be described without it.

Behind n poles a response begins late and curves; to first order, which is all that a lateness covers, this is a delay. Filters of
1, 2 and 4 poles, as lock-ins have them, are tried, the same for all transients, each from the time constant that is best to first
order, and the likeliest first. The first one is kept that is worth more than chance, if no other filter and no delay is worth
more. Deviations of its time constant and steepness are nuisances of each log (`trials.extra`), as a log may not show how many
poles there are. Transients alone remain a misfit: to first order their feedthrough, lateness and gain look alike behind any
filter.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.trials.perturbed import Course
from sysid.trials.trial import Trial
from sysid.verdict.coincidence import complex_of, hangs_on
from sysid.verdict.conclusion import Question
from sysid.verdict.immediate import FED
from sysid.verdict.late import SURE
from sysid.verdict.misfit import Linear, error_of_lateness
from sysid.verdict.view import View

# Log-likelihood: SURE, and nearly four for each of its numbers in d and in q, whose priors are so much wider than what is found.
ENOUGH = 25.0
ORDERS = (1, 2, 4)
TIMES = np.geomspace(0.02, 1.0, 40)  # of tau, the delay of all poles together: each a tenth longer
ROUNDS = 4  # of the plant and the time constant in turn
FURTHEST = 0.7  # of its logarithm in one of them: twice
TINY = 1e-9  # of what a log tells of it
ANY = 10.0  # prior of a gain that may be off by any factor
NEAR = 0.03  # of it: what is left is a nuisance to first order


class _Tried(NamedTuple):
    """So many poles (0: a delay) of a time constant (s), and what it is worth in log-likelihood."""

    order: int
    time: float
    worth: float


def behind(question: Question, state: State) -> tuple[Question, list[State]] | None:
    """The question and its minima with the filter that the logs show; None where they show none, or a delay besides, or where
    the error of G would be due to how the filtered response begins."""
    reference, free = question.minimiser.reference, question.minimiser.free
    hidden = [i for i, t in enumerate(state.trials) if _may_be(t)]
    if not hidden or len(hidden) == len(state.trials):
        return None
    views, linear = _seen(question, state)
    late = any(0.5 * (views[i].late / error_of_lateness(views[i], linear)) ** 2 > SURE for i in hidden)
    likeliest = _tried(views, linear, hidden)
    if not likeliest[0].order and likeliest[0].worth > likeliest[1].worth + SURE:
        return None  # late, and not by a filter
    for tried in likeliest:
        if not tried.order or not (late or tried.worth > SURE):
            continue
        best, time = _fitted(question, state, hidden, tried)
        if best.likelihood - state.likelihood < ENOUGH or _tried(*_seen(question, best), hidden)[0].worth > SURE:
            continue  # the first order misled, far from the minimum
        views = [View(best.trials[i], best.models[i], best, reference, coloured=True) for i in hidden]
        if hangs_on(("late", "filter", "poles"), best, reference, free) or any(map(_feeds, views)):
            return None
        if _is_gain(question, state, best, hidden):
            return None
        said = _said([state.trials[i].log.name for i in hidden], time, tried.order)
        trials = _filtered(question.trials, hidden, time, tried.order)
        return replace(question, trials=trials, warnings=(*question.warnings, said)), question.minimiser.imaged([best])
    return None


def _fitted(question: Question, state: State, hidden: Sequence[int], tried: _Tried) -> tuple[State, float]:
    """The minimum behind such a filter, and its time constant (s): the plant and this in turn."""
    time, best = tried.time, state
    for k in range(ROUNDS):
        best = question.minimiser.refine(_filtered(best.trials, hidden, time, tried.order), best.theta, known=min(k, 1))
        views = [View(best.trials[i], best.models[i], best, question.minimiser.reference) for i in hidden]
        longer = _longer(views)
        if abs(longer) < NEAR:
            break
        time *= float(np.exp(np.clip(longer, -FURTHEST, FURTHEST)))
    return best, best.trials[hidden[0]].smoothing[0]


def _filtered(trials: Sequence[Trial], hidden: Sequence[int], time: float, order: int) -> tuple[Trial, ...]:
    """The trials, those whose filter is hidden behind this one."""

    def behind(t: Trial) -> Trial:
        nuisances = tuple(dict.fromkeys((*t.nuisances, "filter", "poles")))
        return replace(t, nuisances=nuisances, filter=(time, order), extra={}, late=0.0)

    return tuple(behind(t) if i in hidden else t for i, t in enumerate(trials))


def _feeds(view: View) -> bool:
    """Whether so much of the drive goes through beside the filter that it rather makes something else look like one: a gain
    (`_is_gain`), or a saturated channel."""
    if "feedthrough" not in view.trial.shapes:
        return False
    through = complex_of(view, "feedthrough", 1.0) @ np.array([c.value for c in view.columns])
    return bool(abs(through) > FED * view.trial.scale)


def _is_gain(question: Question, before: State, after: State, hidden: Sequence[int]) -> bool:
    """Whether a gain of each of these logs is worth as much. A gain of r (a drive in other units, another range) looks like one
    pole of tau (1 - 1/r) behind a feedthrough of (r - 1) G: exactly so of a step, and by coincidence of a filter."""
    own = [replace(t, nuisances=(*t.nuisances, "gain"), narrow=t.narrow | {"gain": ANY}, late=0.0) for t in before.trials]
    trials = tuple(own[i] if i in hidden else t for i, t in enumerate(before.trials))
    return question.minimiser.refine(trials, before.theta, known=1).likelihood > after.likelihood - SURE


def _longer(views: Sequence[View]) -> float:
    """Change of the log time constant, averaged over the logs that determine it."""
    values, weights = [0.0], [TINY]
    for view in views:
        for k in (k for k, column in enumerate(view.columns) if column.name == "filter_d"):
            size = view.trial.extra["filter"].prior / view.trial.looseness
            values.append(size * view.columns[k].value)
            weights.append(1 / (size**2 * view.covariance()[k, k]))
    return float(np.average(values, weights=weights))


def _may_be(trial: Trial) -> bool:
    """A transient with a known, changing drive and no stated filter. Not one of means: with a filter these would have to be
    shorter."""
    moved = not trial.steady and trial.signed and trial.driven and trial.changes > 0 and trial.log.theta is None
    return moved and trial.whole is None and "late" in trial.nuisances and "lockin_tau_s" not in trial.log.bench


def _seen(question: Question, state: State) -> tuple[list[View], Linear]:
    minimiser = question.minimiser
    views = View.each(state, minimiser.reference)
    return views, Linear(views, state, list(minimiser.free), 0.0)


def _tried(views: Sequence[View], linear: Linear, hidden: Sequence[int]) -> list[_Tried]:
    """The best time of each kind of filter, and of a delay, instead of what the logs are taken to be behind, to first order in
    all else; what is worth most first."""
    tau, found = views[0].course.tau, []
    for order in (0, *ORDERS):
        times = TIMES * tau / max(order, 1)
        shown = {i: views[i].observed(_without(views[i].course, order, times) - views[i].course.forced) for i in hidden}
        worth = [linear.gained({i: x[k] for i, x in shown.items()}) for k in range(len(times))]
        found.append(_Tried(order, float(times[np.argmax(worth)]), max(worth)))
    return sorted(found, key=lambda t: -t.worth)


def _without(course: Course, order: int, times: np.ndarray) -> np.ndarray:
    """(T, n) the response to the drive behind another filter than it is taken to be, or later behind none."""
    bare = replace(course, trial=replace(course.trial, filter=None))
    return bare.behind(times, order).T if order else np.stack([bare.later(t) for t in times])


def _said(names: Sequence[str], time: float, order: int) -> str:
    poles = f"{order} poles" if order > 1 else "one pole"
    return (
        f"{', '.join(names)}: no lock-in's filter is stated; one of {poles} of about {time:.2g} s is fitted, as the response"
        " is not described without it; state lockin_tau_s and lockin_order, or the delay_s of a late trigger"
    )
