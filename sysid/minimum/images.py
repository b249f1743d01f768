"""Other minima that the logs tell no better or worse, as trials and theta to start from: mirror images of one
that was found, where they hold amplitudes alone, and its aliases, where rows are far apart."""

from collections.abc import Sequence

import numpy as np

from sysid.model.theta import TWO_PI, Theta
from sysid.trials.trial import LEAST_WARMING, Trial

ODDS = 20.0  # of one hypothesis against another, from which the other is not told
SELDOM = 1000.0  # of them, to which the other is told beside it
EVEN = 0.01  # of a step, by which others may differ: a rounded clock's
Begin = tuple[tuple[Trial, ...], np.ndarray]


def images(
    trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float], drifts: bool
) -> list[Begin]:
    """All images of a minimum at theta; `drifts`: whether k_T is free."""
    begun = any(t.begun for t in trials)
    settled = [as_settled(trials, theta)] if begun else []
    return [*_mirrored(trials, theta, reference, drifts), *settled, *_aliased(trials, theta, reference)]


def _aliased(trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float]) -> list[Begin]:
    """Images with the resonance as many times further from the drive as rows in even steps cannot tell: what
    turns by a whole turn more from row to row looks the same, of a plate of another gain,

        f0' - f = f0 - f -+ 1/dt        G'/|1 + j 2 pi (f0' - f) tau| = G/|1 + j 2 pi (f0 - f) tau|

    A plate is driven where it moves: beforehand the odds go with the power of its response, 1/|1 + j ...|^2,
    and an alias of less than one in ODDS is none."""
    found, at = [], Theta.of(theta)
    for _, further, ratio in aliases(trials, theta, reference):
        if ratio**2 < ODDS:
            other = at._replace(log_G=at.log_G + np.log(ratio), f0=at.f0 + further)
            found.append((tuple(trials), np.array(other)))
    return found


def seldom_alias(
    trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float]
) -> tuple[Trial, float, float] | None:
    """Of logs at one frequency, of which nothing else tells the resonance, the likeliest alias of less than
    one in ODDS, with its distance (Hz) and the odds against it; None where it is less than one in SELDOM."""
    resonant = [t for t in trials if t.resonant]
    at = [(np.min(t.log.frequency), np.max(t.log.frequency)) for t in resonant]
    if not at or any(t.steady for t in resonant) or np.ptp(at) > 0:
        return None
    found = min(aliases(trials, theta, reference), key=lambda x: x[2], default=None)
    seldom = found is not None and ODDS <= found[2] ** 2 < SELDOM
    return (found[0], found[1], found[2] ** 2) if seldom else None


def aliases(
    trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float]
) -> list[tuple[Trial, float, float]]:
    """Of each log in even steps its nearest alias: how many Hz away, and by what the response to a drive is
    smaller there."""
    found, at = [], Theta.of(theta)
    for trial in (t for t in trials if t.resonant and not t.steady and not t.log.amplitude_only):
        rows = trial.whole or trial.log  # means of rows beat less than each of them
        steps = np.diff(rows.time)
        even = len(steps) > 1 and np.ptp(steps) < EVEN * trial.spacing  # no spacing: all rows at one time
        if not even or np.ptp(rows.frequency) > 0:
            continue
        away = float(at.detuning(trial.hold(reference))[0])
        other = away - np.copysign(TWO_PI / trial.spacing, away)
        ratio = abs(1 + 1j * other * np.exp(at.log_tau)) / abs(1 + 1j * away * np.exp(at.log_tau))
        found.append((trial, (other - away) / TWO_PI, float(ratio)))
    return found


def _mirrored(
    trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float], drifts: bool
) -> list[Begin]:
    """Images with the resonance on the other side of the drive, at the same distance. There is one for each
    log at a constant frequency that shows only its amplitude, or that a demodulator of unknown phase has
    turned: once by shifting f0, and once by changing k_T about the temperature of the other logs. The start
    of that log is mirrored too."""
    resonant = [t for t in trials if t.resonant]
    level, drift = theta[2:4] * [1, drifts]
    warming = {id(t): float(np.mean(t.hold(reference).warming)) for t in resonant}
    mirrored = {}
    for trial in (t for t in resonant if _of_size_alone(t) and np.ptp(t.log.frequency) == 0):
        turned = tuple(
            t.with_bench(start=np.conj(t.bench.start), offset=np.conj(t.bench.offset)) if t is trial else t
            for t in trials
        )
        image = 2 * (trial.log.frequency[0] - reference[0]) - level - drift * warming[id(trial)]
        mirrored[image - drift * warming[id(trial)], drift] = turned
        others = [
            warming[id(t)] for t in resonant if abs(warming[id(t)] - warming[id(trial)]) > LEAST_WARMING
        ]
        pivot = float(np.mean(others)) if others else warming[id(trial)]
        if drifts and abs(warming[id(trial)] - pivot) > LEAST_WARMING:  # else no k_T leads to the image
            slope = (image - level - drift * pivot) / (warming[id(trial)] - pivot)
            mirrored[level + (drift - slope) * pivot, slope] = turned
    return [(turned, np.array([*theta[:2], *to, *theta[4:]])) for to, turned in sorted(mirrored.items())]


def _of_size_alone(trial: Trial) -> bool:
    return trial.log.amplitude_only or (trial.steady and "rotation" in trial.nuisances)


def as_settled(trials: Sequence[Trial], theta: np.ndarray, more: float = 1.0) -> Begin:
    """Amplitudes taken as settled at their first row: another start with another G may look the same. `more`:
    a further factor on G."""
    size = next(abs(1 + t.bench.start) for t in trials if t.begun) or 1.0
    settled = tuple(t.with_bench(start=0.0) if t.begun else t for t in trials)
    return settled, theta + np.log(size * more) * np.eye(1, len(theta))[0]
