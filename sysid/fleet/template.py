"""What a clean plate looks like to the single fit: the score tests of all that its model leaves out.

A cell holds plates of one layout whose time constant, detuning and noise are alike, and priors where these
are narrowed. For plates in its middle and at its `nodes`, simulated without noise, the single fit's own
`terms` are linearised (`linear.Linear.scored`), which is done once and kept on disk; what is said of a term,
which is no number, is that of a plate in the middle of several cells, the template of these. The whitened
residuals of all plates of a cell are tried by products of matrices (`cells`), and what they are worth is
weighed here, for the plates of all cells of a template at once. A residual is orthogonal to what its own fit
can adjust, so its chance is that of the single fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.fleet.near import FREE, Near, Trying
from sysid.fleet.tests import Placed
from sysid.trials.trial import Trial
from sysid.verdict import identify
from sysid.verdict.averaged import FARAWAY, WIDER, Allowed, Hidden, Together, each_of, largest, widest
from sysid.verdict.conclusion import doubted, likeliest
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.linear import ENOUGH, PERHAPS, Found, Scored
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Kind


@dataclass(frozen=True, eq=False)
class Template:
    """The tests of plates of several cells, which are of these `terms`."""

    terms: Near = field(repr=False)

    @property
    def views(self) -> list[LinearisedLog]:
        """The logs that the terms are of."""
        return self.terms.views

    @cached_property
    def names(self) -> list[list[str]]:
        """Of the bench's columns of each log."""
        return [[c.name for c in v.columns] for v in self.views]

    @cached_property
    def tried(self) -> list[Trying]:
        """Each test."""
        return [x.light() for x in self.terms.tried]

    @cached_property
    def sizes(self) -> np.ndarray:
        """(K,) how many numbers each test has."""
        return np.array([len(x.scored.usual) for x in self.terms.tried])

    @cached_property
    def begins(self) -> np.ndarray:
        """(K,) where those of each are among the numbers of all."""
        return np.cumsum([0, *self.sizes[:-1]])

    @cached_property
    def logs(self) -> np.ndarray:
        """(q,) the log that each number is of."""
        return np.repeat([x.term.log or 0 for x in self.terms.tried], self.sizes)

    def own(self, k: int) -> slice:
        """Where the numbers of the k-th test are."""
        return slice(self.begins[k], self.begins[k] + self.sizes[k])

    def scored(self, k: int, at: Placed, p: int) -> Scored:
        """The k-th test of the p-th plate."""
        own, scored = self.own(k), self.tried[k].scored
        return scored._replace(
            numbers=at.numbers[p, own],
            values=at.values[p, own, : len(scored.values)].T,
            moves=at.moves[p, :, own],
            usual=at.usual[p, own],
        )

    def found(self, at: Placed, plates: int = 1) -> list[list[Found]]:
        """What the logs of plates at these places hold beside the model, or that would move their parameters
        far if they do, by the thresholds of `misfits`, but that it is certain where chance makes as much in
        less than one plate of `plates`."""
        worth = 0.5 * np.add.reduceat(at.numbers**2, self.begins, axis=1)
        found: list[list[Found]] = [[] for _ in worth]
        enough = max(ENOUGH, float(np.log(plates)))
        for p, k in zip(*np.nonzero((worth > self._chance + PERHAPS) & self._here(at.phases)), strict=True):
            x, scored, more = self.tried[k], self.scored(k, at, p), float(worth[p, k] - self._chance[k])
            certain, rare = more >= enough, more >= ENOUGH
            moves = dict(zip(FREE, (scored.moves @ scored.numbers / at.wider[p]).tolist(), strict=True))
            said = x.term.say(scored.values @ scored.numbers, scored.errors)
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

    def averaged(self, at: Placed) -> tuple[np.ndarray, list[Finding | None]]:
        """(P, 3, 3) what effects that the logs allow add to the covariance of each plate, in its errors, and
        what is said of it (`verdict.averaged`)."""
        spans = np.zeros((len(at.numbers), len(FREE), len(FREE)))
        said = list[Finding | None]([None] * len(spans))
        if (here := self._spanned) is None:
            return spans, said
        some, each = here
        own, usual = at.numbers[:, some.at], at.usual[:, some.at]
        worth = 0.5 * np.add.reduceat(own**2, some.begins, axis=1)
        seen = worth > self._chance[some.tests] + PERHAPS
        may = self._here(at.phases)[:, some.tests]
        likely = each.likely(own, usual, at.values[:, some.at], may.T, seen.T)
        k, p = np.nonzero(likely)
        added = each.added((k, p), at.moves[:, :, some.at], own, usual)
        np.add.at(spans, p, likely[k, p, None, None] * added)
        for i in np.flatnonzero(np.max(np.einsum("pii->pi", spans), axis=1) >= WIDER**2 - 1).tolist():
            tests = [(j, self.scored(int(some.tests[j]), at, i)) for j in k[p == i]]
            parts = [(Allowed(each.each[j].term, x), x.numbers, float(likely[j, i])) for j, x in tests]
            hint = widest(parts, FREE, self.views)
            said[i] = hint and hint.told(True)
        return spans, said

    def assumed(self, at: Placed, std: np.ndarray) -> list[list[Assumed]]:
        """What the logs of plates at these places would not show, and is assumed not to be there, as it would
        move parameters, whose errors are `std` (P, 3), far."""
        some, errors = self._hidden, std * at.wider
        numbers, found = largest(at.usual[:, some.at]), [list[Assumed]() for _ in std]
        moved = (at.moves[:, :, some.at] * numbers[:, None]) ** 2
        moved = (
            np.sqrt(np.add.reduceat(moved, some.begins, axis=2)) * self._here(at.phases)[:, None, some.tests]
        )
        # in less noise as much is more of an error
        whole = np.reshape([x.moved for x in self.terms.whole], (-1, len(FREE))).T / at.loud[:, None, None]
        moved = np.concatenate([moved, whole], axis=2) / at.wider[:, :, None]
        most = np.max(moved, axis=1)[:, self._alike]  # (P, kinds, places)
        best = self._alike[np.arange(len(self._alike)), np.argmax(most, axis=2)]
        plates, kinds = np.nonzero(np.max(most, axis=2) > FARAWAY)
        which = best[plates, kinds]
        values = self._coefficients(plates, which, numbers, at.values)
        told = moved[plates, :, which], errors[plates], values
        for p, k, *each in zip(plates.tolist(), which.tolist(), *(x.tolist() for x in told), strict=True):
            moves = {n: x * error for n, x, error in zip(FREE, each[0], each[1], strict=True) if x > FARAWAY}
            x = self._unseen(k, tuple(each[2]))
            found[p].append(Assumed(x.key, x.logs, x.shown_by, x.size, moves))
        return found

    def _coefficients(
        self, plates: np.ndarray, which: np.ndarray, numbers: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        """(n, M) of these places among what may be hidden, one of each of `plates` (n,), as they are told; 0
        of what is hidden whole."""
        places, has = self._hidden.places
        some = np.minimum(which, len(places) - 1)
        own, here = places[some], has[some] * (which < len(places))[:, None]
        at = plates[:, None], self._hidden.at[own]
        return rounded(np.sum((numbers[plates[:, None], own] * here)[:, :, None] * values[at], axis=1))

    @cached_property
    def _alike(self) -> np.ndarray:
        """(kinds, places) of each kind the places among what may be hidden: of its tests, and of what these
        hide whole; the first of them again where others have more."""
        kinds: dict[Kind, list[int]] = {}
        terms = [self.tried[k].term for k in self._hidden.tests] + [x.term for x in self.terms.whole]
        for k, term in enumerate(terms):
            kinds.setdefault(term.kind, []).append(k)
        most = max(map(len, kinds.values()), default=0)
        return np.array([each + each[:1] * (most - len(each)) for each in kinds.values()], int)

    def _unseen(self, k: int, value: tuple[float, ...]) -> Assumed:
        """What is assumed not to be there at one of these places, by its coefficients; not what it moves."""
        if (k, value) not in self._told:
            tests, logs = self._hidden.tests, [v.trial.log.name for v in self.views]
            if k < len(tests):
                x = self.tried[tests[k]]
                hidden = Hidden(x.term, np.array(value[: len(x.scored.values)]), np.zeros(0))
            else:
                hidden = self.terms.whole[k - len(tests)]
            self._told[k, value] = hidden.told(logs, {})
        return self._told[k, value]

    @cached_property
    def _told(self) -> dict[tuple[int, tuple[float, ...]], Assumed]:
        """Of places and coefficients what was told of them before: plates of a lot are nearly alike."""
        return {}

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
    def _spanned(self) -> "tuple[_Some, Together] | None":
        """What errors span: some tests, and the effects that these are of."""
        tests = [k for k, x in enumerate(self.tried) if x.allowed is not None]
        if not tests:
            return None
        return self._some(tests), Together.of([x.allowed for k in tests if (x := self.tried[k]).allowed])

    def _some(self, tests: Sequence[int]) -> "_Some":
        """Of these tests the numbers side by side."""
        sizes = self.sizes[tests]
        at = np.concatenate([self.begins[k] + np.arange(n) for k, n in zip(tests, sizes, strict=True)])
        return _Some(np.array(tests), np.cumsum([0, *sizes[:-1]]), at, each_of(sizes))

    def why(self, name: str, temperature: float | None) -> str:
        """Why a parameter that is not free is not determined, at that temperature (degC)."""
        trials: Sequence[Trial] = [v.trial for v in self.views]
        if temperature is not None:
            trials = [
                replace(t, log=replace(t.log, temperature=np.full(len(t.log), temperature))) for t in trials
            ]
        return identify.why(name, trials, 1.0, FREE, 1)


class _Some(NamedTuple):
    """Some `tests` (K,), their numbers (q,) side by side, each one's from `begins` on, or at its `places`
    (`averaged.each_of`), and where those are among the numbers of all tests, `at`."""

    tests: np.ndarray
    begins: np.ndarray
    at: np.ndarray
    places: tuple[np.ndarray, np.ndarray]


def rounded(numbers: np.ndarray) -> np.ndarray:
    """To two digits, as they are told."""
    digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(numbers), np.finfo(float).tiny))) - 1)
    return np.rint(numbers / digit) * digit
