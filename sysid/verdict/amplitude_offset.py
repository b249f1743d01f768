"""An offset of d and q under an amplitude log, fitted where its rows at rest show one.

    w = |W + o + n|

An instrument that records the amplitude alone hides what Wd and Wq read at rest. There w is |o|, not the
noise's size, and in a step or a ring-down o adds to the response at first and takes from it later, as the
response turns. Where the rows at rest, before the first drive and long after the last, are larger than noise,
the log is fitted with an offset, of a prior as wide as they tell. It is kept if that describes the log better
than chance would; if it moves G or tau of a driven log by more than their errors, as the log then does not
tell whether it is there; and where the rows at rest leave no doubt: a step alone cannot tell the offset's
direction, but then G is not known better than that. Rows of one sign without a frequency are read as the
output of a first-order plant, on an offset of its own; the amplitude on one of d and q is kept instead where
it describes them better and leaves nothing that an effect may explain.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.model import rice
from sysid.model.theta import NAMES
from sysid.rows.prepare import OFFSET_UNITS
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.misfit import described

FEW = 4  # rows at rest, of which nothing is told
SEEN = -1.0  # standard deviations of the logarithm of the power at rest, above which an offset is tried
SURE = 4.0  # above which it is there
# log-likelihood: with a resonance that only an offset shows, three numbers, looked for from four sides
WORTH = 8.0
SOME = 2.0  # in a log that had an offset before, of the response's own direction
MOVES = 3.0  # standard deviations of G or tau
LARGE = 3.0  # times what is read at rest: a response so large has noise that is nearly normal
STILL = 0.1  # of the last rows, less than which is left of a response that rings down
TINY = float(np.finfo(float).tiny)
TURNS = np.exp(0.5j * np.pi * np.arange(4))  # of an offset, from where its direction is looked for
ROUNDS = Rounds(4)  # of each of them


class _Rest(NamedTuple):
    """What an amplitude log reads at rest: the offset that this may be, by how many standard deviations it is
    more than noise, and the noise beside the drive."""

    size: float
    seen: float
    noise: float


def with_offsets(minimiser: Minimiser, states: list[State]) -> tuple[list[State], list[str]]:
    """The minima with the offsets that lie under amplitudes, and sentences that say so."""
    said = []
    for i, trial in enumerate(states[0].trials):
        trial = _as_amplitude(trial)
        rest = _at_rest(trial, states[0].tau)
        if rest is None or rest.seen < SEEN:
            continue
        best, *others = _fitted(minimiser, states[0], i, rest)
        if _there(minimiser, rest, states[0], best, i):
            more = [end for s in states[1:] for end in _fitted(minimiser, s, i, rest)]
            states = minimiser.imaged([best, *others, *more])
            said.append(_said(states[0].trials[i]))
    return states, said


def _as_amplitude(trial: Trial) -> Trial:
    """The trial, read as an amplitude if it may be one: rows of one sign without a frequency were taken for
    the output of a first-order plant."""
    log = trial.log
    signed = trial.signed and log.amplitude_only and not trial.steady and not trial.resonant
    if not signed or log.response_unit in OFFSET_UNITS or np.min(log.response) <= 0:
        return trial
    new = replace(trial, rectified=True)
    begins = new.start_free and not new.begun
    return new.with_bench(start=complex(np.mean(log.response[:3]))) if begins else new


def _at_rest(trial: Trial, tau: float) -> _Rest | None:
    """Of an amplitude that is at rest before its first drive, or rings down; None of others, and where too
    few rows show it."""
    log = trial.whole or trial.log
    if "offset" not in trial.nuisances or trial.signed or trial.steady or log.relative_noise:
        return None
    driven = np.flatnonzero(log.drive) if trial.driven else np.zeros(1, int)
    first, last = driven[0], driven[-1]
    off, level = log.time[min(last + 1, len(log) - 1)], max(float(np.median(log.response[-FEW:])), TINY)

    def falls(to: float) -> float:
        return off + tau * float(np.log(trial.scale / to))

    beside = (
        log.response[first + 1 : last + 1] if trial.driven else log.response[log.time < falls(LARGE * level)]
    )
    noise = rice.variance(beside) if len(beside) > FEW else 0.0
    if noise == 0:
        return None
    before = trial.driven & (np.arange(len(log)) <= first) & (not trial.start_free)
    rest = log.response[before | (log.time > falls(STILL * max(level, float(np.sqrt(noise)))))]
    if len(rest) < FEW:
        return None
    power = float(np.mean(rest**2))
    error = float(np.sqrt(1 / len(rest) + rice.MEDIAN / len(beside)))
    more = max(power - 2 * noise, 0.0) + 2 * noise * error
    return _Rest(float(np.sqrt(more)), float(np.log(power / (2 * noise))) / error, float(np.sqrt(noise)))


def _fitted(minimiser: Minimiser, state: State, i: int, rest: _Rest) -> list[State]:
    """The minima near `state` with an offset of about that size under the i-th log, in every direction that
    describes it, the best first: a step may not tell whether an offset adds to it or takes from it."""

    trial = _as_amplitude(state.trials[i])
    # Without a frequency to tell the turn of the response, lateness would take what an offset does as a step
    # begins.
    prompt = tuple(n for n in trial.nuisances if n != "late" or trial.resonant)

    def begun(turn: complex) -> tuple[Trial, ...]:
        narrow, known = trial.bench.narrow | {"offset": rest.size}, {"standing": True, "floor_free": True}
        new = replace(trial, nuisances=prompt).with_bench(
            **known, offset=rest.size * turn, narrow=narrow, floor=rest.noise**2, late=0.0
        )
        return _with(state.trials, i, with_noise(new, rest.noise, 0.0))

    def ended(to: Minimiser, theta: np.ndarray) -> list[State]:
        ends = sorted((to.refine(begun(turn), theta, ROUNDS) for turn in TURNS), key=lambda s: s.cost)
        late = [_with(s.trials, i, replace(s.trials[i], nuisances=trial.nuisances)) for s in ends]
        return minimiser.distinct([replace(s, trials=trials) for s, trials in zip(ends, late, strict=True)])

    ways = ((minimiser, state.theta), *_in_tune(minimiser, state))
    return sorted((s for way in ways for s in ended(*way)), key=lambda s: s.cost + WORTH * (not s.converged))


def _in_tune(minimiser: Minimiser, state: State) -> list[tuple[Minimiser, np.ndarray]]:
    """Of decays that show their resonance only by how it beats with an offset, so that without one f0 is
    anywhere: the same with the resonance held at their frequency."""
    resonant = [t for t in state.trials if t.resonant]
    if "f0" not in minimiser.free or not all(_decays(t) for t in resonant):
        return []
    tuned = state.theta.copy()
    tuned[NAMES.index("f0")] = float(np.mean(resonant[0].log.frequency)) - minimiser.reference[0]
    return [(replace(minimiser, free=tuple(n for n in minimiser.free if n != "f0")), tuned)]


def _decays(trial: Trial) -> bool:
    """An amplitude that nothing drives."""
    return trial.log.amplitude_only and not (trial.steady or trial.driven)


def _with(trials: Sequence[Trial], i: int, trial: Trial) -> tuple[Trial, ...]:
    """The trials, the i-th replaced."""
    return (*trials[:i], trial, *trials[i + 1 :])


def _there(minimiser: Minimiser, rest: _Rest, before: State, after: State, i: int) -> bool:
    worth = after.likelihood - before.likelihood
    if before.converged and not after.converged and worth < 0:
        return False  # noise of long memory is larger at rest than its neighbouring rows tell
    nested = before.trials[i].signed  # it has an offset already, of the response's own direction
    if rest.seen > SURE and not nested:
        return True
    if nested and not described(minimiser, after):
        return False  # it bends a response as it begins, as what else there is may do
    tells = worth > SOME if nested else before.trials[i].driven
    return after.converged and (worth > WORTH or (tells and _moved(before, after) > MOVES))


def _moved(before: State, after: State) -> float:
    """How far G or tau is off, in the errors that they had."""
    variance = np.diag(before.covariance)[:2]
    return float(
        np.sqrt(np.max((after.theta - before.theta)[:2] ** 2 / np.where(variance > 0, variance, np.inf)))
    )


def _said(trial: Trial) -> str:
    share = 100 * abs(trial.bench.offset) / trial.scale
    return (
        f"{trial.log.name}: an offset of d and q seems to lie under the amplitude, of {share:.2g} % of the"
        f" response, and is"
        " fitted; record wd and wq, or subtract what these read at rest before taking the amplitude"
    )
