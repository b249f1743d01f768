"""A peak that leans over: a resonance whose shift with the squared amplitude exceeds the first order.

A Duffing plate settles like one whose resonance is f0 + kappa |W|^2 (Nayfeh & Mook, Nonlinear Oscillations, 1979, 4.1). Above
8/sqrt(27) = 1.54 half bandwidths of shift at G V it jumps, at different frequencies upwards and downwards. As |W| of each settled
point is recorded, row k shows, whichever way the sweep came, what a linear plate shows at

    f_k - kappa w_k^2

so a single number kappa, beside the parameters of the linear plate, fits all rows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.misfit import Found, explained

STEPS = 24  # of each sign, a sixth part each, within which the cost falls to its optimum,
NEAREST, FARTHEST = 1 / 64, 1 / 2  # from and to so much of the span of the frequencies; of less the first order tells
ZOOMS = 4  # times that the interval about the best is halved
BACK = 0.1  # of the way forth: noise of w moves a steep row to and fro
LEAST_ROWS = 8  # of a sweep that shows a lean: five numbers, and some to spare
SURE = 10.0  # log-likelihood by which a lean explains logs, of 49 that are tried: by chance of one in two thousand good fits


def leaning(minimiser: Minimiser, state: State, found: Sequence[Found]) -> str | None:
    """A sentence where logs of settled points, which `state` does not describe, are described by a leaning peak, and better than
    by anything in `found`; else None."""
    if not all(_swept(t) for t in state.trials):
        return None
    top = max(float(np.max(np.abs(t.log.response))) for t in state.trials)
    span = max(float(np.ptp(t.log.frequency)) for t in state.trials) / top**2
    sizes = np.geomspace(NEAREST, FARTHEST, STEPS)
    tried = span * np.concatenate([-sizes[::-1], [0.0], sizes])
    rough = [_rough(state.trials, kappa) for kappa in tried]
    k = int(np.argmin(rough))
    if rough[STEPS] - rough[k] < SURE:
        return None
    straight = minimiser.minima(_straightened(state.trials, 0.0))[0]
    kappa, lean = _fitted(minimiser, state.trials, tried[k], sizes[1] / sizes[0] - 1)
    gained = straight.cost - lean.cost
    if gained < SURE or not explained(minimiser, straight, lean, gained, found):
        return None
    if not all(_stable(t, kappa) for t in state.trials):
        return None
    about = f"by about {kappa * top**2:+.3g} Hz at {top:.2g} {state.trials[0].log.response_unit}"
    said = f"the frequency does depend on the amplitude, {about}: the peak leans over, and a sweep jumps where it is steep"
    return f"{said} (hysteresis between sweeps up and down); record at a smaller drive"


def _stable(trial: Trial, kappa: float) -> bool:
    """Whether a sweep of one direction stays on the branches on which a leaning peak rests: there f - kappa w^2 goes the way
    that f goes, and jumps that way too; on the branch between, and beside another peak, it goes back."""
    steps = np.diff(trial.log.frequency)
    if not (np.all(steps >= 0) or np.all(steps <= 0)):
        return True
    moved = np.diff(_moved(trial, kappa)) * np.sign(np.sum(steps))
    return float(-np.sum(np.minimum(moved, 0.0))) < BACK * float(np.sum(np.maximum(moved, 0.0)))


def _swept(trial: Trial) -> bool:
    """Whether a log holds settled points of a sweep, each of them driven."""
    if not (trial.steady and trial.driven and trial.resonant) or len(trial.log) < LEAST_ROWS:
        return False
    return bool(np.all(trial.inputs.drive != 0)) and float(np.ptp(trial.log.frequency)) > 0


def _fitted(minimiser: Minimiser, trials: Sequence[Trial], kappa: float, within: float) -> tuple[float, State]:
    """The kappa about the given one, to a share `within`, that fits best, and its state."""
    first = minimiser.minima(_straightened(trials, kappa))[0]
    white = tuple(with_noise(t, t.noise.std, 0.0) for t in first.trials)
    found = {kappa: minimiser.refine(white, first.theta, rounds=1)}  # beside which the others compare
    for _ in range(ZOOMS):
        best = min(found, key=lambda x: found[x].cost)
        for near in (best * (1 - within), best * (1 + within)):
            anew = zip(_straightened(trials, near), found[best].trials, strict=True)
            white = tuple(with_noise(t, old.noise.std, 0.0) for t, old in anew)
            found[near] = minimiser.refine(white, found[best].theta, rounds=1)
        within /= 2
    best = min(found, key=lambda x: found[x].cost)
    return best, minimiser.refine(found[best].trials, found[best].theta)


def _straightened(trials: Sequence[Trial], kappa: float) -> tuple[Trial, ...]:
    """The logs as a linear plate would show them."""
    return tuple(Trial.of(replace(t.log, frequency=_moved(t, kappa)), t.kind, t.nuisances) for t in trials)


def _moved(trial: Trial, kappa: float) -> np.ndarray:
    return trial.log.frequency - kappa * np.abs(trial.log.response) ** 2


def _rough(trials: Sequence[Trial], kappa: float) -> float:
    """What is left, as minus a log-likelihood, of (V/w)^2 as a parabola of the moved frequency, in each log by itself. The error
    of 1/w^2 is that of w times 2/w^3."""
    left = 0.0
    for t in trials:
        w, f = np.abs(t.log.response), _moved(t, kappa)
        x, weight = (f - np.mean(f)) / np.ptp(f), w**3 / t.inputs.drive[t.inputs.interval] ** 2
        rows = weight[:, None] * np.stack([np.ones(len(x)), x, x**2], axis=1)
        rest = w - rows @ np.linalg.lstsq(rows, w, rcond=None)[0]
        left += 0.5 * len(w) * float(np.log(max(rest @ rest, 1e-300)))
    return left
