"""The search for the numbers of effects beside a minimum.

An effect's numbers u stand outside of the fit of the plant. At each u the log is read as with the effect, and
all else is fitted as ever; u then goes along the Gauss-Newton step of plant and numbers together, with
columns

    d model/d u = (model(u + h) - model(u - h)) / 2h

beside those of the plant (Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973, the other way round). Their
joint information gives the errors: what the numbers leave open of the plant is added to its covariance.
Descriptions compare by the Laplace approximation of their evidence,

    log p(logs) = log likelihood - sum (u/s)^2 / 2 + log det(C_u/s^2) / 2 - log(effects that were tried)

with s the numbers' prior standard deviations and C_u their covariance, in white noise of one level.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from sysid.adoption.description import Description, Group, Instance
from sysid.effects.effect import About, plain
from sysid.minimum.minimise import ESTIMATED, Minimiser, State
from sysid.model.theta import NAMES
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial, freedom, with_noise
from sysid.verdict.linear import Linear
from sysid.verdict.linearised import LinearisedLog

NEARLY = 3.0  # log evidence within which another description may be true as well: odds of twenty to one
FOLLOWED = 4  # effects that are followed, and the best of each effect: each from
CLOSER = 3  # of its starts, at first for
FIRST = 2  # steps;
WITHIN = 30.0  # log likelihood of the best of all then, one step later, up to its optimum
STEPS = 15
HOPS = 8  # of numbers that a log follows in steps: most need two
LEVEL = Rounds(1, white=True)  # what is compared
# of them at a start of d and q, which are linear in what the bench adds: most take four steps
ROUGH = Rounds(1, steps=8, white=True)
SHARES = (1.0, 0.4, 0.1)  # of a step, of which the first that is better is taken
ROUNDS = 3  # of the numbers and the colour of the noise in turn
APART = 0.05  # prior standard deviations, by which optima differ
NEAR = 0.05  # standard deviations: a step that short ends the search
LONG = 512  # rows, which tell the colour of a log's noise well enough
NUGGET = 1e-6  # of the power of noise behind a filter: a recorder's own
DIFFERENCE = 1e-4  # prior standard deviations: of a central difference, whose error is its square


@dataclass(frozen=True, eq=False)
class Point:
    """Numbers of effects, and the minimum of all else there."""

    instances: tuple[Instance, ...]
    numbers: np.ndarray
    state: State
    cost: float


class Looked(NamedTuple):
    """From a point: the step to the numbers' optimum, their covariance, what they leave open of the plant
    (6, 6), and what the step gains, to second order."""

    step: np.ndarray
    covariance: np.ndarray
    dispersion: np.ndarray
    gain: float


class Search:
    """For the numbers of effects beside a minimum."""

    def __init__(self, minimiser: Minimiser, state: State, about: About):
        self.minimiser, self.alone = minimiser, _all_its_own(state)
        self.about = about
        self.trials = tuple(plain(t, t.noise.std) for t in state.trials)
        self.looked = cache(self.look)  # a point is looked at where a search begins, ends and is weighed

    @cached_property
    def names(self) -> list[str]:
        """Of the plant's parameters that are fitted."""
        return [n for n in NAMES if n in self.minimiser.free]

    @cached_property
    def base(self) -> float:
        """Cost of the plant alone, as that of a description is counted."""
        return self.at((), np.zeros(0), self.alone).cost

    def ends(self, before: Description | None, tried: Sequence[Group], count: int) -> list[Description]:
        """Where one more effect than those `before` leads to, of `count` that were tried, the likeliest
        first."""
        known = 0 if before is None else len(before.instances)
        starts = [p for x in tried for p in self.starts(before, x) if np.isfinite(self.hoped(p))]
        starts.sort(key=self.hoped)
        followed = []
        for group in _likely([p.instances[known:] for p in starts]):
            own = [p for p in starts if p.instances[known:] == group][:CLOSER]
            followed += self.distinct([self.followed(p, FIRST) for p in own], np.inf)
        followed = [p for p in followed if self.plausible(p)] or followed
        followed.sort(key=lambda p: p.cost)
        within = followed[0].cost + WITHIN if followed else np.inf
        hopeful = [min(p.cost, self.hoped(p)) < within for p in followed]
        optima = [
            self.by_its_motion(self.followed(p, STEPS)) if hope else p
            for p, hope in zip(followed, hopeful, strict=True)
        ]
        each = [
            self.distinct([p for p in optima if p.instances == x], NEARLY)
            for x in {p.instances for p in optima}
        ]
        return sorted((self.ended(p, count) for points in each for p in points), key=lambda d: -d.evidence)

    def starts(self, before: Description | None, group: Group) -> list[Point]:
        """Points at the starts of one more effect, the same in all logs that have it for themselves."""
        known = () if before is None else before.instances
        near, numbers = (self.alone, np.zeros(0)) if before is None else (before.state, before.numbers)
        where, found, every = {i for x in group for i in x.where}, [], (*known, *group)
        rounds = ROUGH if all(self.trials[k].signed for k in where) else LEVEL
        afresh = all(group[0].effect.afresh(self.trials[k]) for k in where)
        for start in zip(
            *(x.effect.starts(self.trials[x.where[0]], self.about) for x in group), strict=False
        ):
            u = np.concatenate([numbers, *start])
            found.append(self.hopped(self.at(every, u, self.anew(every, u) if afresh else near, rounds)))
        return found

    def hopped(self, point: Point) -> Point:
        """The point, its numbers that logs follow in steps where they had better be, seen from its plate."""
        for _ in range(HOPS):
            numbers = point.numbers.copy()
            for x, part in zip(point.instances, self.parts(point.instances), strict=True):
                if x.effect.hop is not None:
                    numbers[part] = x.effect.hop(*self.seen_from(point.state, x.where[0]))
            if np.array_equal(numbers, point.numbers):
                break
            there = self.at(point.instances, numbers, point.state)
            if there.cost >= point.cost - NEAR:
                break
            point = there
        return point

    def hoped(self, point: Point) -> float:
        """The cost after one more step from a point, to second order."""
        return point.cost - self.looked(point).gain

    def at(
        self, instances: tuple[Instance, ...], numbers: np.ndarray, near: State, rounds: Rounds = LEVEL
    ) -> Point:
        """With these effects, at the minimum near another, or on the way to it."""
        state = self.refined(instances, numbers, near, rounds)
        return Point(instances, numbers, state, self.cost(instances, numbers, state))

    def applied(self, instances: Sequence[Instance], numbers: np.ndarray, near: State) -> tuple[Trial, ...]:
        """The logs read as with these effects, of a plate that moves as it does in a state near by."""
        fed = [t.bench.fed for t in near.trials]
        read = [t.with_bench(fed=x) for t, x in zip(self.trials, fed, strict=True)]
        for instance, part in zip(instances, self.parts(instances), strict=True):
            for i in instance.where:
                read[i] = instance.effect.applied(read[i], numbers[part], self.about)
        return tuple(read)

    def parts(self, instances: Sequence[Instance]) -> list[slice]:
        """Where each one's numbers stand."""
        ends = np.cumsum([0, *(len(self.stds([x])) for x in instances)])
        return [slice(a, b) for a, b in pairwise(ends)]

    def stds(self, instances: Sequence[Instance]) -> np.ndarray:
        """Prior standard deviations of the numbers."""
        each = [x.effect.stds(self.trials[x.where[0]], self.about) for x in instances]
        return np.concatenate(each) if each else np.zeros(0)

    def refined(
        self, instances: Sequence[Instance], numbers: np.ndarray, near: State, rounds: Rounds
    ) -> State:
        """The minimum near another, with these effects and white noise of the levels there; in one round: so
        costs compare."""
        state = self._refined(instances, numbers, near, rounds)
        return state if _fed(near) else _all_its_own(state)

    def _refined(
        self, instances: Sequence[Instance], numbers: np.ndarray, near: State, rounds: Rounds
    ) -> State:
        read = zip(self.applied(instances, numbers, near), near.trials, strict=True)
        return self.minimiser.refine(
            tuple(with_noise(t, old.noise.std, 0.0) for t, old in read), near.theta, rounds
        )

    def anew(self, instances: Sequence[Instance], numbers: np.ndarray) -> State:
        """The best minimum that the logs, read with these effects, lead to by themselves."""
        return _all_its_own(self.minimiser.minima(self.applied(instances, numbers, self.alone))[0])

    def cost(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> float:
        """- log likelihood of what was recorded and - log prior of the numbers."""
        stretched = 0.0
        for x, part in zip(instances, self.parts(instances), strict=True):
            for i in x.where:
                trial, about = self.seen_from(state, i)
                stretched += x.effect.stretched(trial, numbers[part], about)
        return 0.5 * float(np.sum((numbers / self.stds(instances)) ** 2)) - state.likelihood - stretched

    def seen_from(self, state: State, i: int) -> tuple[Trial, About]:
        """A log as it was recorded, and what is known of it, from a plate and a bench near by."""
        return replace(self.trials[i], bench=state.trials[i].bench), self.about._replace(theta=state.theta)

    def followed(self, point: Point, most: int) -> Point:
        """Where `most` steps from a point, or fewer, lead."""
        for _ in range(most):
            look = self.looked(point)
            if _ends(look.step, look.covariance):
                break
            step = look.step / max(1.0, float(np.max(np.abs(look.step) / self.stds(point.instances))))
            there = (self.at(point.instances, point.numbers + share * step, point.state) for share in SHARES)
            better = next((p for p in there if p.cost < point.cost), None)
            if better is None:
                break
            gained, point = point.cost - better.cost, better
            if gained < NEAR**2:
                break
        return point

    def by_its_motion(self, point: Point) -> Point:
        """The optimum near another where what is fed beside a plate is no motion of it, if that is better. It
        is known only where the plate is nearly described: until then all that a log shows is its plate's."""
        if _fed(point.state):
            return point
        begun = self._refined(point.instances, point.numbers, point.state, LEVEL)
        there = self.followed(self.at(point.instances, point.numbers, begun), STEPS)
        return there if there.cost < point.cost - NEAR else point

    def distinct(self, points: Sequence[Point], within: float) -> list[Point]:
        """Of points of the same effects, the best first, each whose cost is `within` so much of the best,
        once."""
        kept: list[Point] = []
        for p in sorted(points, key=lambda p: p.cost):
            if kept and p.cost > kept[0].cost + within:
                break
            if all(self.differ(p, k) for k in kept):
                kept.append(p)
        return kept

    def differ(self, a: Point, b: Point) -> bool:
        """Whether points of the same effects differ by their numbers and by what they make of the logs: two
        modes may have changed places."""
        each = zip(a.state.trials, a.state.models, b.state.models, strict=True)
        models = any(np.max(np.abs(m - other)) > NEAR * t.noise.std for t, m, other in each)
        return models and bool(np.any(np.abs(a.numbers - b.numbers) > APART * self.stds(a.instances)))

    def look(self, point: Point, coloured: bool = False) -> Looked:
        """What is seen from a point. `coloured`: by the noise as it is found there, else as if it were
        white."""
        instances, numbers, state = point.instances, point.numbers, point.state
        views = LinearisedLog.each(state, self.minimiser.reference, coloured)
        linear, stds = Linear(views, state, self.names, 0.0), self.stds(instances)
        rows = self.columns(instances, numbers, state, views)
        cross = sum(j.T @ x for j, x in zip(linear.jacobians, rows, strict=True))
        score = sum(x.T @ v.r for x, v in zip(rows, views, strict=True)) - numbers / stds**2
        own = sum(x.T @ x for x in rows) + np.diag(stds**-2.0) - cross.T @ linear.inverse @ cross
        known, axes = np.linalg.eigh(own * np.outer(stds, stds))
        covariance = (axes / np.maximum(known, 1.0)) @ axes.T * np.outer(stds, stds)  # no less than the prior
        by = linear.inverse @ cross
        index = [NAMES.index(n) for n in self.names]
        dispersion = np.zeros((len(NAMES), len(NAMES)))
        dispersion[np.ix_(index, index)] = by @ covariance @ by.T
        score = score - by.T @ linear.slope
        gain = 0.5 * float(score @ covariance @ score)
        sloped = np.concatenate([[x.effect.hop is None] * len(self.stds([x])) for x in instances] or [[]])
        return Looked(sloped * (covariance @ score), covariance, dispersion, gain)

    def columns(
        self, instances: Sequence[Instance], numbers: np.ndarray, state: State, views: Sequence[LinearisedLog]
    ) -> list[np.ndarray]:
        """Of each log the derivatives of its rows by the numbers (n, d), off what its nuisances can make."""
        step = DIFFERENCE * self.stds(instances)
        found = [np.zeros((len(v.r), len(numbers))) for v in views]
        for instance, part in zip(instances, self.parts(instances), strict=True):
            for k in range(part.start, part.stop):
                away = step[k] * np.eye(len(numbers))[k]
                above, below = (self.applied(instances, numbers + way, state) for way in (away, -away))
                for i in instance.where:
                    change = (views[i].modelled(above[i]) - views[i].modelled(below[i])) / (2 * step[k])
                    found[i][:, k] = views[i].off(change)
        return found

    def ended(self, point: Point, count: int) -> Description:
        """The description at an optimum. Its evidence is that in white noise of one level, as that of the
        plant alone is: tails and colour make up for what a wrong description leaves."""
        _, covariance, dispersion, *_ = self.looked(point)
        stds, parts = self.stds(point.instances), self.parts(point.instances)
        volume = 0.5 * float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1])
        evidence = self.base - point.cost + volume - len(point.instances) * np.log(count)
        evidence = evidence + self.coloured(point) if np.isfinite(evidence) else -np.inf
        found = Description(
            point.instances,
            point.numbers,
            point.state,
            parts,
            covariance,
            dispersion,
            evidence,
            self.about,
            True,
        )
        return found._replace(sense=self.makes_sense(found))

    def coloured(self, point: Point) -> float:
        """Log likelihood that it is worth that the noise of logs went through what is there, and has its
        colour: of rows r (n,) with the correlation C, each at its best level,

            n log(sum |r|^2/sum |L^-1 r|^2)/2 - log det L,    C = L L^T
        """
        gained = 0.0
        for x, part in zip(point.instances, self.parts(point.instances), strict=True):
            for i in x.where if x.effect.colour is not None else ():
                trial, n = point.state.trials[i], min(len(point.state.trials[i].log), LONG)
                left = trial.residual(trial.as_recorded(point.state.models[i]))[:n]
                alike = x.effect.colour(point.numbers[part], self.about, trial.spacing * np.arange(n))
                factor = cholesky(toeplitz(alike) + NUGGET * np.eye(n), lower=True)
                rows = np.stack([left.real, left.imag], axis=1)
                own = solve_triangular(factor, rows, lower=True)
                ratio = float(np.sum(rows**2) / max(np.sum(own**2), 1e-300))
                volume = trial.channels * float(np.sum(np.log(np.diag(factor))))
                dof = freedom(trial) * n / len(trial.log)
                gained += max(0.5 * dof * float(np.log(max(ratio, 1e-300))) - volume, 0.0)
        return gained

    def stated(self, found: Description) -> tuple["Search", Description] | None:
        """The search and the description with the logs as they are read where their metadata state what was
        found, as of noise behind a filter, of which neighbouring rows hold the same; None where it states
        nothing."""
        read = list(self.alone.trials)
        for x, part in zip(found.instances, found.parts, strict=True):
            if x.effect.stated is not None:
                metadata = x.effect.stated(found.numbers[part], self.about)
                for i in x.where:
                    log, kind = read[i].log, read[i].kind
                    told = replace(log, bench={**metadata, **log.bench})  # what it states itself stays
                    read[i] = Trial.of(told, kind, read[i].nuisances)
        if all(len(t.log) == len(old.log) for t, old in zip(read, self.alone.trials, strict=True)):
            return None
        state = self.minimiser.refine(tuple(read), found.state.theta)
        search = Search(self.minimiser, state, self.about)
        point = search.followed(search.at(found.instances, found.numbers, state), STEPS)
        anew = search.finished(search.ended(point, 1))
        return search, anew._replace(evidence=found.evidence, nearly=found.nearly, rival=found.rival)

    def plausible(self, point: Point) -> bool:
        """Whether all numbers would be those of their effects if they were known exactly: two modes may have
        changed places."""
        each = zip(point.instances, self.parts(point.instances), strict=True)
        exact = 1e-300 * self.stds(point.instances)
        own = self.own(point.state)
        return all(x.effect.seen(point.numbers[p], exact[p], own) for x, p in each)

    def makes_sense(self, found: Description) -> bool:
        """Whether all numbers are those of their effects."""
        std, each = np.sqrt(np.diag(found.covariance)), zip(found.instances, found.parts, strict=True)
        return all(x.effect.seen(found.numbers[p], std[p], self.own(found.state)) for x, p in each)

    def own(self, state: State) -> float:
        """The largest response of a plate, of which modes may take something away, over that of the logs."""
        driven = state.G * self.about.drive / self.about.top if "G" in self.names else 0.0
        return max(1.0, driven)

    def in_colour(
        self,
        instances: tuple[Instance, ...],
        numbers: np.ndarray,
        near: State,
        trials: tuple[Trial, ...] = (),
    ) -> Point:
        """The minimum near another with the noise that is there, whatever its colour; its logs read as
        `trials`, or as there."""
        state = self.minimiser.refine(trials or near.trials, near.theta, ESTIMATED)
        state = state if _fed(near) else _all_its_own(state)
        return Point(instances, numbers, state, self.cost(instances, numbers, state))

    def finished(self, found: Description) -> Description:
        """The description with the noise that it leaves, whatever its colour."""
        point = self.in_colour(found.instances, found.numbers, found.state)
        step, covariance, dispersion, *_ = self.looked(point, True)
        for _ in range(ROUNDS):
            if _ends(step, covariance):
                break
            numbers = point.numbers + step
            anew = zip(self.applied(point.instances, numbers, point.state), point.state.trials, strict=True)
            trials = tuple(replace(t, noise=old.noise) for t, old in anew)
            new = self.in_colour(found.instances, numbers, point.state, trials)
            if not new.cost < point.cost:
                break
            point = new
            step, covariance, dispersion, *_ = self.looked(point, True)
        done = found._replace(
            state=point.state, numbers=point.numbers, covariance=covariance, dispersion=dispersion
        )
        return done._replace(sense=self.makes_sense(done))


def _fed(state: State) -> bool:
    """Whether it is known what is fed beside its plates."""
    return any(np.any(t.bench.fed) for t in state.trials)


def _all_its_own(state: State) -> State:
    """The same with all that its logs show taken for motions of their plates."""
    return replace(state, trials=tuple(t.with_bench(fed=0.0) for t in state.trials))


def _likely(tried: Sequence[Group]) -> list[Group]:
    """Of these, the likeliest first: the first few, and the first of each effect."""
    each = list(dict.fromkeys(tried))
    first = {x[0].effect.name: x for x in reversed(each)}
    return [x for k, x in enumerate(each) if k < FOLLOWED or first[x[0].effect.name] is x]


def _ends(step: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether a step is none, or shorter than matters in any direction that the logs know of."""
    known = NEAR * np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding may leave less than nothing
    return not np.all(np.isfinite(step)) or bool(np.all(np.abs(step) <= known))
