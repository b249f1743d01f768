"""Which plates of a batch the full fit has to see, and why: noise that is not white and normal, and all that
the single fit looks for beside its model.

The noise is tried by score tests of one number each against what the single fit would take it for (colour,
outliers, levels that differ between the channels, noise that goes with the response or with its rate, noise
of the phase); where one is worth `WORTH` the single fit's own estimate decides. Colour and noise of the phase
are held to a little more. The rest is tried with `fleet.template`.
"""

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sysid.fleet import nodes
from sysid.fleet.arrays import Rows, on_rows, there
from sysid.fleet.batch import Batch, Reduced, both
from sysid.fleet.cells import Cells
from sysid.fleet.closed import Block, Step, column, column_of, made
from sysid.fleet.delayed import shares
from sysid.fleet.near import FREE, PHASES
from sysid.fleet.nodes import AXES
from sysid.fleet.plate import NOISES
from sysid.fleet.template import Template
from sysid.fleet.tests import Placed
from sysid.rows.rounding import DIGITS, REPEATED
from sysid.trials.noise import ODD, WORTH, apart, estimate, proportional, scatter_of_stamps, tails
from sysid.trials.residuals import BEGINS
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.gain_confounding import SEEN
from sysid.verdict.identify import limits
from sysid.verdict.immediate import FED
from sysid.verdict.immediate import SEEN as FELT
from sysid.verdict.linear import ENOUGH, MOVES

COLOUR, TAILS, APART, SHARE, STAMPS, PHASE = NOISES
# in log-likelihood, where chance would make more of it than of others: colour is one of half a dozen kinds,
# and the two numbers of a phase's noise are looked for only as a fit ends
LEAST = {COLOUR: WORTH + np.log(6), PHASE: ODD}


def residual(log: Reduced, step: np.ndarray) -> np.ndarray:
    """(P, n) of one log, in units of its noise."""
    along = log.along(step)
    along[:, log.block.bench] -= log.values(step)
    return made(log.block, along) / log.noise(step, log.values(step))[:, None]


def noise(block: Block, turn: np.ndarray, left: np.ndarray) -> dict[str, np.ndarray]:
    """What each other kind of noise is worth in log-likelihood, (P,), by residuals (P, n) with the rotation
    `turn` (P,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = () if block.swept else (column(block, 3),)
        found = _worth(column(block, 0), left, block.order, turn, *rate)
    kinds = (COLOUR, TAILS, APART, SHARE, *(() if block.swept else (STAMPS,)), PHASE)
    return dict(zip(kinds, map(np.asarray, found), strict=True))


@on_rows()
def _worth(xp: Any, model: Rows, left: np.ndarray, order: np.ndarray, turn: np.ndarray, *rates: Rows):
    """(P,) of each kind, the residual's rows taken in this `order`; of a response (P, n) that moves, by its
    rate as well."""
    across = phase_noise(xp, model * turn[:, None], left)
    left, model = left[:, order], model[:, order]
    n, square = left.shape[1], left.real**2 + left.imag**2
    total = square.sum(axis=1)
    share = [xp.sum((left[:, k:] * left[:, :-k].conj()).real, axis=1) / total for k in (1, 2)]
    colour = n * xp.maximum(xp.maximum(*share), 0.0) ** 2
    kurtosis = (xp.mean(square**2, axis=1) / (total / n) ** 2 - 2) * np.sqrt(n) / 2
    rare = xp.max(square, axis=1) * n / total - np.log(n)
    outliers = xp.maximum(0.5 * xp.maximum(kurtosis, 0.0) ** 2, rare)
    d, q = xp.sum(left.real**2, axis=1), xp.sum(left.imag**2, axis=1)
    differ = n * xp.log(total / (2 * xp.sqrt(d * q)))
    relative = square * (n / total)[:, None] - 1
    found = [colour, outliers, differ, _rising(xp, model, relative)]
    return [*found, *(_rising(xp, rate, relative) for rate in rates), across]


def _rising(xp: Any, size: Rows, relative: Rows) -> Rows:
    """(P,) worth of a power that rises with the square of a size (P, n)."""
    weight = size.real**2 + size.imag**2
    weight = weight - xp.mean(weight, axis=1, keepdims=True)
    score = xp.sum(weight * relative, axis=1) / xp.sqrt(xp.sum(weight**2, axis=1))
    return 0.5 * xp.maximum(score, 0.0) ** 2


def phase_noise(xp: Any, model: Rows, left: Rows) -> Rows:
    """(P,) worth of noise across the response in proportion to it, alone or in neighbours, over that along
    it."""
    turned = left * model.conj()
    across, along = turned.imag, turned.real
    worth = xp.zeros(len(left))
    for power in (across**2 - along**2, across[:, 1:] * across[:, :-1] - along[:, 1:] * along[:, :-1]):
        score = power.sum(axis=1) / xp.sqrt(xp.maximum(xp.sum(power**2, axis=1), 1e-300))
        worth = xp.maximum(worth, 0.5 * xp.maximum(score, 0.0) ** 2)
    return worth


@on_rows()
def _recorded(xp: Any, basis: Rows, scale: np.ndarray) -> Rows:
    """(P,) whether rows repeat the row before, share the largest or smallest value of a channel, or are
    recorded in steps; `scale` (P,): the largest response."""
    y = basis[:, -1]
    found = xp.any(y[:, 1:] == y[:, :-1], axis=1)
    for channel in (y.real, y.imag):
        ordered = xp.sort(channel, axis=1)
        same = ordered[:, 1:] - ordered[:, :-1] <= scale[:, None] * 10.0**-DIGITS
        found = found | same[:, 0] | same[:, -1] | (xp.mean(same, axis=1) > 1 - REPEATED)
    return found


def _confirmed(kind: str, block: Block, p: int, left: np.ndarray) -> bool:
    """Whether the single fit would take the residual (n,) of the p-th plate for noise of that kind as
    well."""
    order = block.order
    if kind == COLOUR:
        return estimate(left, block.clock, block.freedom)[1] > 0
    if kind == TAILS:
        return tails(left)[1] < 1
    if kind == APART:
        return apart(left, np.ones(len(left))) != 1
    if kind == SHARE:
        size = np.abs(column_of(block, 0, p)[order]) / block.scale[p]
        return proportional(left[order], size, np.ones(len(left)), False) > 0
    if kind == STAMPS and isinstance(block, Step):
        told = block.first + BEGINS - 1
        return scatter_of_stamps(left[told:], column_of(block, 3, p)[told:], block.spacing) > 0
    return True


def vague(batch: Batch) -> np.ndarray:
    """(P,) why the numbers of a plate are not for the table, as far as its own fit says, else ""; "not
    determined" where an error is larger than `identify.limits` let it be."""
    most = limits(1.0, 1.0)
    widest = np.stack(
        [np.full(len(batch.tau), most["G"]), np.full(len(batch.tau), most["tau"]), most["f0"] / batch.tau]
    )
    std = np.sqrt(np.einsum("pii->ip", batch.covariance))
    why = np.where(np.all(std <= widest, axis=0), "", "not determined").astype(object)
    if len(batch.logs) > 1:
        why[batch.hung[0]] = "a feedthrough and a lateness that may cancel"
    why[~batch.converged] = "not converged"
    return why


class Screened(NamedTuple):
    """Of each plate: why it goes to the full fit, "" where it need not, (P,); what effects that its logs
    allow add to its covariance, (P, 3, 3) in its errors, and what is said of these; what is to be warned of;
    and what they would not show."""

    why: np.ndarray
    spans: np.ndarray
    said: list[Finding | None]
    doubts: list[Finding | None]
    assumed: list[list[Assumed]]

    @classmethod
    def nothing(cls, batch: Batch) -> "Screened":
        """Of the plates of a batch."""
        count = len(batch.theta)
        said, doubts = (list[Finding | None]([None] * count) for _ in range(2))
        none: list[list[Assumed]] = [[] for _ in range(count)]
        return cls(np.full(count, "", object), np.zeros_like(batch.covariance), said, doubts, none)

    def look(self, template: Template, here: np.ndarray, at: Placed, std: np.ndarray, plates: int) -> None:
        """At these plates (p,) of all (P,), with the tests of a template as they are `at` their places; the
        errors `std` (P, 3) are of all."""
        for p, found in zip(here.tolist(), template.found(at, plates), strict=True):
            self.doubts[p] = template.doubt(found) if found else None
            if found and self.doubts[p] is None and not self.why[p]:
                self.why[p] = found[-1].name
        quiet = self.why[here] == ""
        here, at = here[quiet], at.of(quiet)
        self.spans[here], told = template.averaged(at)
        for p, finding, assumed in zip(here.tolist(), told, template.assumed(at, std[here]), strict=True):
            self.said[p], self.assumed[p] = finding, assumed


def screened(
    batch: Batch,
    lefts: Sequence[np.ndarray],
    cells: Cells,
    wider: np.ndarray | float = 1.0,
    plates: int = 1,
) -> Screened:
    """The plates of a batch, of so many `plates` of a run; `lefts`: the `residual` of each log; `wider` (P,
    3): the errors of G, tau and f0 by which harm is measured, over those of the fit."""
    why = np.full(len(batch.theta), "", object)

    def say(which: np.ndarray, reason: str) -> None:
        why[which & (why == "")] = reason

    say(~batch.converged, "not converged")
    if len(batch.logs) > 1:
        say(batch.hung[0], "a feedthrough and a lateness that may cancel")
    say(
        batch.hung[1] & (min(x.block.rest for x in batch.logs) < batch.tau),
        "an offset and a start that may cancel",
    )
    phases = []
    for log, turn, left in zip(batch.logs, batch.turns, lefts, strict=True):
        recorded = np.asarray(_recorded(log.block.basis, log.block.scale))
        say(recorded, "rows that repeat, or are recorded in steps")
        for kind, worth in noise(log.block, turn, left).items():
            some = surely(worth, LEAST.get(kind, WORTH), plates)
            for p in np.flatnonzero(some):
                some[p] = not np.isfinite(worth[p]) or _confirmed(kind, log.block, int(p), left[p])
            say(some, kind)
        quarter = np.angle(turn) / (0.5 * np.pi)
        phases.append(np.rint(PHASES * quarter).astype(int) % PHASES)
        for reason, which in _of_bench(batch, log, turn):
            say(which, reason)
    wider = wider + np.zeros((len(why), len(FREE)))
    found = _by_template(batch, lefts, np.stack(phases, axis=1), cells, wider, plates)
    return found._replace(why=np.where(why == "", found.why, why))


def surely(worth: np.ndarray, least: float, plates: int) -> np.ndarray:
    """(P,) what is `worth` so much in log-likelihood that it is no chance: of so many `plates` of a run
    chance gives k the logarithm of plates/k, where k of the batch alone have as much (Benjamini & Hochberg,
    J. R. Stat. Soc. B 57, 289, 1995). At the `least` as much as the single fit asks."""
    found = np.nan_to_num(worth, nan=np.inf)
    ordered = np.sort(found)[::-1]
    more = ordered >= np.maximum(np.log(plates / np.arange(1, len(found) + 1)), least)
    return found >= np.min(ordered[more], initial=np.inf)


def _by_template(
    batch: Batch,
    lefts: Sequence[np.ndarray],
    phases: np.ndarray,
    cells: Cells,
    wider: np.ndarray,
    plates: int,
) -> Screened:
    """By the single fit's own terms, of one of so many `plates`."""
    places, keys, rows = cells.places(batch), cells.keys(batch), None
    away, powers = (places - keys[:, :AXES]), cells.powers(batch, keys)
    found, placed = Screened.nothing(batch), dict[Template, tuple[list[np.ndarray], list[Placed]]]()
    std = np.sqrt(np.einsum("pii->pi", batch.covariance))
    late = [lateness(batch, k) for k, x in enumerate(batch.logs) if not x.block.swept]
    every = np.unique(keys, axis=0)
    # processes that begin at once go through new cells from either end, and make few of them twice
    for key in every if os.getpid() % 2 else every[::-1]:
        here, cell = np.flatnonzero(np.all(keys == key, axis=1)), cells.cell(key)
        if isinstance(cell, str):
            found.why[here] = cell
            continue
        if rows is None:
            each = [_rows(batch, k, left, cell.template.names[k]) for k, left in enumerate(lefts)]
            rows = there(np.concatenate(each, axis=1).astype(np.float32))
        share = cell.share(away[here] * nodes.turned(key))
        found.why[here] = cell.tests.refused[np.argmax(share, axis=1)]  # at the nearest node
        second = np.max(np.abs(np.tensordot(share, cell.tests.second, 1)), axis=(1, 2))
        for seconds, error in late:  # `misfit._very_late`
            seen = 0.5 * (seconds[here] / error[here]) ** 2 >= ENOUGH
            found.why[here[seen & (second * seconds[here] ** 2 > MOVES)]] = "late"
        which, parts = placed.setdefault(cell.template, ([], []))
        which.append(here)
        parts.append(cell.placed(rows, here, share, phases[here], powers[here], wider[here]))
    for template, (which, parts) in placed.items():
        found.look(template, np.concatenate(which), Placed.together(parts), std, plates)
    return found


def _rows(batch: Batch, k: int, left: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """The rows (P, R) of one log, in the plate's frame, and of the priors of the bench's columns of these
    names, as `LinearisedLog.recorded` has them."""
    log = batch.logs[k]
    back = batch.turns[k].conj() * np.exp(-1j * log.full(batch.step)[:, 3])
    values, turned, held = log.values(batch.step) * back[:, None] / log.prior, left * back[:, None], {}
    for name, value in zip(log.block.names, values.T, strict=True):
        sign = 1 if name == "late" else -1  # a lateness takes the rate off
        held[f"{name}_d"], held[f"{name}_q"] = sign * value.real, sign * value.imag
    nothing = np.zeros(len(left))
    priors = np.stack([held.get(name, nothing) for name in names], axis=1)
    return np.concatenate([turned.real, turned.imag, priors], axis=1)


def lateness(batch: Batch, k: int) -> tuple[np.ndarray, np.ndarray]:
    """(P,) how late the response of a step is, s, and the error of it."""
    log, turn = batch.logs[k], batch.turns[k]
    form = np.zeros_like(log.prior, complex)
    form[:, 1] = -turn.conj()
    return np.sum(form * log.values(batch.step), axis=1).real, log.error(form, batch.covariance)


def _of_bench(batch: Batch, log: Reduced, turn: np.ndarray):
    """What the bench's numbers of one log ask for: reasons, and the plates that they hold for."""
    values, theta = log.values(batch.step), batch.theta
    if log.block.swept:
        if len(batch.logs) == 1 and not log.block.timed:  # `through`, of which no other log tells more
            yield "a feedthrough that may be a delay", np.array([s is not None for s in shares(batch, 0)])
        return
    settled = np.exp(theta[:, 0]) * np.abs(log.block.drive)
    first, *_ = both(log, theta, turn, values, batch.covariance)
    if len(batch.logs) == 1:  # `immediate`
        share = np.abs(first) / np.abs(settled + first)
        form = np.zeros_like(values)
        form[:, 3] = turn.conj()
        yield (
            "a response that is there at once",
            (share > FED) & (np.abs(first) > FELT * log.error(form, batch.covariance)),
        )
    else:  # `gain_confounding.cancelling`
        _, worth = cancelling(batch, log, turn)
        yield "gain", worth >= ENOUGH + np.log(len(batch.logs))


def cancelling(batch: Batch, log: Reduced, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) the gain of a step relative to the other log if its feedthrough and its lateness cancel, 1 where
    no feedthrough is seen, and what that is worth (`gain_confounding.cancelling`); with the plant held."""
    values, held = log.values(batch.step), np.zeros_like(batch.covariance)
    first, left, error, _ = both(log, batch.theta, turn, values, held)
    form = np.zeros_like(values)
    form[:, 3] = turn.conj()
    seen = np.abs(first.real) >= SEEN * log.error(form, held)
    late = (turn.conj() * values[:, 1]).real / log.prior[:, 1]
    worth = 2 * np.log(np.abs(first) / error) - 0.5 * np.abs(left / error) ** 2 + 0.5 * late**2
    largest = np.max(np.abs(column(log.block, 0)), axis=1)
    return np.where(seen, 1 + first.real / largest, 1.0), np.where(seen, worth, -np.inf)
