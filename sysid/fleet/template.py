"""What a clean plate looks like to the single fit: the score tests of all that its model leaves out.

A cell holds plates of one layout whose time constant, detuning and noise are nearly alike, and priors where
these are narrowed. For a plate in its middle, simulated without noise, the single fit's own `terms` are
linearised once (`linear.Linear.scored`), and again where one of these is a little larger; the whitened
residuals of all plates of the cell are then tried by one product of matrices. A residual is orthogonal to
what its own fit can adjust, so its chance is that of the single fit. A plate's own test is that of the
middle, moved in proportion to how far the plate is off it: its rows w, by whose size the numbers w^T r/|w|
have unit variance, and what they move.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sysid import reading
from sysid.effects.registry import ADOPTED, EVERY
from sysid.fleet.arrays import Rows, on_rows, padding, there
from sysid.fleet.closed import Block
from sysid.fleet.near import (
    AXES,
    FREE,
    Near,
    Trying,
    matched,
    models_at,
    narrowed,
    simulated,
    size_of,
    state_at,
)
from sysid.logs.log import Log
from sysid.minimum.minimise import DOUBTFUL, State
from sysid.model.plant import LOW_Q
from sysid.trials.trial import Trial
from sysid.verdict import flank, identify, lone
from sysid.verdict.averaged import WIDER, Allowed, Kind, Together, widest
from sysid.verdict.conclusion import doubted, likeliest
from sysid.verdict.finding import Finding
from sysid.verdict.linear import ENOUGH, PERHAPS, Found
from sysid.verdict.linearised import LinearisedLog

BESIDE = 0.1  # of a cell, by which a step is taken to see how tests change across it
NUISANCES = tuple(name for name in EVERY if name not in ("thermometer", *ADOPTED))


@dataclass(frozen=True, eq=False)
class Template:
    """The tests of a cell: `weights` (R, (1 + AXES) q) of all terms side by side, each from `begins`, and how
    they change along the axes. `second` (logs, 3): by what G, tau and f0 move, in their errors, with the
    square (s^2) of a lateness. `refused`: why the batch does not cover such plates."""

    refused: str = ""
    trials: tuple[Trial, ...] = ()
    names: tuple[tuple[str, ...], ...] = ()  # of the bench's columns of each log
    tried: tuple[Trying, ...] = field(default=(), repr=False)
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    begins: np.ndarray = field(default_factory=lambda: np.zeros(0, int), repr=False)
    second: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), repr=False)
    views: tuple[LinearisedLog, ...] = field(default=(), repr=False)

    @classmethod
    def of(
        cls,
        logs: Sequence[Log],
        blocks: Sequence[Block],
        places: Sequence[tuple[np.ndarray, float]],
        levels: Sequence[float],
    ) -> "Template":
        """Of the inputs of `logs`, whose `blocks` are of one plate, in the `places` that are the middle and
        BESIDE along each axis: theta (3,) there, and the width of the prior of a feedthrough that may cancel
        a lateness (inf: as it is), in noise of `levels`."""
        trials, near = tuple[Trial, ...](), list[Near]()
        for theta, narrow in places:
            if near and narrow == np.inf and np.array_equal(theta, places[0][0]):
                near.append(near[0])
                continue
            models = models_at(blocks, theta)
            read, warnings = reading.trials(simulated(logs, models, levels), NUISANCES)
            trials = trials or read
            if said := _uncovered(read, blocks, warnings, logs):
                return cls(said, trials)
            state, views, reference = state_at(theta, narrowed(read, theta, narrow), models, levels)
            if not near and (said := _undescribed(state, views, reference)):
                return cls(said, trials)
            near.append(Near.of(state, views, reference))
        return cls._tried(near, trials)

    @classmethod
    def _tried(cls, places: "Sequence[Near]", trials: tuple[Trial, ...]) -> "Template":
        (fit, tried, views), *others = places
        found, weights = list[Trying](), list[np.ndarray]()
        alike = [matched(places[0], other) for other in others]
        for j, x in enumerate(tried):
            rows, moves = fit.rows(x.term, x.scored)
            near = [
                other.fit.rows(t[j], x.scored) if t[j] else (rows, moves)
                for other, t in zip(others, alike, strict=True)
            ]
            moved = np.array([(m - moves) / BESIDE for _, m in near])
            weights.append(np.array([rows, *((r - rows) / BESIDE for r, _ in near)]))
            found.append(
                replace(x, moves=moved, products=np.einsum("irn,jrn->nij", weights[-1], weights[-1]))
            )
        second = [
            fit.moved(i, v.observed((v.course.pole * v.course.rate)[None])[0]) for i, v in enumerate(views)
        ]
        return cls(
            trials=trials,
            names=tuple(tuple(c.name for c in v.columns) for v in views),
            tried=tuple(x.light() for x in found),
            weights=np.concatenate([w for part in zip(*weights, strict=True) for w in part], axis=1),
            begins=np.cumsum([0, *(w[0].shape[1] for w in weights[:-1])]),
            second=np.array([[moves[name] for name in FREE] for moves in second]),
            views=tuple(views),
        )

    def numbers(self, rows: Rows, which: np.ndarray, away: np.ndarray) -> np.ndarray:
        """(p, q) of all tests side by side, of these plates (p,), which are `away` (p, AXES) from the middle,
        by the residuals (P, R) of all in the plate's frame, with those of the priors."""
        more = padding(len(which))
        some = np.pad(which, (0, more), mode="edge") if more else which
        found = np.asarray(_products(rows, some, self._weights))[: len(which)]
        middle, *slopes = np.split(found, 1 + AXES, axis=1)
        whole = middle + sum(a[:, None] * s for a, s in zip(away.T, slopes, strict=True))
        return whole / size_of(self._sizes, away)

    @cached_property
    def _sizes(self) -> np.ndarray:
        return np.concatenate([x.products for x in self.tried])

    @cached_property
    def _weights(self) -> Rows:
        return there(self.weights)

    def found(self, numbers: np.ndarray, away: np.ndarray, phases: np.ndarray) -> list[list[Found]]:
        """What each plate's logs hold beside the model, or that would move its parameters far if they do, by
        the thresholds of `misfits`; `numbers` (P, q) of all tests of plates that are `away` (P, AXES) from
        the middle, `phases` (P, logs): in which PHASES of a quarter turn each rotation is."""
        worth = 0.5 * np.add.reduceat(numbers**2, self.begins, axis=1)
        found: list[list[Found]] = [[] for _ in numbers]
        for p, k in zip(*np.nonzero((worth > self._chance + PERHAPS) & self._here(phases)), strict=True):
            x, u = self.tried[k], self._own(numbers, k)[p]
            scored, certain = x.at(away[p]), bool(worth[p, k] >= x.chance + ENOUGH)
            moves = dict(zip(FREE, (scored.moves @ u).tolist(), strict=True))
            said = x.term.say(scored.values @ u, scored.errors)
            new = Found(said or "", worth[p, k], moves, x.term.name, x.term.log, x.term.freedom, certain)
            if said is not None and (certain or new.harmful):
                found[p].append(new)
        return found

    def doubt(self, found: Sequence[Found]) -> Finding | None:
        """What the single fit would warn of where a plate's logs hold these, none of them certain; None where
        it has to look closer, as at what one log has for itself, or several may have alike."""
        if any(f.certain or (f.name, f.log) in self._firm for f in found):
            return None
        likely = likeliest(sorted(found, key=lambda f: -f.worth))
        return next(iter(doubted(likely, [t.log.name for t in self.trials])), None)

    @cached_property
    def _firm(self) -> set[Kind]:
        """What one log has for itself, and what several may have alike."""
        return {x.kind for x in self.tried if x.term.between or x.term.parts}

    def averaged(
        self, numbers: np.ndarray, away: np.ndarray, phases: np.ndarray, power: np.ndarray
    ) -> tuple[np.ndarray, list[Finding | None]]:
        """(P, 3, 3) what effects that the logs allow add to the covariance of each plate, in its errors, and
        what is said of it (`verdict.averaged`). `power` (P, logs): of the noise, over that of the cell."""
        spans = np.zeros((len(numbers), len(FREE), len(FREE)))
        said = list[Finding | None]([None] * len(numbers))
        if (here := self._spanned) is None:
            return spans, said
        size = 1 / size_of(self._sizes[here.at], away)
        own, loud = numbers[:, here.at], power[:, here.logs] * size**2
        share = here.each.likely(own, loud, self._here(phases)[:, here.tests].T)
        k, p = np.nonzero(share)
        shifts = here.moves[0][k] + np.einsum("ea,aeij->eij", away[p], here.moves[1:, k])
        shifts = shifts * size[p[:, None], here.each.places[k]][:, None]
        np.add.at(spans, p, share[k, p, None, None] * here.each.added((k, p), shifts, own, loud))
        for i in np.flatnonzero(np.max(np.einsum("pii->pi", spans), axis=1) >= WIDER**2 - 1).tolist():
            some = [
                (self._one(int(j), away[i], power[i]), here.each.own(own[i], j), float(share[j, i]))
                for j in k[p == i]
            ]
            hint = widest(some, FREE, self.views)
            said[i] = hint and hint.told(True)
        return spans, said

    def _one(self, k: int, away: np.ndarray, power: np.ndarray) -> Allowed:
        """The k-th effect that errors span, in the noise of a plate."""
        assert self._spanned is not None
        x = self.tried[self._spanned.tests[k]]
        return Allowed(x.term, x.at(away)).louder(power[x.term.log or 0])

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
    def _spanned(self) -> "_Spanned | None":
        tests = [k for k, x in enumerate(self.tried) if x.allowed is not None]
        if not tests:
            return None
        some = [self.tried[k] for k in tests]
        together, sizes = (
            Together.of([x.allowed for x in some if x.allowed]),
            [len(x.products) for x in some],
        )
        at = np.concatenate([self.begins[k] + np.arange(n) for k, n in zip(tests, sizes, strict=True)])
        logs = np.repeat([x.term.log or 0 for x in some], sizes)
        moves = [[x.scored.moves for x in some], *([x.moves[a] for x in some] for a in range(AXES))]
        beside = np.array([together.side_by_side(each) for each in moves])
        return _Spanned(np.array(tests), at, logs, together, beside)

    def _own(self, numbers: np.ndarray, k: int) -> np.ndarray:
        """(P, r) those of the k-th test."""
        return numbers[:, self.begins[k] :][:, : self.tried[k].scored.values.shape[1]]

    def why(self, name: str, temperature: float | None) -> str:
        """Why a parameter that is not free is not determined, at that temperature (degC)."""
        trials: Sequence[Trial] = self.trials
        if temperature is not None:
            trials = [
                replace(t, log=replace(t.log, temperature=np.full(len(t.log), temperature))) for t in trials
            ]
        return identify.why(name, trials, 1.0, FREE, 1)


class _Spanned(NamedTuple):
    """What errors span: of which test each effect is; of each of its numbers the place among those of all
    tests, and the log; and `moves` (1 + AXES, K, 3, r), what they move of G, tau and f0, in errors, and how
    that changes along the axes."""

    tests: np.ndarray
    at: np.ndarray
    logs: np.ndarray
    each: Together
    moves: np.ndarray


@on_rows()
def _products(xp: Any, rows: Rows, which: np.ndarray, weights: Rows) -> Rows:
    return rows[which] @ weights


def _uncovered(
    trials: Sequence[Trial], blocks: Sequence[Block], warnings: Sequence[str], logs: Sequence[Log]
) -> str:
    """Why logs of this layout are not read as the batch takes them; "" where they are."""
    if warnings:
        said = warnings[0]
        return next((said.removeprefix(f"{log.name}: ") for log in logs if said.startswith(log.name)), said)
    if reading.free(trials) != FREE:
        return "its logs may tell other parameters than G, tau and f0"
    for trial, block in zip(trials, blocks, strict=True):
        read = (
            *trial.shapes,
            *(("start",) if trial.start_free else ()),
            *(("late",) if trial.lateness else ()),
        )
        if sorted(read) != sorted(block.names) or len(trial.log) != block.response.shape[1]:
            return "its logs are read in another way"
        if (
            trial.steady != block.swept
            or trial.sideways != 1.0
            or not np.all(trial.there)
            or any(trial.steps)
        ):
            return "its logs are read in another way"
    return ""


def _undescribed(state: State, views: Sequence[LinearisedLog], reference: tuple[float, float]) -> str:
    """Why such plates are not for the batch, as far as their place in the logs tells; "" where they are."""
    f0 = reference[0] + state.named.f0
    if np.pi * f0 * state.tau < DOUBTFUL * LOW_Q:
        return "its Q is low"
    if flank.seen(state, reference) is not None:
        return "its resonance lies outside of all that was driven"
    if said := lone.resting(state, reference, FREE, None, views):
        return f"one reading decides {' and '.join(said)}"
    return ""
