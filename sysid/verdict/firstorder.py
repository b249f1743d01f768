"""What effects do to logs to first order: a `Term` for each place of their other numbers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.effects.effect import About, Effect, Fitted
from sysid.effects.number import Number
from sysid.effects.registry import EFFECTS
from sysid.trials.trial import Trial
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import UNNAMED, Term

STEP = 1e-4  # prior standard deviations: of a difference, whose error is in proportion to it
LEAST = 1e-9  # of a shape: less is rounding
EXACT = 1e-200  # of a variance, as of a number without an error
WITHIN = 2.0  # prior standard deviations; a larger number is of something else


def of_effects(
    views: Mapping[int, LinearisedLog], about: About, effects: Sequence[Effect] = EFFECTS
) -> Iterator[Term]:
    """All that these effects may be in the logs: in each for itself, in all that show them, or both."""
    for effect in effects:
        shown = {i: v for i, v in views.items() if effect.shows(v.trial)}
        groups = [] if effect.scope == "plate" else [{i: v} for i, v in shown.items()]
        if shown and (effect.scope == "plate" or (effect.scope == "bench" and len(shown) > 1)):
            groups.append(shown)
        for group in groups:
            yield from _terms(effect, group, next(iter(group)) if len(group) == 1 else None, about)


def hidden(views: Mapping[int, LinearisedLog], about: About) -> Iterator[Term]:
    """What logs hide that do not show it at any size, alike in all of them."""
    for effect in EFFECTS:
        some = {
            i: v for i, v in views.items() if not effect.shows(v.trial) and effect.shown_by(v.trial, about)
        }
        if some:
            yield from _terms(effect, some, None, about)


def _terms(
    effect: Effect, views: Mapping[int, LinearisedLog], log: int | None, about: About
) -> Iterator[Term]:
    """Of one effect in these logs, at all places. A coefficient is one of its `linear` numbers in prior
    standard deviations; where it has none, 1 is all that it does."""
    view = next(iter(views.values()))
    stds = effect.stds(view.trial, about)
    places = np.zeros((1, len(stds))) if effect.places is None else effect.places(view.trial, about)
    name = f"{view.trial.log.name}: " if len(views) == 1 else ""
    needs = [effect.shown_by(v.trial, about) for v in views.values()]
    for k, values in enumerate(places):
        shapes, shown = _shapes(effect, views, values, stds, about)
        if not shapes:
            continue
        place = Place(effect, view.trial, about, values, stds, _apart(places, values), shown, name)
        yield Term(
            effect.name,
            shapes,
            place.say,
            log,
            freedom=next(iter(shapes.values())).shape[1] + (len(places) > 1),
            shown_by=needs[0] if all(needs) else "",
            expected=effect.expected and all(_even(v) for v in views.values()),
            alike=not effect.many,
            sense=place.sense,
            source=(effect, k),
            numbers=place.numbers,
        )


def _even(view: LinearisedLog) -> bool:
    """Settled points in even noise, of which nothing but the plate leans a peak by as little as it does."""
    noise = view.trial.noise
    return view.trial.steady and not (noise.coloured or noise.share)


def _apart(places: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(d,) half of the way to the next place, of each number."""
    away = np.abs(places - place)
    nearest = np.min(np.where(away > 0, away, np.inf), axis=0, initial=np.inf)
    return np.where(np.isfinite(nearest), 0.5 * nearest, 0.0)


def _shapes(
    effect: Effect, views: Mapping[int, LinearisedLog], place: np.ndarray, stds: np.ndarray, about: About
) -> tuple[dict[int, np.ndarray], list[int]]:
    """Of each log (n, m), and which numbers they are of: those that do something."""
    numbers = [k for k in effect.linear if k < len(stds)]
    steps = [STEP * stds[k] * np.eye(len(place))[k] for k in numbers] or [0.0]
    over = STEP if numbers else 1.0
    found = {}
    for i, view in views.items():
        read = [effect.applied(view.ideal, place + step, about) for step in steps]
        if any(len(trial.log) != len(view.trial.log) for trial in read):
            return {}, []
        found[i] = np.stack([(view.modelled(t) - view.base) / over for t in read], axis=1)
    size = np.sqrt(sum(np.sum(np.abs(x) ** 2, axis=0) for x in found.values()))
    some = np.flatnonzero(size > LEAST * max(np.max(size), *(v.trial.scale for v in views.values())))
    if not len(some):
        return {}, []
    return {i: x[:, some] for i, x in found.items()}, [numbers[k] for k in some if numbers]


def _far(value: np.ndarray) -> bool:
    """Whether such coefficients are of something else, or beyond what is linear."""
    return max(map(abs, value.tolist())) > WITHIN


@dataclass(frozen=True)
class Place:
    """Numbers `values` (d,) of an effect of which those of `shown` are coefficients; `apart` (d,) is how well
    the others are known; sentences begin with `name`."""

    effect: Effect
    trial: Trial
    about: About
    values: np.ndarray
    stds: np.ndarray
    apart: np.ndarray
    shown: list[int]
    name: str

    def numbers(self, value: np.ndarray, std: np.ndarray) -> dict[str, Number]:
        """By coefficients and their standard deviations, in units of the bench."""
        return self.effect.numbers(
            self.trial, self._with(self.values, value), self._with(self.apart, std), self.about
        )

    def sense(self, value: np.ndarray) -> bool:
        """Whether such coefficients make sense, or are of something else."""
        if _far(value):
            return True
        numbers = self._with(self.values, value)
        fitted = Fitted(numbers, self._exact, self.about.tau, self.about.tau)
        sense = self.effect.sensible(self.trial, fitted) if self.shown else bool(value[0] > 0)
        return sense and not self.effect.noise_like(self.trial, numbers)

    def say(self, value: np.ndarray, std: np.ndarray) -> str | None:
        """The same in words; None where such numbers make no sense."""
        if not self.sense(value):
            return None
        if _far(value):
            return UNNAMED
        told = self.effect.said(self.trial, self.numbers(value, std))
        return f"{self.name}{told.what}; {told.to_do}"

    @cached_property
    def _exact(self) -> np.ndarray:
        """(d, d) covariance of numbers without errors."""
        return np.diag(EXACT * self.stds**2)

    def _with(self, all_of_it: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """(d,) with the numbers of the coefficients."""
        found = all_of_it.copy()
        found[self.shown] = shown[: len(self.shown)] * self.stds[self.shown]
        return found
