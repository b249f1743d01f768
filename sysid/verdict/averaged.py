"""Effects that logs allow and do not show: the errors are averaged over them.

What a log holds to first order it shows by numbers x (r,) of unit variance, and an effect of a usual size
(`linear.USUAL`) would add numbers of variances q. Its evidence over that of its absence, and its numbers if
it is there, are

    log B = sum(k x^2 - log(1 + q))/2,    k x +- sqrt(k),    k = q/(1 + q)

Of K effects that are tried, n alike at other places, each is as likely beforehand as all its places together:

    p = (B/(K n))/(1 + sum of all B/(K n))

If it moves theta by D x, it adds p D (diag(k) + k x x^T k) D^T to its covariance. The estimate stays what it
was. Two kinds are left out: effects that the logs speak against (B < 1), so that errors of logs which show
nothing are what they are without; and those that logs would not show if they were of a usual size, which are
an assumption of every fit to such logs. What a log would have for itself if it contradicts the others is
`differing`'s.

Hoeting, Madigan, Raftery & Volinsky, Bayesian model averaging: a tutorial, Statistical Science 14, 382
(1999).
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid.model.prior import NAMES
from sysid.verdict.finding import Finding
from sysid.verdict.linear import Linear, Scored
from sysid.verdict.term import Term

SHOWS = 5.0  # standard deviations, by which logs would show an effect of a usual size
WIDER = 1.5  # times an error, from which it is said what it spans


class Average(NamedTuple):
    """What effects add to the covariance of theta (6, 6); the one that adds most, where that is much."""

    covariance: np.ndarray
    said: Finding | None = None

    @classmethod
    def none(cls) -> "Average":
        """Where there is nothing to average over."""
        return cls(np.zeros((len(NAMES), len(NAMES))))


class Allowed(NamedTuple):
    """An effect that logs allow: its test, its log evidence, and how likely it is."""

    term: Term
    scored: Scored
    evidence: float
    likely: float


def averaged(fit: Linear, tried: Sequence[Term]) -> Average:
    """Over the effects `tried` beside a fit, linearised."""
    each = _allowed(fit, tried)
    if not each:
        return Average.none()
    added, index = Average.none().covariance, [NAMES.index(n) for n in fit.names]
    spans = np.array([x.likely * second_moment(x.scored) for x in each])
    added[np.ix_(index, index)] = spans.sum(axis=0)
    return Average(added, _said(fit, each, spans))


def _allowed(fit: Linear, tried: Sequence[Term]) -> list[Allowed]:
    """Those that are averaged over."""
    shown = [(t, s) for t in tried if not t.between and (s := fit.scored(t)) is not None and shows(s)]
    before = chances_before([t for t, _ in shown])
    each = [
        Allowed(t, s, b, chance * np.exp(b))
        for (t, s), chance in zip(shown, before, strict=True)
        if (b := float(evidence(s.numbers, s.usual))) > 0 and _say(fit, t, s) is not None
    ]
    every = 1 + sum(x.likely for x in each)
    return [x._replace(likely=x.likely / every) for x in each]


def _say(fit: Linear, term: Term, scored: Scored) -> str | None:
    return term.say(scored.values @ mean(scored.numbers, scored.usual), fit.views[term.log or 0])


def shows(scored: Scored) -> bool:
    """Whether logs would show a usual effect, in whatever direction."""
    return bool(np.min(scored.usual) > SHOWS**2)


def chances_before(terms: Sequence[Term]) -> np.ndarray:
    """How likely each of these terms is beforehand, over the chance that there is none."""
    places = Counter((t.name, t.log) for t in terms)
    return np.array([1 / (len(places) * places[t.name, t.log]) for t in terms])


def evidence(numbers: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """log B by numbers (..., r)."""
    return 0.5 * np.sum(usual / (1 + usual) * numbers**2 - np.log1p(usual), axis=-1)


def mean(numbers: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(..., r) of an effect's numbers if it is there."""
    return usual / (1 + usual) * numbers


def second_moment(scored: Scored, numbers: np.ndarray | None = None) -> np.ndarray:
    """(..., p, p) of what an effect moves of theta if it is there; `numbers` (..., r) unless those of the
    test."""
    shifts, usual = scored.shifts, scored.usual
    moved = mean(scored.numbers if numbers is None else numbers, usual) @ shifts.T
    return moved[..., :, None] * moved[..., None, :] + (shifts * mean(np.ones(len(usual)), usual)) @ shifts.T


def _said(fit: Linear, each: Sequence[Allowed], spans: np.ndarray) -> Finding | None:
    """On the effect that adds most to the error that grows most, if that is much."""
    grown = np.einsum("ij,kjl,il->ki", fit.reported, spans, fit.reported) / fit.std**2
    p = int(np.argmax(grown.sum(axis=0)))
    wider, x = float(np.sqrt(1 + grown[:, p].sum())), each[int(np.argmax(grown[:, p]))]
    what = _say(fit, x.term, x.scored)
    if wider < WIDER or not what:
        return None
    moves = x.scored.moves @ mean(x.scored.numbers, x.scored.usual)
    about = f"the error of {fit.names[p]} spans it, and is {wider:.2g} times what it is without"
    return Finding(
        x.term.name,
        "widened",
        f"{what} (perhaps, with {x.likely / (1 - x.likely):.2g} to one; {about})",
        () if x.term.log is None else (fit.views[x.term.log].trial.log.name,),
        evidence=x.evidence,
        moves=dict(zip(fit.names, moves.tolist(), strict=True)),
    )
