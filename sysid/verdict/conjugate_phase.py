"""Logs whose Wq has the other sign than it should: their phase turns the other way.

A sweep shows the sign by itself (`minimum.guess.phase_falls`); of a transient it shows beside other logs,
which conjugate it agrees with. Sweeps that rise are followed first: what else may look like it, a delay
before zero say, is then none.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.guess import phase_falls
from sysid.minimum.minimise import Minimiser, State, hopeful
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial
from sysid.verdict.linear import Found
from sysid.verdict.misfit import described
from sysid.verdict.wording import SAY_SO

SURE = 10.0  # log-likelihood
EXPLAINED = 0.25  # of the power that is left, half of its root


def mirrored(
    minimiser: Minimiser, trials: Sequence[Trial], together: State, likely: Sequence[Found]
) -> Found | None:
    """The logs whose conjugates are described along with the others, which they are not themselves, and
    better than by anything that is `likely`; else None."""
    least, found = max([SURE, *(f.worth for f in likely)]), None
    alike = minimiser.refine(tuple(trials), together.theta, Rounds(1))
    for turned in _tried(trials):
        first = minimiser.roughly(tuple(_conjugate(t) if i in turned else t for i, t in enumerate(trials)))
        if not hopeful(first[0], min(alike.cost, together.cost - least)):
            continue
        there = minimiser.distinct(first)[0]
        worth = together.cost - there.cost
        if worth > least and (described(minimiser, there) or _mostly(turned, together, there)):
            least, found = worth, _found(trials, turned, worth)
    return found


def _found(trials: Sequence[Trial], turned: Sequence[int], worth: float) -> Found:
    names, rises = ", ".join(trials[i].log.name for i in turned), any(trials[i].swept for i in turned)
    seen = "rises through the resonance" if rises else "turns the other way than in the other logs"
    said = f"{names}: the phase {seen}; if d and q are not swapped, {SAY_SO}"
    log = turned[0] if len(turned) == 1 else None
    return Found(said, worth, {"f0": np.inf}, "mirrored", log, 1, mostly=rises)


def _mostly(turned: Sequence[int], together: State, there: State) -> bool:
    """Whether the conjugates of sweeps are left with little of what the sweeps are: something else may be
    left as well."""
    if not all(together.trials[i].swept for i in turned):
        return False
    before, after = (
        sum(float(np.sum(np.abs(s.trials[i].residual(s.models[i])) ** 2)) for i in turned)
        for s in (together, there)
    )
    return after < EXPLAINED * before


def _tried(trials: Sequence[Trial]) -> Iterator[tuple[int, ...]]:
    """Which logs may be turned."""
    told = [i for i, t in enumerate(trials) if t.resonant and np.iscomplexobj(t.log.response)]
    moving = tuple(i for i in told if not trials[i].steady)
    rising = tuple(i for i in told if trials[i].swept and not phase_falls(trials[i]))
    each = [rising, tuple(told)] if rising else []
    each += [(i,) for i in moving] if len(trials) > 1 else []
    each += [moving] if 1 < len(moving) < len(trials) else []
    yield from dict.fromkeys(each)


def _conjugate(trial: Trial) -> Trial:
    log, whole = (x and replace(x, response=x.response.conj()) for x in (trial.log, trial.whole))
    return replace(trial, log=log, whole=whole)
