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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import gammaincc

from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import NAMES, carried
from sysid.model.span import inverted
from sysid.verdict.coincidence import cancelling
from sysid.verdict.moments import ASTRAY, LATE, at_changes
from sysid.verdict.term import UNNAMED, Term, together
from sysid.verdict.terms import CURVED, RUNNING, one_way, own, terms, times
from sysid.verdict.unexplained import left_of
from sysid.verdict.view import View
from sysid.verdict.wording import OFTEN, UNSAID

ENOUGH = 5.0  # log-likelihood: by chance in one of a thousand good fits
PERHAPS = 3.0  # by chance in one of a hundred
UNCHANGED = 0.01  # sum of squares in units of the noise
# standard deviations of its prior, by which a response may be late before more than its first order matters
TENSE = 2.0
ALIKE = (
    "drift",
    "lag",
    "late",
    "early",
    "phase_delay",
    "background",
    "dwell",
    "saturation",
)  # in several logs
# of a shape's square, less than which the plant and the nuisances leave of what they can do themselves
LEAST = 1e-6
ROUNDED = 1e-10  # of the largest of a term's directions: less is none
MOVES = 2.0  # standard deviations of G, tau or f0
SURELY = 4.0  # standard deviations of the noise
ROUGHLY = 0.1  # of a residual, by which a response farther along explains it
# log-likelihood towards a curve over temperature: with three of them a log that contradicts two is as likely
LEAN = 1.0
FARAWAY = 4.0  # of these, by what is not seen
EXPLAINED = 0.25  # of a power, half of its root: more is left by what is not its cause
CHANCE = 3.0  # standard deviations


@dataclass(frozen=True)
class Found:
    """A term that the logs hold."""

    sentence: str
    worth: float  # log-likelihood
    moves: dict[str, float]  # by parameter, in its standard deviations
    name: str
    log: int | None

    freedom: int  # numbers that it has
    certain: bool = True
    explains: bool = True  # most of what neighbouring rows share, or all but what chance leaves of it

    @property
    def farthest(self) -> str:
        """Which of G, tau and f0 it moves most, and k_T where that is not one number."""
        return max(
            (n for n in self.moves if n != "k_T" or self.name == CURVED), key=lambda n: abs(self.moves[n])
        )

    @property
    def harmful(self) -> bool:
        return abs(self.moves[self.farthest]) > MOVES


def misfits(
    state: State, reference: tuple[float, float], free: Sequence[str], at: float | None
) -> tuple[list[Found], list[str]]:
    """What the logs hold that the model leaves out, the most significant first; and sentences on what could
    be there unseen and would move the parameters far. `at` (degC): where parameters are reported."""
    if all(t.silent for t in state.trials):
        return [], []
    views = View.each(state, reference)
    away = 0.0 if at is None else at - reference[1]
    fit = Linear(views, state, [n for n in NAMES if n in free], away)
    tried = terms(views, free, away)
    found = fit.found(tried)
    if len(views) > 1 and not any(
        f.harmful and f.certain for f in found
    ):  # alike in several logs: freer, and so looked for last
        alike = list(together([t for t in tried if t.name in ALIKE and fit.tells(t)], views))
        found, tried = found + fit.found(alike, len(tried)), tried + alike
    if len(views) > 1:
        found += [
            gain
            for i, v in enumerate(views)
            if (gain := _cancelling(i, v, ENOUGH + np.log(len(views)))) is not None
        ]
    found += [late for i, v in enumerate(views) if (late := _very_late(i, v, fit)) is not None]
    found += [astray for i, v in enumerate(views) if (astray := _outlying(i, v)) is not None]
    doubts = [said for t in tried if t.log is not None and t.unseen and (said := fit.doubt(t)) is not None]
    doubts += [
        said
        for i, v in enumerate(views)
        if (said := _runs_on(i, v, fit) or _row_before(i, v, fit)) is not None
    ]
    return sorted(found, key=lambda f: round(2 * f.freedom - f.worth - LEAN * (f.name == CURVED), 3)), doubts


def described(minimiser: Minimiser, state: State) -> bool:
    """Whether the model describes the logs of a minimum: it leaves out nothing that is certain, and nothing
    unexplained."""
    found, _ = misfits(state, minimiser.reference, minimiser.free, None)
    left = (left_of(state, i) for i, t in enumerate(state.trials) if not t.silent)
    return state.converged and not any(f.certain for f in found) and all(x is None or x.noise for x in left)


def _very_late(i: int, view: View, fit: "Linear") -> Found | None:
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


def _outlying(i: int, view: View) -> Found | None:
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


def _earlier(view: View, run: np.ndarray) -> float:
    """What is left of a run of rows when they show what the model does later."""
    c, tried = view.course, view.course.tau * np.geomspace(0.01, 4, 48)
    return min(
        float(np.linalg.norm(view.residual[run] - view.observed((c.later(-t) - c.forced)[None])[0, run]))
        for t in tried
    )


def _aslant(view: View, run: np.ndarray) -> float:
    """What of a run of rows does not point along the response's change there."""
    along = view.model[run[-1]] - view.model[run[0] - 1]
    return float(np.linalg.norm((view.residual[run] * np.conj(along)).imag / (np.abs(along) or 1.0)))


def _runs_on(i: int, view: View, fit: "Linear") -> str | None:
    """What a sweep of one direction cannot tell, whose delay is stated, from a frequency that runs on between
    its rows: half a step."""
    log, changes = view.trial.log, np.diff(view.trial.log.frequency) if view.trial.resonant else np.zeros(1)
    if "f0" not in fit.names or not one_way(view) or "delay_s" not in log.bench or np.any(changes == 0):
        return None  # a frequency that stays for several rows does not run on
    f0, step = fit.names.index("f0"), float(np.ptp(log.frequency)) / (len(log) - 1)
    moved = 0.5 * step * min(fit.share(i)[f0, f0], 1.0)
    if moved < MOVES * fit.std[f0]:
        return None
    way = "higher" if log.frequency[-1] > log.frequency[0] else "lower"
    return RUNNING.format(log.name, moved, way, moved / fit.std[f0])


def _row_before(i: int, view: View, fit: "Linear") -> str | None:
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


def error_of_lateness(view: View, fit: "Linear") -> float:
    """Standard deviation (s) of how late the response is."""
    k = next(k for k, c in enumerate(view.columns) if c.name in ("late", "late_d"))
    share = view.trial.lateness / view.columns[k].prior
    return share * float(np.sqrt(view.covariance(fit.covariance)[k, k]))


def _cancelling(i: int, view: View, threshold: float) -> Found | None:
    """A gain of its own that a log shows as a feedthrough and a lateness that cancel."""
    found = cancelling(view)
    if found is None or found[1] < threshold:
        return None
    return Found(own(view.trial.log.name, "G", times(found[0] - 1)), found[1], {"G": np.inf}, "gain", i, 1)


def chances_of(tried: Sequence[Term], others: int = 0) -> list[float]:
    """Log-likelihood that each term is worth by chance; `others`: how many were tried before. Half of the
    chance is that of what one log has for itself, of which there are few: what logs contradict each other in
    moves the parameters more than all else."""
    between = sum(t.between for t in tried)
    shares = 1 if between in (0, len(tried)) else 2
    few, many = (np.log(max(shares * n, 1)) for n in (between, len(tried) - between + others))
    chances = [np.log(2) if t.expected else few if t.between else many for t in tried]
    return [c + t.freedom - 1 for t, c in zip(tried, chances, strict=True)]


class _Added(NamedTuple):
    """Rows of a term's shapes by log, and which of its coefficients they have; their size; products of the
    rows, scaled to unit size, with the Jacobian, with themselves and with the residual."""

    rows: dict[int, tuple[np.ndarray, slice]]
    scale: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    score: np.ndarray


class _Looked(NamedTuple):
    """Rows of a term's shapes in one log, and their products with its Jacobian, with themselves and with its
    residual."""

    rows: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    score: np.ndarray


class Scored(NamedTuple):
    """A term's score test at a fit, for residuals of any size: the products of a residual's rows (R,) of all
    logs with `rows` (R, r) are r numbers u of unit variance by chance, and the term is worth |u|^2/2. Its
    coefficients are `values` (m, r) u, and the parameters move by `moves` (p, r) u of their standard
    deviations."""

    rows: np.ndarray
    values: np.ndarray
    moves: np.ndarray


class Linear:
    """The joint fit of the parameters `names`, linearised: what one more term would change of what is
    reported `away` (degC) from the mean temperature."""

    def __init__(self, views: list[View], state: State, names: list[str], away: float):
        index = [NAMES.index(n) for n in names]
        self.views, self.names, self.reported = views, names, carried(away)[np.ix_(index, index)]
        self.covariance = state.covariance
        # What is left out passes for noise of the phase as well: it is harmful by the errors without that.
        firm = min((j.left for v in views if (j := v.trial.noise.jitter)), default=1.0)
        self.std = np.sqrt(
            firm * np.diag(self.reported @ state.spread[np.ix_(index, index)] @ self.reported.T)
        )
        self.jacobians = [v.jacobian[:, index] for v in views]
        self.prior = state.prior.precision[np.ix_(index, index)]
        self.pulled = state.prior.slope(state.theta)[index]
        self.inverse = inverted(sum(j.T @ j for j in self.jacobians) + self.prior)
        self.slope = sum(j.T @ v.r for j, v in zip(self.jacobians, views, strict=True)) - self.pulled
        self.before = [v.likelihood(v.recorded) for v in views]
        self.looked: dict[tuple[Term, int], _Looked] = {}
        self.added: dict[Term, _Added | None] = {}

    def moved(self, i: int, shape: np.ndarray) -> dict[str, float]:
        """What the parameters move, in their standard deviations, when `shape`, with no unknown, is taken off
        the i-th log."""
        shift = self.reported @ self.inverse @ self.jacobians[i].T @ self.views[i].off(shape) / self.std
        return dict(zip(self.names, -shift, strict=True))

    def share(self, i: int) -> np.ndarray:
        """(p, p) by how much the parameters move with those that the i-th log would have."""
        return self.reported @ self.inverse @ self.jacobians[i].T @ self.jacobians[i]

    def gained(self, shapes: Mapping[int, np.ndarray]) -> float:
        """What it is worth, in log-likelihood, when logs hold `shapes` (n,), with no unknown, and the
        parameters follow."""
        rows = {i: self.views[i].off(shape) for i, shape in shapes.items()}
        shift = self.inverse @ (self.slope - sum(self.jacobians[i].T @ x for i, x in rows.items()))
        worth = self._believed(shift)
        for j, (view, jacobian) in enumerate(zip(self.views, self.jacobians, strict=True)):
            worth += view.likelihood(view.r - jacobian @ shift - rows.get(j, 0.0)) - self.before[j]
        return worth

    def found(self, tried: Sequence[Term], others: int = 0) -> list[Found]:
        """Those that the logs hold; `others`: how many were tried before."""
        self.look([t for t in tried if not t.parts])
        chances = chances_of(tried, others)
        return [f for t, c in zip(tried, chances, strict=True) if (f := self.worth(t, c)) is not None]

    def tells(self, term: Term) -> bool:
        """Whether the logs can tell the term from the plant and the nuisances."""
        added = self._added(term)
        return added is not None and bool(np.all(np.diag(self._own(added)) >= LEAST))

    def _believed(self, shift: np.ndarray) -> float:
        """What a shift of the parameters changes of the prior's log density."""
        return -float(shift @ (self.pulled + 0.5 * self.prior @ shift))

    def doubt(self, term: Term) -> str | None:
        """What the term would do at a size of two of its standard deviations, at which it is not seen; None
        if that is little."""
        added = self._added(term)
        if added is None or (own := self._own(added))[0, 0] < LEAST:
            return None
        scale, cross = added.scale, added.cross
        value = 2 / np.sqrt(own[0, 0])
        moves = self.reported @ self.inverse @ cross[:, 0] * value / self.std
        k = int(np.argmax(np.abs(moves)))
        if abs(moves[k]) < FARAWAY:
            return None
        return term.unseen.format(
            value / scale[0], f"{self.names[k]} by {abs(moves[k]):.2g} of its standard deviations"
        )

    def _added(self, term: Term) -> "_Added | None":
        """Looked at once: a term may be part of another."""
        if term not in self.added:
            self.added[term] = self._all(term) if term.parts else self._alone(term)
        return self.added[term]

    def _all(self, term: Term) -> "_Added":
        parts = [added for t in term.parts if (added := self._added(t)) is not None]
        begins = np.cumsum([0, *(len(a.scale) for a in parts)])
        rows = {
            i: (x, slice(k, k + x.shape[1]))
            for a, k in zip(parts, begins, strict=False)
            for i, (x, _) in a.rows.items()
        }
        scale, score = (np.concatenate(x) for x in zip(*((a.scale, a.score) for a in parts), strict=True))
        cross, square = (
            np.concatenate([a.cross for a in parts], axis=1),
            block_diag(*(a.square for a in parts)),
        )
        return _Added(rows, scale, cross, square, score)

    def look(self, tried: Sequence[Term]) -> None:
        """At the shapes of these terms, at all of a log at once."""
        for i, (view, jacobian) in enumerate(zip(self.views, self.jacobians, strict=True)):
            here = [t for t in tried if i in t.shapes]
            if not here:
                continue
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # of an absurd value's powers; `_alone` leaves them out
                rows = view.off(np.concatenate([t.shapes[i].T for t in here]))
                cross, square, score = jacobian.T @ rows.T, rows @ rows.T, rows @ view.r
            end = 0
            for t in here:
                part = slice(end, end := end + t.shapes[i].shape[1])
                self.looked[t, i] = _Looked(rows[part].T, cross[:, part], square[part, part], score[part])

    def _alone(self, term: Term) -> "_Added | None":
        if any((term, i) not in self.looked for i in term.shapes):
            self.look([term])
        parts = {i: self.looked[term, i] for i in term.shapes}
        cross, square, score = (sum(x) for x in zip(*(part[1:] for part in parts.values()), strict=True))
        scale = np.sqrt(np.diag(square))
        if not np.all(np.isfinite(scale)) or np.all(scale == 0):
            return None
        size = np.where(scale > 0, scale, 1.0)
        rows = {i: (part.rows, slice(None)) for i, part in parts.items()}
        return _Added(rows, scale, cross / size, square / np.outer(size, size), score / size)

    def _own(self, added: "_Added") -> np.ndarray:
        """Products of a term's rows with themselves, less what the parameters can make of them."""
        return added.square - added.cross.T @ self.inverse @ added.cross

    def scored(self, term: Term) -> Scored | None:
        """The term's score test, `worth` for noise of a known level; None where the plant and the nuisances
        make up for the term."""
        added = self._added(term)
        if added is None or np.any(np.diag(own := self._own(added)) < LEAST):
            return None
        sizes, axes = np.linalg.eigh(own)
        told = sizes > ROUNDED * sizes[-1]
        axes = axes[:, told] / np.sqrt(sizes[told])
        shift, scale = self.inverse @ added.cross @ axes, np.where(added.scale > 0, added.scale, 1.0)
        rows = [-jacobian @ shift for jacobian in self.jacobians]
        for i, (shapes, which) in added.rows.items():
            rows[i] += (shapes / scale[which]) @ axes[which]
        values = axes / scale[:, None]
        moves = -(self.reported @ shift) / self.std[:, None]
        if term.beside is not None and term.beside[0] in self.names:
            k = self.names.index(term.beside[0])
            moves[k] += term.beside[1] * values[0] / self.std[k]
        return Scored(np.concatenate(rows), values, moves)

    def worth(self, term: Term, chance: float) -> Found | None:
        """The term with its gain in log-likelihood and what it moves; None when it is worth no more than
        `chance` gives."""
        threshold = chance + PERHAPS
        added = self._added(term)
        if added is None:
            return None
        rows, scale, cross = added.rows, added.scale, added.cross
        own, score = self._own(added), added.score - cross.T @ self.inverse @ self.slope
        if np.any(np.diag(own) < LEAST):
            return None
        value = score / own[0] if len(own) == 1 else np.linalg.lstsq(own, score, rcond=ROUNDED)[0]
        if 0.5 * score @ value < threshold:
            return None
        shift = self.inverse @ (self.slope - cross @ value)
        gained, coefficient = self._believed(shift), value / np.where(scale > 0, scale, 1.0)
        for i, (view, jacobian) in enumerate(zip(self.views, self.jacobians, strict=True)):
            change = jacobian @ shift + (rows[i][0] @ coefficient[rows[i][1]] if i in rows else 0.0)
            if change @ change > UNCHANGED:
                gained += view.likelihood(view.r - change) - self.before[i]
        said = term.say(coefficient, self.views[term.log or 0])
        if gained < threshold or said is None:
            return None
        moves = dict(zip(self.names, self.reported @ shift / self.std, strict=True))
        if term.beside is not None and term.beside[0] in moves:
            moves[term.beside[0]] += (
                term.beside[1] * value[0] / scale[0] / self.std[self.names.index(term.beside[0])]
            )
        if term.squared is not None and term.squared[0] in moves:
            moves[term.squared[0]] += (
                term.squared[1] * (value[0] / scale[0]) ** 2 / self.std[self.names.index(term.squared[0])]
            )
        certain = bool(gained >= chance + ENOUGH)
        explains = said != UNNAMED and self._explains(rows, coefficient, shift)
        found = Found(said, float(gained), moves, term.name, term.log, term.freedom, certain, explains)
        return found if found.certain or found.harmful else None

    def _explains(
        self, rows: Mapping[int, tuple[np.ndarray, slice]], coefficient: np.ndarray, shift: np.ndarray
    ) -> bool:
        """Whether a term of these rows and coefficients explains what the model leaves of the logs that hold
        it: neighbouring rows of the residual then share EXPLAINED of the power they did, or less, or no more
        than independent rows by chance."""
        before = after = chance = 0.0
        for i, (part, which) in rows.items():
            view, jacobian = self.views[i], self.jacobians[i]
            left = view.r - jacobian @ shift - part @ coefficient[which]
            before, after = before + view.shared(view.r), after + view.shared(left)
            chance += float(left @ left) / np.sqrt(view.n)
        return after <= max(EXPLAINED * before, CHANCE * chance)
