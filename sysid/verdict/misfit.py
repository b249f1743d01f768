"""Does the model describe the logs? Each thing that it leaves out is tried as one more term, to first order.

For a term with shapes A, its coefficients are fitted beside the plant's parameters and the nuisances of every
log (white weights), the noise of the logs is estimated anew from what is then left, and the gain in
log-likelihood is what the term is worth. A term counts as found when that exceeds ENOUGH plus the logarithm
of the number of terms that were tried (of one that is to be expected, of two: a Bonferroni bound may be
shared out unevenly; Genovese et al., Biometrika 93, 509, 2006). It makes the fit a misfit when including it
would move G, tau or f0 out of their intervals; else it is a warning. One that would move them and is worth
less, but PERHAPS, is a warning too.

Cook & Weisberg, Residuals and Influence in Regression (1982), added variables and one-step influence.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sysid.effects.effect import About, one_way
from sysid.effects.plate import CURVED
from sysid.minimum.minimise import Minimiser, State
from sysid.model.theta import NAMES
from sysid.verdict.averaged import Average, Hidden, assumed, averaged
from sysid.verdict.between import own, times
from sysid.verdict.finding import Assumed
from sysid.verdict.firstorder import hidden
from sysid.verdict.gain_confounding import cancelling
from sysid.verdict.linear import ENOUGH, MOVES, Found, Linear
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.lines import line
from sysid.verdict.term import Term, together
from sysid.verdict.terms import RUNNING, terms
from sysid.verdict.timing import ASTRAY, LATE, at_changes
from sysid.verdict.unexplained import left_of
from sysid.verdict.wording import OFTEN, UNSAID

# standard deviations of its prior, by which a response may be late before more than its first order matters
TENSE = 2.0
SURELY = 4.0  # standard deviations of the noise
ROUGHLY = 0.1  # of a residual, by which a response farther along explains it
# log-likelihood towards a curve over temperature: with three of them a log that contradicts two is as likely
LEAN = 1.0


class Misfits(NamedTuple):
    """What the logs hold that the model leaves out, the most significant first; sentences on what could be
    there unseen and would move the parameters far; the fit, linearised, the terms that were `tried` beside
    it, and what these were about."""

    found: list[Found]
    unseen: list[str]
    fit: Linear | None = None
    tried: Sequence[Term] = ()
    about: About | None = None

    def in_colour(self, state: State, reference: tuple[float, float]) -> "Misfits":
        """The same in the noise of its minimum, whatever its colour."""
        if self.fit is None or not any(t.noise.coloured for t in state.trials):
            return self
        views = LinearisedLog.each(state, reference, coloured=True)
        return self._replace(fit=Linear(views, state, self.fit.names, self.fit.away))

    def average(self, told: Sequence[str] = NAMES) -> Average:
        """What the terms that are not found add to the errors of their minimum; said is what they do to the
        parameters `told`."""
        return Average.none() if self.fit is None else averaged(self.fit, self.tried, told)

    def assumed(self) -> list[Assumed]:
        """What is taken not to be there, as the logs would not show it."""
        if self.fit is None or self.about is None:
            return []
        fit, views = self.fit, self.fit.views
        each = Hidden.each(fit, [*self.tried, *hidden(dict(enumerate(views)), self.about)])
        return assumed(each, fit.names, fit.std, [v.trial.log.name for v in views])


def misfits(state: State, reference: tuple[float, float], free: Sequence[str], at: float | None) -> Misfits:
    """Of a minimum. `at` (degC): where parameters are reported."""
    if all(t.silent for t in state.trials):
        return Misfits([], [])
    views = LinearisedLog.each(state, reference)
    away = 0.0 if at is None else at - reference[1]
    fit = Linear(views, state, [n for n in NAMES if n in free], away)
    about = About.of(state, reference, away)
    tried = terms(views, free, about, away)
    found = fit.found(tried)
    if len(views) > 1 and not any(
        f.harmful and f.certain for f in found
    ):  # alike in several logs: freer, and so looked for last
        alike = list(together([t for t in tried if t.alike and fit.tells(t)]))
        found, tried = found + fit.found(alike, len(tried)), tried + alike
    if len(views) > 1:
        found += [
            gain
            for i, v in enumerate(views)
            if (gain := _cancelling(i, v, ENOUGH + np.log(len(views)))) is not None
        ]
    found += [late for i, v in enumerate(views) if (late := _very_late(i, v, fit)) is not None]
    found += [astray for i, v in enumerate(views) if (astray := _outlying(i, v)) is not None]
    found += [tone for i, v in enumerate(views) if (tone := line(i, v, fit)) is not None]
    doubts = [
        said
        for i, v in enumerate(views)
        if (said := _runs_on(i, v, fit) or _row_before(i, v, fit)) is not None
    ]
    found.sort(key=lambda f: round(2 * f.freedom - f.worth - LEAN * (f.name == CURVED.name), 3))
    return Misfits(found, doubts, fit, tried, about)


def described(minimiser: Minimiser, state: State, beside: float = 0.0) -> bool:
    """Whether the model describes the logs of a minimum: it leaves out nothing that is certain and worth more
    than `beside`, in log-likelihood, and nothing unexplained."""
    found = misfits(state, minimiser.reference, minimiser.free, None).found
    left = (left_of(state, i) for i in range(len(state.trials)))
    certain = any(f.certain and f.worth > beside for f in found)
    return state.converged and not certain and all(x is None or x.noise for x in left)


def _very_late(i: int, view: LinearisedLog, fit: "Linear") -> Found | None:
    """A response so late that more than its first order matters: t^2 d^2W/dt^2 behind a filter, half of that
    for a delay. Where the logs say that neither is there, it is not late, and noise or another parameter
    looks so to first order."""
    lateness, c = view.trial.lateness, view.course
    if not lateness or 0.5 * (view.late / error_of_lateness(view, fit)) ** 2 < ENOUGH:
        return None
    second = view.late**2 * view.observed((c.pole * c.rate)[None])[0]
    if max(fit.gained({i: share * second}) for share in (0.5, 1.0)) < -ENOUGH:
        return None
    moves = fit.moved(i, second)
    column = view.off(view.observed(c.rate[None])[0])  # its own prior keeps it from vanishing
    if abs(view.late) >= TENSE * lateness and np.sum(column**2) * view.late**2 >= 2 * ENOUGH:
        moves = {"tau": np.inf}
    said = LATE.format(view.trial.log.name, f" of about {view.late:.2g} s")
    found = Found(said, 0.5 * (view.late / lateness) ** 2, moves, "late", i, 1)
    return found if found.harmful else None


def _outlying(i: int, view: LinearisedLog) -> Found | None:
    """The worst outliers of a log beside a change of its inputs, if they are what the response shows when it
    is elsewhere in time by more than it may be: of the row at the change what comes later, of several rows
    after it what points along the response, as the fit has made up for the rest."""
    trial, noise, rows = view.trial, view.trial.noise, at_changes(view.trial)
    weight = np.ones(len(trial.log)) if noise.tail is None else np.array(noise.tail)
    weight[~noise.kept] = 0.0
    if not rows or not trial.lateness or trial.lost:
        return None
    rank = -np.log(
        np.searchsorted(np.sort(weight), weight, side="right") / len(weight)
    )  # by chance exponential
    after = [np.arange(row + 1, row + 1 + n) for row in rows for n in (2, 3) if row + n < len(weight)]
    for runs, name, elsewhere in (
        ([np.array([row]) for row in rows], "astray", _earlier),
        (after, "late", _aslant),
    ):
        chances = [float(gammaincc(len(run), np.sum(rank[run]))) for run in runs]
        if not runs or (worth := -float(np.log(len(runs) * max(min(chances), 1e-300)))) < ENOUGH:
            continue
        left = view.residual[run := runs[int(np.argmin(chances))]]
        if np.max(np.abs(left)) <= TENSE * trial.lateness * np.max(np.abs(view.course.push)):
            continue
        if elsewhere(view, run) <= max(SURELY * noise.std, ROUGHLY * float(np.linalg.norm(left))):
            said = (
                ASTRAY.format(trial.log.name, trial.log.time[run[0]])
                if name == "astray"
                else LATE.format(trial.log.name, "")
            )
            return Found(said, worth, {"G": np.inf}, name, i, 2)
    return None


def _earlier(view: LinearisedLog, run: np.ndarray) -> float:
    """What is left of a run of rows when they show what the model does later."""
    c, tried = view.course, view.course.tau * np.geomspace(0.01, 4, 48)
    return min(
        float(np.linalg.norm(view.residual[run] - view.observed((c.later(-t) - c.forced)[None])[0, run]))
        for t in tried
    )


def _aslant(view: LinearisedLog, run: np.ndarray) -> float:
    """What of a run of rows does not point along the response's change there."""
    along = view.model[run[-1]] - view.model[run[0] - 1]
    return float(np.linalg.norm((view.residual[run] * np.conj(along)).imag / (np.abs(along) or 1.0)))


def _runs_on(i: int, view: LinearisedLog, fit: "Linear") -> str | None:
    """What a sweep of one direction cannot tell, whose delay is stated, from a frequency that runs on between
    its rows: half a step."""
    log, changes = view.trial.log, np.diff(view.trial.log.frequency) if view.trial.resonant else np.zeros(1)
    if (
        "f0" not in fit.names
        or view.trial.steady
        or not one_way(view.trial)
        or "delay_s" not in log.bench
        or np.any(changes == 0)
    ):
        return None  # a frequency that stays for several rows does not run on
    f0, step = fit.names.index("f0"), float(np.ptp(log.frequency)) / (len(log) - 1)
    moved = 0.5 * step * min(fit.share(i)[f0, f0], 1.0)
    if moved < MOVES * fit.std[f0]:
        return None
    way = "higher" if log.frequency[-1] > log.frequency[0] else "lower"
    return RUNNING.format(log.name, moved, way, moved / fit.std[f0])


def _row_before(i: int, view: LinearisedLog, fit: "Linear") -> str | None:
    """That `sampling` is not stated of a transient whose lateness is known, and would move the parameters
    far: `settled` has each row show the response a row earlier."""
    trial = view.trial
    if (
        trial.steady
        or trial.log.sampling is not None
        or trial.log.theta is not None
        or trial.lateness >= 0.5 * trial.spacing
    ):
        return None
    if trial.changes > OFTEN * len(trial.log):
        return None  # `wording.sampled` has said so
    moves = fit.moved(i, trial.spacing * view.observed(view.course.rate[None])[0])
    name = max((n for n in moves if n != "k_T"), key=lambda n: abs(moves[n]))
    if not MOVES < abs(moves[name]) < np.inf:
        return None
    return (
        f"{trial.log.name}: {UNSAID} instant; settled would move {name} by {abs(moves[name]):.2g} of its"
        f" standard deviations"
    )


def error_of_lateness(view: LinearisedLog, fit: "Linear") -> float:
    """Standard deviation (s) of how late the response is."""
    k = next(k for k, c in enumerate(view.columns) if c.name in ("late", "late_d"))
    share = view.trial.lateness / view.columns[k].prior
    return share * float(np.sqrt(view.covariance(fit.covariance)[k, k]))


def _cancelling(i: int, view: LinearisedLog, threshold: float) -> Found | None:
    """A gain of its own that a log shows as a feedthrough and a lateness that cancel."""
    found = cancelling(view)
    if found is None or found[1] < threshold:
        return None
    return Found(own(view.trial.log.name, "G", times(found[0] - 1)), found[1], {"G": np.inf}, "gain", i, 1)
