"""The joint fit linearised about its minimum, and what one more term in it would be worth and would move."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from sysid.effects.number import Number
from sysid.effects.plate import CURVED
from sysid.minimum.minimise import State
from sysid.model.span import inverted
from sysid.model.theta import NAMES, carried
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import UNNAMED, Term

ENOUGH = 5.0  # log-likelihood: by chance in one of a thousand good fits
PERHAPS = 3.0  # by chance in one of a hundred
UNCHANGED = 0.01  # sum of squares in units of the noise
# of a shape's square, less than which the plant and the nuisances leave of what they can do themselves
LEAST = 1e-6
ROUNDED = 1e-10  # of the largest of a term's directions: less is none
EXPLAINED = 0.25  # of a power, half of its root: more is left by what is not its cause
CHANCE = 3.0  # standard deviations
# of the log likelihood that the best explanation gains: numbers that are large curve what they do
PROMISES = 0.1
MOVES = 2.0  # standard deviations of G, tau or f0
USUAL = 0.1  # of the response at its largest, that effects make up: much larger ones are found


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
    numbers: dict[str, Number] = field(default_factory=dict)  # in units of the bench
    mostly: bool = False  # it is most of its logs, and nothing is told of them
    plates: int = 1  # so many that it is no more than chance, though it would be certain of one

    @property
    def farthest(self) -> str:
        """Which of G, tau and f0 it moves most, and k_T where that is not one number."""
        return max(
            (n for n in self.moves if n != "k_T" or self.name == CURVED.name),
            key=lambda n: abs(self.moves[n]),
        )

    @property
    def harmful(self) -> bool:
        return abs(self.moves[self.farthest]) > MOVES


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
    """Rows of a term's shapes by log, and which of its coefficients they have; their size, and the standard
    deviation of usual coefficients; products of the rows, scaled to unit size, with the Jacobian, with
    themselves and with the residual."""

    rows: dict[int, tuple[np.ndarray, slice]]
    scale: np.ndarray
    usual: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    score: np.ndarray


class _Looked(NamedTuple):
    """Rows of a term's shapes in one log, the standard deviation of usual coefficients there, and products of
    the rows with its Jacobian, with themselves and with its residual."""

    rows: np.ndarray
    usual: np.ndarray
    cross: np.ndarray
    square: np.ndarray
    score: np.ndarray


class Scored(NamedTuple):
    """A term's score test at a fit: the term is worth |u|^2/2 by r numbers u of unit variance by chance,
    which are `numbers` (r,) for the logs at hand. Its coefficients are `values` (m, r) u, and the parameters
    move by `moves` (p, r) u of their standard deviations, theta's by `shifts` (p, r) u. Coefficients of a
    usual size (`USUAL`) would make numbers of variances `usual` (r,) besides."""

    numbers: np.ndarray
    values: np.ndarray
    moves: np.ndarray
    shifts: np.ndarray
    usual: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(m,) standard deviations of the coefficients."""
        return np.linalg.norm(self.values, axis=1)


class Linear:
    """The joint fit of the parameters `names`, linearised: what one more term would change of what is
    reported `away` (degC) from the mean temperature."""

    def __init__(self, views: list[LinearisedLog], state: State, names: list[str], away: float):
        index = [NAMES.index(n) for n in names]
        self.views, self.names, self.away = views, names, away
        self.reported = carried(away)[np.ix_(index, index)]
        self.covariance = state.covariance
        # What is left out passes for such noise as well: it is harmful by the errors without that.
        firm = min((v.trial.noise.firm for v in views), default=1.0)
        self.std = np.sqrt(
            firm * np.diag(self.reported @ state.spread[np.ix_(index, index)] @ self.reported.T)
        )
        self.jacobians = [v.jacobian[:, index] for v in views]
        self.prior = state.prior.precision[np.ix_(index, index)]
        self.pulled = state.prior.slope(state.theta)[index]
        self.inverse = inverted(sum(j.T @ j for j in self.jacobians) + self.prior)
        self.slope = sum(j.T @ v.r for j, v in zip(self.jacobians, views, strict=True)) - self.pulled
        self.looked: dict[tuple[Term, int], _Looked] = {}
        self.added: dict[Term, _Added | None] = {}
        self.tests: dict[Term, Scored | None] = {}
        self.gain = cache(self._gain)  # many effects are compared with all that was tried

    @cached_property
    def before(self) -> list[float]:
        """Log-likelihood of each log as it is."""
        return [v.likelihood(v.recorded) for v in self.views]

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
        return self.worth_more(tried, chances_of(tried, others))

    def worth_more(self, tried: Sequence[Term], chances: Sequence[float]) -> list[Found]:
        """Those that are worth more than chance gives."""
        each = zip(tried, chances, self.scored(tried), strict=True)
        return [f for t, c, s in each if self._hopeful(t, c, s) and (f := self.worth(t, c)) is not None]

    def _hopeful(self, term: Term, chance: float, scored: Scored | None) -> bool:
        """Whether a tested term may be worth more; one of which not all coefficients are told may be."""
        if scored is None or len(scored.numbers) < len(scored.values):
            return scored is not None
        return 0.5 * float(scored.numbers @ scored.numbers) > chance + PERHAPS - UNCHANGED

    def _gain(self, term: Term) -> float:
        """Log likelihood that a term is worth in noise of a known level, by what the plant and the nuisances
        do not make up for."""
        added = self._added(term)
        if added is None:
            return 0.0
        own = self._own(added)
        told = np.diag(own) >= LEAST
        score = (added.score - added.cross.T @ self.inverse @ self.slope)[told]
        if not len(score):
            return 0.0
        return 0.5 * float(score @ np.linalg.lstsq(own[np.ix_(told, told)], score, rcond=ROUNDED)[0])

    def tells(self, term: Term) -> bool:
        """Whether the logs can tell the term from the plant and the nuisances."""
        added = self._added(term)
        return added is not None and bool(np.all(np.diag(self._own(added)) >= LEAST))

    def _believed(self, shift: np.ndarray) -> float:
        """What a shift of the parameters changes of the prior's log density."""
        return -float(shift @ (self.pulled + 0.5 * self.prior @ shift))

    def usually(self, term: Term) -> tuple[np.ndarray, np.ndarray]:
        """(m,) coefficients of a term of a usual size, and (p,) by how much the parameters move with it, in
        their standard deviations."""
        if (added := self._added(term)) is None:
            return np.zeros(0), np.zeros(len(self.names))
        moves = self.reported @ self.inverse @ added.cross * (added.usual * added.scale)
        return added.usual, np.linalg.norm(moves, axis=1) / self.std

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
        of_each = ((a.scale, a.usual, a.score) for a in parts)
        scale, usual, score = (np.concatenate(x) for x in zip(*of_each, strict=True))
        cross, square = (
            np.concatenate([a.cross for a in parts], axis=1),
            block_diag(*(a.square for a in parts)),
        )
        return _Added(rows, scale, usual, cross, square, score)

    def look(self, tried: Sequence[Term]) -> None:
        """At the shapes of these terms, at all of a log at once."""
        for i, (view, jacobian) in enumerate(zip(self.views, self.jacobians, strict=True)):
            here = [t for t in tried if i in t.shapes]
            if not here:
                continue
            shapes = np.concatenate([t.shapes[i].T for t in here])
            usual = USUAL * view.trial.scale / np.maximum(np.max(np.abs(shapes), axis=1), 1e-300)
            with np.errstate(over="ignore", invalid="ignore"):  # of an absurd value's powers: `_added`
                rows = view.off(shapes)
                found = jacobian.T @ rows.T, rows @ rows.T, rows @ view.r
            end = 0
            for t in here:
                part = slice(end, end := end + t.shapes[i].shape[1])
                cross, square, score = found[0][:, part], found[1][part, part], found[2][part]
                self.looked[t, i] = _Looked(rows[part].T, usual[part], cross, square, score)

    def _alone(self, term: Term) -> "_Added | None":
        if any((term, i) not in self.looked for i in term.shapes):
            self.look([term])
        parts = {i: self.looked[term, i] for i in term.shapes}
        (first, *others) = parts.values()
        usual, cross, square, score = first[1:]
        for part in others:
            usual = np.minimum(usual, part.usual)
            cross, square, score = cross + part.cross, square + part.square, score + part.score
        scale = np.sqrt(square.diagonal())
        if not np.isfinite(scale).all() or not scale.any():
            return None
        size = np.where(scale > 0, scale, 1.0)
        rows = {i: (part.rows, slice(None)) for i, part in parts.items()}
        return _Added(rows, scale, usual, cross / size, square / (size[:, None] * size), score / size)

    def _own(self, added: "_Added") -> np.ndarray:
        """Products of a term's rows with themselves, less what the parameters can make of them."""
        return added.square - added.cross.T @ self.inverse @ added.cross

    def scored(self, terms: Sequence[Term]) -> list[Scored | None]:
        """The score test of each term, `worth` for noise of a known level; None where the plant and the
        nuisances make up for the term."""
        sizes: dict[int, list[tuple[Term, _Added]]] = {}
        for term in (t for t in terms if t not in self.tests):
            self.tests[term] = None
            if (added := self._added(term)) is not None:
                sizes.setdefault(len(added.scale), []).append((term, added))
        for some in sizes.values():
            for (term, _), scored in zip(some, self._scored([added for _, added in some]), strict=True):
                self.tests[term] = scored and self._beside(term, scored)
        return [self.tests[term] for term in terms]

    def _scored(self, each: "Sequence[_Added]") -> list[Scored | None]:
        """Those of terms of as many coefficients m, side by side."""
        scale, usual, cross, square, score = (
            np.stack(x)
            for x in zip(*((a.scale, a.usual, a.cross, a.square, a.score) for a in each), strict=True)
        )
        pulled = cross.swapaxes(1, 2) @ self.inverse
        own = square - pulled @ cross  # (T, m, m)
        told = np.all(np.einsum("tmm->tm", own) >= LEAST, axis=1)
        unit = usual * scale  # by which coefficients that are usual are as large as one another
        sizes, axes = np.linalg.eigh(
            np.where(told[:, None, None], own * unit[:, :, None] * unit[:, None], 0.0)
        )
        kept = sizes > ROUNDED * sizes[:, -1:]
        axes = unit[:, :, None] * axes / np.sqrt(np.where(kept, sizes, 1.0))[:, None]
        shifts = -pulled.swapaxes(1, 2) @ axes
        values = axes / np.where(scale > 0, scale, 1.0)[:, :, None]
        numbers = (axes.swapaxes(1, 2) @ (score - pulled @ self.slope)[:, :, None])[:, :, 0]
        moves = self.reported @ shifts / self.std[:, None]
        return [
            Scored(*(x[k][..., kept[k]] for x in (numbers, values, moves, shifts, sizes)))
            if told[k]
            else None
            for k in range(len(each))
        ]

    def _beside(self, term: Term, scored: Scored) -> Scored:
        """The test of a term with what that moves besides."""
        if term.beside is None or term.beside[0] not in self.names:
            return scored
        beside = np.zeros_like(scored.shifts)
        beside[self.names.index(term.beside[0])] = term.beside[1] * scored.values[0]
        return scored._replace(shifts=scored.shifts + beside, moves=scored.moves + beside / self.std[:, None])

    def rows(self, term: Term, scored: Scored) -> tuple[np.ndarray, np.ndarray]:
        """(R, r) whose products with a residual's rows (R,) of all logs are the numbers of a term with that
        test; (p, r) what they move, in standard deviations of the parameters."""
        added = self._added(term)
        assert added is not None
        axes = added.scale[:, None] * scored.values
        shift = self.inverse @ added.cross @ axes
        rows = [-jacobian @ shift for jacobian in self.jacobians]
        for i, (shapes, which) in added.rows.items():
            rows[i] += shapes @ scored.values[which]
        return np.concatenate(rows), -self.reported @ shift / self.std[:, None]

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
        open_ = np.diag(inverted(own)) / np.where(scale > 0, scale, np.inf) ** 2
        std = np.sqrt(np.maximum(open_, 0.0))
        said = term.say(coefficient, std)
        if gained < threshold or said is None:
            return None
        moves = dict(zip(self.names, self.reported @ shift / self.std, strict=True))
        if term.beside is not None and term.beside[0] in moves:
            moves[term.beside[0]] += (
                term.beside[1] * value[0] / scale[0] / self.std[self.names.index(term.beside[0])]
            )
        certain = bool(gained >= chance + ENOUGH)
        explains = said != UNNAMED and self._explains(rows, coefficient, shift)
        numbers = term.numbers(coefficient, std) if explains else {}
        found = Found(
            said, float(gained), moves, term.name, term.log, term.freedom, certain, explains, numbers
        )
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
