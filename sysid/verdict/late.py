"""The delay of a log whose response is late by more than the fit's first order covers.

Everything else is fitted anew at each of several delays, with white noise of one level so that costs compare. In a step a delay
of less than a row looks like a gain and a feedthrough that cancel; as little of them as possible is likelier, so the feedthrough
has a prior of THROUGH of the response.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import NAMES
from sysid.rows.hold import read_at
from sysid.trials.trial import Trial, with_noise
from sysid.trials.whitening import uneven
from sysid.verdict.misfit import Found
from sysid.verdict.moments import EARLY, FILTERED, LATE
from sysid.verdict.unexplained import SIGNIFICANT, shared

THROUGH = 0.03  # of the response
BEFORE, ROWS, TAUS = 2.0, 6.0, 0.5  # it is looked for from two rows before what is stated to six behind it, or half of tau,
WIDER = 3  # and twice as far as often as it is found at the end
POINTS = 25  # delays that are tried at first: of eight rows, three in each
ZOOMS = 4  # times that the interval about the best is divided
PARTS = 6
SIDES = {"late": 1, "early": -1}  # by what is found, on which side of what is stated the delay is looked for
WATCHED = ("G", "tau", "f0")
ALIKE = 2.0  # log-likelihood within which delays fit alike: 95 %
SURE = 10.0  # log-likelihood that a delay is worth when it is no chance, however the noise was taken
POLES, FILTER = (1, 2, 4), 4  # of a lock-in's filter; rounds in which its time is found with the plant
LEFT = 0.05  # of the power that neighbouring rows share, which a filter of other poles than those that are tried may leave
VAGUE, CLEAR = 0.5, 0.01  # of tau, that they span, from which no delay is told, and up to which only the best


def timed(found: Sequence[Found], state: State, reference: tuple[float, float], free: Sequence[str]) -> list[Found]:
    """The effects that the logs show; those late or early with the delay at which their log fits best."""
    minimiser, anew = Minimiser(reference, tuple(free), state.prior), {}
    for f in found:
        if f.name in SIDES and f.log is not None and f.log not in anew and state.trials[f.log].log.theta is None:
            anew[f.log] = _timed(_Costs(state, f.log, minimiser), SIDES[f.name])
    return [_with(f, anew[f.log]) if f.name in SIDES and f.log in anew else f for f in found]


class _Timed(NamedTuple):
    """What to say of a log that is late, or early; what it gains, in log-likelihood, by the delay that fits best; and how far the
    parameters are there, by name, in their standard deviations; whether that, or a filter that is as late, leaves only noise. No
    sentence: as it was."""

    sentence: str | None
    worth: float
    moves: dict[str, float]
    explains: bool


def _with(found: Found, timed: _Timed) -> Found:
    """Far from the fit what a delay moves is more than to first order, and by other noise."""
    certain, moves = timed.worth > SURE, dict(found.moves)
    if certain:
        moves |= {n: m for n, m in timed.moves.items() if abs(m) > abs(moves.get(n, 0.0))}
    sentence, certain = timed.sentence or found.sentence, found.certain or certain
    whole = timed.worth if timed.explains else 0.0
    return replace(found, sentence=sentence, whole=whole, certain=certain, moves=moves, explains=timed.explains)


def _timed(costs: "_Costs", side: int) -> _Timed:
    """The delay to state, with those that fit as well; no number where the log does not tell it."""
    log, tau, tried = costs.trial.log, costs.state.tau, _tried(costs, side)
    best = min(tried, key=tried.__getitem__)
    alike = [delay for delay, cost in tried.items() if cost < tried[best] + ALIKE]
    low, high = min(alike), max(alike)
    rest = tried[costs.stated] - tried[best], costs.moves(best), costs.explains(best)
    if side > 0 and costs.stated and rest[0] < ALIKE:
        return _Timed(FILTERED.format(log.name, costs.stated), *rest)
    if high - low > VAGUE * tau or low <= min(tried) or high >= max(tried):
        return _Timed(LATE.format(log.name, "") if side > 0 else None, *rest)
    if best < (0.0 if side > 0 else costs.stated):
        return _Timed(EARLY.format(log.name, costs.stated - best, best), *rest)
    beside = f" ({low:.2g} to {high:.2g} s fit as well)" if high - low > CLEAR * tau else ""
    return _Timed(LATE.format(log.name, f" of about {best:.3g} s{beside}"), *rest)


def _tried(costs: "_Costs", side: int) -> dict[float, float]:
    """What is left at delays (s) about the best."""
    row, stated = costs.trial.spacing, costs.stated
    span = max(ROWS * row, TAUS * costs.state.tau)
    tried = costs.at(np.append(stated, stated + side * np.linspace(-BEFORE * row, span, POINTS)))
    for _ in range(WIDER):
        end = side * max(side * delay for delay in tried)
        if min(tried, key=tried.__getitem__) != end:
            break
        tried |= costs.at(end + side * span * np.linspace(0, 1, POINTS)[1:])
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

    def moves(self, delay: float) -> dict[str, float]:
        """How far each parameter is at a delay (s), in its standard deviations at the fit."""
        away, covariance = self._refined(delay).theta - self.state.theta, self.state.spread
        places = {n: NAMES.index(n) for n in WATCHED if n in self.minimiser.free}
        return {n: float(away[k] / np.sqrt(covariance[k, k])) for n, k in places.items()}

    def explains(self, delay: float) -> bool:
        """Whether the delay (s), or poles that are as late, leave nothing of the log but noise."""
        if self._described(self._refined(delay)):
            return True
        late = delay - self.stated
        if late <= 0 or self.trial.smoothing[1] or self.trial.log.amplitude_only:
            return False
        return any(self._described(self._with(_filtered(self.trial, late / n, n), FILTER)) for n in POLES)

    def _described(self, state: State) -> bool:
        left, chance = shared(state.trials[self.i], state.models[self.i])
        return chance < SIGNIFICANT or left < LEFT * shared(self.trial, self.state.models[self.i])[0]

    def _one(self, delay: float) -> float:
        return self._refined(delay).cost

    def _refined(self, delay: float) -> State:
        return self._with(_delayed(self.trial, delay), 1)

    def _with(self, trial: Trial, rounds: int) -> State:
        """The minimum near that of the fit with this trial for the i-th."""
        trials = (*self.state.trials[: self.i], trial, *self.state.trials[self.i + 1 :])
        return self.minimiser.refine(trials, self.state.theta, rounds)


def _filtered(trial: Trial, time: float, order: int) -> Trial:
    """The trial behind so many poles of about that time constant (s), with white noise."""
    plain, nuisances = _delayed(trial, trial.log.bench.get("delay_s", 0.0)), (*trial.nuisances, "filter", "poles")
    return replace(plain, nuisances=tuple(dict.fromkeys(nuisances)), filter=(time, order))


def _delayed(trial: Trial, delay: float) -> Trial:
    """The trial as it would be if the delay were stated, with white noise."""
    log = replace(trial.log, bench={**trial.log.bench, "delay_s": delay})
    spread = uneven(trial.noise.share, log.response)
    plain = replace(trial, noise=replace(trial.noise, spread=spread, tail=None, kept=trial.there, efficiency=1.0, jitter=None))
    inputs, narrow = read_at(trial.inputs, log.time, delay), {"feedthrough": THROUGH * trial.scale}
    new = replace(plain, log=log, inputs=inputs, narrow=narrow, extra={}, resonance=None, late=0.0)
    levels = () if trial.noise.rounded is None else tuple(x._replace(time=0.0) for x in trial.noise.levels)
    return with_noise(new, trial.noise.std, 0.0, levels)
