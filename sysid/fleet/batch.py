"""The fit of many plates that are recorded alike: the equations of the single fit with a leading axis of
plates P.

Each look at the rows is one Gram matrix of the columns of each log (`fleet.closed`). The bench's coefficients
are complex with an isotropic prior, and are eliminated in it,

    S = M - M_c (M_cc + sigma^2/prior^2)^-1 M_c^H,

the rotation after them; the sum over the logs gives a Gauss-Newton step of log G, log tau and f0. The noise
is that of the residual, sum of squares over degrees of freedom, and the covariance that of the single fit
(`minimum.minimise`). Where the error of G is that of a feedthrough and a lateness that cancel, their priors
are those of `verdict.gain_confounding`; where logs differ, errors are widened as in `verdict.differing`. A
log may have a real gain of its own with a normal prior, whose column is that of log G: it is eliminated
last.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sysid.fleet.closed import Block, gram
from sysid.minimum.minimise import NEAR, SHARE, SHORT
from sysid.trials.trial import FLOOR
from sysid.verdict.gain_confounding import MOSTLY

LOOKS = 6  # at the rows, at most
LEFT = 1e-2  # squared errors of a last step, which leaves their square
MOVED = 1e-3  # relative change of the noise in a last step, and in a round that no other follows


class Seen(NamedTuple):
    """A look at one log: the `rows` (P, 5, m) of `look`, and the products of these (P, 5, 5), of them with
    the bench's columns, (P, K, 5), and of those, (P, K, K)."""

    block: Block
    rows: np.ndarray
    plant: np.ndarray
    across: np.ndarray
    bench: np.ndarray

    @classmethod
    def of(cls, block: Block, products: np.ndarray, rows: np.ndarray) -> "Seen":
        """By the products (P, m, m) of the log's columns."""
        felt = products @ rows.swapaxes(1, 2)
        k = block.bench
        return cls(block, rows, rows.conj() @ felt, felt[:, k], products[:, k, k])


@dataclass(frozen=True, eq=False)
class Reduced:
    """One log at a linearisation, all but the plant eliminated: `information` (P, 3, 3) of log G, log tau and
    f0, the `slope` (P, 3) by which they rise, and what is needed to follow them. `left` (P,): sum of squares
    of the residual, with that of the priors. `gain` (P,): standard deviation of the prior of the log's own
    gain, 0 where it has none, which `follow` (P, 4) gives by the step and 1."""

    block: Block
    rows: np.ndarray = field(repr=False)  # (P, 5, m) as `look` gives them
    inverse: np.ndarray = field(repr=False)  # (P, K, K) of the bench's information times sigma^2
    pull: np.ndarray = field(repr=False)  # (P, K, 5) by which the bench's numbers follow the rows
    whole: np.ndarray = field(repr=False)  # (P, 5, 5) products of the rows, the bench eliminated
    std: np.ndarray = field(repr=False)
    prior: np.ndarray = field(repr=False)  # (P, K) of the bench's numbers
    information: np.ndarray
    slope: np.ndarray
    left: np.ndarray
    gain: np.ndarray
    follow: np.ndarray = field(repr=False)

    @classmethod
    def of(cls, seen: "Seen", std: np.ndarray, prior: np.ndarray, gain: np.ndarray) -> "Reduced":
        """With noise `std` (P,) and these priors."""
        inner = seen.bench.copy()
        diagonal = np.arange(inner.shape[1])
        inner[:, diagonal, diagonal] += (std[:, None] / prior) ** 2
        inverse = np.linalg.inv(inner)
        pull = inverse @ seen.across
        whole = (seen.plant - seen.across.conj().swapaxes(1, 2) @ pull).real
        both, follow, left = _of_plant(whole, std, gain)
        information, slope = both[:, :, :3], both[:, :, 3]
        return cls(
            seen.block, seen.rows, inverse, pull, whole, std, prior, information, slope, left, gain, follow
        )

    def without(self, *names: str) -> np.ndarray:
        """(P, 3, 3) the information without these numbers of the bench, as far as there are such."""
        ks = [k for k, name in enumerate(self.block.names) if name in names]
        if not ks:
            return self.information
        its, own = self.pull[:, ks], self.inverse[:, ks][:, :, ks]
        added = (np.swapaxes(its, 1, 2).conj() @ np.linalg.solve(own, its)).real
        return _of_plant(self.whole + added, self.std, self.gain)[0][:, :, :3]

    @property
    def freedom(self) -> np.ndarray:
        """(P,) degrees of freedom that the bench leaves."""
        return self.block.freedom - (self.gain > 0)

    def gained(self, step: np.ndarray) -> np.ndarray:
        """(P,) the log's own gain less 1 after the step (P, 3)."""
        return np.sum(self.follow[:, :3] * step, axis=1) + self.follow[:, 3]

    def full(self, step: np.ndarray) -> np.ndarray:
        """(P, 4) the step (P, 3), with the log's own gain, and that of the rotation beside it."""
        a, felt = self.whole, step.copy()
        felt[:, 0] += self.gained(step)
        turn = (a[:, 3, 4] - np.sum(a[:, 3, :3] * felt, axis=1)) / np.maximum(a[:, 3, 3], 1e-300)
        return np.concatenate([felt, turn[:, None]], axis=1)

    def along(self, step: np.ndarray) -> np.ndarray:
        """(P, m) coefficients of the columns in the residual after the step, but for the bench's."""
        return self.rows[:, 4] - np.sum(self.full(step)[:, :, None] * self.rows[:, :4], axis=1)

    def values(self, step: np.ndarray) -> np.ndarray:
        """(P, K) the bench's numbers after the step."""
        full = self.full(step)
        return self.pull[:, :, 4] - np.sum(self.pull[:, :, :4] * full[:, None], axis=2)

    def noise(self, step: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(P,) level per channel after the step."""
        gained = 2 * np.sum(step * self.slope, axis=1) - _form(self.information, step)
        held = np.sum(np.abs(values / self.prior) ** 2, axis=1)
        held = held + (self.gained(step) / np.where(self.gain > 0, self.gain, 1.0)) ** 2
        square = np.maximum(self.left - self.std**2 * (gained + held), 0.0)
        return np.maximum(np.sqrt(square / self.freedom), FLOOR * self.block.scale)

    def error(self, form: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """(P,) standard deviation per channel of a linear form (P, K) of the bench's numbers, with the plant
        of that covariance (P, 3, 3); of a log without a gain of its own."""
        a, square = self.whole, self.std**2
        turn = -a[:, 3, :3] / np.maximum(a[:, 3, 3], 1e-300)[:, None]  # that goes with the plant
        moves = (form[:, None] @ self.pull[:, :, :4])[:, 0]  # (P, 4)
        by_plant = moves[:, :3] + moves[:, 3:] * turn
        own = (form[:, None] @ self.inverse @ form.conj()[:, :, None]).real[:, 0, 0] * square
        plant = np.einsum("pi,pij,pj->p", by_plant, covariance, by_plant.conj()).real
        rotation = np.abs(moves[:, 3]) ** 2 * square / np.maximum(a[:, 3, 3], 1e-300)
        return np.sqrt(own + 0.5 * (plant + rotation))


@dataclass(frozen=True, eq=False)
class Batch:
    """The fits of P plates: `theta` (P, 3) of log G, log tau and f0 (Hz), their `covariance` by the
    likelihood, and each log at the last linearisation, whose `step` (P, 3) led there; `converged` (P,).
    `tight` (P,): with the narrower priors of a feedthrough and a lateness; `hung` (2, P): G is known no
    better than these that cancel, or than an offset and a start. `notes`: of each plate what there is to say
    of how it was fitted."""

    blocks: tuple[Block, ...]
    theta: np.ndarray
    covariance: np.ndarray
    logs: tuple[Reduced, ...]
    seen: tuple[Seen, ...] = field(repr=False)
    turns: tuple[np.ndarray, ...] = field(repr=False)
    step: np.ndarray = field(repr=False)
    converged: np.ndarray
    tight: np.ndarray
    hung: np.ndarray
    going: "_Going" = field(repr=False)
    notes: tuple[tuple[str, ...], ...] = ()

    @property
    def tau(self) -> np.ndarray:
        """(P,) s."""
        return np.exp(self.theta[:, 1])


def solved(information: np.ndarray) -> np.ndarray:
    """(P, 3, 3) inverse of information matrices, scaled to unit diagonal."""
    size = np.sqrt(np.maximum(np.einsum("pii->pi", information), 1e-300))
    both = size[:, :, None] * size[:, None]
    return np.linalg.inv(information / both + 1e-13 * np.eye(information.shape[1])) / both


def _of_plant(
    whole: np.ndarray, std: np.ndarray, gain: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By the products `whole` (P, 5, 5) of a log's rows those of the plant with itself and with what is left,
    (P, 3, 4), in its noise, the rotation and the log's own gain eliminated; that gain's `Reduced.follow`; and
    the sum of squares that is left."""
    turned = np.maximum(whole[:, 3, 3], 1e-300)
    rest = whole - whole[:, :, 3:4] * (whole[:, 3:4] / turned[:, None, None])
    both = rest[:, :3, [0, 1, 2, 4]] / (std**2)[:, None, None]
    own = both[:, 0]  # (P, 4) of the gain, with the plant and with what is left
    follow = (gain**2 / (1 + gain**2 * own[:, 0]))[:, None] * own
    both = both - own[:, :3, None] * follow[:, None]
    left = np.maximum(rest[:, 4, 4] - std**2 * follow[:, 3] * own[:, 3], 0.0)
    return both, follow * (-1, -1, -1, 1), left


def _sum(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.sum(parts, axis=0)


def _form(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (vector * (matrix @ vector[:, :, None])[:, :, 0]).sum(axis=1)


@dataclass(eq=False)
class _Going:
    """A fit as it goes on, of which each plate is followed until it is done, whatever the others are: theta,
    and for each log noise, rotation, the bench's numbers, their priors and that of its own gain; whether
    priors are `narrowed` where they are to be, and are `tight`."""

    theta: np.ndarray
    std: list[np.ndarray]
    turns: list[np.ndarray]
    values: list[np.ndarray]
    priors: list[np.ndarray]
    gains: Sequence[np.ndarray]
    narrowed: np.ndarray
    tight: np.ndarray

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> "_Going":
        """From the data; a sweep tells tau and f0 better than a step."""
        none = np.zeros(len(blocks[0].response), bool)
        return cls(
            next((b for b in blocks if b.swept), blocks[0]).start(),
            [np.maximum(b.noise(), FLOOR * b.scale) for b in blocks],
            [np.ones(len(none), complex) for _ in blocks],
            [np.zeros_like(b.prior, complex) for b in blocks],
            [b.prior for b in blocks],
            [np.zeros(len(none)) for _ in blocks],
            none,
            none,
        )

    def seen(self, blocks: Sequence[Block], first: bool) -> list[Seen]:
        """Each log here; at the `first` look the rotations are found."""
        rows = [b.look(self.theta, t, v) for b, t, v in zip(blocks, self.turns, self.values, strict=True)]
        products = [gram(b) for b in blocks]
        if first:
            self.turns = [_turned(b, m) for b, m in zip(blocks, products, strict=True)]
            for row, turn in zip(rows, self.turns, strict=True):  # with which only the response goes as yet
                row[:, :4] *= turn[:, None, None]
                row[:, 4, 0] *= turn
        return [Seen.of(*each) for each in zip(blocks, products, rows, strict=True)]

    def follow(self, logs: Sequence[Reduced], step: np.ndarray, which: np.ndarray) -> None:
        """The step of these plates."""
        for i, x in enumerate(logs):
            turned, values = self.turns[i] * np.exp(1j * np.clip(x.full(step)[:, 3], -1, 1)), x.values(step)
            self.std[i] = np.where(which, x.noise(step, values), self.std[i])
            self.turns[i] = np.where(which, turned, self.turns[i])
            self.values[i] = np.where(which[:, None], values, self.values[i])
        self.theta = np.where(which[:, None], self.theta + _short(step, self.theta), self.theta)


def fitted(blocks: Sequence[Block]) -> Batch:
    """Fit the plates of these blocks, one for each log, from no start values."""
    return _fitted(blocks, _Going.of(blocks), True)


def with_gains(batch: Batch, gains: Sequence[np.ndarray]) -> Batch:
    """The fits of a batch, whose columns they take over, of which each log has a gain of its own with a prior
    of this standard deviation (P,), 0 where it has none; plates without any stay as they are."""
    none = ~np.any(np.array(gains) > 0, axis=0)
    return _fitted(batch.blocks, replace(batch.going, gains=gains, narrowed=none), False)


def _fitted(blocks: Sequence[Block], going: _Going, first: bool) -> Batch:
    """The fits from there on."""
    for look in range(LOOKS):
        seen = going.seen(blocks, first and look == 0)
        logs, covariance, step, moved = _settled(seen, going, going.std)
        left = _left(logs, step)
        if np.any(near := (left < NEAR) & ~going.narrowed):
            going.narrowed = going.narrowed | near
            if np.any(near & (hung := confounds_gain(logs, "late")[0])):
                _tighten(going, logs, covariance, step, near & hung)
                logs, covariance, step, moved = _settled(seen, going, [x.std for x in logs])
                left = _left(logs, step)
        done = going.narrowed & (left < LEFT) & (moved < MOVED) & np.all(np.isfinite(step), axis=1)
        if np.all(done) or look == LOOKS - 1:
            break
        going.follow(logs, step, ~done)
    late, start = confounds_gain(logs, "late", "start")
    return Batch(
        tuple(blocks),
        going.theta + _short(step, going.theta),
        _informed(logs, covariance),
        tuple(logs),
        tuple(seen),
        tuple(going.turns),
        step,
        done,
        going.tight,
        np.stack([going.tight & late, start]),
        going,
    )


def _turned(block: Block, products: np.ndarray) -> np.ndarray:
    """The rotation that takes the response to what was recorded, beside what the bench's columns make of
    it."""
    k = block.bench
    inner = products[:, k, k] + 1e-9 * np.einsum("pii->p", products[:, k, k])[:, None, None] * np.eye(
        k.stop - k.start
    )
    along = products[:, 0, -1] - (products[:, :1, k] @ np.linalg.solve(inner, products[:, k, -1:]))[:, 0, 0]
    return along / np.maximum(np.abs(along), 1e-300)


def _settled(
    seen: Sequence[Seen], going: _Going, std: Sequence[np.ndarray]
) -> tuple[list[Reduced], np.ndarray, np.ndarray, np.ndarray]:
    """Each log reduced, in noise that begins at `std` and is followed once where it moves; the covariance,
    the step and by how much the noise still moves."""
    for again in (True, False):
        logs = [Reduced.of(*each) for each in zip(seen, std, going.priors, going.gains, strict=True)]
        covariance = solved(_sum([x.information for x in logs]))
        step = (covariance @ _sum([x.slope for x in logs])[:, :, None])[:, :, 0]
        found = [x.noise(step, x.values(step)) for x in logs]
        moved = np.max([np.abs(f / s - 1) for f, s in zip(found, std, strict=True)], axis=0)
        if not again or np.all(still := moved < MOVED):
            break
        std = [np.where(still, s, f) for f, s in zip(found, std, strict=True)]
    return logs, covariance, step, moved


def _left(logs: Sequence[Reduced], step: np.ndarray) -> np.ndarray:
    """(P,) squared errors that the step still goes."""
    return np.sum(step * _sum([x.slope for x in logs]), axis=1)


def _short(step: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The step, no longer than the derivatives are trusted: in log G, log tau and half bandwidths."""
    half = 1 / (2 * np.pi * np.exp(theta[:, 1]))
    size = np.max(
        np.abs(step) / np.stack([np.full(len(step), 3 * SHORT), np.full(len(step), 2 * SHORT), half], 1), 1
    )
    return step / np.maximum(size, 1.0)[:, None]


def confounds_gain(logs: Sequence[Reduced], *names: str) -> np.ndarray:
    """(names, P) whether the error of G is that of these of the bench's numbers, "late" and "start", as
    `gain_confounding` has it."""
    found = np.zeros((len(names), len(logs[0].information)), bool)
    some = {name for x in logs for name in x.block.names} & {"late", "start"}
    if some & set(names):
        least = solved(_sum([x.without(*some) for x in logs]))[:, 0, 0]
    for k, name in enumerate(names):
        if name in some:
            alone = solved(_sum([x.without(*(some - {name})) for x in logs]))[:, 0, 0]
            found[k] = least < MOSTLY**2 * alone
    return found


def both(log: Reduced, theta: np.ndarray, turn: np.ndarray, values: np.ndarray, covariance: np.ndarray):
    """Of a step the feedthrough in the plate's own frame, that less what the lateness adds, and the error of
    it (`gain_confounding._Both.of_step`); the rise (P,), by which the lateness counts."""
    rise, form = np.exp(theta[:, 0] - theta[:, 1]) * np.abs(log.block.drive), np.zeros_like(values)
    form[:, 3], form[:, 1] = turn.conj(), turn.conj() * rise
    return turn.conj() * values[:, 3], np.sum(form * values, axis=1), log.error(form, covariance), rise


def narrow(log: Reduced, sizes: Mapping[str, np.ndarray]) -> np.ndarray:
    """(P, K) the priors of a log, those of the bench's numbers by name no wider than `sizes` (P,)."""
    prior = log.prior.copy()
    for name, size in sizes.items():
        k = log.block.names.index(name)
        prior[:, k] = np.minimum(prior[:, k], size)
    return prior


def sized(left: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The size that a log shows of a feedthrough and a lateness that may cancel."""
    return np.sqrt(0.5 * np.abs(left) ** 2 + error**2)


def _tighten(
    going: _Going,
    logs: Sequence[Reduced],
    covariance: np.ndarray,
    step: np.ndarray,
    hung: np.ndarray,
) -> None:
    """Give these plates, whose G hangs on a lateness, the narrower priors of `gain_confounding.tightened`."""
    going.tight = going.tight | hung
    for i, (x, turn) in enumerate(zip(logs, going.turns, strict=True)):
        if not x.block.swept:
            turn = turn * np.exp(1j * x.full(step)[:, 3])
            _, left, error, rise = both(x, going.theta, turn, x.values(step), covariance)
            size = sized(left, error)
            tight = narrow(x, {"feedthrough": size, "late": size / rise})
            going.priors[i] = np.where(hung[:, None], tight, going.priors[i])


def _informed(logs: Sequence[Reduced], covariance: np.ndarray) -> np.ndarray:
    """The covariance, each log's information less the share of its residual that the plant has absorbed
    (`minimise._informed`)."""
    left = [
        1 - np.minimum(np.einsum("pij,pji->p", x.information, covariance) / x.freedom, SHARE) for x in logs
    ]
    return solved(_sum([f[:, None, None] * x.information for f, x in zip(left, logs, strict=True)]))
