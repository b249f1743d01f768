"""What a clean plate looks like to the single fit: the score tests of all that its model leaves out.

A cell holds plates of one layout whose time constant, detuning and noise are nearly alike. For a plate in its
middle, simulated without noise, the single fit's own `terms` are linearised once (`linear.Linear.scored`);
the whitened residuals of all plates of the cell are then tried by one product of matrices. A residual is
orthogonal to what its own fit can adjust, so its chance is that of the single fit; a shape from the middle of
a cell finds nearly as much as the plate's own.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sysid import reading
from sysid.effects.clock import ROWS_LOST
from sysid.effects.effect import About
from sysid.effects.registry import ADOPTED, EVERY
from sysid.effects.sensor import SATURATIONS
from sysid.fleet.arrays import Rows, on_rows, one, padding, there
from sysid.fleet.closed import Block
from sysid.logs.log import Log
from sysid.minimum.minimise import DOUBTFUL, State
from sysid.model.plant import LOW_Q
from sysid.model.span import inverted
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial, with_noise
from sysid.verdict import flank, identify, lone
from sysid.verdict.averaged import Allowed, Kind, Together, spanned, widest
from sysid.verdict.coincidence import tightened
from sysid.verdict.conclusion import doubted, likeliest
from sysid.verdict.finding import Finding
from sysid.verdict.firstorder import of_effects
from sysid.verdict.linear import ENOUGH, PERHAPS, Found, Linear, Scored, chances_of
from sysid.verdict.term import Term, together
from sysid.verdict.terms import terms
from sysid.verdict.view import View

FREE = ("G", "tau", "f0")  # what a layout's logs determine
PHASES = 4  # of a quarter turn, by which channels that saturate each look different
NEARLY = 2.0  # of log-likelihood: a plate's own test may be worth so much more than its cell's
LITTLE = 0.01  # of an error's square, that an effect adds: less changes it by half a percent
LEAST = 0.125  # power of the noise of plates of a cell, over the cell's: of one of several logs
QUIET = 1e-3  # of the noise, that a simulated log has, so that it is read as one with noise
CHANNELS = {effect.name for effect in SATURATIONS}  # of which each may be off by itself
NUISANCES = tuple(name for name in EVERY if name not in ("thermometer", *ADOPTED))


@dataclass(frozen=True, eq=False)
class Trying:
    """One term with its test: by `chance` it is worth as much; `phase` (log, place) if only in logs whose
    rotation is near that; `allowed` where errors span it."""

    term: Term
    scored: Scored
    chance: float
    phase: tuple[int, int] | None = None
    allowed: Allowed | None = None

    @property
    def kind(self) -> Kind:
        return self.term.name, self.term.log

    def light(self) -> "Trying":
        """Without the arrays over the rows, which the template has side by side."""
        term = replace(self.term, shapes={})
        allowed = Allowed(term, self.scored) if spanned(term, self.scored, LEAST) else None
        return replace(self, term=term, allowed=allowed)


@dataclass(frozen=True, eq=False)
class Template:
    """The tests of a cell: `weights` (R, q) of all terms side by side, each from `begins`. `second`
    (logs, 3): by what G, tau and f0 move, in their errors, with the square (s^2) of a lateness. `refused`:
    why the batch does not cover such plates."""

    refused: str = ""
    trials: tuple[Trial, ...] = ()
    names: tuple[tuple[str, ...], ...] = ()  # of the bench's columns of each log
    tried: tuple[Trying, ...] = field(default=(), repr=False)
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    begins: np.ndarray = field(default_factory=lambda: np.zeros(0, int), repr=False)
    second: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), repr=False)
    views: tuple[View, ...] = field(default=(), repr=False)

    @classmethod
    def of(
        cls,
        logs: Sequence[Log],
        blocks: Sequence[Block],
        theta: np.ndarray,
        levels: Sequence[float],
        tight: bool,
    ) -> "Template":
        """Of the inputs of `logs`, whose `blocks` are of one plate at `theta` (3,), and noise of `levels`;
        `tight`: with the narrower priors of a feedthrough and a lateness."""
        models, rng = _models(blocks, theta), np.random.default_rng(0)
        simulated = [
            replace(log, response=m + QUIET * s * (rng.standard_normal((2, len(m))).T @ (1, 1j)))
            for log, m, s in zip(logs, models, levels, strict=True)
        ]
        trials, warnings = reading.trials(simulated, NUISANCES)
        if said := _uncovered(trials, blocks, warnings, logs):
            return cls(said, trials)
        state, views, reference = _state(theta, trials, models, levels, tight)
        if said := _undescribed(state, views, reference):
            return cls(said, trials)
        return cls._tried(state, views, reference, trials)

    @classmethod
    def _tried(
        cls,
        state: State,
        views: list[View],
        reference: tuple[float, float],
        trials: tuple[Trial, ...],
    ) -> "Template":
        fit, about = Linear(views, state, list(FREE), 0.0), About.of(state, reference)
        every = terms(views, FREE, about, 0.0)
        fit.look(every)
        alike = list(together([t for t in every if t.alike and fit.tells(t)])) if len(views) > 1 else []
        chances = [*chances_of(every), *(chances_of(alike, len(every)) if alike else ())]
        known: list[tuple[Term, float, tuple[int, int] | None]] = [
            (t, chance, None)
            for t, chance in zip([*every, *alike], chances, strict=True)
            if t.name not in CHANNELS or t.parts
        ]
        of_each = {(t.name, t.log): chance for t, chance in zip(every, chances, strict=False)}
        for i, view in enumerate(views):
            known += [(t, of_each[t.name, t.log], phase) for t, phase in _turned(i, view, about)]
        fit.look([t for t, _, phase in known if phase is not None])
        tried = [
            Trying(t, scored, chance, phase)
            for (t, chance, phase), scored in zip(known, fit.scored([t for t, *_ in known]), strict=True)
            if scored is not None
        ]
        weights = [fit.rows(x.term, x.scored) for x in tried]
        second = [
            fit.moved(i, v.observed((v.course.pole * v.course.rate)[None])[0]) for i, v in enumerate(views)
        ]
        return cls(
            trials=trials,
            names=tuple(tuple(c.name for c in v.columns) for v in views),
            tried=tuple(x.light() for x in tried),
            weights=np.concatenate(weights, axis=1),
            begins=np.cumsum([0, *(w.shape[1] for w in weights[:-1])]),
            second=np.array([[moves[name] for name in FREE] for moves in second]),
            views=tuple(views),
        )

    def concerned(self, numbers: np.ndarray, phases: np.ndarray, power: np.ndarray) -> list[int]:
        """Which tests decide what is said of a plate, by its `numbers` (q,), the place `phases` (logs,) of
        its rotations and the `power` (logs,) of its noise over the cell's; of rows that may be missing also
        those at the next places, as its own may be another row."""
        worth = 0.5 * np.add.reduceat(numbers**2, self.begins)
        near = (worth > self._chance + PERHAPS - NEARLY) & self._here(phases[None])[0]
        some = set(np.flatnonzero(near).tolist())
        (likely,) = self._likely(numbers[None], phases[None], power[None])
        for k, x, own, share in likely:
            if share * np.max(np.diag(x.spans(x.scored.moves, own))) > LITTLE:
                some.add(k)
        astray = {k for k in some if (source := self.tried[k].term.source) and source[0] in ROWS_LOST}
        beside = {k + step for k in astray for step in (-1, 1)} & set(range(len(self.tried)))
        return sorted(
            some | {k for k in beside if self.tried[k].kind in {self.tried[j].kind for j in astray}}
        )

    def numbers(self, rows: Rows, which: np.ndarray) -> np.ndarray:
        """(p, q) of all tests side by side, of these plates (p,), by the residuals (P, R) of all in the
        plate's frame, with those of the priors."""
        some = np.pad(which, (0, padding(len(which))), mode="edge")
        return np.asarray(_products(rows, some, self._weights))[: len(which)]

    @cached_property
    def _weights(self) -> Rows:
        return there(self.weights)

    def found(self, numbers: np.ndarray, phases: np.ndarray) -> list[list[Found]]:
        """What each plate's logs hold beside the model, or that would move its parameters far if they do, by
        the thresholds of `misfits`; `numbers` (P, q) of all tests, `phases` (P, logs): in which PHASES of a
        quarter turn each rotation is."""
        worth = 0.5 * np.add.reduceat(numbers**2, self.begins, axis=1)
        found: list[list[Found]] = [[] for _ in numbers]
        for p, k in zip(*np.nonzero((worth > self._chance + PERHAPS) & self._here(phases)), strict=True):
            x, u = self.tried[k], self._own(numbers, k)[p]
            certain = bool(worth[p, k] >= x.chance + ENOUGH)
            moves = dict(zip(FREE, (x.scored.moves @ u).tolist(), strict=True))
            said = x.term.say(x.scored.values @ u, x.scored.errors)
            new = Found(said or "", worth[p, k], moves, x.term.name, x.term.log, x.term.freedom, certain)
            if said is not None and (certain or new.harmful):
                found[p].append(new)
        return found

    def doubt(self, found: Sequence[Found], alike: bool = True) -> Finding | None:
        """What the single fit would warn of where a plate's logs hold these, none of them certain; None where
        it has to look closer, as at what one log has for itself, or several may have `alike`."""
        if any(f.certain or (f.name, f.log) in self._firm[alike] for f in found):
            return None
        likely = likeliest(sorted(found, key=lambda f: -f.worth))
        return next(iter(doubted(likely, [t.log.name for t in self.trials])), None)

    @cached_property
    def _firm(self) -> tuple[set[Kind], set[Kind]]:
        """What one log has for itself; and also what several may have alike."""
        own = {x.kind for x in self.tried if x.term.between}
        return own, own | {x.kind for x in self.tried if x.term.parts}

    def averaged(
        self, numbers: np.ndarray, phases: np.ndarray, power: np.ndarray
    ) -> tuple[np.ndarray, list[Finding | None]]:
        """(P, 3, 3) what effects that the logs allow add to the covariance of each plate, in its errors, and
        what is said of it (`verdict.averaged`). `power` (P, logs): of the noise, over that of the cell."""
        spans = np.zeros((len(numbers), len(FREE), len(FREE)))
        said = list[Finding | None]([None] * len(numbers))
        for p, likely in enumerate(self._likely(numbers, phases, power)):
            if likely:
                some = [x[1:] for x in likely]
                spans[p] = sum(share * x.spans(x.scored.moves, own) for x, own, share in some)
                hint = widest(some, FREE, self.views)
                said[p] = hint and hint.told(True)
        return spans, said

    def _likely(
        self, numbers: np.ndarray, phases: np.ndarray, power: np.ndarray
    ) -> list[list[tuple[int, Allowed, np.ndarray, float]]]:
        """Of each plate the effects that errors span: which test each is of, what it is in its noise, its
        numbers, and how likely it is."""
        found: list[list[tuple[int, Allowed, np.ndarray, float]]] = [[] for _ in numbers]
        if self._spanned is None:
            return found
        which, at, each = self._spanned
        own, share = numbers[:, at], each.likely(numbers[:, at], *self._allowed(phases, power))
        for k, p in zip(*np.nonzero(share), strict=True):
            x = each.each[k].louder(power[p, each.each[k].term.log or 0])
            found[p].append((int(which[each.begins[k]]), x, each.own(own[p], k), float(share[k, p])))
        return found

    def _allowed(self, phases: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, q) the noise of each of these numbers, (K, P) and which effects there may be, of plates of such
        rotations and noise (P, logs)."""
        assert self._spanned is not None
        which, _, each = self._spanned
        logs = np.array([x.term.log or 0 for x in self.tried])
        return power[:, logs[which]], self._here(phases)[:, which[each.begins]].T

    def shown(self, phases: np.ndarray, power: np.ndarray) -> dict[Kind, int]:
        """How many effects of each kind a plate's logs would show, of all that errors may span; `phases` and
        `power` as `concerned` has them."""
        if self._spanned is None:
            return {}
        each = self._spanned[2]
        there = each.there(*self._allowed(phases[None], power[None]))
        return dict(zip(each.kinds, (each.alike @ there)[:, 0].astype(int).tolist(), strict=True))

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
    def _spanned(self) -> tuple[np.ndarray, np.ndarray, Together] | None:
        """What errors span: of each of its numbers which test it is of, and where it stands."""
        tests = [k for k, x in enumerate(self.tried) if x.allowed is not None]
        if not tests:
            return None
        sizes = [self.tried[k].scored.values.shape[1] for k in tests]
        at = np.concatenate([self.begins[k] + np.arange(n) for k, n in zip(tests, sizes, strict=True)])
        return np.repeat(tests, sizes), at, Together.of([a for k in tests if (a := self.tried[k].allowed)])

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


@on_rows()
def _products(xp: Any, rows: Rows, which: np.ndarray, weights: Rows) -> Rows:
    return rows[which] @ weights


def _models(blocks: Sequence[Block], theta: np.ndarray) -> list[np.ndarray]:
    """The response of each log of the one plate of these blocks at `theta` (3,), without a bench."""
    for block in blocks:
        block.look(theta[None], np.ones(1, complex), np.zeros_like(block.prior, complex))
    return [np.array(one(block.columns, 0)[0]) for block in blocks]


def _state(
    theta: np.ndarray,
    trials: Sequence[Trial],
    models: Sequence[np.ndarray],
    levels: Sequence[float],
    tight: bool,
) -> tuple[State, list[View], tuple[float, float]]:
    """A minimum at `theta` (3,) with noise of these levels and the covariance that its logs leave, the logs
    there, and what frequencies and temperatures are counted from; `tight` as `Template.of` has it."""
    reference, at = reading.reference(trials), np.zeros(len(NAMES))
    at[:3] = theta - (0.0, 0.0, reference[0])
    trials = tuple(with_noise(t, s, 0.0) for t, s in zip(trials, levels, strict=True))
    state, views = _minimum(at, trials, models, reference)
    if tight:
        state, views = _minimum(at, tightened(state, reference, ("late",)), models, reference)
    return state, views, reference


def _minimum(
    theta: np.ndarray, trials: tuple[Trial, ...], models: Sequence[np.ndarray], reference: tuple[float, float]
) -> tuple[State, list[View]]:
    """That of these trials at theta."""
    covariance = np.zeros((len(NAMES), len(NAMES)))
    state = State(theta, covariance, trials, tuple(models), 0.0, 0.0, True, False, covariance)
    views = View.each(state, reference)
    jacobians = [v.jacobian[:, :3] for v in views]
    covariance[:3, :3] = inverted(sum(j.T @ j for j in jacobians))
    return replace(state, covariance=covariance, alone=covariance), views


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


def _undescribed(state: State, views: Sequence[View], reference: tuple[float, float]) -> str:
    """Why such plates are not for the batch, as far as their place in the logs tells; "" where they are."""
    f0 = reference[0] + state.named.f0
    if np.pi * f0 * state.tau < DOUBTFUL * LOW_Q:
        return "its Q is low"
    if flank.seen(state, reference) is not None:
        return "its resonance lies outside of all that was driven"
    if said := lone.resting(state, reference, FREE, None, views):
        return f"one reading decides {' and '.join(said)}"
    return ""


def _turned(i: int, view: View, about: About) -> list[tuple[Term, tuple[int, int] | None]]:
    """Effects of single channels of one log, in the plate's frame: they look different as the demodulator is
    turned, for each of PHASES rotations."""
    found: list[tuple[Term, tuple[int, int] | None]] = []
    turns, log, each = [np.exp(0.5j * np.pi * k / PHASES) for k in range(PHASES)], view.trial.log, []
    for turn in turns:
        turned = copy(view)
        turned.trial = replace(view.trial, log=log.again(turn * log.response))
        turned.model, turned.turn = turn * view.model, turn * view.turn
        turned.__dict__.pop("ideal", None), turned.__dict__.pop("base", None)
        each.append(
            [
                replace(t, shapes={i: turn.conjugate() * t.shapes[i]})
                for t in of_effects({i: turned}, about, SATURATIONS)
            ]
        )
    for same in zip(*each, strict=True):
        first = same[0].shapes[i]
        if np.allclose(same[1].shapes[i], first, rtol=0, atol=1e-9 * float(np.max(np.abs(first)))):
            found.append((same[0], None))
        else:
            found += [(t, (i, k)) for k, t in enumerate(same)]
    return found
