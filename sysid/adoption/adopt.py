"""Effects that logs call for, found and fitted: the loop

    minima --not described--> each effect, from each of its starts --> the best, with all its numbers -->
    described? --> adopted

One is adopted if its evidence beats both the plant alone and all that the first order found of other kinds,
whose evidence is at most

    worth - freedom log(2 worth/freedom) / 2

as the prior of a number is no narrower than the number, and if what it leaves is noise of each row's own. The
best that is not adopted is still named where it explains most of what the plant leaves. What was tried in
full and explains nothing is refuted: the first order's name for it is no cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.adoption.description import RIVAL, Description, Instance
from sysid.adoption.search import NEARLY, Search
from sysid.effects.registry import EFFECTS
from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import NAMES
from sysid.trials.trial import Trial
from sysid.verdict.conclusion import BETWEEN
from sysid.verdict.linear import Found
from sysid.verdict.misfit import misfits
from sysid.verdict.unexplained import left_of, slow

SURE = 3.0  # log evidence: odds of twenty to one
MOST = 2  # effects in one set of logs
# of the power that neighbouring rows share, which an effect takes beside which there may be another
TAKEN = 0.25


@dataclass(frozen=True)
class Outcome:
    """What became of the effects that were tried: a description that is adopted; one that is only `named`, as
    it explains most but not all, or `surely`; and which names, of the first order in which log, are
    `refuted`."""

    adopted: Description | None = None
    named: Description | None = None
    refuted: frozenset[tuple[str, int]] = field(default_factory=frozenset)
    surely: bool = False


def tried(minimiser: Minimiser, state: State, found: Sequence[Found], names: Sequence[str]) -> Outcome:
    """The effects, of those called `names`, fitted to the logs of a minimum that the plant alone does not
    describe. `found`: what the logs hold to first order."""
    each = instances(state.trials, names)
    adoption = _Adoption(Search(minimiser, state), found)
    wrong = misfitting(state, found) | {i for i, t in enumerate(state.trials) if slow(t, state.tau)}
    here = [x for x in each if _promises(x, found, wrong)]
    before: tuple[Instance, ...] = ()
    numbers, named, count = np.zeros(0), None, len(here)
    for _ in range(MOST):
        best = adoption.best(before, numbers, here, count) if here else None
        if best is None:
            break
        left = misfits(best.state, minimiser.reference, minimiser.free, None).found
        wrong, ahead = misfitting(best.state, left), adoption.ahead(best)
        if ahead and best.white and best.state.converged and not wrong:
            rough = any(x.effect.rough for x in best.instances)
            return Outcome(None, best, adoption.refuted(best), True) if rough else Outcome(best)
        if not before and ahead and adoption.cause(best) and not _mistaken(best, left):
            named = best
        if not best.explains(state, 1 - TAKEN):
            break
        before, numbers = best.instances, best.numbers
        here = [x for x in each if (x not in before or x.effect.many) and _promises(x, left, wrong)]
    return Outcome(None, named, adoption.refuted(named), named is not None and named.explains(state))


class _Adoption:
    """What is known of effects that were tried beside what the first order `found`."""

    def __init__(self, search: Search, found: Sequence[Found]):
        self.search, self.found = search, found
        self.alone: list[Description] = []  # of effects by themselves
        self.contradicting: dict[int, float] = {}  # evidence that a log is another plate's

    def best(
        self, before: tuple[Instance, ...], numbers: np.ndarray, here: Sequence[Instance], count: int
    ) -> Description | None:
        """The best description with one more effect; None where none gains, or one that is no effect at all
        by its numbers gains more: something else is there."""
        ends = self.search.ends(before, numbers, here, count)
        self.alone += [] if before else ends
        least = max([SURE, *(d.evidence - NEARLY for d in ends if not d.sense)])
        for best in (d for d in ends if d.sense and d.evidence >= least):
            done = self.search.finished(best) if self.ahead(best) else best
            if done.sense:
                near = best.evidence - NEARLY
                alike = [d for d in ends if d is not best and d.sense and d.evidence > near]
                others = {d.instances[-1].effect.name: d.evidence for d in reversed(ends)}
                del others[best.instances[-1].effect.name]
                return done._replace(
                    dispersion=done.dispersion + _between(done, alike),
                    nearly=tuple(name for name, evidence in reversed(others.items()) if evidence > near),
                    rival=max(others.values(), default=-np.inf),
                )
        return None

    def ahead(self, best: Description) -> bool:
        """Whether it beats what the first order found of other kinds, that was not tried in full."""
        full = {name for d in self.alone for name in d.names()}
        others = [f for f in self.found if not any(f.name in x.effect.alike for x in best.instances)]
        others = [f for f in others if not any(f.name == n and f.log in (None, i) for n, i in full)]
        apart = {f.log for f in others if f.name in BETWEEN and f.log is not None}
        return best.evidence > max([SURE, *map(_most_evidence, others), *map(self.apart, apart)])

    def apart(self, i: int) -> float:
        """The same of a log that is another plate's, with parameters of its own, which to first order may
        seem worth less than they are."""
        if i not in self.contradicting:
            search, whole = self.search, range(len(self.search.trials))
            parts = [tuple(search.trials[k] for k in whole if (k == i) is own) for own in (True, False)]
            each = [search.minimiser.refine(part, search.alone.theta, 1, 0) for part in parts]
            self.contradicting[i] = _most(sum(s.likelihood for s in each) + search.base, len(search.names))
        return self.contradicting[i]

    def cause(self, best: Description) -> bool:
        """Whether it is what the plant alone leaves: next to nothing is left, or little of what nothing else
        explains."""
        known = any(f.explains for f in self.found)
        return best.explains(self.search.alone) or (not known and best.most(self.search.alone))

    def refuted(self, named: Description | None) -> frozenset[tuple[str, int]]:
        """First order's names of effects that were tried by themselves and explain nothing."""
        told = [*self.alone, *([] if named is None else [named])]
        able = {n for d in told if d.evidence > 0 and d.explains(self.search.alone) for n in d.names()}
        return frozenset({n for d in self.alone for n in d.names()} - able)


def instances(trials: Sequence[Trial], names: Sequence[str]) -> list[Instance]:
    """All that logs can show, but for those in coarse steps: rows of one value share their rounding error,
    which is no noise by which descriptions compare."""
    each: list[Instance] = []
    for effect in (e for e in EFFECTS if e.name in names):
        here = tuple(i for i, t in enumerate(trials) if t.noise.rounded is None and effect.shows(t))
        if effect.scope != "plate":
            each += [Instance(effect, (i,)) for i in here]
        if effect.scope == "plate" and here:
            each.append(Instance(effect, here))
        if effect.scope == "bench" and len(here) > 1:
            each.append(Instance(effect, here))
    return each


def misfitting(state: State, found: Sequence[Found]) -> set[int]:
    """The logs that show what the plant alone does not describe."""
    every = set(range(len(state.trials)))
    shown = [every if f.log is None else {f.log} for f in found if f.certain]
    return {i for i in every if not state.trials[i].silent and left_of(state, i)}.union(*shown)


def _mistaken(best: Description, left: Sequence[Found]) -> bool:
    """Whether what is left beside it is another effect that it may be taken for, and worth much beside it."""
    left = [f for f in left if f.worth > RIVAL * best.evidence]
    each = [x.effect for x in best.instances]
    own = {name for e in each for name in (e.name, *e.known_as)}
    return any(
        f.certain and f.explains and f.name in e.alike and f.name not in own for e in each for f in left
    )


def _promises(instance: Instance, found: Sequence[Found], wrong: set[int]) -> bool:
    """Whether the logs that it is about are not described, and the first order says nothing of one of them,
    or something that this may be."""
    told = [f for f in found if f.log is None or f.log in instance.where]
    return not wrong.isdisjoint(instance.where) and (
        not told or any(f.name in instance.effect.alike for f in told)
    )


def _most_evidence(found: Found) -> float:
    """An upper bound of the evidence of what was found to first order."""
    return _most(found.worth, found.freedom)


def _most(worth: float, freedom: int) -> float:
    return worth - 0.5 * freedom * float(np.log(max(2 * worth / freedom, 1.0)))


def _between(best: Description, alike: Sequence[Description]) -> np.ndarray:
    """(6, 6) what descriptions that are nearly as likely add to the covariance about the best, by their share
    of the evidence."""
    weights = np.exp([a.evidence - best.evidence for a in alike])
    found = np.zeros((len(NAMES), len(NAMES)))
    for weight, other in zip(weights, alike, strict=True):
        away = other.state.theta - best.state.theta
        found += weight / (1 + np.sum(weights)) * np.outer(away, away)
    return found
