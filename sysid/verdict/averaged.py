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
logs would not show if they were of a usual size, which are an assumption of every fit to such logs, unless
they show it by more than chance does in one good fit of a hundred. What a
log would have for itself if it contradicts the others is `differing`'s.

Hoeting, Madigan, Raftery & Volinsky, Bayesian model averaging: a tutorial, Statistical Science 14, 382
(1999).
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sysid.model.theta import NAMES
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.linear import PERHAPS, Linear, Scored, chances_of
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import UNNAMED, Kind, Term

DIRECT = ("G", "tau", "f0")  # of which it is told what is assumed: one log shows each of them
HIDES = 2.0  # standard deviations of an effect, of which less is as likely not to be there
FARAWAY = 4.0  # standard deviations of a parameter, from which it is told what is assumed
SHOWS = 5.0  # standard deviations, by which logs would show an effect of a usual size
WIDER = 1.5  # times an error, from which it is said what it spans
MOST = 100.0  # of log evidence: more is as certain
UNUSUAL = "something that looks like {}, of a size that it seldom has"
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

    def about(self, found: Finding) -> bool:
        """Whether another finding is of the same effect."""
        return (found.key, found.logs) == (self.key, self.logs)

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

    def sensible(self, value: np.ndarray) -> bool:
        """Whether such coefficients make sense."""
        if self.term.sense is None:
            return self.term.say(value, self.scored.errors) is not None
        return self.term.sense(value)


def spanned(term: Term) -> bool:
    """Whether errors may span a term: it is one effect, by which no log contradicts the others."""
    return not (term.between or term.parts)


def each_of(sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K, r) where the numbers of each are, of so many (K,) that lie side by side, and 1 for each of them, 0
    where it has fewer than others."""
    begins, some = np.cumsum([0, *sizes[:-1]])[:, None], np.arange(max(sizes))
    has = some < sizes[:, None]
    return np.where(has, begins + some, 0), has * 1.0


class Together(NamedTuple):
    """Effects that logs allow, their numbers side by side, each one's from `begins` on. Methods take, of the
    q numbers of P plates, what each plate's logs show, the variances of what is `usual`, (P, q), and the
    coefficients of each, `values` (P, q, M)."""

    each: Sequence[Allowed]
    begins: np.ndarray
    kinds: Sequence[Kind]  # (n,) all that there are
    alike: np.ndarray  # (n, K) which effects are of each kind
    places: np.ndarray  # (K, r) of the numbers of each
    has: np.ndarray  # (K, r) 1 for each of its numbers, 0 where it has fewer than others

    @classmethod
    def of(cls, each: Sequence[Allowed]) -> "Together":
        """Of these effects, at least one."""
        sizes = np.array([len(x.scored.usual) for x in each])
        begins = np.cumsum([0, *sizes[:-1]])
        of_each = [x.term.kind for x in each]
        kinds = list(dict.fromkeys(of_each))
        alike = np.array([[float(one == kind) for one in of_each] for kind in kinds])
        return cls(each, begins, kinds, alike, *each_of(sizes))

    def added(
        self, which: tuple[np.ndarray, np.ndarray], moves: np.ndarray, numbers: np.ndarray, usual: np.ndarray
    ) -> np.ndarray:
        """(e, p, p) the second moments of what numbers move, `moves` (P, p, q), if these effects (e,) of
        these plates (e,) are there."""
        k, p = which
        at = p[:, None], self.places[k]
        moves = (moves.swapaxes(1, 2)[at] * self.has[k][:, :, None]).swapaxes(1, 2)
        numbers, usual = numbers[at], usual[at]
        mean = usual / (1 + usual)
        moved = np.sum(moves * (mean * numbers)[:, None], axis=2)
        return moved[:, :, None] * moved[:, None] + (moves * mean[:, None]) @ moves.swapaxes(1, 2)

    def own(self, numbers: np.ndarray, k: int) -> np.ndarray:
        """(r, ...) those of the k-th effect."""
        return numbers[self.begins[k] :][: len(self.each[k].scored.usual)]

    def there(self, usual: np.ndarray, here: np.ndarray | bool = True) -> np.ndarray:
        """(K, P) which effects logs would show, if they were of a usual size in whatever direction of their
        numbers; `here` (K, P): which there may be."""
        return (np.minimum.reduceat(usual, self.begins, axis=1).T > SHOWS**2) & here

    def _before(self, there: np.ndarray) -> np.ndarray:
        """(K, P) how likely each is beforehand over the chance of none."""
        counts = self.alike @ there
        kinds = np.sum(counts > 0, axis=0)
        return 1 / np.maximum(kinds * (self.alike.T @ counts), 1)

    @property
    def _tried(self) -> np.ndarray:
        """(K, 1) how many kinds there are, times at how many places each may be."""
        return len(self.kinds) * (self.alike.T @ np.sum(self.alike, axis=1))[:, None]

    def likely(
        self,
        numbers: np.ndarray,
        usual: np.ndarray,
        values: np.ndarray,
        here: np.ndarray | bool = True,
        seen: np.ndarray | bool = False,
    ) -> np.ndarray:
        """(K, P) how likely each effect is by the numbers; 0 where the logs speak against it. `here` as
        `there` has it; `seen` (K, P): which are worth more than chance is."""
        mean = usual / (1 + usual) * numbers
        found = 0.5 * np.add.reduceat(mean * numbers - np.log1p(usual), self.begins, axis=1).T
        there, odds = self.there(usual, here), np.zeros_like(found)
        known = ~there & here & seen
        before, there = np.where(known, 1 / self._tried, self._before(there)), there | known
        for k, p in zip(*np.nonzero((found > 0) & there), strict=True):
            x = self.each[k]
            value = self.own(mean[p], k) @ self.own(values[p], k)[:, : len(x.scored.values)]
            if x.sensible(value):
                odds[k, p] = before[k, p] * np.expm1(min(found[k, p], MOST))
        return odds / (1 + odds.sum(axis=0))


def side_by_side(each: Sequence[np.ndarray]) -> np.ndarray:
    """(q, M) the coefficients (m, r) of numbers of several effects, those of each number in a row."""
    most = max(len(values) for values in each)
    return np.concatenate([np.pad(values, ((0, most - len(values)), (0, 0))).T for values in each])


def averaged(fit: Linear, tried: Sequence[Term], told: Sequence[str] = NAMES) -> Average:
    """Over the effects `tried` beside a fit, linearised; said is what they do to the parameters `told`."""
    scored = zip(tried, fit.scored(tried), chances_of(tried), strict=True)
    some = [(Allowed(t, s), chance) for t, s, chance in scored if s is not None and spanned(t)]
    if not some:
        return Average.none()
    each = [x for x, _ in some]
    numbers = [x.scored.numbers for x in each]
    seen = np.array([[0.5 * n @ n > chance + PERHAPS] for n, (_, chance) in zip(numbers, some, strict=True)])
    whole, together = np.concatenate(numbers)[None], Together.of(each)
    usual = np.concatenate([x.scored.usual for x in each])[None]
    share = together.likely(whole, usual, side_by_side([x.scored.values for x in each])[None], seen=seen)
    k, p = np.nonzero(share)
    if not len(k):
        return Average.none()
    added, index = Average.none().covariance, [NAMES.index(n) for n in fit.names]
    shifts = np.concatenate([x.scored.shifts for x in each], axis=1)[None]
    spans = together.added((k, p), shifts, whole, usual)
    added[np.ix_(index, index)] = np.tensordot(share[k, p], spans, 1)
    those = [(each[j], numbers[j], float(share[j, 0])) for j in k]
    return Average(added, widest(those, fit.names, fit.views, told))


class Hidden(NamedTuple):
    """The coefficients `value` (m,) of a term that logs would not show, and by how much each parameter would
    move, `moved` (p,), in its standard deviations."""

    term: Term
    value: np.ndarray
    moved: np.ndarray

    @classmethod
    def each(cls, fit: Linear, tried: Sequence[Term]) -> "list[Hidden]":
        """Of terms of which it is known what would show them: of a usual size or, if less, the largest that
        would not show."""
        found, some = [], [term for term in tried if term.shown_by]
        for term, scored in zip(some, fit.scored(some), strict=True):
            value, moved = fit.usually(term)
            if scored:
                numbers = largest(scored.usual)
                value, moved = scored.values @ numbers, np.linalg.norm(scored.moves * numbers, axis=1)
            found.append(cls(term, value, moved))
        return found

    def told(self, logs: Sequence[str], moves: dict[str, float]) -> Assumed:
        """As what is assumed of some of `logs`, if it is not there."""
        numbers = self.term.numbers(self.value, np.zeros(len(self.value)))
        size = numbers.get("size", next(iter(numbers.values())))
        where = tuple(logs[i] for i in self.term.shapes)
        return Assumed(self.term.name, where, self.term.shown_by, size, moves)


def largest(usual: np.ndarray) -> np.ndarray:
    """Numbers of variances `usual`, or, if less, the largest that would not show, `HIDES` standard
    deviations."""
    return np.minimum(np.sqrt(usual), HIDES)


def assumed(
    each: Iterable[Hidden], names: Sequence[str], std: np.ndarray, logs: Sequence[str]
) -> list[Assumed]:
    """Of what `logs` would not show all that is assumed not to be there, as it would move G, tau or f0 by
    many of its `std` (p,); of each effect what moves them farthest."""
    found: dict[Kind, tuple[float, Hidden]] = {}
    direct = np.array([name in DIRECT for name in names])
    for x in each:
        most = float(np.max(x.moved[direct], initial=0.0))
        if most > max(FARAWAY, found.get(x.term.kind, (0.0,))[0]):
            found[x.term.kind] = most, x
    return [
        x.told(
            logs,
            {
                n: float(x.moved[k] * std[k])
                for k, n in enumerate(names)
                if direct[k] and x.moved[k] > FARAWAY
            },
        )
        for _, x in found.values()
    ]


def widest(
    some: Sequence[tuple[Allowed, np.ndarray, float]],
    names: Sequence[str],
    views: Sequence[LinearisedLog],
    told: Sequence[str] = NAMES,
) -> Hint | None:
    """The effect that adds most to the error that grows most of those of the parameters `told`, of `some`
    with their numbers and how likely they are; None where the error grows little."""
    grown = np.array([p * np.diag(x.spans(x.scored.moves, n)) for x, n, p in some]) * np.isin(names, told)
    k = int(np.argmax(grown.sum(axis=0)))
    wider, (x, numbers, share) = float(np.sqrt(1 + grown[:, k].sum())), some[int(np.argmax(grown[:, k]))]
    if wider < WIDER or (what := x.say(numbers)) is None:
        return None
    logs = () if x.term.log is None else (views[x.term.log].trial.log.name,)
    what = ": ".join((*logs, UNUSUAL.format(x.term.name.replace("_", " ")))) if what == UNNAMED else what
    moves = dict(zip(names, (x.scored.moves @ x.mean(numbers)).tolist(), strict=True))
    return Hint(x.term.name, logs, what, share, names[k], wider, float(x.evidence(numbers)), moves)
