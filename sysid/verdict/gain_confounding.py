"""What the bench adds to a step, where nothing else separates it from the gain: two effects that would have
to cancel.

A step shows the level at which it settles, A = G + nu, and how it rises, B = G (1 + t/tau): the feedthrough
nu, the lateness t and the gain are three unknowns for two numbers. With a lateness of up to a row, G would be
known only to a row over tau, although A = B within the noise means that both are absent or that they cancel.
Cancelling is the less likely the better A and B agree. So both get normal priors of one size s, in the unit
of the response, from the difference that the log itself shows,

    s^2 = |A - B|^2/2 + variance(A - B)        for each of Wd and Wq,

and G is known about as well as A and B agree (empirical Bayes, Efron & Morris, JASA 70, 311, 1975). This is
twice the unbiased s^2, with the noise added instead of subtracted: one number hardly shows the size of two,
and an s that is too small does more harm than one that is too large. In a study of 60 logs each, with the
lateness drawn from a row and an independent feedthrough, 97 % of the intervals held the truth (with half of
s^2: 85 %); on a bench without either, all did.

Real rows, those of a first-order log, show only one difference. The sum of two normal numbers of one size
over their difference is a Student t of one degree of freedom: 95 % lie within 12.7 instead of 1.96, so s^2 is
the unbiased (A - B)^2/2 times the square of that ratio. Several logs that leave G open show the size
together, in seconds: in one of many the two may cancel by chance. The feedthrough of a bench affects G in all
its logs and does not average out, so s^2 grows with their number. Where other logs determine G the priors
stay wide; a feedthrough and a lateness that cancel there are taken for the simpler explanation, a gain of the
log's own.

In the same way, a rest before the step that is short beside tau, or one that no row shows, tells only the sum
of an offset and of a plate that moves already: both get priors of the size of that sum. Settled points at one
frequency show only the sum of the plate's response and a feedthrough, which is taken to be as large, per
volt, as those of the other logs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from sysid.minimum.minimise import State
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.result import NORMAL95

SEEN = 2.0  # errors of a feedthrough, from which it may be there
MOSTLY = 0.5  # of the standard deviation of log G beside one of them, below which it falls without
REGULAR = 1e-10  # least eigenvalue of the scaled information of parameters that the logs tell apart


def tightened(state: State, reference: tuple[float, float], names: Sequence[str]) -> tuple[Trial, ...]:
    """The trials with priors of the size that they show, for a state whose error of G is due to `names`."""
    trials = list(state.trials)
    views = LinearisedLog.each(state, reference, coloured=True)
    for pair in (PAIRS[name] for name in names):
        held = [i for i, v in enumerate(views) if pair.held(v.trial, v.course.tau)]
        both = [pair.both(views[i], state.covariance) for i in held]
        units = [pair.unit(views[i]) for i in held]
        for i, size, unit in zip(held, pair.sizes(both, units), units, strict=True):
            trials[i] = trials[i].with_bench(narrow=trials[i].bench.narrow | pair.priors(size, unit))
    return tuple(trials)


def with_feedthroughs(state: State, reference: tuple[float, float]) -> tuple[Trial, ...]:
    """The trials; those of settled points at one frequency with a feedthrough, whose prior is as wide as the
    feedthroughs in the other logs. Unchanged where no log can show one."""
    if not any(t.at_one_frequency for t in state.trials):
        return state.trials
    squares = []
    for trial, model in zip(state.trials, state.models, strict=True):
        if trial.at_one_frequency or "feedthrough" not in trial.shapes:
            continue
        view = LinearisedLog(trial, model, state, reference, coloured=True)
        through = complex_of(view, "feedthrough", 1 / float(np.max(np.abs(trial.shapes["feedthrough"]))))
        value = abs(through @ np.array([c.value for c in view.columns]))
        square = value**2 + float((through @ view.covariance(state.covariance) @ through.conj()).real)
        squares.append(square / trial.channels)
    if not squares:
        return state.trials
    size = float(np.sqrt(np.mean(squares)))
    return tuple(
        t.with_bench(narrow={**t.bench.narrow, "feedthrough": size * float(np.max(np.abs(t.log.drive)))})
        if t.at_one_frequency
        else t
        for t in state.trials
    )


def loosened(trial: Trial) -> Trial:
    """The trial with the wide priors that it has beside other logs."""
    return trial.with_bench(narrow={})


def confounds_gain(state: State, reference: tuple[float, float], free: Sequence[str]) -> tuple[str, ...]:
    """The nuisances, "late" or "start", that cause the error of G: with one of them alone it is known much
    worse than with none. Where both do, neither shows by what is left without it."""
    names = may_cancel(state) if "G" in free else ()
    if not names:
        return ()
    least = _without(names, state, reference, free)
    each = ((name, _without(tuple(n for n in names if n != name), state, reference, free)) for name in names)
    return tuple(name for name, alone in each if least is not None and _much(least, alone))


def may_cancel(state: State) -> tuple[str, ...]:
    """The nuisances, "late" or "start", that some log may hold beside what cancels them."""
    return tuple(name for name, pair in PAIRS.items() if any(pair.held(t, state.tau) for t in state.trials))


def _much(less: float, more: float | None) -> bool:
    """Whether one variance of log G is much less than another; None is that of a G that is not told."""
    return more is None or less < MOSTLY**2 * more


def _without(
    names: Sequence[str], state: State, reference: tuple[float, float], free: Sequence[str]
) -> float | None:
    """The variance of log G if there were none of these nuisances."""
    views = []
    for trial, model in zip(state.trials, state.models, strict=True):
        kept = tuple(n for n in trial.nuisances if n not in names)
        extra = {n: shape for n, shape in trial.bench.extra.items() if n not in names}
        without = replace(trial, nuisances=kept).with_bench(extra=extra)
        views.append(LinearisedLog(without, model, state, reference, coloured=True))
    index = [NAMES.index(n) for n in free]
    return _variance(views, index, state.prior.precision[np.ix_(index, index)])


def cancelling(view: LinearisedLog) -> tuple[float, float] | None:
    """The gain of a log relative to the others if its feedthrough and its lateness cancel; and what that is
    worth in log-likelihood, against a feedthrough of any phase and of the size seen. None where no
    feedthrough is seen."""
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
    """A rest that is short beside tau, before a step; of d and q it may be before the first row."""
    shared = trial.signed and trial.start_free and "offset" in trial.shapes
    return shared and (trial.from_rest or (trial.changes > 0 and bool(trial.inputs.duration[0] < tau)))


class _Both(NamedTuple):
    """Two effects that may cancel: the first of them, in the unit of the response; what is `left` of their
    sum, which the gain does not affect; its error per channel. With the plant's parameters held, or of the
    covariance `plant` of theta."""

    first: complex
    left: complex
    error: float
    own: float  # the error of the first's real part
    channels: int  # of the log, in which both are

    @classmethod
    def of_step(cls, view: LinearisedLog, plant: np.ndarray | None = None) -> "_Both":
        """A feedthrough in the plate's frame, and less what the lateness adds: A - B."""
        through = complex_of(view, "feedthrough", np.conj(view.turn))
        late = complex_of(view, "late", _rise(view) * view.trial.lateness / view.trial.looseness)
        return cls._of(view, plant, through, through - late)

    @classmethod
    def of_rest(cls, view: LinearisedLog, plant: np.ndarray | None = None) -> "_Both":
        """An offset, and with what the plate still rings by."""
        offset = complex_of(view, "offset", 1.0)
        return cls._of(view, plant, offset, offset + complex_of(view, "start", 1.0))

    @classmethod
    def _of(
        cls, view: LinearisedLog, plant: np.ndarray | None, first: np.ndarray, both: np.ndarray
    ) -> "_Both":
        values = np.array([c.value for c in view.columns])
        covariance = view.covariance(plant)
        channels = view.trial.channels
        error = np.sqrt((both @ covariance @ both.conj()).real / channels)
        own = np.sqrt(first.real @ covariance @ first.real)
        return cls(complex(first @ values), complex(both @ values), float(error), float(own), channels)


def _of_each(both: Sequence[_Both], units: Sequence[float]) -> list[float]:
    """The size of what each log has for itself."""
    return [_common([b], [u])[0] for b, u in zip(both, units, strict=True)]


def _common(both: Sequence[_Both], units: Sequence[float]) -> list[float]:
    """The size that logs show together of what is alike in all of them in `units`, each log as sharply as its
    noise lets it."""
    weight = np.array([(u / b.error) ** 2 for b, u in zip(both, units, strict=True)])
    squares = np.array([abs(b.left / u) ** 2 / b.channels for b, u in zip(both, units, strict=True)])
    square = float(weight @ squares / np.sum(weight))
    seen = float(np.sum(weight) ** 2 / np.sum(weight**2))
    factors = [1.0 if b.channels > 1 else 0.5 * (stdtrit(seen, 0.975) / NORMAL95) ** 2 for b in both]
    return [
        float(np.sqrt(f * seen * square * u**2 + b.error**2))
        for f, b, u in zip(factors, both, units, strict=True)
    ]


def complex_of(view: LinearisedLog, name: str, factor: complex) -> np.ndarray:
    """The linear form that gives a complex coefficient from the columns of d and q."""
    return np.array(
        [factor * (c.name == f"{name}_d") + 1j * factor * (c.name == f"{name}_q") for c in view.columns]
    )


def _rise(view: LinearisedLog) -> float:
    """Rate of the response after the largest step, per second."""
    return float(np.max(np.abs(view.course.push)))


def _variance(views: Sequence[LinearisedLog], index: Sequence[int], prior: np.ndarray) -> float | None:
    """Of log G, the numbers of theta at `index` free, with a prior of that precision; None where the logs do
    not part them."""
    gram = sum(v.jacobian[:, index].T @ v.jacobian[:, index] for v in views) + prior
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < REGULAR:
        return None
    return float(np.linalg.inv(scaled)[0, 0] / size[0] ** 2)


def _one(view: LinearisedLog) -> float:
    return 1.0


class _Pair(NamedTuple):
    """Two nuisances that may cancel: whether a log may hold both, by its tau; what it shows of them; the unit
    in which they are alike in all logs, if so; their sizes in the unit of the response; the standard
    deviations of their priors."""

    held: Callable[[Trial, float], bool]
    both: Callable[[LinearisedLog, np.ndarray], _Both]
    unit: Callable[[LinearisedLog], float]
    sizes: Callable[[Sequence[_Both], Sequence[float]], list[float]]
    priors: Callable[[float, float], dict[str, float]]


PAIRS = {
    "late": _Pair(
        _step,
        _Both.of_step,
        _rise,
        _common,
        lambda size, rise: {"feedthrough": size, "lateness": size / rise},
    ),
    "start": _Pair(_rest, _Both.of_rest, _one, _of_each, lambda size, _: {"offset": size, "start": size}),
}
