"""A step or ring-down whose Wq has the other sign than that of the other logs.

It turns the other way, as if the resonance lay on the other side of the drive, and by the others it does not.
A sweep shows the sign by itself (`minimum.guess.phase_falls`); of a transient it shows beside other logs,
which conjugate it agrees with.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import Minimiser, State, hopeful
from sysid.trials.trial import Trial
from sysid.verdict.linear import Found
from sysid.verdict.misfit import described
from sysid.verdict.wording import SAY_SO

SURE = 10.0  # log-likelihood


def mirrored(
    minimiser: Minimiser, trials: Sequence[Trial], together: State, likely: Sequence[Found]
) -> Found | None:
    """The logs, one transient or all of them, whose conjugates are described along with the others, which
    they are not themselves, and better than by anything that is `likely`; else None."""
    least, found = max([SURE, *(f.worth for f in likely)]), None
    alike = minimiser.refine(tuple(trials), together.theta, 1)
    for turned in _tried(trials):
        first = minimiser.roughly(tuple(_conjugate(t) if i in turned else t for i, t in enumerate(trials)))
        if not hopeful(first[0], alike):
            continue
        there = minimiser.distinct(first)[0]
        if (worth := together.cost - there.cost) > least and described(minimiser, there):
            names = ", ".join(trials[i].log.name for i in turned)
            said = (
                f"{names}: the phase turns the other way than in the other logs; if d and q are not"
                f" swapped, {SAY_SO}"
            )
            log = turned[0] if len(turned) == 1 else None
            least, found = worth, Found(said, worth, {"f0": np.inf}, "mirrored", log, 1)
    return found


def _tried(trials: Sequence[Trial]) -> Iterator[tuple[int, ...]]:
    moving = tuple(
        i for i, t in enumerate(trials) if t.resonant and not t.steady and np.iscomplexobj(t.log.response)
    )
    if len(trials) > 1:
        yield from ((i,) for i in moving)
    if 1 < len(moving) < len(trials):
        yield moving


def _conjugate(trial: Trial) -> Trial:
    log, whole = (x and replace(x, response=x.response.conj()) for x in (trial.log, trial.whole))
    return replace(trial, log=log, whole=whole)
