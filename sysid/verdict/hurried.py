"""A sweep that was called settled, and whose points had not settled: read as what it was, a transient of an even clock.

Each frequency begins where the one before it left the plate, after a dwell that no column tells. Its first order
(`terms._too_fast`) is good for a dwell of some tau; at less the plate rings on behind the resonance, which looks like a second
one. So the log is read with the times of several dwells, and all else is fitted anew.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.trials.trial import Trial
from sysid.verdict.identify import seconds
from sysid.verdict.misfit import Found, described, explained

DWELLS = (0.25, 0.5, 1.0, 2.0, 4.0)  # tau: of less a sweep shows no resonance, of more its points have settled
NEARER = (2**0.5, 2**0.25, 2**0.125)  # factors about the best, in turn
SURE = 10.0  # log-likelihood by which a dwell explains a log, of five that are tried: by chance of one in four thousand good fits
ROUNDS = 3  # of the noise and all else in turn, at each dwell
ENOUGH = 6.0  # tau to dwell at each frequency, e^-6 of the change is left
LEAST_ROWS = 8
NAME = "swept too fast"  # of its first order among what was found
LIKE = (NAME, "second resonance")  # what a sweep looks like to first order that rings on


def hurried(minimiser: Minimiser, state: State, found: Sequence[Found]) -> str | None:
    """A sentence where a sweep of one direction, which `state` does not describe, is described by a dwell too short for settled
    points, and better than by anything in `found`; else None."""
    for i, trial in enumerate(state.trials):
        if not one_way(trial) or not any(f.log == i and f.name in LIKE for f in found):
            continue
        if len(state.trials) > 1 and described(minimiser, minimiser.refine((trial,), state.theta)):
            continue  # it contradicts the others
        tried = {dwell: _read(minimiser, state, i, dwell * state.tau) for dwell in DWELLS}
        if max(s.likelihood for s in tried.values()) < state.likelihood + SURE:
            continue
        for nearer in NEARER:
            dwell = max(tried, key=lambda d: tried[d].likelihood)
            tried |= {d: _read(minimiser, tried[dwell], i, d * state.tau) for d in (dwell / nearer, dwell * nearer)}
        dwell = max(tried, key=lambda d: tried[d].likelihood)
        gained = tried[dwell].likelihood - state.likelihood
        others = [f for f in found if f.name != NAME]
        if gained > SURE and explained(minimiser, state, tried[dwell], gained, others):
            short, enough = dwell * state.tau / tried[dwell].tau, seconds(ENOUGH * tried[dwell].tau)
            return (
                f"{trial.log.name}: swept too fast for settled points (dwell about {short:.2g} tau); dwell {enough} or longer at"
                " each frequency, or record the time of every row and say kind: transient"
            )
    return None


def one_way(trial: Trial) -> bool:
    """Whether a log is a sweep of settled points that may have been too fast: of d and q, driven, in one direction."""
    if not (trial.swept and trial.signed and trial.driven) or len(trial.log) < LEAST_ROWS:
        return False
    if "background" not in trial.nuisances:
        return False  # what is left is then rather that
    steps = np.diff(trial.log.frequency)
    return bool(np.all(steps > 0) or np.all(steps < 0))


def _read(minimiser: Minimiser, state: State, i: int, step: float) -> State:
    """The minimum with the i-th log as a transient whose rows are `step` s apart, of their own inputs."""
    trial = state.trials[i]
    time = step * np.arange(len(trial.log))
    log = replace(trial.log, time=time, kind="transient", sampling="settled")
    timed = Trial.of(log, "transient", trial.nuisances)
    timed = replace(timed, noise=timed.noise.at(trial.noise.std, 0.0, (), 0.0))
    return minimiser.refine((*state.trials[:i], timed, *state.trials[i + 1 :]), state.theta, ROUNDS)
