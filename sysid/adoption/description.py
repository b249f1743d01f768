"""A description of logs with effects: where they are, their numbers, what is left, and what to say of it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sysid.effects.effect import About, Effect
from sysid.minimum.minimise import State
from sysid.model.theta import std_of
from sysid.trials.trial import Trial
from sysid.verdict.finding import Finding
from sysid.verdict.unexplained import SIGNIFICANT, is_coloured_noise, shared

# of the power that neighbouring rows share, a tenth of its root, that may be left of a true cause
LEFT = 0.01
MUCH = 0.25  # of that power, which may be left by the only cause that there is
SURE = 3.0  # log evidence of an effect: odds of twenty to one
RIVAL = 0.25  # of the evidence, with which another effect is a cause as well


@dataclass(frozen=True)
class Instance:
    """An effect in the logs `where`: in one, or in all that show it."""

    effect: Effect
    where: tuple[int, ...]


# One effect as it is tried: in one log, in all of them alike, or in each by numbers of its own.
Group = tuple[Instance, ...]


class Description(NamedTuple):
    """A description with effects: their `numbers` one after another, its state, each one's in its `parts`,
    and these numbers' covariance; what the plant's covariance (6, 6) grows by; its log evidence over that of
    the plant alone; what is known of the logs beforehand; whether its numbers are those of the effects; the
    names of others that are nearly as likely, whether the law of one of them, or of its own, is not known
    well, the evidence of the likeliest other, and of which numbers the sign is not known."""

    instances: tuple[Instance, ...]
    numbers: np.ndarray
    state: State
    parts: list[slice]
    covariance: np.ndarray
    dispersion: np.ndarray
    evidence: float
    about: About
    sense: bool
    nearly: tuple[str, ...] = ()
    rough: bool = False
    rival: float = -np.inf
    mirrored: frozenset[int] = frozenset()

    @property
    def where(self) -> set[int]:
        """The logs that it is about."""
        return {i for x in self.instances for i in x.where}

    @property
    def event(self) -> bool:
        """Whether it is about what happened to a log for a while."""
        return any(x.effect.hop is not None for x in self.instances)

    @property
    def vague(self) -> bool:
        """Whether with such numbers one of its effects may look like anything."""
        each, trials = zip(self.instances, self.parts, strict=True), self.state.trials
        return any(x.effect.vague(trials[i], self.numbers[part]) for x, part in each for i in x.where)

    @property
    def white(self) -> bool:
        """Whether these are left with noise of each row's own, or that a filter behind it made: noise of
        longer memory may be what a wrong effect leaves."""
        return not self.smooth

    @property
    def smooth(self) -> set[int]:
        """The logs of these that it leaves with more than that."""
        return {i for i in self.where if not _white(self.state.trials[i], self.state.models[i])}

    def explains(self, before: State, left: float = LEFT) -> bool:
        """Whether it leaves that share of what the plant alone leaves of these logs, or no more than
        chance."""
        for i in self.where:
            power, chance = shared(self.state.trials[i], self.state.models[i])
            if chance > SIGNIFICANT and power > left * shared(before.trials[i], before.models[i])[0]:
                return False
        return True

    def takes(self, before: State) -> float:
        """The share that it takes of what the plant alone leaves of its logs together, each in its noise."""
        left, was = 0.0, 0.0
        for i in self.where:
            alone = before.trials[i], before.models[i]
            own = self.state.trials[i], self.state.models[i]
            left += shared(*own)[0] / alone[0].noise.std ** 2
            was += shared(*alone)[0] / alone[0].noise.std ** 2
        return 1 - left / was if was > 0 else 1.0

    def most(self, before: State) -> bool:
        """Whether it takes most of what the plant alone leaves, and no other effect does."""
        return self.rival < RIVAL * self.evidence and self.explains(before, MUCH)

    def findings(self, outcome: str, beside: str) -> tuple[Finding, ...]:
        """Each effect, in words and numbers; `beside`: what the words say between what there is and what to
        do."""
        found, stds = [], np.sqrt(np.diag(self.covariance))
        fitted, moved = (
            std_of(self.state.spread, "tau"),
            float((self.state.theta - self.about.theta)[2]),
        )
        about = self.about._replace(fitted=(self.state.tau, fitted), moved=moved)
        for x, part in zip(self.instances, self.parts, strict=True):
            names, first = tuple(self.state.trials[i].log.name for i in x.where), x.where[0]
            trial = self.state.trials[first]
            numbers = x.effect.numbers(trial, self.numbers[part], stds[part], about)
            told = x.effect.said(trial, numbers)
            as_well = " or ".join(with_article(name) for name in self.nearly)
            doubt = f" ({as_well} describes it nearly as well)" if as_well else ""
            another = x.effect.another
            so = "so that it has no G and tau of first order" if another else beside
            sentence = f"{', '.join(names)}: {told.what}, {so}{doubt}; {told.to_do}"
            found.append(
                Finding(x.effect.name, outcome, sentence, names, numbers, self.evidence, mostly=another)
            )
        return tuple(found)

    def names(self) -> set[tuple[str, int]]:
        """First order's names of its effects, in each of their logs."""
        return {
            (name, i) for x in self.instances for name in (x.effect.name, *x.effect.known_as) for i in x.where
        }


def with_article(name: str) -> str:
    """The name of an effect in a sentence: an image, a second mode."""
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name.replace('_', ' ')}"


def _white(trial: Trial, model: np.ndarray) -> bool:
    if shared(trial, model)[1] < SIGNIFICANT:
        return True
    model = trial.as_recorded(model)
    return trial.smoothing[1] > 0 and is_coloured_noise(trial, trial.residual(model), model)
