"""Logs read with effects of given numbers: the minimum of all else there, and what is seen from it.

An effect's numbers u stand outside of the fit of the plant. At each u the log is read as with the effect, and
all else is fitted as ever. The Gauss-Newton step of plant and numbers together has the columns

    d model/d u = (model(u + h) - model(u - h)) / 2h

beside those of the plant (Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973, the other way round). Their
joint information gives the errors: what the numbers leave open of the plant is added to its covariance.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sysid.adoption.description import Instance
from sysid.effects.effect import About, Effect, Fitted, plain
from sysid.minimum.minimise import ESTIMATED, Minimiser, State
from sysid.model.theta import NAMES
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.linear import Linear
from sysid.verdict.linearised import LinearisedLog

LEVEL = Rounds(1, white=True)  # what is compared
APART = 0.05  # prior standard deviations, by which optima differ
NEAR = 0.05  # standard deviations, which matter to nothing
SETTLED = 8  # times that an effect follows the plate, each of which halves what is left at the least
TINY = 1e-12  # of a prior variance: a number that is as good as known
DIFFERENCE = 1e-4  # prior standard deviations: of a central difference, whose error is its square


@dataclass(frozen=True, eq=False)
class Point:
    """Numbers of effects, and the minimum of all else there; how far a step of the numbers is trusted, in
    prior standard deviations."""

    instances: tuple[Instance, ...]
    numbers: np.ndarray
    state: State
    cost: float
    trust: float = 1.0


class Looked(NamedTuple):
    """From a point: the step to the numbers' optimum, their covariance, what they leave open of the plant
    (6, 6), and what the step gains, to second order; by how much theta moves by itself (6,), and with the
    numbers (6, d); the slope (d,) of - cost by these."""

    step: np.ndarray
    covariance: np.ndarray
    dispersion: np.ndarray
    gain: float
    rest: np.ndarray
    along: np.ndarray
    score: np.ndarray

    def within(self, far: float, stds: np.ndarray) -> tuple[np.ndarray, float]:
        """The best step, to second order, none of whose numbers goes further than so many `stds`, and what it
        gains (Levenberg, Q. Appl. Math. 2, 164, 1944)."""
        spread, axes = np.linalg.eigh(self.covariance / np.outer(stds, stds))
        slope, held = axes.T @ (stds * self.score), 0.0
        while True:
            along = slope / (1 / np.maximum(spread, TINY) + held)
            away = np.where(self.step == 0, 0.0, axes @ along)
            if np.max(np.abs(away), initial=0.0) <= far:
                gained = along @ (slope - 0.5 * along / np.maximum(spread, TINY))
                return stds * away, self.gain + float(gained - 0.5 * slope @ (spread * slope))
            held = max(2 * held, 0.1 / float(np.max(spread)))


class Points:
    """Of logs at a minimum."""

    def __init__(self, minimiser: Minimiser, state: State, about: About):
        self.minimiser, self.alone, self.about = replace(minimiser, plain=True), its_own(state), about
        self.trials = tuple(plain(t, t.noise.std) for t in state.trials)
        self.looked = cache(self.look)  # a point is looked at where a search begins, ends and is weighed
        self.known = cache(self.beforehand)

    @cached_property
    def names(self) -> list[str]:
        """Of the plant's parameters that are fitted."""
        return [n for n in NAMES if n in self.minimiser.free]

    @cached_property
    def base(self) -> float:
        """Cost of the plant alone, as that of a description is counted."""
        return self.at((), np.zeros(0), self.alone).cost

    def at(
        self,
        instances: tuple[Instance, ...],
        numbers: np.ndarray,
        near: State,
        rounds: Rounds = LEVEL,
        theta: np.ndarray | None = None,
    ) -> Point:
        """With these effects, at the minimum near another, or on the way to it; `theta`: where it is
        foreseen."""
        state = self.refined(instances, numbers, near, rounds, theta)
        for _ in range(SETTLED if any(x.effect.settles for x in instances) else 0):
            near, state = state, self.refined(instances, numbers, state, rounds)
            if abs(state.likelihood - near.likelihood) < NEAR**2:
                break
        return Point(instances, numbers, state, self.cost(instances, numbers, state))

    def applied(
        self,
        instances: Sequence[Instance],
        numbers: np.ndarray,
        near: State,
        some: Collection[int] | None = None,
    ) -> tuple[Trial, ...]:
        """The logs, or `some` of them, read as with these effects, of a plate that moves as it does in a
        state near by."""
        some, read = range(len(self.trials)) if some is None else some, list(self.trials)
        for i in some:
            read[i] = read[i].with_bench(fed=near.trials[i].bench.fed)
            # a floor that a plate without them wanted below zero is theirs to find anew
            if not (read[i].floor_held or read[i].bench.floor_free):
                read[i] = read[i].with_bench(floor=near.trials[i].noise.std ** 2, floor_free=True)
        for instance, part in zip(instances, self.parts(instances), strict=True):
            for i in (i for i in instance.where if i in some):
                read[i] = instance.effect.applied(
                    read[i], numbers[part], self.about._replace(near=near.theta)
                )
        return tuple(read)

    def parts(self, instances: Sequence[Instance]) -> list[slice]:
        """Where each one's numbers stand."""
        ends = np.cumsum([0, *(len(self.known(x)) for x in instances)])
        return [slice(a, b) for a, b in pairwise(ends)]

    def beforehand(self, instance: Instance) -> np.ndarray:
        """Prior standard deviations of one's numbers."""
        return instance.effect.stds(self.trials[instance.where[0]], self.about)

    def stds(self, instances: Sequence[Instance]) -> np.ndarray:
        """The same of all."""
        return np.concatenate([np.zeros(0), *map(self.known, instances)])

    def steps(self, instances: Sequence[Instance]) -> np.ndarray:
        """(d,) of central differences by the numbers."""
        each = []
        for x in instances:
            trial = self.trials[x.where[0]]
            small = DIFFERENCE * x.effect.stds(trial, self.about)
            each.append(small if x.effect.steps is None else x.effect.steps(trial, self.about))
        return np.concatenate(each) if each else np.zeros(0)

    def onward(self, point: Point, step: np.ndarray, rounds: Rounds = LEVEL) -> Point:
        """The point after a step of the numbers, looked for where the plant is foreseen."""
        look, near = self.looked(point), point.state
        theta = self.minimiser.onward(near.theta, look.rest + look.along @ step)
        return self.at(point.instances, point.numbers + step, near, rounds, theta)

    def refined(
        self,
        instances: Sequence[Instance],
        numbers: np.ndarray,
        near: State,
        rounds: Rounds,
        theta: np.ndarray | None = None,
    ) -> State:
        """The minimum near another, with these effects and white noise of the levels there; in one round: so
        costs compare."""
        state = self.begun(instances, numbers, near, rounds, theta)
        return state if fed(near) else its_own(state)

    def begun(
        self,
        instances: Sequence[Instance],
        numbers: np.ndarray,
        near: State,
        rounds: Rounds,
        theta: np.ndarray | None = None,
    ) -> State:
        """The same where what is fed beside its plates is known."""
        read = zip(self.applied(instances, numbers, near), near.trials, strict=True)
        trials = tuple(with_noise(t, old.noise.std, 0.0) for t, old in read)
        return self.minimiser.refine(trials, near.theta if theta is None else theta, rounds, near.low_q)

    def anew(self, instances: Sequence[Instance], numbers: np.ndarray) -> State:
        """The best minimum that the logs, read with these effects, lead to by themselves."""
        return its_own(self.minimiser.roughly(self.applied(instances, numbers, self.alone))[0])

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
        state = state if fed(near) else its_own(state)
        return Point(instances, numbers, state, self.cost(instances, numbers, state))

    def cost(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> float:
        """- log likelihood of what was recorded and - log prior of the numbers."""
        known = 0.5 * float(np.sum((numbers / self.stds(instances)) ** 2))
        return known - state.likelihood - self.stretched(instances, numbers, state)

    def stretched(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> float:
        """The log of by how much these effects stretch what was recorded."""
        found = 0.0
        for x, part in zip(instances, self.parts(instances), strict=True):
            for i in x.where:
                trial, about = self.seen_from(state, i)
                found += x.effect.stretched(trial, numbers[part], about)
        return found

    def seen_from(self, state: State, i: int) -> tuple[Trial, About]:
        """A log as it was recorded, and what is known of it, from a plate and a bench near by."""
        return replace(self.trials[i], bench=state.trials[i].bench), self.about._replace(near=state.theta)

    def told(self, where: set[int], state: State) -> float:
        """The information of tau in a state over that in the plant alone, in the noise of its one log, a
        transient; 1 where settled points, or other logs, tell it as well."""
        others = any(t.steady or (t.driven and i not in where) for i, t in enumerate(self.trials))
        if others or len(where) > 1:
            return 1.0
        (i,) = where
        noise = [x.trials[i].noise.std for x in (state, self.alone)]
        return float((self.alone.covariance[1, 1] / noise[1] ** 2) / (state.covariance[1, 1] / noise[0] ** 2))

    def sensible(
        self, instances: Sequence[Instance], numbers: np.ndarray, covariance: np.ndarray, state: State
    ) -> bool:
        """Whether all numbers, with this covariance, are those of their effects."""
        driven = state.G * self.about.drive / self.about.top if "G" in self.names else 0.0
        own = max(1.0, driven)  # modes may take something away from one another
        beside = state.tau, self.about.tau, own
        each = zip(instances, self.parts(instances), strict=True)
        return all(
            x.effect.sensible(self.trials[i], Fitted(numbers[part], covariance[part, part], *beside))
            for x, part in each
            for i in x.where
        )

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
        # what stretches rows stretches their noise as well
        score += self.differences(lambda u: self.stretched(instances, u, state), instances, numbers)
        own = sum(x.T @ x for x in rows) + np.diag(stds**-2.0) - cross.T @ linear.inverse @ cross
        known, axes = np.linalg.eigh(own * np.outer(stds, stds))
        covariance = (axes / np.maximum(known, 1.0)) @ axes.T * np.outer(stds, stds)  # no less than the prior
        by = np.zeros((len(NAMES), len(numbers)))
        rest, index = np.zeros(len(NAMES)), [NAMES.index(n) for n in self.names]
        by[index], rest[index] = linear.inverse @ cross, linear.inverse @ linear.slope
        score = score - cross.T @ rest[index]
        gain = 0.5 * float(score @ covariance @ score + linear.slope @ rest[index])
        each = [_sloped(x.effect, len(self.known(x))) for x in instances]
        sloped = np.concatenate(each) if each else np.zeros(0)
        step, moved = sloped * (covariance @ score), by @ covariance @ by.T
        return Looked(step, covariance, moved, gain, rest, -by, score)

    def differences(
        self, found: Callable[[np.ndarray], float], instances: Sequence[Instance], numbers: np.ndarray
    ) -> np.ndarray:
        """(d,) central differences by the numbers."""
        away = np.diag(self.steps(instances))
        each = [(found(numbers + way) - found(numbers - way)) / (2 * np.sum(way)) for way in away]
        return np.array(each)

    def columns(
        self, instances: Sequence[Instance], numbers: np.ndarray, state: State, views: Sequence[LinearisedLog]
    ) -> list[np.ndarray]:
        """Of each log the derivatives of its rows by the numbers (n, d), off what its nuisances can make."""
        step = self.steps(instances)
        found = [np.zeros((len(v.r), len(numbers))) for v in views]
        for where, part in zip((x.where for x in instances), self.parts(instances), strict=True):
            for k in range(part.start, part.stop):
                away = step[k] * np.eye(len(numbers))[k]
                above, below = (self.applied(instances, numbers + x, state, where) for x in (away, -away))
                for i in where:
                    change = (views[i].modelled(above[i]) - views[i].modelled(below[i])) / (2 * step[k])
                    found[i][:, k] = views[i].off(change)
        return found


def _sloped(effect: Effect, count: int) -> np.ndarray:
    """(d,) whether steps lead to a number: a log follows those that hop in steps, but for the linear ones."""
    return np.array([effect.hop is None or k in effect.linear for k in range(count)])


def fed(state: State) -> bool:
    """Whether it is known what is fed beside its plates."""
    return any(np.any(t.bench.fed) for t in state.trials)


def its_own(state: State) -> State:
    """The same with all that its logs show taken for motions of their plates."""
    return replace(state, trials=tuple(t.with_bench(fed=0.0) for t in state.trials))
