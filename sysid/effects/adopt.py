"""Effects that logs call for, found and fitted: the loop

    minima --not described--> each effect, from each of its starts --> the best, with all its numbers --> described? --> adopted

An effect's numbers u stand outside of the fit of the plant. At each u the log is read as with the effect, and all else is
fitted as ever; u then goes along the Gauss-Newton step of plant and numbers together, with the columns

    d model/d u = (model(u + h) - model(u - h)) / 2h

beside those of the plant (Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973, the other way round). Their joint information
gives the errors: what the numbers leave open of the plant is added to its covariance. Descriptions compare by the Laplace
approximation of their evidence,

    log p(logs) = log likelihood - sum (u/s)^2 / 2 + log det(C_u/s^2) / 2 - log(effects that were tried)

with s the numbers' prior standard deviations and C_u their covariance. One is adopted if it beats both the plant alone and all
that was found of other kinds, and if what it leaves is noise of each row's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sysid.effects.effect import About, Effect, plain
from sysid.effects.registry import EFFECTS
from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import NAMES
from sysid.trials.perturbed import Course
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.misfit import Found, Linear, described
from sysid.verdict.unexplained import SIGNIFICANT, left_of, shared
from sysid.verdict.view import View

SURE = 3.0  # log evidence: odds of twenty to one
NEARLY = 3.0  # within which another description may be true as well, so that the error spans it
MOST = 2  # effects in one set of logs
CLOSER = 6  # starts of the most likely effects, that are followed to their optimum
FOLLOWED = 4  # effects that are followed
STEPS = 15
SHARES = (1.0, 0.4, 0.1)  # of a step, of which the first that is better is taken
APART = 0.05  # prior standard deviations, by which optima differ
NEAR = 0.05  # standard deviations: a step that short ends the search
DIFFERENCE = 1e-4  # prior standard deviations: of a central difference, whose error is its square


@dataclass(frozen=True)
class Instance:
    """An effect in the logs `where`: in one, or in all that show it where it is the plate's."""

    effect: Effect
    where: tuple[int, ...]


class Adopted(NamedTuple):
    """A description with effects: its state, their `numbers` one after another, each one's in its `parts`, and these numbers'
    covariance; what the plant's covariance (6, 6) grows by; and its log evidence over that of the plant alone."""

    instances: tuple[Instance, ...]
    state: State
    numbers: np.ndarray
    parts: list[slice]
    covariance: np.ndarray
    dispersion: np.ndarray
    evidence: float

    @property
    def white(self) -> bool:
        """Whether the logs that it is about are left with noise of each row's own: noise of long memory may be what a wrong
        effect leaves."""
        where = {i for x in self.instances for i in x.where}
        return all(shared(self.state.trials[i], self.state.models[i])[1] < SIGNIFICANT for i in where)

    def said(self) -> list[str]:
        """A sentence for each effect."""
        found, stds = [], np.sqrt(np.diag(self.covariance))
        for instance, part in zip(self.instances, self.parts, strict=True):
            names = ", ".join(self.state.trials[i].log.name for i in instance.where)
            said = instance.effect.said(self.state.trials[instance.where[0]], self.numbers[part], stds[part])
            found.append(f"{names}: {said}")
        return found


def adopted(minimiser: Minimiser, state: State, found: Sequence[Found], names: Sequence[str]) -> Adopted | None:
    """The effects, of those called `names`, that describe the logs of a minimum which the plant alone does not; None where none
    do. `found`: what the logs hold to first order."""
    search = Search(minimiser, state)
    wrong = misfitting(state, found)
    tried = [x for x in instances(state.trials, names) if _promises(x, found, wrong)]
    if not tried:
        return None
    before: tuple[Instance, ...] = ()
    numbers = np.zeros(0)
    for _ in range(MOST):
        best = search.best(before, numbers, [x for x in tried if x not in before], len(tried))
        if best is None:
            return None
        other = [f.worth for f in found if not any(f.name in x.effect.alike for x in best.instances)]
        if best.evidence > max([0.0, *other]) and best.white and described(minimiser, best.state):
            return best
        before, numbers = best.instances, best.numbers
    return None


def instances(trials: Sequence[Trial], names: Sequence[str]) -> list[Instance]:
    """All that logs can show."""
    each = []
    for effect in (e for e in EFFECTS if e.name in names):
        here = tuple(i for i, t in enumerate(trials) if effect.shows(t))
        if effect.plate:  # a transient would need what an effect of the plate does to its pole from row to row
            each += [Instance(effect, here)] if here and all(t.steady for t in trials) else []
        else:
            each += [Instance(effect, (i,)) for i in here]
    return each


def misfitting(state: State, found: Sequence[Found]) -> set[int]:
    """The logs that show what the plant alone does not describe."""
    left = {i for i, t in enumerate(state.trials) if not t.silent and (x := left_of(state, i)) is not None and not x.noise}
    return left | {f.log for f in found if f.log is not None and f.certain}


def _promises(instance: Instance, found: Sequence[Found], wrong: set[int]) -> bool:
    """Whether a log that it is about is not described, and the first order says nothing of it, or something that this may be."""
    told = [f for f in found if f.log is None or f.log in instance.where]
    return not wrong.isdisjoint(instance.where) and (not told or any(f.name in instance.effect.alike for f in told))


class Search:
    """For the numbers of effects beside a minimum."""

    def __init__(self, minimiser: Minimiser, state: State):
        self.minimiser, self.alone = minimiser, state
        self.about = [About.of(state, minimiser.reference, i) for i in range(len(state.trials))]
        self.trials = tuple(plain(t, t.noise.std) for t in state.trials)

    @cached_property
    def names(self) -> list[str]:
        """Of the plant's parameters that are fitted."""
        return [n for n in NAMES if n in self.minimiser.free]

    def best(self, before: tuple[Instance, ...], numbers: np.ndarray, tried: Sequence[Instance], count: int) -> Adopted | None:
        """The best description with one more effect than those `before`, of `count` that were tried; None where none gains."""
        rough: list[tuple[float, int, Instance, np.ndarray, State]] = []
        for instance in tried:
            i = instance.where[0]
            for start in instance.effect.starts(self.trials[i], self.about[i]):
                u = np.append(numbers, start)
                state = self.refined((*before, instance), u, self.alone)
                rough.append((self.cost((*before, instance), u, state), len(rough), instance, u, state))
        rough = [r for r in rough if np.isfinite(r[0])]
        rough.sort(key=lambda r: r[:2])
        likely = list(dict.fromkeys(r[2] for r in rough))[:FOLLOWED]
        ends = []
        for instance in likely:
            every = (*before, instance)
            starts = [r for r in rough if r[2] == instance][:CLOSER]
            descents = sorted((self.followed(every, u, state) for *_, u, state in starts), key=lambda end: self.cost(every, *end))
            ends += [self.ended(every, *end, count) for end in self.distinct(every, descents)]
        if not ends:
            return None
        best = max(ends, key=lambda a: a.evidence)
        if best.evidence < SURE:
            return None
        alike = [a for a in ends if a is not best and a.evidence > best.evidence - NEARLY]
        return best._replace(dispersion=best.dispersion + _between(best, alike))

    def applied(self, instances: Sequence[Instance], numbers: np.ndarray) -> tuple[Trial, ...]:
        """The logs read as with these effects."""
        read = list(self.trials)
        for instance, part in zip(instances, self.parts(instances), strict=True):
            for i in instance.where:
                read[i] = instance.effect.applied(read[i], numbers[part], self.about[i])
        return tuple(read)

    def parts(self, instances: Sequence[Instance]) -> list[slice]:
        """Where each one's numbers stand."""
        ends = np.cumsum([0, *(len(self.stds([x])) for x in instances)])
        return [slice(a, b) for a, b in pairwise(ends)]

    def stds(self, instances: Sequence[Instance]) -> np.ndarray:
        """Prior standard deviations of the numbers."""
        each = [x.effect.stds(self.trials[x.where[0]], self.about[x.where[0]]) for x in instances]
        return np.concatenate(each) if each else np.zeros(0)

    def refined(self, instances: Sequence[Instance], numbers: np.ndarray, near: State) -> State:
        """The minimum near another, with these effects and white noise of the levels there; in one round: so costs compare."""
        read = zip(self.applied(instances, numbers), near.trials, strict=True)
        return self.minimiser.refine(tuple(with_noise(t, old.noise.std, 0.0) for t, old in read), near.theta, 1)

    def cost(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> float:
        """- log likelihood and - log prior of the numbers."""
        return 0.5 * float(np.sum((numbers / self.stds(instances)) ** 2)) - state.likelihood

    def followed(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> tuple[np.ndarray, State]:
        """The optimum that steps from these numbers lead to."""
        cost = self.cost(instances, numbers, state)
        for _ in range(STEPS):
            step, covariance, _ = self.looked(instances, numbers, state)
            if not np.all(np.isfinite(step)) or np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < NEAR:
                break
            step = step / max(1.0, float(np.max(np.abs(step) / self.stds(instances))))
            for share in SHARES:
                new = numbers + share * step
                there = self.refined(instances, new, state)
                if (after := self.cost(instances, new, there)) < cost:
                    break
            else:
                break
            gained, cost, numbers, state = cost - after, after, new, there
            if gained < NEAR**2:
                break
        return numbers, state

    def distinct(self, instances: Sequence[Instance], ends: Sequence[tuple[np.ndarray, State]]) -> list[tuple[np.ndarray, State]]:
        """Of optima, the best first, each that is nearly as good, once."""
        kept: list[tuple[np.ndarray, State]] = []
        for numbers, state in ends:
            if kept and self.cost(instances, numbers, state) > self.cost(instances, *kept[0]) + NEARLY:
                break
            if all(np.any(np.abs(numbers - other) > APART * self.stds(instances)) for other, _ in kept):
                kept.append((numbers, state))
        return kept

    def looked(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> tuple[np.ndarray, ...]:
        """At a minimum: the step to the numbers' optimum, their covariance, and what they leave open of the plant (6, 6)."""
        views = View.each(state, self.minimiser.reference)
        linear, stds = Linear(views, state, self.names, 0.0), self.stds(instances)
        rows = self.columns(instances, numbers, state, views)
        cross = sum(j.T @ x for j, x in zip(linear.jacobians, rows, strict=True))
        score = sum(x.T @ v.r for x, v in zip(rows, views, strict=True)) - numbers / stds**2
        own = sum(x.T @ x for x in rows) + np.diag(stds**-2.0) - cross.T @ linear.inverse @ cross
        covariance = np.linalg.pinv(own / np.outer(1 / stds, 1 / stds), rcond=1e-12, hermitian=True) * np.outer(stds, stds)
        by = linear.inverse @ cross
        index = [NAMES.index(n) for n in self.names]
        dispersion = np.zeros((len(NAMES), len(NAMES)))
        dispersion[np.ix_(index, index)] = by @ covariance @ by.T
        return covariance @ (score - by.T @ linear.slope), covariance, dispersion

    def columns(
        self, instances: Sequence[Instance], numbers: np.ndarray, state: State, views: Sequence[View]
    ) -> list[np.ndarray]:
        """Of each log the derivatives of its rows by the numbers (n, d), off what its nuisances can make."""
        step = DIFFERENCE * self.stds(instances)
        found = [np.zeros((len(v.r), len(numbers))) for v in views]
        for instance, part in zip(instances, self.parts(instances), strict=True):
            for k in range(part.start, part.stop):
                away = step[k] * np.eye(len(numbers))[k]
                above, below = (self.applied(instances, numbers + way) for way in (away, -away))
                for i in instance.where:
                    change = (self.modelled(above[i], views[i]) - self.modelled(below[i], views[i])) / (2 * step[k])
                    found[i][:, k] = views[i].off(change)
        return found

    def modelled(self, trial: Trial, view: View) -> np.ndarray:
        """(n,) the plate's part of a log read as `trial`, as the view has it."""
        course = Course.of(trial, self.minimiser.reference, view.course.theta)
        start, late = view.beside
        plate = view.own * (course.forced + start * course.free + late * course.rate)
        plate = plate if trial.alongside is None else plate + trial.alongside
        return view.observed(plate[None])[0]

    def ended(self, instances: tuple[Instance, ...], numbers: np.ndarray, state: State, count: int) -> Adopted:
        """The description at its optimum, with the noise that it leaves."""
        state = self.minimiser.refine(state.trials, state.theta, known=1)
        _, covariance, dispersion = self.looked(instances, numbers, state)
        stds = self.stds(instances)
        volume = 0.5 * float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1]) - len(instances) * np.log(count)
        evidence = volume - self.cost(instances, numbers, state) - self.alone.likelihood
        std, parts = np.sqrt(np.diag(covariance)), self.parts(instances)
        sense = all(x.effect.makes_sense(numbers[p], std[p]) for x, p in zip(instances, parts, strict=True))
        evidence = evidence if sense and np.isfinite(evidence) else -np.inf
        return Adopted(instances, state, numbers, parts, covariance, dispersion, evidence)


def _between(best: Adopted, alike: Sequence[Adopted]) -> np.ndarray:
    """(6, 6) what descriptions that are nearly as likely add to the covariance about the best, by their share of the evidence."""
    weights = np.exp([a.evidence - best.evidence for a in alike])
    found = np.zeros((len(NAMES), len(NAMES)))
    for weight, other in zip(weights, alike, strict=True):
        away = other.state.theta - best.state.theta
        found += weight / (1 + np.sum(weights)) * np.outer(away, away)
    return found
