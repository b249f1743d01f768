"""Effects that logs allow and do not show: the errors are averaged over them.

What a log holds to first order it shows by numbers x (r,) of unit variance, and an effect of a usual size
(`linear.USUAL`) would add numbers of variances q. Its evidence over that of its absence, and its numbers if
it is there, are

    log B = sum(k x^2 - log(1 + q))/2,    k x +- sqrt(k),    k = q/(1 + q)

Of K effects that are tried, n alike at other places, each is as likely beforehand as all its places together:

    p = o/(1 + sum of all o),    o = (B - 1)/(K n), or 0

If it moves theta by D x, it adds p D (diag(k) + k x x^T k) D^T to its covariance. The estimate stays what it
was. Two kinds are left out: effects that the logs speak against (B < 1; the 1 that is taken off B makes the
errors steady there), so that errors of logs which show nothing are what they are without; and those that
logs would not show if they were of a usual size, which are an assumption of every fit to such logs. What a
log would have for itself if it contradicts the others is `differing`'s.

Hoeting, Madigan, Raftery & Volinsky, Bayesian model averaging: a tutorial, Statistical Science 14, 382
(1999).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sysid.model.theta import NAMES
from sysid.verdict.finding import Finding
from sysid.verdict.linear import Linear, Scored
from sysid.verdict.term import Term
from sysid.verdict.view import View

SHOWS = 5.0  # standard deviations, by which logs would show an effect of a usual size
WIDER = 1.5  # times an error, from which it is said what it spans
MOST = 100.0  # of log evidence: more is as certain
SPANS = "the error of {} spans it, and is {:.2g} times what it is without"
OMITS = (
    "the error of {} does not include it, as tau or G would then not be determined; another log would tell"
)


class Hint(NamedTuple):
    """An effect that may be there, in words, and how likely; the error that grows most by it, and how many
    times; what it would move."""

    key: str
    logs: tuple[str, ...]
    what: str
    share: float
    parameter: str
    wider: float
    evidence: float
    moves: dict[str, float]

    def told(self, spanned: bool) -> Finding:
        """As a finding; `spanned`: the errors include it."""
        about = (SPANS if spanned else OMITS).format(self.parameter, self.wider)
        sentence = f"{self.what} ({100 * self.share:.2g} % likely; {about})"
        outcome = "widened" if spanned else "noted"
        return Finding(self.key, outcome, sentence, self.logs, evidence=self.evidence, moves=self.moves)


class Average(NamedTuple):
    """What effects add to the covariance of theta (6, 6); the one that adds most, where that is much."""

    covariance: np.ndarray
    hint: Hint | None = None

    @classmethod
    def none(cls) -> "Average":
        """Where there is nothing to average over."""
        return cls(np.zeros((len(NAMES), len(NAMES))))


class Allowed(NamedTuple):
    """An effect that logs allow, and its test."""

    term: Term
    scored: Scored

    def louder(self, power: float) -> "Allowed":
        """In noise of so many times the power."""
        return self._replace(scored=self.scored._replace(usual=self.scored.usual / power))

    def evidence(self, numbers: np.ndarray) -> np.ndarray:
        """log B by numbers (..., r)."""
        usual = self.scored.usual
        return 0.5 * np.sum(usual / (1 + usual) * numbers**2 - np.log1p(usual), axis=-1)

    def mean(self, numbers: np.ndarray) -> np.ndarray:
        """(r,) of its numbers if it is there."""
        return self.scored.usual / (1 + self.scored.usual) * numbers

    def spans(self, shifts: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """(p, p) the second moment of what moves by `shifts` (p, r) if it is there."""
        moved = shifts @ self.mean(numbers)
        return np.outer(moved, moved) + (shifts * self.mean(np.ones(shifts.shape[1]))) @ shifts.T

    def say(self, numbers: np.ndarray) -> str | None:
        """Its sentence; None where such numbers make no sense."""
        return self.term.say(self.scored.values @ self.mean(numbers), self.scored.errors)

    def sensible(self, numbers: np.ndarray) -> bool:
        """Whether such numbers make sense."""
        if self.term.sense is None:
            return self.say(numbers) is not None
        return self.term.sense(self.scored.values @ self.mean(numbers))


Kind = tuple[str, int | None]  # of effects: their name, and the log that they are in


def spanned(term: Term, scored: Scored, power: float = 1.0) -> bool:
    """Whether errors span a tested term in noise of so many times the power: logs would show it if it were of
    a usual size, in whatever direction of its numbers."""
    return not (term.between or term.parts) and bool(np.min(scored.usual) > power * SHOWS**2)


class Together(NamedTuple):
    """Effects that logs allow, their numbers side by side, each one's from `begins` on."""

    each: Sequence[Allowed]
    begins: np.ndarray
    usual: np.ndarray  # (q,) variances
    kinds: Sequence[Kind]  # (n,) all that there are
    alike: np.ndarray  # (n, K) which effects are of each kind

    @classmethod
    def of(cls, each: Sequence[Allowed]) -> "Together":
        """Of these effects, at least one."""
        usual = [x.scored.usual for x in each]
        begins = np.cumsum([0, *map(len, usual[:-1])])
        of_each = [(x.term.name, x.term.log) for x in each]
        kinds = list(dict.fromkeys(of_each))
        alike = np.array([[float(one == kind) for one in of_each] for kind in kinds])
        return cls(each, begins, np.concatenate(usual), kinds, alike)

    def own(self, numbers: np.ndarray, k: int) -> np.ndarray:
        """(r,) those of the k-th effect."""
        return numbers[self.begins[k] :][: len(self.each[k].scored.usual)]

    def there(self, power: np.ndarray, here: np.ndarray | bool = True) -> np.ndarray:
        """(K, P) which effects logs would show in noise of `power` (P, q) over that of the tests; `here`
        (K, P): which there may be."""
        return (np.minimum.reduceat(self.usual / power, self.begins, axis=1).T > SHOWS**2) & here

    def _before(self, there: np.ndarray, others: Mapping[Kind, int]) -> np.ndarray:
        """(K, P) how likely each is beforehand over the chance of none."""
        counts = self.alike @ there
        for k, kind in enumerate(self.kinds):
            if kind in others:
                counts[k] = np.maximum(counts[k], others[kind])
        kinds = np.sum(counts > 0, axis=0) + len({*others} - {*self.kinds})
        return 1 / np.maximum(kinds * (self.alike.T @ counts), 1)

    def likely(
        self,
        numbers: np.ndarray,
        power: np.ndarray,
        here: np.ndarray | bool = True,
        others: Mapping[Kind, int] | None = None,
    ) -> np.ndarray:
        """(K, P) how likely each effect is by the numbers (P, q) of as many plates; 0 where the logs speak
        against it. `power` and `here` as `there` has them. `others`: how many of a kind there are, where
        those at hand are not all."""
        usual = self.usual / power
        shown = usual / (1 + usual) * numbers**2 - np.log1p(usual)
        found = 0.5 * np.add.reduceat(shown, self.begins, axis=1).T
        there, odds = self.there(power, here), np.zeros_like(found)
        before = self._before(there, others or {})
        for k, p in zip(*np.nonzero((found > 0) & there), strict=True):
            if self.each[k].louder(power[p, self.begins[k]]).sensible(self.own(numbers[p], k)):
                odds[k, p] = before[k, p] * np.expm1(min(found[k, p], MOST))
        return odds / (1 + odds.sum(axis=0))


def averaged(fit: Linear, tried: Sequence[Term], others: Mapping[Kind, int] | None = None) -> Average:
    """Over the effects `tried` beside a fit, linearised; `others` as `Together.likely` has it."""
    scored = zip(tried, fit.scored(tried), strict=True)
    each = [Allowed(t, s) for t, s in scored if s is not None and spanned(t, s)]
    if not each:
        return Average.none()
    numbers = [x.scored.numbers for x in each]
    whole = np.concatenate(numbers)[None]
    share = Together.of(each).likely(whole, np.ones_like(whole), others=others)
    some = [(each[k], numbers[k], float(share[k, 0])) for k in np.flatnonzero(share.any(axis=1))]
    if not some:
        return Average.none()
    added, index = Average.none().covariance, [NAMES.index(n) for n in fit.names]
    added[np.ix_(index, index)] = sum(p * x.spans(x.scored.shifts, n) for x, n, p in some)
    return Average(added, widest(some, fit.names, fit.views))


def widest(
    some: Sequence[tuple[Allowed, np.ndarray, float]], names: Sequence[str], views: Sequence[View]
) -> Hint | None:
    """The effect that adds most to the error that grows most, of `some` with their numbers and how likely
    they are; None where the error grows little."""
    grown = np.array([p * np.diag(x.spans(x.scored.moves, n)) for x, n, p in some])
    k = int(np.argmax(grown.sum(axis=0)))
    wider, (x, numbers, share) = float(np.sqrt(1 + grown[:, k].sum())), some[int(np.argmax(grown[:, k]))]
    what = x.say(numbers)
    if wider < WIDER or not what:
        return None
    moves = dict(zip(names, (x.scored.moves @ x.mean(numbers)).tolist(), strict=True))
    logs = () if x.term.log is None else (views[x.term.log].trial.log.name,)
    return Hint(x.term.name, logs, what, share, names[k], wider, float(x.evidence(numbers)), moves)
