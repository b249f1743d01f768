"""Effects that logs call for, found and fitted: the loop

    minima --not described--> each effect, from each of its starts --> the best, with all its numbers -->
    described? --> adopted

An effect's numbers u stand outside of the fit of the plant. At each u the log is read as with the effect, and
all else is fitted as ever; u then goes along the Gauss-Newton step of plant and numbers together, with the
columns

    d model/d u = (model(u + h) - model(u - h)) / 2h

beside those of the plant (Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973, the other way round). Their
joint information gives the errors: what the numbers leave open of the plant is added to its covariance.
Descriptions compare by the Laplace approximation of their evidence,

    log p(logs) = log likelihood - sum (u/s)^2 / 2 + log det(C_u/s^2) / 2 - log(effects that were tried)

with s the numbers' prior standard deviations and C_u their covariance. One is adopted if it beats both the
plant alone and all that the first order found of other kinds, whose evidence is at most

    worth - freedom log(2 worth/freedom) / 2

as the prior of a number is no narrower than the number, and if what it leaves is noise of each row's own. The
best that is not adopted is still named where it explains most of what the plant leaves. What was tried in
full and explains nothing is refuted: the first order's name for it is no cause. """

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
from sysid.verdict.finding import Finding
from sysid.verdict.misfit import Found, Linear, misfits
from sysid.verdict.unexplained import SIGNIFICANT, is_coloured_noise, left_of, shared
from sysid.verdict.view import View

SURE = 3.0  # log evidence: odds of twenty to one
NEARLY = 3.0  # within which another description may be true as well, so that the error spans it
MOST = 2  # effects in one set of logs
CLOSER = 6  # starts of the most likely effects, that are followed,
FIRST = 2  # at first for so many steps, and
KEPT = 2  # of them to their optimum
FOLLOWED = 4  # effects that are followed
STEPS = 15
ROUNDS = 3  # of the numbers and the colour of the noise in turn
SHARES = (1.0, 0.4, 0.1)  # of a step, of which the first that is better is taken
LEFT = 0.05  # of the power that neighbouring rows share: what else there is may leave that much of a cause that is true
APART = 0.05  # prior standard deviations, by which optima differ
NEAR = 0.05  # standard deviations: a step that short ends the search
DIFFERENCE = 1e-4  # prior standard deviations: of a central difference, whose error is its square


@dataclass(frozen=True)
class Instance:
    """An effect in the logs `where`: in one, or in all that show it."""

    effect: Effect
    where: tuple[int, ...]


class Adopted(NamedTuple):
    """A description with effects: its state, their `numbers` one after another, each one's in its `parts`,
    and these numbers' covariance; what the plant's covariance (6, 6) grows by; its log evidence over that of
    the plant alone; what is known of the logs beforehand; whether its numbers are those of the effects; the
    names of others that are nearly as likely."""

    instances: tuple[Instance, ...]
    state: State
    numbers: np.ndarray
    parts: list[slice]
    covariance: np.ndarray
    dispersion: np.ndarray
    evidence: float
    about: About
    sense: bool
    nearly: tuple[str, ...] = ()

    @property
    def where(self) -> set[int]:
        """The logs that it is about."""
        return {i for x in self.instances for i in x.where}

    @property
    def white(self) -> bool:
        """Whether these are left with noise of each row's own, or that a filter behind it made: noise of
        longer memory may be what a wrong effect leaves."""
        return all(_white(self.state.trials[i], self.state.models[i]) for i in self.where)

    def explains(self, before: State) -> bool:
        """Whether it leaves little of what the plant alone leaves of these logs, or no more than chance."""
        for i in self.where:
            power, chance = shared(self.state.trials[i], self.state.models[i])
            if chance > SIGNIFICANT and power > LEFT * shared(before.trials[i], before.models[i])[0]:
                return False
        return True

    def findings(self, outcome: str, beside: str) -> tuple[Finding, ...]:
        """Each effect, in words and numbers; `beside`: what the words say between what there is and what to
        do."""
        found, stds = [], np.sqrt(np.diag(self.covariance))
        for x, part in zip(self.instances, self.parts, strict=True):
            names, first = tuple(self.state.trials[i].log.name for i in x.where), x.where[0]
            numbers = x.effect.numbers(self.numbers[part], stds[part], self.about)
            told = x.effect.said(self.state.trials[first], numbers)
            as_well = " or ".join(f"a {name.replace('_', ' ')}" for name in self.nearly)
            doubt = f" ({as_well} describes it nearly as well)" if as_well else ""
            sentence = f"{', '.join(names)}: {told.what}, {beside}{doubt}; {told.to_do}"
            found.append(Finding(x.effect.name, outcome, sentence, names, numbers, self.evidence))
        return tuple(found)


@dataclass(frozen=True)
class Outcome:
    """What became of the effects that were tried: a description that is adopted; one that is only `named`, as
    it explains most but not all; and which names, of the first order in which log, are `refuted`."""

    adopted: Adopted | None = None
    named: Adopted | None = None
    refuted: frozenset[tuple[str, int]] = field(default_factory=frozenset)


def tried(minimiser: Minimiser, state: State, found: Sequence[Found], names: Sequence[str]) -> Outcome:
    """The effects, of those called `names`, fitted to the logs of a minimum that the plant alone does not
    describe. `found`: what the logs hold to first order."""
    search, each = Search(minimiser, state), instances(state.trials, names)
    some = [x for x in each if _promises(x, found, misfitting(state, found))]
    before: tuple[Instance, ...] = ()
    numbers, named, here = np.zeros(0), None, some
    for _ in range(MOST):
        best = search.best(before, numbers, here, len(some)) if here else None
        if best is None:
            break
        others = (f for f in found if not (_may_be(f, best) or search.tried(f)))
        ahead = best.evidence > max([SURE, *map(_most_evidence, others)])
        left, _ = misfits(best.state, minimiser.reference, minimiser.free, None)
        wrong = misfitting(best.state, left)
        if ahead and best.white and best.state.converged and not wrong and not any(f.certain for f in left):
            rough = any(x.effect.rough for x in best.instances)
            return Outcome(None, best, search.refuted(best)) if rough else Outcome(best)
        named = best if not before and ahead and best.explains(state) else named
        before, numbers = best.instances, best.numbers
        here = [x for x in each if (x not in before or x.effect.many) and _promises(x, left, wrong)]
    return Outcome(None, named, search.refuted(named))


def instances(trials: Sequence[Trial], names: Sequence[str]) -> list[Instance]:
    """All that logs can show, but for those in coarse steps: rows of one value share their rounding error,
    which is no noise by which descriptions compare."""
    each: list[Instance] = []
    for effect in (e for e in EFFECTS if e.name in names):
        here = tuple(i for i, t in enumerate(trials) if t.noise.rounded is None and effect.shows(t))
        if effect.scope != "plate":
            each += [Instance(effect, (i,)) for i in here]
        if effect.scope == "plate":  # a transient would need what an effect of the plate does to its pole from row to row
            each += [Instance(effect, here)] if here and all(t.steady for t in trials) else []
        if effect.scope == "bench" and len(here) > 1:
            each.append(Instance(effect, here))
    return each


def misfitting(state: State, found: Sequence[Found]) -> set[int]:
    """The logs that show what the plant alone does not describe."""
    every = set(range(len(state.trials)))
    shown = [every if f.log is None else {f.log} for f in found if f.certain]
    return {i for i in every if not state.trials[i].silent and _left(state, i)}.union(*shown)


def _left(state: State, i: int) -> bool:
    left = left_of(state, i)
    return left is not None and not left.noise


def _promises(instance: Instance, found: Sequence[Found], wrong: set[int]) -> bool:
    """Whether the logs that it is about are not described, and the first order says nothing of one of them,
    or something that this may be."""
    told = [f for f in found if f.log is None or f.log in instance.where]
    return not wrong.isdisjoint(instance.where) and (not told or any(f.name in instance.effect.alike for f in told))


def _may_be(found: Found, best: Adopted) -> bool:
    """Whether what was found to first order may be this, or what this leaves in its own logs."""
    return any(found.name in x.effect.alike for x in best.instances)


def _most_evidence(found: Found) -> float:
    """An upper bound of the evidence of what was found to first order."""
    return found.worth - 0.5 * found.freedom * float(np.log(max(2 * found.worth / found.freedom, 1.0)))


class Search:
    """For the numbers of effects beside a minimum."""

    def __init__(self, minimiser: Minimiser, state: State):
        self.minimiser, self.alone = minimiser, state
        self.about = About.of(state, minimiser.reference)
        self.trials = tuple(plain(t, t.noise.std) for t in state.trials)
        self.ends: list[Adopted] = []  # of the effects that were tried by themselves

    @cached_property
    def names(self) -> list[str]:
        """Of the plant's parameters that are fitted."""
        return [n for n in NAMES if n in self.minimiser.free]

    @cached_property
    def base(self) -> float:
        """Cost of the plant alone, as that of a description is counted."""
        return self.cost((), np.zeros(0), self.refined((), np.zeros(0), self.alone))

    def refuted(self, named: Adopted | None) -> frozenset[tuple[str, int]]:
        """First order's names of effects that were tried by themselves and explain nothing."""
        told = [*self.ends] if named is None else [*self.ends, named]
        able = {(n, i) for a in told if a.evidence > 0 and a.explains(self.alone) for n, i in _names(a)}
        return frozenset({(n, i) for a in self.ends for n, i in _names(a)} - able)

    def tried(self, found: Found) -> bool:
        """Whether what was found to first order was tried in full."""
        return any(name == found.name and found.log in (None, i) for a in self.ends for name, i in _names(a))

    def best(self, before: tuple[Instance, ...], numbers: np.ndarray, tried: Sequence[Instance], count: int) -> Adopted | None:
        """The best description with one more effect than those `before`, of `count` that were tried; None
        where none gains."""
        rough: list[tuple[float, int, Instance, np.ndarray, State]] = []
        for instance in tried:
            i = instance.where[0]
            for start in instance.effect.starts(self.trials[i], self.about):
                u = np.append(numbers, start)
                near = self.anew((*before, instance), u) if instance.effect.afresh else self.alone
                state = self.refined((*before, instance), u, near)
                rough.append((self.cost((*before, instance), u, state), len(rough), instance, u, state))
        rough = [r for r in rough if np.isfinite(r[0])]
        rough.sort(key=lambda r: r[:2])
        ends = []
        for instance in _likely([r[2] for r in rough]):
            every = (*before, instance)
            starts = [r[3:] for r in rough if r[2] == instance][:CLOSER]
            first = sorted((self.followed(every, *s, FIRST) for s in starts), key=lambda end: self.cost(every, *end))
            optima = [self.followed(every, *s, STEPS) for s in self.distinct(every, first, np.inf)[:KEPT]]
            optima.sort(key=lambda end: self.cost(every, *end))
            ends += [self.ended(every, *end, count) for end in self.distinct(every, optima)]
        self.ends += [] if before else ends
        able = sorted((a for a in ends if a.sense and a.evidence >= SURE), key=lambda a: -a.evidence)
        done = next(((d, a) for a in able if (d := self.finished(a)).sense), None)
        if done is None:
            return None
        best, own = done
        alike = [self.finished(a) for a in ends if a is not own and a.evidence > best.evidence - NEARLY]
        others = (a.instances[-1].effect for a in alike)
        nearly = dict.fromkeys(e.name for e in others if e is not best.instances[-1].effect)
        return best._replace(dispersion=best.dispersion + _between(best, alike), nearly=tuple(nearly))

    def applied(self, instances: Sequence[Instance], numbers: np.ndarray) -> tuple[Trial, ...]:
        """The logs read as with these effects."""
        read = list(self.trials)
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

    def refined(self, instances: Sequence[Instance], numbers: np.ndarray, near: State) -> State:
        """The minimum near another, with these effects and white noise of the levels there; in one round: so
        costs compare."""
        read = zip(self.applied(instances, numbers), near.trials, strict=True)
        return self.minimiser.refine(tuple(with_noise(t, old.noise.std, 0.0) for t, old in read), near.theta, 1)

    def anew(self, instances: Sequence[Instance], numbers: np.ndarray) -> State:
        """The best minimum that the logs, read with these effects, lead to by themselves."""
        return self.minimiser.minima(self.applied(instances, numbers))[0]

    def cost(self, instances: Sequence[Instance], numbers: np.ndarray, state: State) -> float:
        """- log likelihood of what was recorded and - log prior of the numbers."""
        stretched = sum(
            x.effect.stretched(self.trials[i], numbers[part])
            for x, part in zip(instances, self.parts(instances), strict=True)
            for i in x.where
        )
        return 0.5 * float(np.sum((numbers / self.stds(instances)) ** 2)) - state.likelihood - stretched

    def followed(
        self, instances: Sequence[Instance], numbers: np.ndarray, state: State, most: int
    ) -> tuple[np.ndarray, State]:
        """Where `most` steps from these numbers, or fewer, lead."""
        cost = self.cost(instances, numbers, state)
        for _ in range(most):
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

    def distinct(
        self, instances: Sequence[Instance], ends: Sequence[tuple[np.ndarray, State]], within: float = NEARLY
    ) -> list[tuple[np.ndarray, State]]:
        """Of ends, the best first, each whose cost is `within` so much of the best one's, once."""
        kept: list[tuple[np.ndarray, State]] = []
        for numbers, state in ends:
            if kept and self.cost(instances, numbers, state) > self.cost(instances, *kept[0]) + within:
                break
            if all(np.any(np.abs(numbers - other) > APART * self.stds(instances)) for other, _ in kept):
                kept.append((numbers, state))
        return kept

    def looked(
        self, instances: Sequence[Instance], numbers: np.ndarray, state: State, coloured: bool = False
    ) -> tuple[np.ndarray, ...]:
        """At a minimum: the step to the numbers' optimum, their covariance, and what they leave open of the
        plant (6, 6). `coloured`: by the noise as it is found there, else as if it were white."""
        views = View.each(state, self.minimiser.reference, coloured)
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
        """(n,) the plate's part of a log read as `trial`, as the view has it, less what is recorded."""
        course = Course.of(trial, self.minimiser.reference, view.course.theta)
        start, late = view.beside
        plate = view.own * (course.forced + start * course.free + late * course.rate)
        plate = plate if trial.alongside is None else plate + trial.alongside
        return view.observed(plate[None])[0] - trial.log.response

    def ended(self, instances: tuple[Instance, ...], numbers: np.ndarray, state: State, count: int) -> Adopted:
        """The description at its optimum. Its evidence is that in white noise of one level, as that of the
        plant alone is: tails and colour make up for what a wrong description leaves."""
        _, covariance, dispersion = self.looked(instances, numbers, state)
        stds, parts = self.stds(instances), self.parts(instances)
        volume = 0.5 * float(np.linalg.slogdet(covariance / np.outer(stds, stds))[1]) - len(instances) * np.log(count)
        evidence = volume - self.cost(instances, numbers, state) + self.base
        evidence = evidence if np.isfinite(evidence) else -np.inf
        found = Adopted(instances, state, numbers, parts, covariance, dispersion, evidence, self.about, True)
        return found._replace(sense=self.makes_sense(found))

    def makes_sense(self, found: Adopted) -> bool:
        """Whether all numbers are those of their effects."""
        std, each = np.sqrt(np.diag(found.covariance)), zip(found.instances, found.parts, strict=True)
        return all(x.effect.makes_sense(found.numbers[p], std[p]) for x, p in each)

    def finished(self, found: Adopted) -> Adopted:
        """The description with the noise that it leaves, whatever its colour."""
        instances, numbers, state = found.instances, found.numbers, found.state
        state = self.minimiser.refine(state.trials, state.theta, known=1)
        for _ in range(ROUNDS):
            step, covariance, dispersion = self.looked(instances, numbers, state, True)
            if not np.all(np.isfinite(step)) or np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < NEAR:
                break
            numbers = numbers + step
            anew = zip(self.applied(instances, numbers), state.trials, strict=True)
            state = self.minimiser.refine(tuple(replace(t, noise=old.noise) for t, old in anew), state.theta, known=1)
        done = found._replace(state=state, numbers=numbers, covariance=covariance, dispersion=dispersion)
        return done._replace(sense=self.makes_sense(done))


def _likely(tried: Sequence[Instance]) -> list[Instance]:
    """Of instances, the likeliest first: the first of each effect, and the first few."""
    each = list(dict.fromkeys(tried))
    first = {x.effect.name: x for x in reversed(each)}
    return [x for k, x in enumerate(each) if k < FOLLOWED or first[x.effect.name] is x]


def _white(trial: Trial, model: np.ndarray) -> bool:
    if shared(trial, model)[1] < SIGNIFICANT:
        return True
    model = trial.as_recorded(model)
    return trial.smoothing[1] > 0 and is_coloured_noise(trial, trial.residual(model), model)


def _names(adopted: Adopted) -> set[tuple[str, int]]:
    """First order's names of a description's effects, in each of their logs."""
    return {(name, i) for x in adopted.instances for name in x.effect.known_as for i in x.where}


def _between(best: Adopted, alike: Sequence[Adopted]) -> np.ndarray:
    """(6, 6) what descriptions that are nearly as likely add to the covariance about the best, by their share
    of the evidence."""
    weights = np.exp([a.evidence - best.evidence for a in alike])
    found = np.zeros((len(NAMES), len(NAMES)))
    for weight, other in zip(weights, alike, strict=True):
        away = other.state.theta - best.state.theta
        found += weight / (1 + np.sum(weights)) * np.outer(away, away)
    return found
