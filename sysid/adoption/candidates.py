"""Which effects are tried, and in which logs: what these show most of, to first order."""

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.adoption.description import SURE, Group, Instance
from sysid.effects.effect import Effect, nowhere
from sysid.effects.registry import EFFECTS
from sysid.trials.trial import Trial
from sysid.verdict.linear import PROMISES
from sysid.verdict.misfit import Misfits

TOGETHER = 2  # logs, of more of which it is not tried in each by itself
# of what the best one gains to first order: those that gain more are tried first. Of 60 simulated benches,
# each with a softening, a filter, a delay, a second mode or an image, of up to three half bandwidths or 0.8
# time constants, the true one gained 0.53 of it or more; of sweeps too fast it may be hardly more than
# PROMISES
LIKELY = 0.25


def instances(trials: Sequence[Trial], names: Sequence[str]) -> list[Instance]:
    """All that logs can show, but for those in coarse steps: rows of one value share their rounding error,
    which is no noise by which descriptions compare."""
    each: list[Instance] = []
    for effect in (e for e in EFFECTS if e.name in names):
        here = tuple(i for i, t in enumerate(trials) if t.noise.rounded is None and effect.shows(t))
        if effect.scope != "plate" and len(trials) > effect.relative:
            each += [Instance(effect, (i,)) for i in here]
        if effect.scope == "plate" and here:
            each.append(Instance(effect, here))
        if effect.scope == "bench" and len(here) > 1:
            each.append(Instance(effect, here))
    return each


def candidates(each: Sequence[Instance], looked: Misfits, wrong: set[int]) -> tuple[list[Group], ...]:
    """These effects as they are tried: the likely ones, the others, and last what may be anything, in a log
    that is wrong: its like in another is not looked for."""
    known = [x for x in each if x.effect.hop is None and not wrong.isdisjoint(x.where)]
    shares = {x: shown(x, looked) for x in known}
    likely, every = (
        groups([x for x in known if shares[x] >= least], wrong, shares) for least in (LIKELY, PROMISES)
    )
    anything: list[Group] = [(x,) for x in each if x not in known and wrong.issuperset(x.where)]
    return likely, [x for x in every if x not in likely], anything


def shown(x: Instance, looked: Misfits) -> float:
    """The share of what its logs show of anything, to first order, that an effect would be; infinite of one
    of which the first order tells nothing, as it does nothing small, and 0 of one that changes nothing, or
    gains less than the evidence that it has to have, which its numbers cost besides."""
    if looked.fit is None:
        return np.inf
    here = [t for t in looked.tried if t.log is None or t.log in x.where]
    own_name = () if x.effect.places is nowhere else (x.effect.name,)  # else that of another of its kind
    own = [t for t in here if t.name in (*own_name, *x.effect.known_as)]
    if not own:
        return 0.0 if x.effect.places is None else np.inf  # as of one temperature
    most, best = (max(looked.fit.gain(t) for t in some) for some in (here, own))
    return best / most if best >= SURE else 0.0


def groups(each: Sequence[Instance], wrong: set[int], shares: Mapping[Instance, float]) -> list[Group]:
    """These effects as they are tried: each for itself, and one that several logs may have for themselves in
    all that are `wrong` at once; where these are more than TOGETHER, of single ones that of which its log
    shows most."""
    alike: dict[Effect, list[Instance]] = {}
    for x in each:
        if len(x.where) == 1 and x.effect.scope != "plate" and not x.effect.many:
            alike.setdefault(x.effect, []).append(x)
    several = [tuple(y for y in xs if y.where[0] in wrong) for xs in alike.values()]
    for_all = {x[0].effect for x in several if len(x) > TOGETHER}
    others = [x[x[0].effect.relative :] for x in several if x]  # but for the one beside which they are
    most = {e: max(alike[e], key=lambda x: shares[x]) for e in for_all}
    alone = [(x,) for x in each if len(x.where) > 1 or most.get(x.effect, x) == x]
    return [*alone, *(x for x in others if len(x) > 1)]
