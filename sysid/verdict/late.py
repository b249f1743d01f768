"""By how much a response is late that is later than its first order: the delay with which its log fits best.

Everything else is fitted anew at each of a few delays, with white noise of one level, so that what is left compares. In a step a
delay within a row looks like a gain and a feedthrough that cancel; the less of them is the likelier, so that the feedthrough has
a prior of THROUGH of the response.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.rows.hold import read_at
from sysid.trials.trial import Trial, with_noise
from sysid.trials.whitening import uneven
from sysid.verdict.misfit import Found
from sysid.verdict.moments import EARLY, FILTERED, LATE

THROUGH = 0.03  # of the response
BEFORE, ROWS, TAUS = 2.0, 6.0, 0.5  # it is looked for from two rows before what is stated to six behind it, or half of tau,
WIDER = 3  # and twice as far as often as it is found at the end
POINTS = 25  # delays that are tried at first: of ten rows, two and more in each
ZOOMS = 4  # times that the interval about the best is divided
PARTS = 6
ALIKE = 2.0  # log-likelihood within which delays fit alike: 95 %
SURE = 10.0  # log-likelihood that a delay is worth when it is no chance, however the noise was taken
VAGUE, CLEAR = 0.5, 0.01  # of tau, that they span, from which no delay is told, and up to which only the best


def timed(found: Sequence[Found], state: State, reference: tuple[float, float], free: Sequence[str]) -> list[Found]:
    """What the logs hold, those that begin late with the delay with which they fit best."""
    anew: dict[int, _Timed] = {}
    for f in found:
        if f.name == "late" and f.log is not None and f.log not in anew and state.trials[f.log].log.theta is None:
            anew[f.log] = _timed(_Costs(state, f.log, Minimiser(reference, tuple(free), state.prior)))
    return [_with(f, anew[f.log]) if f.name == "late" and f.log in anew else f for f in found]


class _Timed(NamedTuple):
    """What to say of a log that is late, and what it gains, in log-likelihood, by the delay that fits best."""

    sentence: str
    worth: float


def _with(found: Found, timed: _Timed) -> Found:
    return replace(found, sentence=timed.sentence, certain=found.certain or timed.worth > SURE)


def _timed(costs: "_Costs") -> _Timed:
    """The delay to state, with those that fit as well; no number where the log does not tell it."""
    log, tau, tried = costs.trial.log, float(np.exp(costs.state.theta[1])), _tried(costs)
    best = min(tried, key=tried.__getitem__)
    alike = [delay for delay, cost in tried.items() if cost < tried[best] + ALIKE]
    low, high, worth = min(alike), max(alike), tried[costs.stated] - tried[best]
    if costs.stated and worth < ALIKE:
        return _Timed(FILTERED.format(log.name, costs.stated), worth)
    if high - low > VAGUE * tau or low <= min(tried) or high >= max(tried):
        return _Timed(LATE.format(log.name, ""), worth)
    if best < 0:
        return _Timed(EARLY.format(log.name, costs.stated - best, best), worth)
    beside = f" ({low:.2g} to {high:.2g} s fit as well)" if high - low > CLEAR * tau else ""
    return _Timed(LATE.format(log.name, f" of about {best:.3g} s{beside}"), worth)


def _tried(costs: "_Costs") -> dict[float, float]:
    """What is left at delays (s) about the best."""
    row, stated = costs.trial.spacing, costs.stated
    span = max(ROWS * row, TAUS * float(np.exp(costs.state.theta[1])))
    tried = costs.at(np.append(stated, np.linspace(stated - BEFORE * row, stated + span, POINTS)))
    for _ in range(WIDER):
        if min(tried, key=tried.__getitem__) < max(tried):
            break
        tried |= costs.at(max(tried) + span * np.linspace(0, 1, POINTS)[1:])
    for _ in range(ZOOMS):
        delays = sorted(tried)
        k = delays.index(min(tried, key=tried.__getitem__))
        tried |= costs.at(np.linspace(delays[max(k - 1, 0)], delays[min(k + 1, len(delays) - 1)], PARTS + 1)[1:-1])
    return tried


class _Costs:
    """What is left of all logs when the i-th is late."""

    def __init__(self, state: State, i: int, minimiser: Minimiser):
        self.state, self.i, self.minimiser, self.trial = state, i, minimiser, state.trials[i]
        self.stated = self.trial.log.bench.get("delay_s", 0.0)

    def at(self, delays: np.ndarray) -> dict[float, float]:
        """By delay (s)."""
        return {float(d): self._one(float(d)) for d in delays}

    def _one(self, delay: float) -> float:
        trials = list(self.state.trials)
        trials[self.i] = _delayed(trials[self.i], delay)
        return self.minimiser.refine(tuple(trials), self.state.theta, rounds=1).cost


def _delayed(trial: Trial, delay: float) -> Trial:
    """The trial as it would be if the delay were stated, with white noise."""
    log = replace(trial.log, bench={**trial.log.bench, "delay_s": delay})
    spread = uneven(trial.noise.share, log.response)
    plain = trial.knowing(spread=spread, tail=None, kept=trial.there, efficiency=1.0, jitter=None)
    inputs, narrow = read_at(trial.inputs, log.time, delay), {"feedthrough": THROUGH * trial.scale}
    new = replace(plain, log=log, inputs=inputs, narrow=narrow, extra={}, resonance=None, late=0.0)
    levels = () if trial.noise.rounded is None else tuple(x._replace(time=0.0) for x in trial.noise.levels)
    return with_noise(new, trial.noise.std, 0.0, levels)
