"""What a clean plate looks like to the single fit: the score tests of all that its model leaves out.

A cell holds plates of one layout whose time constant, detuning and noise are alike, and priors where these
are narrowed. For plates in its middle and at its `nodes`, simulated without noise, the single fit's own
`terms` are linearised (`linear.Linear.scored`), which is done once and kept on disk; what is said of a term,
which is no number, is that of a plate in the middle of several cells. The whitened residuals of all plates
of the cell are then tried by products of matrices. A residual is orthogonal to what its own fit can adjust,
so its chance is that of the single fit. A plate's own test is a polynomial of its place through those of the
nodes: its rows w, by whose size the numbers w^T r/|w| have unit variance, and what they move.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sysid.fleet.arrays import Rows, on_rows, padding, there
from sysid.fleet.near import FREE, Near, Trying, products_of, size_of
from sysid.fleet.tests import Tests
from sysid.trials.trial import Trial
from sysid.verdict import identify
from sysid.verdict.averaged import FARAWAY, WIDER, Allowed, Hidden, Together, largest, widest
from sysid.verdict.conclusion import doubted, likeliest
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.linear import ENOUGH, PERHAPS, Found
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Kind


class Placed(NamedTuple):
    """Plates in a cell: the `share` (P, N) that each node has of the tests of each, and the `size` (P, q) of
    the rows of these; in which PHASES of a quarter turn each rotation is, (P, logs); the `power` (P, logs) of
    the noise, over that of the cell; by how much `wider` (P, 3) errors are than those of the fit, as harm is
    measured."""

    share: np.ndarray
    size: np.ndarray
    phases: np.ndarray
    power: np.ndarray
    wider: np.ndarray

    def of(self, which: np.ndarray) -> "Placed":
        """Some of them."""
        return Placed(*(each[which] for each in self))


@dataclass(frozen=True, eq=False)
class Template:
    """The tests of a cell, of these `terms`; `narrowed`: its priors are."""

    terms: Near = field(repr=False)
    tests: Tests = field(repr=False)
    narrowed: bool

    @property
    def views(self) -> list[LinearisedLog]:
        """The logs that the terms are of."""
        return self.terms.views

    @cached_property
    def names(self) -> list[list[str]]:
        """Of the bench's columns of each log."""
        return [[c.name for c in v.columns] for v in self.views]

    @cached_property
    def begins(self) -> np.ndarray:
        """Of each test, among the numbers of all."""
        return np.cumsum([0, *(x.scored.values.shape[1] for x in self.terms.tried[:-1])])

    @cached_property
    def tried(self) -> list[Trying]:
        """Each test."""
        products, tests, larger = products_of(self._all), self.tests, self.tests.larger.T
        return [
            replace(
                x,
                scored=x.scored._replace(
                    values=tests.values[a:b, : len(x.scored.values)].T, usual=tests.usual[a:b]
                ),
                moves=tests.moves[:, :, a:b],
                larger=usual,
                products=products[a:b],
            ).light()
            for x, a, b, usual in zip(
                self.terms.tried, self.begins, [*self.begins[1:], len(products)], larger, strict=True
            )
        ]

    @cached_property
    def _all(self) -> np.ndarray:
        return self.tests.weights.astype(float)

    def sizes(self, share: np.ndarray) -> np.ndarray:
        """(P, q) of the rows of all tests of plates with such shares."""
        return size_of(self._sizes, share)

    def numbers(self, rows: Rows, which: np.ndarray, at: Placed) -> np.ndarray:
        """(p, q) of all tests side by side, of these plates (p,), which are at these places, by the residuals
        (P, R) of all in the plate's frame, with those of the priors."""
        more = padding(len(which))
        some = np.pad(which, (0, more), mode="edge") if more else which
        found = np.asarray(_products(rows, some, *self._weights))[: len(which)]
        each = found.reshape(len(found), *self.tests.weights.shape[1:])
        return (at.share[:, None] @ each)[:, 0] / at.size

    @cached_property
    def _sizes(self) -> np.ndarray:
        return np.concatenate([x.products for x in self.tried])

    @cached_property
    def _weights(self) -> tuple[Rows, Rows]:
        return there(self.tests.basis.astype(float)), there(self._all.reshape(len(self._all), -1))

    def found(self, numbers: np.ndarray, at: Placed, plates: int = 1) -> list[list[Found]]:
        """What the logs of plates at these places hold beside the model, or that would move their parameters
        far if they do, by the thresholds of `misfits`, but that it is certain where chance makes as much in
        less than one plate of `plates`; `numbers` (P, q) of all tests."""
        worth = 0.5 * np.add.reduceat(numbers**2, self.begins, axis=1)
        found: list[list[Found]] = [[] for _ in numbers]
        enough = max(ENOUGH, float(np.log(plates)))
        for p, k in zip(*np.nonzero((worth > self._chance + PERHAPS) & self._here(at.phases)), strict=True):
            x, u = self.tried[k], self._own(numbers, k)[p]
            scored, more = x.at(at.share[p], at.power[p]), float(worth[p, k] - x.chance)
            certain, rare = more >= enough, more >= ENOUGH
            moves = dict(zip(FREE, (scored.moves @ u / at.wider[p]).tolist(), strict=True))
            said = x.term.say(scored.values @ u, scored.errors)
            named = x.term.name, x.term.log, x.term.freedom
            new = Found(said or "", worth[p, k], moves, *named, certain, plates=plates if rare else 1)
            if said is not None and (certain or new.harmful):
                found[p].append(new)
        return found

    def doubt(self, found: Sequence[Found]) -> Finding | None:
        """What the single fit would warn of where a plate's logs hold these, none of them certain; None where
        it has to look closer."""
        if any(f.certain for f in found):
            return None
        likely = likeliest(sorted(found, key=lambda f: -f.worth))
        return next(iter(doubted(likely, [v.trial.log.name for v in self.views])), None)

    def averaged(self, numbers: np.ndarray, at: Placed) -> tuple[np.ndarray, list[Finding | None]]:
        """(P, 3, 3) what effects that the logs allow add to the covariance of each plate, in its errors, and
        what is said of it (`verdict.averaged`)."""
        spans = np.zeros((len(numbers), len(FREE), len(FREE)))
        said = list[Finding | None]([None] * len(numbers))
        if (here := self._spanned) is None:
            return spans, said
        some, size = here.some, 1 / at.size[:, here.some.at]
        own, loud = numbers[:, some.at], some.louder(at)
        worth = 0.5 * np.add.reduceat(own**2, some.begins, axis=1)
        seen = (worth > self._chance[some.tests] + PERHAPS).T
        likely = here.each.likely(own, loud, self._here(at.phases)[:, some.tests].T, seen)
        k, p = np.nonzero(likely)
        shifts = np.einsum("en,neij->eij", at.share[p], here.moves[:, k])
        shifts = shifts * size[p[:, None], here.each.places[k]][:, None]
        np.add.at(spans, p, likely[k, p, None, None] * here.each.added((k, p), shifts, own, loud))
        for i in np.flatnonzero(np.max(np.einsum("pii->pi", spans), axis=1) >= WIDER**2 - 1).tolist():
            each = [
                (self._one(int(j), at.share[i], at.power[i]), here.each.own(own[i], j), float(likely[j, i]))
                for j in k[p == i]
            ]
            hint = widest(each, FREE, self.views)
            said[i] = hint and hint.told(True)
        return spans, said

    def assumed(self, at: Placed, std: np.ndarray) -> list[list[Assumed]]:
        """What the logs of plates at these places would not show, and is assumed not to be there, as it would
        move parameters, whose errors are `std` (P, 3), far."""
        some, size, power = self._hidden, 1 / at.size[:, self._hidden.at], at.power[:, self._hidden.logs]
        numbers = largest(some.usual / some.louder(at))
        moved = np.tensordot(at.share, some.moves, 1) * (size * numbers)[:, None]
        moved = np.sqrt(np.add.reduceat(moved**2, some.begins, axis=2)) / at.wider[:, :, None]
        moved = moved * self._here(at.phases)[:, None, some.tests]
        quiet = 1 / np.sqrt(at.power[:, :1]) / at.wider  # in which as much is more of an error
        whole = np.reshape([x.moved for x in self.terms.whole], (-1, len(FREE))).T
        moved, errors = np.concatenate([moved, quiet[:, :, None] * whole], axis=2), std * at.wider
        coefficients, found = rounded(numbers * size * np.sqrt(power)), [list[Assumed]() for _ in std]
        for places in self._alike.values():
            most = np.max(moved[:, :, places], axis=1)
            best = np.argmax(most, axis=1)
            for p in np.flatnonzero(most[np.arange(len(best)), best] > FARAWAY).tolist():
                k = places[best[p]]
                far = zip(FREE, moved[p, :, k].tolist(), errors[p].tolist(), strict=True)
                moves = {name: x * error for name, x, error in far if x > FARAWAY}
                own = some.own(coefficients[p], k) if k < len(some.tests) else coefficients[p, :0]
                found[p].append(replace(self._unseen(k, tuple(own.tolist())), moves=moves))
        return found

    @cached_property
    def _alike(self) -> dict[Kind, list[int]]:
        """Of each kind the places among what may be hidden: of its tests, and of what these hide whole."""
        kinds: dict[Kind, list[int]] = {}
        terms = [self.tried[k].term for k in self._hidden.tests] + [x.term for x in self.terms.whole]
        for k, term in enumerate(terms):
            kinds.setdefault(term.kind, []).append(k)
        return kinds

    def _unseen(self, k: int, own: tuple[float, ...]) -> Assumed:
        """What is assumed not to be there at one of these places, by its coefficients; not what it moves."""
        if (k, own) not in self._told:
            tests, logs = self._hidden.tests, [v.trial.log.name for v in self.views]
            if k < len(tests):
                x = self.tried[tests[k]]
                hidden = Hidden(x.term, x.scored.values @ np.array(own), np.zeros(0))
            else:
                hidden = self.terms.whole[k - len(tests)]
            self._told[k, own] = hidden.told(logs, {})
        return self._told[k, own]

    @cached_property
    def _told(self) -> dict[tuple[int, tuple[float, ...]], Assumed]:
        """Of places and coefficients what was told of them before: plates of a lot are nearly alike."""
        return {}

    def _one(self, k: int, share: np.ndarray, power: np.ndarray) -> Allowed:
        """The k-th effect that errors span, in the noise of a plate."""
        assert self._spanned is not None
        x = self.tried[self._spanned.some.tests[k]]
        return Allowed(x.term, x.at(share, power))

    @cached_property
    def _chance(self) -> np.ndarray:
        """(K,) what each test is worth by chance."""
        return np.array([x.chance for x in self.tried])

    @cached_property
    def _phases(self) -> np.ndarray:
        """(K, 2) of each test the log and the place of its `phase`, -1 where it is for all."""
        return np.array([x.phase or (-1, -1) for x in self.tried])

    def _here(self, phases: np.ndarray) -> np.ndarray:
        """(P, K) whether each test is one for plates of such rotations (P, logs)."""
        log, place = self._phases.T
        return (place < 0) | (phases[:, log] == place)

    @cached_property
    def _hidden(self) -> "_Some":
        return self._some([k for k, x in enumerate(self.tried) if x.term.shown_by])

    @cached_property
    def _spanned(self) -> "_Spanned | None":
        tests = [k for k, x in enumerate(self.tried) if x.allowed is not None]
        if not tests:
            return None
        some = self._some(tests)
        together = Together.of([x.allowed for k in tests if (x := self.tried[k]).allowed])
        moves = [[self.tried[k].moves[n] for k in tests] for n in range(len(self.tests.moves))]
        return _Spanned(some, together, np.array([together.side_by_side(each) for each in moves]))

    def _some(self, tests: Sequence[int]) -> "_Some":
        """Of these tests the numbers side by side."""
        each = [self.tried[k] for k in tests]
        sizes = [len(x.products) for x in each]
        at = np.concatenate([self.begins[k] + np.arange(n) for k, n in zip(tests, sizes, strict=True)])
        logs = np.repeat([x.term.log or 0 for x in each], sizes)
        larger = np.repeat(self.tests.larger[:, tests], sizes, axis=1)
        begins = np.cumsum([0, *sizes[:-1]])
        return _Some(
            np.array(tests), begins, at, logs, self.tests.usual[at], self.tests.moves[:, :, at], larger
        )

    def _own(self, numbers: np.ndarray, k: int) -> np.ndarray:
        """(P, r) those of the k-th test."""
        return numbers[:, self.begins[k] :][:, : self.tried[k].scored.values.shape[1]]

    def why(self, name: str, temperature: float | None) -> str:
        """Why a parameter that is not free is not determined, at that temperature (degC)."""
        trials: Sequence[Trial] = [v.trial for v in self.views]
        if temperature is not None:
            trials = [
                replace(t, log=replace(t.log, temperature=np.full(len(t.log), temperature))) for t in trials
            ]
        return identify.why(name, trials, 1.0, FREE, 1)


class _Some(NamedTuple):
    """Some `tests` (K,), their numbers (q,) side by side, each one's from `begins` on: of each number the
    place among those of all tests, the log, and what is `usual`; what they move of G, tau and f0 at the
    nodes, `moves` (N, 3, q), and how much `larger` (N, q) what is usual is there."""

    tests: np.ndarray
    begins: np.ndarray
    at: np.ndarray
    logs: np.ndarray
    usual: np.ndarray
    moves: np.ndarray
    larger: np.ndarray

    def louder(self, at: Placed) -> np.ndarray:
        """(P, q) the power of the noise over what is usual of plates at these places, over that of the
        tests."""
        return at.power[:, self.logs] / at.size[:, self.at] ** 2 / np.exp(at.share @ self.larger)

    def own(self, numbers: np.ndarray, k: int) -> np.ndarray:
        """(r,) those of the k-th test."""
        end = self.begins[k + 1] if k + 1 < len(self.begins) else None
        return numbers[self.begins[k] : end]


class _Spanned(NamedTuple):
    """What errors span: `some` tests, the effects that these are of `together`, and what numbers of each move
    of G, tau and f0 at the nodes, in errors, `moves` (N, K, 3, r)."""

    some: _Some
    each: Together
    moves: np.ndarray


def rounded(numbers: np.ndarray) -> np.ndarray:
    """To two digits, as they are told."""
    digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(numbers), np.finfo(float).tiny))) - 1)
    return np.rint(numbers / digit) * digit


@on_rows()
def _products(xp: Any, rows: Rows, which: np.ndarray, basis: Rows, weights: Rows) -> Rows:
    return rows[which] @ basis @ weights
