"""A lock-in's filter that no log states, fitted where the logs cannot be described without.

Behind n poles a response begins late and bends as it does; to first order, which is all that lateness has, it is a delay.
Filters of the 1, 2 and 4 poles that lock-ins have, the same for all transients, and delays are tried to first order in everything
else. A filter is taken if it is worth more than chance, and if what fits alike leaves the plant where it is: else the logs cannot
tell it from tau. By how much its time constant is another is then one of the nuisances of each log (`trials.extra`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.trials.trial import Trial
from sysid.verdict.conclusion import Question
from sysid.verdict.late import ALIKE, SURE
from sysid.verdict.misfit import Linear
from sysid.verdict.view import View

ORDERS = (1, 2, 4)
TIMES = np.geomspace(0.02, 1.0, 40)  # of tau, the delay of all poles together: each a tenth longer
ROUNDS = 3  # of the plant and the time constant in turn
MOVED = 0.5  # standard deviations of a parameter, by which explanations that fit alike may differ


class _Tried(NamedTuple):
    """So many poles (0: a delay) of a time constant (s): what it is worth in log-likelihood, and by how much theta moves."""

    order: int
    time: float
    worth: float
    shift: np.ndarray


def behind(question: Question, state: State) -> tuple[Question, list[State]] | None:
    """The question anew, and its minimum, with the filter that the logs show; None where they show none, or not which."""
    minimiser = question.minimiser
    views = [View(t, m, state, minimiser.reference) for t, m in zip(state.trials, state.models, strict=True)]
    hidden = [i for i, t in enumerate(state.trials) if _may_be(t)]
    linear = Linear(views, state, list(minimiser.free), 0.0)
    tried = sorted(_tried(linear, hidden, np.exp(state.theta[1])), key=lambda t: -t.worth)
    if not tried or not tried[0].order or tried[0].worth < SURE or not _agree(tried, linear.std):
        return None
    time, order = tried[0].time, tried[0].order
    for _ in range(ROUNDS):
        best = minimiser.refine(_filtered(state.trials, hidden, time, order), state.theta)
        time *= float(np.exp(_longer([View(best.trials[i], best.models[i], best, minimiser.reference) for i in hidden])))
    trials, said = _filtered(question.trials, hidden, time, order), _said([state.trials[i].log.name for i in hidden], time, order)
    return replace(question, trials=trials, warnings=(*question.warnings, said)), [best]


def _filtered(trials: Sequence[Trial], hidden: Sequence[int], time: float, order: int) -> tuple[Trial, ...]:
    """The trials, those whose filter is hidden behind this one."""
    new = (replace(t, nuisances=(*t.nuisances, "filter"), filter=(time, order), extra={}, late=0.0) for t in trials)
    return tuple(a if i in hidden else b for i, (a, b) in enumerate(zip(new, trials, strict=True)))


def _longer(views: Sequence[View]) -> float:
    """By how much the logarithm of the time constant is larger, of all logs together."""
    values, weights = [], []
    for view in views:
        k = [c.name for c in view.columns].index("filter_d")
        size = view.trial.extra["filter"].prior / view.trial.looseness
        values.append(size * view.columns[k].value)
        weights.append(1 / (size**2 * view.covariance()[k, k]))
    return float(np.average(values, weights=weights))


def _may_be(trial: Trial) -> bool:
    """A transient of a known drive that changes, of which no filter is stated; of means a filter would want shorter ones."""
    moved = not trial.steady and trial.signed and trial.driven and trial.changes > 0 and trial.log.theta is None
    return moved and trial.whole is None and "late" in trial.nuisances and "lockin_tau_s" not in trial.log.bench


def _tried(linear: Linear, logs: Sequence[int], tau: float) -> Iterator[_Tried]:
    """All that could be; without logs, nothing."""
    courses = {i: linear.views[i].course for i in logs}
    for order in (0, *ORDERS) if logs else ():
        times = TIMES * tau / max(order, 1)
        if order:
            shapes = {i: c.behind(times, order).T - c.forced for i, c in courses.items()}
        else:
            shapes = {i: np.stack([c.later(t) for t in times]) - c.forced for i, c in courses.items()}
        shown = {i: linear.views[i].observed(x) for i, x in shapes.items()}
        for k, time in enumerate(times):
            yield _Tried(order, float(time), *linear.gained({i: x[k] for i, x in shown.items()}))


def _agree(tried: Sequence[_Tried], std: np.ndarray) -> bool:
    """Whether what fits as well as the first leaves the parameters where that does, the best of each kind."""
    kinds = {t.order: t for t in reversed(tried)}.values()
    alike = [t for t in kinds if t.worth > tried[0].worth - ALIKE]
    return all(np.all(np.abs(t.shift - tried[0].shift) <= MOVED * std) for t in alike)


def _said(names: Sequence[str], time: float, order: int) -> str:
    poles = f"{order} poles" if order > 1 else "one pole"
    return (
        f"{', '.join(names)}: no lock-in's filter is stated; one of {poles} of about {time:.2g} s is fitted, without which the"
        " response would not be described; state lockin_tau_s and lockin_order"
    )
