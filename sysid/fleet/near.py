"""What the single fit tries of a plate in one place: each term with its score test, linearised about a plate
that is simulated there, nearly without noise."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid import reading
from sysid.effects.effect import About
from sysid.effects.registry import ADOPTED, EVERY
from sysid.effects.sensor import SATURATIONS
from sysid.fleet.closed import Block, column
from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.model.plant import LOW_Q
from sysid.model.span import inverted
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial, with_noise
from sysid.verdict import flank, lone
from sysid.verdict.averaged import Allowed, Hidden, spanned
from sysid.verdict.firstorder import hidden, of_effects
from sysid.verdict.linear import Linear, Scored, chances_of
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Kind, Term, together
from sysid.verdict.terms import terms

FREE = ("G", "tau", "f0")  # what a layout's logs determine
NUISANCES = tuple(name for name in EVERY if name not in ("thermometer", *ADOPTED))
PHASES = 4  # of a quarter turn, by which channels that saturate each look different
QUIET = 1e-3  # of the noise, that a simulated log has, so that it is read as one with noise
CHANNELS = {effect.name for effect in SATURATIONS}  # of which each may be off by itself


@dataclass(frozen=True, eq=False)
class Trying:
    """One term with its test: by `chance` it is worth as much, if it may show at all; `phase` (log, place)
    if only in logs whose rotation is near that; `allowed` where errors span it."""

    term: Term
    scored: Scored
    chance: float
    phase: tuple[int, int] | None = None
    allowed: Allowed | None = None

    @property
    def kind(self) -> Kind:
        return self.term.kind

    @property
    def place(self) -> tuple:
        """By which it is the same in plates that are nearly alike."""
        source, parts = self.term.source, tuple(t.log for t in self.term.parts)
        return *self.kind, self.phase, parts, None if source is None else (source[0].name, source[1])

    def light(self) -> "Trying":
        """Without the arrays over the rows, which cells have side by side."""
        term = replace(self.term, shapes=dict.fromkeys(self.term.shapes, np.zeros(0)))
        allowed = Allowed(term, self.scored) if spanned(term) and self.chance < np.inf else None
        return replace(self, term=term, allowed=allowed)


class Near(NamedTuple):
    """All that is tried of plates in one place: the linearised fit there, each term with its chance, and the
    logs; and what these hide whole, as the plant and the bench make up for it."""

    fit: Linear
    tried: list[Trying]
    views: list[LinearisedLog]
    whole: list[Hidden]

    @classmethod
    def of(cls, state: State, views: list[LinearisedLog], reference: tuple[float, float]) -> "Near":
        """Of the logs at a minimum."""
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
            plain = [t for t in every if t.name in CHANNELS and t.log == i]
            known += [(t, of_each[t.name, t.log], phase) for t, phase in _turned(i, view, about, plain)]
        fit.look([t for t, _, phase in known if phase is not None])
        known += [(t, np.inf, None) for t in hidden(dict(enumerate(views)), about)]
        scored = list(zip(known, fit.scored([t for t, *_ in known]), strict=True))
        whole = [Hidden(t, *fit.usually(t)) for (t, *_), s in scored if not s and t.shown_by]
        return cls(fit, [Trying(t, s, chance, phase) for (t, chance, phase), s in scored if s], views, whole)


def products_of(weights: np.ndarray) -> np.ndarray:
    """(q, T) of rows (k, N, q) at N nodes their products with one another, each pair of nodes once."""
    rows = weights.transpose(2, 1, 0)
    one, other = np.triu_indices(rows.shape[1])
    return (rows @ rows.swapaxes(1, 2))[:, one, other] * np.where(one == other, 1, 2)


def size_of(products: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(P, q) size of rows with these products (q, T), of which the nodes have a share (P, N)."""
    one, other = np.triu_indices(share.shape[1])
    return np.sqrt(np.maximum((share[:, one] * share[:, other]) @ products.T, 1e-300))


def matched(middle: Near, other: Near) -> list[Term | None]:
    """Of what is tried in the middle the same beside it, each in its place; None where there is none."""
    left: dict[tuple, list[Term]] = {}
    for x in other.tried:
        left.setdefault(x.place, []).append(x.term)
    return [left[x.place].pop(0) if left.get(x.place) else None for x in middle.tried]


def near_at(
    logs: Sequence[Log], blocks: Sequence[Block], theta: np.ndarray, narrow: float, levels: Sequence[float]
) -> "tuple[Near | None, str]":
    """What is tried of a plate with the inputs of `logs`, whose `blocks` are of one plate, at theta (3,) in
    noise of `levels`; `narrow`: the width of the prior of a feedthrough that may cancel a lateness (inf: as
    it is). Why the batch does not cover such plates, "" where it does."""
    models = models_at(blocks, theta)
    read, warnings = reading.trials(simulated(logs, models, levels), NUISANCES)
    if said := _uncovered(read, blocks, warnings, logs):
        return None, said
    state, views, reference = state_at(theta, narrowed(read, theta, narrow), models, levels)
    return Near.of(state, views, reference), _undescribed(state, views, reference)


def simulated(logs: Sequence[Log], models: Sequence[np.ndarray], levels: Sequence[float]) -> list[Log]:
    """The logs as if they were of these models, nearly without noise."""
    rng = np.random.default_rng(0)
    return [
        replace(log, response=m + QUIET * s * (rng.standard_normal((2, len(m))).T @ (1, 1j)))
        for log, m, s in zip(logs, models, levels, strict=True)
    ]


def models_at(blocks: Sequence[Block], theta: np.ndarray) -> list[np.ndarray]:
    """The response of each log of the one plate of these blocks at `theta` (3,), without a bench."""
    for block in blocks:
        block.look(theta[None], np.ones(1, complex), np.zeros_like(block.prior, complex))
    return [column(block, 0)[0] for block in blocks]


def narrowed(trials: Sequence[Trial], theta: np.ndarray, narrow: float) -> tuple[Trial, ...]:
    """The trials with a feedthrough and a lateness of a step no wider than that
    (`gain_confounding.tightened`)."""
    if narrow == np.inf:
        return tuple(trials)
    found = []
    for trial in trials:
        rise = np.exp(theta[0] - theta[1]) * np.max(np.abs(trial.inputs.drive))
        sizes = {} if trial.steady else {"feedthrough": narrow, "lateness": narrow / rise}
        found.append(trial.with_bench(narrow=sizes))
    return tuple(found)


def state_at(
    theta: np.ndarray, trials: Sequence[Trial], models: Sequence[np.ndarray], levels: Sequence[float]
) -> tuple[State, list[LinearisedLog], tuple[float, float]]:
    """A minimum at `theta` (3,) with noise of these levels and the covariance that its logs leave, the logs
    there, and what frequencies and temperatures are counted from."""
    reference, at = reading.reference(trials), np.zeros(len(NAMES))
    at[:3] = theta - (0.0, 0.0, reference[0])
    trials = tuple(with_noise(t, s, 0.0) for t, s in zip(trials, levels, strict=True))
    return *_minimum(at, trials, models, reference), reference


def _minimum(
    theta: np.ndarray, trials: tuple[Trial, ...], models: Sequence[np.ndarray], reference: tuple[float, float]
) -> tuple[State, list[LinearisedLog]]:
    """That of these trials at theta."""
    covariance = np.zeros((len(NAMES), len(NAMES)))
    state = State(theta, covariance, trials, tuple(models), 0.0, 0.0, True, False, covariance)
    views = LinearisedLog.each(state, reference)
    jacobians = [v.jacobian[:, :3] for v in views]
    covariance[:3, :3] = inverted(sum(j.T @ j for j in jacobians))
    return replace(state, covariance=covariance, alone=covariance), views


def _turned(
    i: int, view: LinearisedLog, about: About, plain: list[Term]
) -> list[tuple[Term, tuple[int, int] | None]]:
    """Effects of single channels of one log, in the plate's frame: they look different as the demodulator is
    turned, for each of PHASES rotations; `plain` as it is."""
    found: list[tuple[Term, tuple[int, int] | None]] = []
    log, each = view.trial.log, [plain]
    for turn in [np.exp(0.5j * np.pi * k / PHASES) for k in range(1, PHASES)]:
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
    q = np.pi * (reference[0] + state.named.f0) * state.tau
    if q < LOW_Q:
        return "its Q is low"
    if flank.seen(state, reference) is not None:
        return "its resonance lies outside of all that was driven"
    if said := lone.resting(state, reference, FREE, None, views):
        return f"one reading decides {' and '.join(said)}"
    return ""
