"""The search for the numbers of effects beside a minimum: from starts along steps to optima, which compare by
the Laplace approximation of their evidence,

    log p(logs) = log likelihood - sum (u/s)^2 / 2 + log det(C_u/s^2) / 2 - log(effects that were tried)

with s the numbers' prior standard deviations and C_u their covariance, in white noise of one level.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from sysid.adoption.description import Description, Group
from sysid.adoption.point import LEVEL, NEAR, Point, Points, fed
from sysid.adoption.profile import profiled
from sysid.effects.plate import AMPLITUDE
from sysid.minimum.minimise import State
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial, freedom

NEARLY = 3.0  # log evidence within which another description may be true as well: odds of twenty to one
FOLLOWED = 4  # effects that are followed, and the best of each effect: each from
CLOSER = 3  # of its starts, at first for
FIRST = 2  # steps;
WITHIN = 30.0  # log likelihood of the best of all then, one step later, up to its optimum
STEPS = 15
HOPS = 8  # of numbers that a log follows in steps: most need two
# what is compared at a start, to whose plate nothing leads but its own steps: d and q are linear in what the
# bench adds, and most take four; and on the way, where steps of plant and numbers together lead on: what is
# seen where the plate is foreseen, or near by
START = Rounds(1, steps=8, white=True)
GLANCE, ROUGH = Rounds(1, steps=0, white=True), Rounds(1, steps=2, white=True)
GOOD, POOR = 0.75, 0.25  # of what was foreseen, from which a step is trusted further, and no longer
ROUNDS = 3  # of the numbers and the colour of the noise in turn
LONG = 512  # rows, which tell the colour of a log's noise well enough
TOLD = 0.1  # of what a log tells of tau, that has to be left beside what happened in it
EXACT = 1e-200  # of a variance, as of a number without an error
# of the power of noise behind a filter, what is the recorder's own, after it: next to nothing, or as much as
# leaves a colour to be seen
OWN = (1e-6, 1e-3, 0.01, 0.1, 0.5)


class Search:
    """For the numbers of effects beside a minimum."""

    def __init__(self, points: Points):
        self.points = points
        self.better = cache(self.stepped)  # what a first few steps led to is followed on if it is hopeful

    def ends(self, before: Description | None, tried: Sequence[Group], count: int) -> list[Description]:
        """Where one more effect than those `before` leads to, of `count` that were tried, the likeliest
        first."""
        known = 0 if before is None else len(before.instances)
        starts = [p for x in tried for p in self.starts(before, x) if np.isfinite(self.hoped(p))]
        starts.sort(key=lambda p: self.hoped(p) - self.volume(p))
        followed = []
        for group in _likely([p.instances[known:] for p in starts]):
            own = [p for p in starts if p.instances[known:] == group][:CLOSER]
            followed += self.distinct([self.followed(p, FIRST, ROUGH) for p in own], np.inf)
        followed = [p for p in followed if self.plausible(p)] or followed
        followed.sort(key=lambda p: p.cost)
        within = followed[0].cost + WITHIN if followed else np.inf
        hopeful = [min(p.cost, self.hoped(p)) < within for p in followed]
        optima = [
            self.by_its_motion(self.beyond_rows(self.followed(p, STEPS))) if hope else p
            for p, hope in zip(followed, hopeful, strict=True)
        ]
        each = [
            self.distinct([p for p in optima if p.instances == x], NEARLY)
            for x in {p.instances for p in optima}
        ]
        return sorted((self.ended(p, count) for points in each for p in points), key=lambda d: -d.evidence)

    def starts(self, before: Description | None, group: Group) -> Iterator[Point]:
        """Where the search for one more effect begins, the same in all logs that have it for themselves; the
        plates on the way to their minimum."""
        known = () if before is None else before.instances
        near, numbers = (self.points.alone, np.zeros(0)) if before is None else (before.state, before.numbers)
        where, every = {i for x in group for i in x.where}, (*known, *group)
        afresh = all(group[0].effect.afresh(self.points.trials[k], self.points.about) for k in where)
        each = (x.effect.starts(self.points.trials[x.where[0]], self.points.about) for x in group)
        for start in zip(*each, strict=False):
            u = np.concatenate([numbers, *start])
            begin = self.points.anew(every, u) if afresh else near
            yield self.hopped(self.points.at(every, u, begin, START))

    def hopped(self, point: Point) -> Point:
        """The point, its numbers that logs follow in steps where they had better be, seen from its plate."""
        for _ in range(HOPS):
            numbers = point.numbers.copy()
            for x, part in zip(point.instances, self.points.parts(point.instances), strict=True):
                if x.effect.hop is not None:
                    numbers[part] = x.effect.hop(*self.points.seen_from(point.state, x.where[0]))
            if np.array_equal(numbers, point.numbers):
                break
            there = self.points.at(point.instances, numbers, point.state)
            if there.cost >= point.cost - NEAR:
                break
            point = there
        return point

    def hoped(self, point: Point) -> float:
        """The cost after one more step from a point, to second order."""
        return point.cost - self.points.looked(point).gain

    def volume(self, point: Point) -> float:
        """Logarithm of the share of the numbers' prior that the logs leave."""
        stds, covariance = self.points.stds(point.instances), self.points.looked(point).covariance
        return 0.5 * float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1])

    def followed(self, point: Point, most: int, rounds: Rounds = LEVEL) -> Point:
        """Where `most` steps of plant and numbers together from a point, or fewer, lead; the plate then at
        its own minimum, or on the way to it."""
        for _ in range(most):
            better = self.better(point)
            if better is None:
                break
            gained, point = point.cost - better.cost, better
            if gained < NEAR**2:
                break
        ended = self.points.at(point.instances, point.numbers, point.state, rounds)
        return replace(ended, trust=point.trust)

    def stepped(self, point: Point) -> Point | None:
        """A step of plant and numbers from a point, as far as one is trusted and leads to a better point, or
        would with a plant that is looked for; None where it does not, or is none."""
        look = self.points.looked(point)
        if _ends(look.step, look.covariance):
            return None
        far, stds = point.trust, self.points.stds(point.instances)
        for rounds in (GLANCE, ROUGH, GLANCE, ROUGH):
            step, foreseen = look.within(far, stds)
            there = self.points.onward(point, step, rounds)
            if (gained := point.cost - there.cost) > 0:
                wider = 2.0 if gained > GOOD * foreseen else 1.0 if gained > POOR * foreseen else POOR
                return replace(there, trust=min(wider * far, 1.0))
            if rounds is ROUGH or far < point.trust:
                far = POOR * min(far, float(np.max(np.abs(step) / stds)))
        return None

    def beyond_rows(self, point: Point) -> Point:
        """The optimum that lies beyond rows of a log from another: of a number by which the response changes
        from row to row, each row may hold one."""
        steps = np.diag(self.points.steps(point.instances))
        parts = zip(point.instances, self.points.parts(point.instances), strict=True)
        stepped = [step for x, part in parts if x.effect.steps for step in steps[part]]
        for step in (sign * step for step in stepped for sign in (1.0, -1.0)):
            further = point
            while (there := self.points.onward(further, step)).cost < further.cost:
                further = there
            point = self.followed(further, STEPS) if further is not point else point
        return point

    def by_its_motion(self, point: Point) -> Point:
        """The optimum near another where what is fed beside a plate is no motion of it, if that is better, of
        laws of the amplitude. It is known only where the plate is nearly described: until then all that a
        log shows is its plate's."""
        if fed(point.state) or not any(x.effect.law == AMPLITUDE for x in point.instances):
            return point
        begun = self.points.begun(point.instances, point.numbers, point.state, LEVEL)
        there = self.followed(self.points.at(point.instances, point.numbers, begun), STEPS)
        return there if there.cost < point.cost - NEAR else point

    def distinct(self, points: Sequence[Point], within: float) -> list[Point]:
        """Of points of the same effects, the best first, each whose cost is `within` so much of the best,
        once."""
        kept: list[Point] = []
        for p in sorted(points, key=lambda p: p.cost):
            if kept and p.cost > kept[0].cost + within:
                break
            if all(self.points.differ(p, k) for k in kept):
                kept.append(p)
        return kept

    def images(self, best: Description, ends: Sequence[Description], count: int) -> list[Description]:
        """Others of the same effects, beside another plate, that are nearly as likely as the best and none of
        its `ends`: where the logs do not know the sign of a number, as of what lies in phase under an
        amplitude."""
        known = [d.state for d in ends if d.instances == best.instances]
        most = self.points.cost(best.instances, best.numbers, best.state) + NEARLY
        found: list[Description] = []
        if best.event:
            return found
        for k in np.flatnonzero(np.abs(best.numbers) > np.sqrt(np.diag(best.covariance))):
            numbers = np.where(np.arange(len(best.numbers)) == k, -1.0, 1.0) * best.numbers
            there = self.points.at(best.instances, numbers, best.state)
            there = self.followed(there, FIRST, ROUGH)  # its sign may not be all that changes
            there = self.followed(there, STEPS) if there.cost < most + WITHIN else there
            if there.cost < most and all(_apart(there.state, state) for state in known):
                known.append(there.state)
                found.append(self.ended(there, count))
        return found

    def plausible(self, point: Point) -> bool:
        """Whether all numbers would be those of their effects if they were known exactly: two modes may have
        changed places."""
        exact = np.diag(EXACT * self.points.stds(point.instances) ** 2)
        return self.points.sensible(point.instances, point.numbers, exact, point.state)

    def ended(self, point: Point, count: int) -> Description:
        """The description at an optimum. Its evidence is that in white noise of one level, as that of the
        plant alone is: tails and colour make up for what a wrong description leaves."""
        _, covariance, dispersion, *_ = self.points.looked(point)
        parts, volume = self.points.parts(point.instances), self.volume(point)
        evidence = self.points.base - point.cost + volume - len(point.instances) * np.log(count)
        evidence = evidence + _coloured(point, self.points) if np.isfinite(evidence) else -np.inf
        found = Description(
            point.instances,
            point.numbers,
            point.state,
            parts,
            covariance,
            dispersion,
            evidence,
            self.points.about,
            True,
        )
        return found._replace(sense=self.make_sense(found))

    def make_sense(self, found: Description) -> bool:
        """Whether all numbers are those of their effects, of a plate that the logs still show."""
        seen = not found.event or self.points.told(found.where, found.state) > TOLD
        return seen and self.points.sensible(found.instances, found.numbers, found.covariance, found.state)

    def stated(self, found: Description) -> tuple["Search", Description] | None:
        """The search and the description with the logs as they are read where their metadata state what was
        found, as of noise behind a filter, of which neighbouring rows hold the same; None where it states
        nothing."""
        read = list(self.points.alone.trials)
        for x, part in zip(found.instances, found.parts, strict=True):
            if x.effect.stated is not None:
                metadata = x.effect.stated(found.numbers[part], self.points.about)
                for i in x.where:
                    log, kind = read[i].log, read[i].kind
                    told = replace(log, bench={**metadata, **log.bench})  # what it states itself stays
                    read[i] = Trial.of(told, kind, read[i].nuisances)
        if all(len(t.log) == len(old.log) for t, old in zip(read, self.points.alone.trials, strict=True)):
            return None
        state = self.points.minimiser.refine(tuple(read), found.state.theta)
        search = Search(Points(self.points.minimiser, state, self.points.about))
        point = search.followed(search.points.at(found.instances, found.numbers, state), STEPS)
        anew = search.finished(search.ended(point, 1))
        return search, anew._replace(evidence=found.evidence, nearly=found.nearly, rival=found.rival)

    def finished(self, found: Description) -> Description:
        """The description with the noise that it leaves, whatever its colour."""
        point = self.points.in_colour(found.instances, found.numbers, found.state)
        look = self.points.looked(point, True)
        for _ in range(ROUNDS):
            if _ends(look.step, look.covariance):
                break
            numbers = point.numbers + look.step
            anew = zip(
                self.points.applied(point.instances, numbers, point.state), point.state.trials, strict=True
            )
            trials = tuple(t.in_noise(old.noise) for t, old in anew)
            new = self.points.in_colour(found.instances, numbers, point.state, trials)
            if not new.cost < point.cost:
                break
            point, look = new, self.points.looked(new, True)
        done = found._replace(
            state=point.state, numbers=point.numbers, covariance=look.covariance, dispersion=look.dispersion
        )
        return done._replace(sense=self.make_sense(done))

    def profiled(self, found: Description) -> Description:
        """The description with errors that follow the likelihood where it is no normal's."""
        if found.event:  # when it happened a log follows in steps
            return found
        point = Point(found.instances, found.numbers, found.state, np.nan)
        look = self.points.looked(point, True)
        wide = profiled(self.points, point, look, found.mirrored)
        return found._replace(
            covariance=found.covariance + wide.covariance - look.covariance,
            dispersion=found.dispersion + wide.dispersion - look.dispersion,
        )


def _coloured(point: Point, points: Points) -> float:
    """Log likelihood that it is worth that the noise of logs went through what is there, and has its
    colour, but for what the recorder adds: of rows r (n,) with the correlation C of either, each at its best
    level and of the best share s of the recorder's,

        n log(sum |r|^2/sum |L^-1 r|^2)/2 - log det L,    (1 - s) C + s = L L^T
    """
    gained = 0.0
    for x, part in zip(point.instances, points.parts(point.instances), strict=True):
        for i in x.where if x.effect.colour is not None else ():
            trial, n = point.state.trials[i], min(len(point.state.trials[i].log), LONG)
            left = trial.residual(trial.as_recorded(point.state.models[i]))[:n]
            alike = x.effect.colour(point.numbers[part], points.about, trial.spacing * np.arange(n))
            rows = np.stack([left.real, left.imag], axis=1)
            dof = freedom(trial) * n / len(trial.log)
            shares = ((1 - own) * toeplitz(alike) + own * np.eye(n) for own in OWN)
            gained += max(0.0, *(_worth(rows, alike, dof, trial.channels) for alike in shares))
    return gained


def _worth(rows: np.ndarray, alike: np.ndarray, dof: float, channels: int) -> float:
    """Log likelihood of rows (n, 2) with a correlation (n, n) over that of rows of their own."""
    factor = cholesky(alike, lower=True)
    own = solve_triangular(factor, rows, lower=True)
    ratio = float(np.sum(rows**2) / max(np.sum(own**2), 1e-300))
    volume = channels * float(np.sum(np.log(np.diag(factor))))
    return 0.5 * dof * float(np.log(max(ratio, 1e-300))) - volume


def _apart(a: State, b: State) -> bool:
    """Whether two plates differ by more than matters."""
    std = np.sqrt(np.diag(b.covariance))
    return bool(np.any(np.abs(a.theta - b.theta) > NEAR * std + np.finfo(float).eps))


def _likely(tried: Sequence[Group]) -> list[Group]:
    """Of these, the likeliest first: the first few, and the first of each effect."""
    each = list(dict.fromkeys(tried))
    first = {x[0].effect.name: x for x in reversed(each)}
    return [x for k, x in enumerate(each) if k < FOLLOWED or first[x[0].effect.name] is x]


def _ends(step: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether a step is none, or shorter than matters in any direction that the logs know of."""
    known = NEAR * np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding may leave less than nothing
    return not np.all(np.isfinite(step)) or bool(np.all(np.abs(step) <= known))
