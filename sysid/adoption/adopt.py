"""Effects that logs call for, found and fitted: the loop

    minima --not described--> each effect, from each of its starts --> the best, with all its numbers -->
    described? --> adopted

One is adopted if its evidence beats the plant alone, all that the first order found of other kinds, whose
evidence is at most

    worth - freedom log(2 worth/freedom) / 2

as the prior of a number is no narrower than the number, and that logs are of plates of their own; and if what
it leaves is noise of each row's own. What several logs may have for themselves is tried in all of them at
once as well. Beside what is not yet described one more is looked for: of another kind once, of the same kind,
as modes are, a few times; one may at first stand for several. What leaves next to nothing, though not noise
alone, is adopted with errors that span that. Any other that explains most of what the plant leaves, where
nothing is much likelier, is named, and so are effects of two kinds in one log. What was tried in full and
explains nothing is refuted: the first order's name for it is no cause.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from sysid.adoption.candidates import candidates, instances
from sysid.adoption.description import RIVAL, SURE, Description, Group, Instance
from sysid.adoption.point import LEVEL, Points
from sysid.adoption.search import NEARLY, Search
from sysid.effects.drift import WARMED
from sysid.effects.effect import About
from sysid.effects.plate import CURVED
from sysid.effects.registry import ADOPTED, EFFECTS
from sysid.minimum.minimise import Minimiser, State
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial
from sysid.verdict.conclusion import BETWEEN
from sysid.verdict.inconsistent_log import DIFFER, apart, warmth
from sysid.verdict.linear import Found
from sysid.verdict.misfit import Misfits, misfits
from sysid.verdict.remains import remains
from sysid.verdict.unexplained import left_of, left_share, slow

MOST = 2  # effects in one set of logs, beyond which only more of one kind are looked for, as modes,
LONGEST = 5  # up to so many in all: each multiplies the time of a search
# of the power that neighbouring rows share, which an effect takes beside which there may be another
TAKEN = 0.25
# of log G and log tau, by which plates of a kind differ, and by which the prefix of a unit makes them
UNLIKE = (0.5, float(np.log(1e3)))


@dataclass(frozen=True)
class Outcome:
    """What became of the effects that were tried: a description that is adopted, if the fit with it is
    successful, and whether `wholly`, or with errors that span what it leaves; one that is else `named`, as it
    explains most but not all, or `surely`, and whether it leaves no log wrong, `described`; which names, of
    the first order in which log, are `refuted`; and `unsure`, those of effects of which none, fitted in full,
    is sure to be there."""

    adopted: Description | None = None
    wholly: bool = True
    named: Description | None = None
    refuted: frozenset[tuple[str, int]] = field(default_factory=frozenset)
    surely: bool = False
    described: bool = False
    unsure: frozenset[str] = field(default_factory=frozenset)


def tried(
    minimiser: Minimiser, state: State, looked: Misfits, names: Sequence[str], bend: float = 0.0
) -> Outcome:
    """The effects, of those called `names`, fitted to the logs of a minimum that the plant alone does not
    describe; `looked`: what these hold to first order; `bend`: see `About`. What lasts comes first: of a
    stretch that is left out it need not be known what happened in it, and two modes may be one."""
    each = instances(state.trials, names)
    away = 0.0 if looked.fit is None else looked.fit.away
    about = About.of(state, minimiser.reference, away)._replace(bend=bend)
    wrong = misfitting(state, looked.found) | {i for i in range(len(state.trials)) if slow(state, i)}
    here = candidates(each, looked, wrong)
    here = ([(x,) for x in each if bend and x.effect is CURVED], *here)
    search = Search(Points(minimiser, state, about))
    adoption = _Adoption(search, looked, sum(map(len, here)))
    lasting, anything = here[:-1], here[-1]
    way = adoption.followed([x for x in each if x.effect.hop is None], (*lasting, []))
    adoption.search = search  # with the logs as they were read at first
    if way.adopted is None or adoption.happened(anything) > way.evidence + NEARLY:
        other = adoption.followed(each, here)
        whole = other.described or other.adopted is not None
        if whole and other.evidence > way.evidence + NEARLY:
            return adoption.outcome(other)
        way = max(other, way, key=lambda w: (w.adopted is not None, w.described, w.evidence))
    return adoption.outcome(way)


class _Way(NamedTuple):
    """Where a search led: the `last` description; one that is `adopted`, unless it is `rough`; one that is
    `named`, and whether it leaves no log wrong, `described`."""

    last: Description | None = None
    adopted: Description | None = None
    named: Description | None = None
    described: bool = False

    @property
    def evidence(self) -> float:
        """Log evidence of the last one."""
        return -np.inf if self.last is None else self.last.evidence


class _Adoption:
    """What is known of effects that were tried, `count` of them, beside what was `looked` at to first
    order."""

    def __init__(self, search: Search, looked: Misfits, count: int):
        self.search, self.before, self.looked, self.count = search, search.points.alone, looked, count
        self.alone: list[Description] = []  # of effects by themselves
        self.led: dict[tuple[Search, tuple[Instance, ...], tuple[Group, ...]], list[Description]] = {}
        self.parts: dict[tuple[tuple[int, ...], ...], float] = {}  # evidence that logs are of several plates
        self.wholly: dict[tuple[str, int], float] = {}  # and of effects that the first order names in it

    def followed(self, each: Sequence[Instance], here: Sequence[Sequence[Group]]) -> _Way:
        """One more effect after the other, of all `each`; at first those that are tried `here`."""
        before, way = None, _Way()
        for count in range(1, LONGEST + 1):
            best = self.best(before, here)
            if best is None:
                break
            if (anew := self.search.stated(best)) is not None:
                self.search, best = anew
            minimiser = self.search.points.minimiser
            left = misfits(best.state, minimiser.reference, minimiser.free, None)
            wrong, ahead = misfitting(best.state, left.found), self.ahead(best) if best.sense else -np.inf
            way = way._replace(last=best) if best.sense else way
            if ahead > 0 and best.white and best.state.converged and not wrong:
                named = best.rough or _entangled(best)
                return way._replace(adopted=best if named else self.search.profiled(best))
            # what happened to a log for a while is no cause of what others show
            elsewhere = best.event and not wrong <= best.where
            cause = not wrong or (self.cause(best) and not elsewhere)
            if before is None and ahead > -NEARLY and cause and not _mistaken(best, left.found):
                way = way._replace(named=best, described=not wrong)
            if best.takes(self.before) < TAKEN:
                break
            before = best
            more = [x for x in each if x not in before.instances or x.effect.many]
            own = {x for x in before.instances if not x.effect.usual}
            if count >= MOST:
                more = [x for x in more if {x} == own or x.effect.usual]
            here = candidates(more, left, wrong | best.smooth)
        return way

    def happened(self, anything: Sequence[Group]) -> float:
        """Evidence of the likeliest of what may have happened to a log for a while."""
        return max((d.evidence for d in self.ends(None, anything) if d.sense), default=-np.inf)

    def outcome(self, way: _Way) -> Outcome:
        """What became of all that was tried."""
        if (best := way.adopted) is not None:
            if best.rough or _entangled(best):
                return Outcome(None, False, best, self.refuted(best), True, True)
            return Outcome(best)
        told = (d for d in (way.named, way.last) if d is not None and self.ahead(d) > 0)
        likely = [d for d in told if d.explains(self.before)]
        lasting = (self.spanning(d, likely[-1]) for d in likely if not (d.rough or d.event or _entangled(d)))
        named = next((d for d in (way.named, *likely) if d is not None), None)
        surely = bool(likely) and likely[0] is named
        refuted, unsure = self.refuted(named), self.unsure()
        return Outcome(next(lasting, None), False, named, refuted, surely, way.described, unsure)

    def spanning(self, named: Description, last: Description) -> Description:
        """A description whose errors span what it leaves: as its like along the logs does, as far as the
        `last` one moves theta from there, and as if it were all a change of G, of tau or of f0, which changes
        the response at resonance by as much."""
        away, minimiser = last.state.theta - named.state.theta, self.search.points.minimiser
        left = max(left_share(named.state, i) for i in named.where)
        each = left * np.array([1.0, 1.0, named.state.half_bandwidth, 0.0, 0.0, 0.0])
        left_over = remains(named.state, minimiser.reference, minimiser.free)
        return named._replace(
            dispersion=named.dispersion + np.outer(away, away) + np.diag(each**2) + left_over
        )

    def ends(self, before: Description | None, some: Sequence[Group]) -> list[Description]:
        """Where one more effect leads, searched for once."""
        known = () if before is None else before.instances
        key = self.search, known, tuple(some)
        if key not in self.led:
            self.led[key] = self.search.ends(before, some, self.count)
            self.alone += self.led[key] if before is None else []
        return self.led[key]

    def best(self, before: Description | None, here: Sequence[Sequence[Group]]) -> Description | None:
        """The best description with one more effect, of those that are likely or else of the others as well;
        None where none gains, or one that is no effect at all by its numbers gains more: something else is
        there, unless a log may have several of it."""
        ends: list[Description] = []
        for k, some in enumerate(here):
            if some and not (ends and self._enough(ends[0])):
                found = self.ends(before, some)
                if k == len(here) - 1 and ends and ends[0].sense and ends[0].explains(self.before):
                    found = [d for d in found if d.white]
                ends = sorted([*ends, *found], key=lambda d: -d.evidence)
        known = SURE if before is None else max(SURE, before.evidence)
        least = max([known, *(d.evidence - NEARLY for d in ends if not d.sense)])
        for best in (d for d in ends if d.evidence >= least):
            done = self.search.finished(best) if best.sense and self.ahead(best) > -NEARLY else best
            if not done.sense and best is ends[0] and best.instances[-1].effect.many:
                return done  # one may stand for several, which are then looked for beside it
            if done.sense:
                near = best.evidence - NEARLY
                images = [d for d in self.search.images(best, ends, self.count) if d.sense]
                alike = [d for d in ends if d is not best and d.sense and near < d.evidence <= best.evidence]
                alike = [*alike, *images]
                others = {d.instances[-1].effect.name: d.evidence for d in reversed(ends)}
                del others[best.instances[-1].effect.name]
                return done._replace(
                    covariance=done.covariance + _between(done, images, lambda d: d.numbers),
                    dispersion=done.dispersion
                    + _between(done, alike, lambda d: d.state.theta)
                    + self._open(done),
                    nearly=tuple(name for name, evidence in reversed(others.items()) if evidence > near),
                    rough=any(map(_rough, (best, *alike))),
                    rival=max(others.values(), default=-np.inf),
                    mirrored=frozenset(
                        k for d in images for k in np.flatnonzero(d.numbers * best.numbers < 0).tolist()
                    ),
                )
        return None

    def _enough(self, best: Description) -> bool:
        """Whether nothing else has to be tried beside it."""
        return best.sense and not best.vague and best.white and self.ahead(best) > 0

    def _open(self, found: Description) -> np.ndarray:
        """(6, 6) what effects that all driven logs have leave open of theta, by the first log of each."""
        trials, known = self.search.points.trials, np.zeros((len(NAMES), len(NAMES)))
        driven = {i for i, t in enumerate(trials) if t.driven}
        for effect in {x.effect for x in found.instances}:
            own = [k for k, x in enumerate(found.instances) if x.effect is effect]
            if driven.issubset({i for k in own for i in found.instances[k].where}):
                numbers = found.numbers[found.parts[own[0]]]
                std = effect.leaves(trials[found.instances[own[0]].where[0]], numbers)
                known += np.outer(std, std)
        return known

    def ahead(self, best: Description) -> float:
        """By how much its evidence is more than that of what the first order found of other kinds and was not
        tried in full, an upper bound of that, and what it is worth in full where the bound is no less; and
        than that its logs, or one which contradicts the others, or each, are of a plate of their own."""
        full = {name for d in self.alone for name in d.names()}
        others = [
            f for f in self.looked.found if not any(f.name == n and f.log in (None, i) for n, i in full)
        ]
        apart = {f.log for f in others if f.name in BETWEEN and f.log is not None}
        among = (f for f in others if f.name not in BETWEEN or f.log is None)
        known = (self.whole(f) if _most_evidence(f) >= best.evidence else SURE for f in among)
        ways = {self._beside({i}) for i in apart}
        if not any(x.effect.relative for x in best.instances):  # which is how that log differs
            ways.add(self._beside(best.where))
        ways |= {tuple((i,) for i in self._every)} if len(apart) > 1 else set()
        return best.evidence - max([SURE, *known, *(self.parted(*way) for way in ways if all(way))])

    def _beside(self, where: set[int]) -> tuple[tuple[int, ...], ...]:
        """These logs and the others."""
        rest = tuple(i for i in self._every if i not in where)
        return tuple(sorted([tuple(sorted(where)), rest]))

    @property
    def _every(self) -> tuple[int, ...]:
        return tuple(range(len(self.search.points.trials)))

    def whole(self, found: Found) -> float:
        """Evidence of what the first order found in a log, with all its numbers."""
        effects = [e for e in EFFECTS if e.name == found.name]
        if found.log is None:
            return _most_evidence(found)
        if not effects:
            return self.linear(found)
        if (found.name, found.log) not in self.wholly:
            ends = self.search.ends(None, [(Instance(e, (found.log,)),) for e in effects], self.count)
            best = max((d.evidence for d in ends), default=-np.inf)
            self.wholly[found.name, found.log] = best
        return self.wholly[found.name, found.log]

    def linear(self, found: Found) -> float:
        """The same of what is no effect, as a background that bends: to first order all but its prior, by
        which it has a usual size, is known."""
        tried = [t for t in self.looked.tried if (t.name, t.log) == (found.name, found.log)]
        scored = [] if self.looked.fit is None else [s for s in self.looked.fit.scored(tried) if s]
        if not scored:
            return _most_evidence(found)
        likeliest = max(scored, key=lambda s: float(s.numbers @ s.numbers))
        return found.worth - 0.5 * float(np.sum(np.log1p(likeliest.usual))) - float(np.log(self.count))

    def parted(self, *groups: tuple[int, ...]) -> float:
        """Evidence that these groups of logs are each of a plate of its own, one of which is that of all; of
        two, that one log is, whichever."""
        if groups not in self.parts:
            points, which = self.search.points, float(np.log(self.count))  # one of all that is tried
            which += float(np.log(len(self._every))) if len(groups) == 2 else 0.0
            own = [self.by_themselves(tuple(points.trials[i] for i in group)) for group in groups]
            cost = [self.differing(s) for s in own]
            gained = sum(s.likelihood for s in own) + points.base
            self.parts[groups] = gained - (sum(cost) - min(cost)) - which
        return self.parts[groups]

    def by_themselves(self, trials: tuple[Trial, ...]) -> State:
        """What some of the logs tell beside the others, near the plate of all or where they lead to."""
        points, search = self.search.points, self.search.points.minimiser.beside(trials)
        begins = [points.alone.theta, search.roughly(trials)[0].theta]
        return max((search.refine(trials, theta, LEVEL) for theta in begins), key=lambda s: s.likelihood)

    def differing(self, own: State) -> float:
        """What it costs that logs have parameters of their own, each of which differs from that of all by d
        with the variance C: log(1 + S^2/C)/2 + d^2/(C + S^2)/2 beside priors of S^2, one of which is 0, as of
        what is the same; and the log of how many of these there are."""
        points, cost = self.search.points, 0.0
        for name in (n for n in DIFFER if n in points.names):
            away, error = apart(own, points.alone, name, warmth(points.minimiser, own.trials))
            unlike = (WARMED * points.alone.half_bandwidth,) if name == "f0" else UNLIKE
            priors = np.array([0.0, *unlike]) / error
            each = 0.5 * (np.log1p(priors**2) + (away / error) ** 2 / (1 + priors**2))
            cost += float(np.min(each) + np.log(len(priors)))
        return cost

    def cause(self, best: Description) -> bool:
        """Whether it is what the plant alone leaves: next to nothing is left, or little of what nothing else
        explains."""
        known = any(f.explains for f in self.looked.found)
        return best.explains(self.before) or (not known and best.most(self.before))

    def refuted(self, named: Description | None) -> frozenset[tuple[str, int]]:
        """First order's names of effects that were tried by themselves and explain nothing."""
        told = [*self.alone, *([] if named is None else [named])]
        able = {n for d in told if d.evidence > 0 and d.explains(self.before) for n in d.names()}
        return frozenset({n for d in self.alone for n in d.names()} - able)

    def unsure(self) -> frozenset[str]:
        """First order's names of effects that were tried by themselves, none of which is sure to be there."""
        sure = {name for d in self.alone if d.evidence >= SURE for name, _ in d.names()}
        return frozenset({name for d in self.alone for name, _ in d.names()} - sure)


def misfitting(state: State, found: Sequence[Found]) -> set[int]:
    """The logs that show what the plant alone does not describe."""
    every = set(range(len(state.trials)))
    shown = [every if f.log is None else {f.log} for f in found if f.certain]
    return {i for i in every if left_of(state, i)}.union(*shown)


def _rough(found: Description) -> bool:
    """Whether the law of an effect is not known well in one of its logs."""
    each, trials = zip(found.instances, found.parts, strict=True), found.state.trials
    return any(x.effect.rough(trials[i], found.numbers[part]) for x, part in each for i in x.where)


def _entangled(best: Description) -> bool:
    """Whether two effects of different kinds are in one log, beside what any bench has and parts of one law
    of the plate: they may make up for a third that is none of them."""
    effects = [(x.effect, x.where) for x in best.instances if not x.effect.usual]
    each = [(effect.law or effect.name, i) for effect, where in effects for i in where]
    return any(i == k and name != other for (name, i), (other, k) in combinations(each, 2))


def _mistaken(best: Description, left: Sequence[Found]) -> bool:
    """Whether what is left beside it is another effect, worth much beside it."""
    own = {name for x in best.instances for name in (x.effect.name, *x.effect.known_as)}
    left = [f for f in left if f.worth > RIVAL * best.evidence and f.name in ADOPTED]
    return any(f.certain and f.explains and f.name not in own for f in left)


def _most_evidence(found: Found) -> float:
    """An upper bound of the evidence of what was found to first order."""
    return _most(found.worth, found.freedom)


def _most(worth: float, freedom: int) -> float:
    return worth - 0.5 * freedom * float(np.log(max(2 * worth / freedom, 1.0)))


def _between(
    best: Description, alike: Sequence[Description], of: Callable[[Description], np.ndarray]
) -> np.ndarray:
    """(n, n) what descriptions that are nearly as likely add to the covariance about the best, by their share
    of the evidence: `of` what of each."""
    weights = np.exp([a.evidence - best.evidence for a in alike])
    away = np.array([of(a) - of(best) for a in alike]).reshape(len(alike), len(of(best)))
    return (weights / (1 + np.sum(weights)) * away.T) @ away
