"""Logs of many plates that are recorded alike, in closed form with a leading axis of plates.

A log of P plates is a stack of complex columns (P, m, n) over its n rows: the response of the plate per unit
rotation, how it changes with the slow pole, what the bench may add, and what was recorded, last. A fit needs
of it only the Gram matrix (P, m, m) and, in terms of these columns, the derivatives by log G, log tau, f0 and
the rotation, and the residual: `look` gives these as rows (P, 5, m) of coefficients. The plant is that of the
single fit (`model.plant`).

The columns are sums of a few, the `basis` (P, b, n), of which the first `moving` change with the plant and
the last is what was recorded. A matrix (P, b, m) of `mixes` says which, for each of the `parts` of the rows;
None where the basis is the columns. `still`: products of what does not change, part by part.

Both kinds have: `names` of the numbers that the bench adds, whose columns are at `bench`, and their `prior`
(P, K); `scale` (P,) largest response; `freedom`; `order` (n,) in which rows are neighbours, and their
`clock`; `rest` s before the step; `middle` (P,) Hz, from which a detuning is counted. `timed`: it is stated
that nothing is late.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.fleet.arrays import Rows, on_rows, one, put, there
from sysid.model.plant import poles, steady

LOOSE = 10.0  # times the largest response: the prior of what the bench adds, as `Trial.looseness` has it
REGULAR = 1e-13  # of a diagonal that is scaled to one: keeps starts of silent logs finite
TWO_PI = 2 * np.pi


@dataclass(eq=False)
class Step:
    """A transient at one frequency: rest, then one level of the drive.

    `time` (n,) s; `row`: from whose time on the drive acts, so that later rows show it; `drive` (P,) V,
    `frequency` (P,) Hz, `response` (P, n). Columns: forced, by the pole, free, rate, one, driven, recorded;
    sums, before the drive acts and behind, of exp(p t), t exp(p t), one and recorded.
    """

    time: np.ndarray
    row: int
    drive: np.ndarray
    frequency: np.ndarray
    response: np.ndarray = field(repr=False)
    timed: bool = False

    names = ("start", "late", "offset", "feedthrough")  # of the columns that the bench adds, at `bench`
    bench = slice(2, 6)
    moving = 2
    swept = False

    def __post_init__(self) -> None:
        plates, n = self.response.shape
        self.elapsed = self.clock = self.time - self.time[0]
        self.first = self.row + 1  # row that shows the drive
        self.since = self.elapsed[self.first :] - self.elapsed[self.row]
        self.rest, self.middle, self.order = float(self.elapsed[self.row]), self.frequency, np.arange(n)
        steps = np.diff(self.time)
        self.spacing = float(np.median(steps))
        self.even = bool(np.ptp(steps) < 1e-9 * self.elapsed[-1])
        self.scale = np.max(np.abs(self.response), axis=1)
        loose = LOOSE * self.scale
        lateness = np.hypot(0.0 if self.timed else self.spacing, 1 / (TWO_PI * self.frequency))
        self.prior = np.stack([loose, lateness, loose, loose], axis=1)
        self.freedom = 2 * n - 2 * len(self.names) - 1
        basis = np.empty((plates, 4, n), complex)
        basis[:, 2], basis[:, 3] = 1, self.response
        self.basis: Rows = there(basis)
        self.parts = (slice(0, self.first), slice(self.first, n))
        self.still = [_products(np, basis[:, 2:, part], basis[:, 2:, part]) for part in self.parts]
        self.mixes = [np.zeros((plates, 4, 7), complex) for _ in self.parts]
        for mix in self.mixes:
            mix[:, 2, 4] = mix[:, 3, 6] = 1
        self.mixes[1][:, 2, 5] = np.sign(self.drive)

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by second differences away from the step."""
        away = np.abs(np.arange(len(self.time) - 2) - self.row) > 2
        return np.sqrt(np.asarray(_scatter(self.basis, np.flatnonzero(away), order=2)) / 12)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: behind the step y(t) - y(0) = p int y + c t + d, p the
        slow pole, linear in p, c and d."""
        found = np.asarray(_decaying(self.basis, self.since, first=self.first))
        pole = found[:, 0]
        falls = pole.real < 0
        tau = np.where(falls, -1 / np.where(falls, pole.real, 1.0), 0.25 * self.since[-1])
        settled = np.abs(found[:, 1]) / np.maximum(np.abs(pole), 1e-300)
        gain = settled * np.abs(1 - 1j * pole.imag * tau) / np.abs(self.drive)
        return np.stack(
            [np.log(np.maximum(gain, 1e-300)), np.log(tau), self.frequency + pole.imag / TWO_PI], 1
        )

    def look(self, theta: np.ndarray, turn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Fill the columns at theta (P, 3) and give the rows of coefficients (P, 5, 7), with the rotation
        `turn` (P,) and the bench's numbers `value` (P, 4) held in the derivatives."""
        tau, omega = np.exp(theta[:, 1]), TWO_PI * self.frequency
        s = poles(tau, TWO_PI * (theta[:, 2] - self.frequency), omega, xp=np)
        p, push = s.slow, np.exp(theta[:, 0]) * self.drive * s.gain
        start, late, target = value[:, 0] / turn, value[:, 1] / turn, push / p
        self.basis = _growing(
            self.basis, p, self.elapsed, self.since, self.spacing, row=self.row, even=self.even
        )
        begun = np.exp(p * self.elapsed[self.row])
        before, behind = self.mixes
        before[:, 1, 1], before[:, 0, 2] = start, 1
        behind[:, 0, 0], behind[:, 2, 0] = target, push / s.fast - target
        behind[:, 1, 1] = push * (1 / p + late) + start * begun  # of forced + late rate + start free
        behind[:, 0, 1], behind[:, 2, 1] = start * begun * self.elapsed[self.row] - target / p, target / p
        behind[:, 0, 2], behind[:, 0, 3] = begun, push
        rows = np.zeros((len(p), 5, 7), complex)
        rows[:, 0, 0], rows[:, 0, 3] = turn, value[:, 1]
        rows[:, 1, 1], rows[:, 1, 0], rows[:, 1, 3] = turn / tau, -turn, -value[:, 1]
        rows[:, 2, 1], rows[:, 3, 0] = TWO_PI * 1j * turn, 1j * turn
        rows[:, 4, 6], rows[:, 4, 0] = 1, -turn
        return rows


@dataclass(eq=False)
class Sweep:
    """Settled points: `points` (n,) Hz, `drive` (P,) V, `response` (P, n). Columns: forced, by log tau, by
    f0, one, slope, recorded."""

    points: np.ndarray
    drive: np.ndarray
    response: np.ndarray = field(repr=False)
    timed: bool = False

    names = ("feedthrough", "slope")
    bench = slice(3, 5)
    moving = 3
    swept = True

    def __post_init__(self) -> None:
        plates, n = self.response.shape
        self.clock, self.rest = np.arange(n) * 1.0, np.inf
        self.order = np.argsort(self.points, kind="stable")
        self.middle = np.full(plates, np.mean(self.points))
        self.scale = np.max(np.abs(self.response), axis=1)
        away = self.points - np.mean(self.points)
        self.prior = np.repeat(LOOSE * self.scale[:, None], 2, axis=1)
        self.freedom = 2 * n - 2 * len(self.names) - 1
        sign = np.sign(self.drive)[:, None]
        basis = np.zeros((plates, 6, n), complex)
        basis[:, 3], basis[:, 4] = sign, sign * away / np.max(np.abs(away))
        basis[:, 5] = self.response
        self.basis: Rows = there(basis)
        self.parts, self.mixes = (slice(0, n),), (None,)
        self.still = [_products(np, basis[:, 3:], basis[:, 3:])]

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by third differences."""
        return np.sqrt(np.asarray(_scatter(self.basis, self.order, order=3)) / 40)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: y = (A + B u + C u^2)/(u - p) over the scaled frequency u,
        linear in p, A, B and C with the weights of the last pole."""
        centre, half = np.mean(self.points), 0.5 * np.ptp(self.points)
        pole = np.asarray(_peaked(self.basis, (self.points - centre) / half))
        tau = 1 / (TWO_PI * half * np.maximum(np.abs(pole.imag), 1e-6))
        theta = np.stack([np.zeros(len(tau)), np.log(tau), centre + half * pole.real], axis=1)
        self.look(theta, np.ones(len(tau), complex), np.zeros((len(tau), 2)))
        gain = np.asarray(_gain(self.basis))
        theta[:, 0] = np.log(np.maximum(np.abs(gain), 1e-300))
        return theta

    def look(self, theta: np.ndarray, turn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """As that of `Step`; the bench's columns are the same at every plate."""
        self.basis = _settled(self.basis, theta, self.drive, self.points)
        rows = np.zeros((len(theta), 5, 6), complex)
        for k in range(3):
            rows[:, k, k] = turn
        rows[:, 3, 0], rows[:, 4, 5], rows[:, 4, 0] = 1j * turn, 1, -turn
        return rows


Block = Step | Sweep


def gram(block: Block) -> np.ndarray:
    """(P, m, m) products of a log's columns."""
    found = []
    for part, still, mix in zip(block.parts, block.still, block.mixes, strict=True):
        new = np.asarray(_moving(block.basis, begin=part.start, end=part.stop, moving=block.moving))
        back = new[:, :, block.moving :].conj().swapaxes(1, 2)
        whole = np.concatenate([new, np.concatenate([back, still], axis=2)], axis=1)
        found.append(whole if mix is None else mix.conj().swapaxes(1, 2) @ (whole @ mix))
    return sum(found[1:], found[0])


def made(block: Block, coefficients: np.ndarray) -> np.ndarray:
    """(P, n) the sum of a log's columns with these coefficients (P, m)."""
    found = []
    for part, mix in zip(block.parts, block.mixes, strict=True):
        each = coefficients if mix is None else (mix @ coefficients[:, :, None])[:, :, 0]
        found.append(np.asarray(_made(block.basis, each, begin=part.start, end=part.stop)))
    return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


def column(block: Block, k: int) -> np.ndarray:
    """(P, n) the k-th of a log's columns."""
    return made(block, np.tile(np.eye(block.bench.stop + 1, dtype=complex)[k], (len(block.drive), 1)))


def column_of(block: Block, k: int, p: int) -> np.ndarray:
    """(n,) the same of the p-th plate alone."""
    rows, unit = np.asarray(one(block.basis, p)), np.eye(block.bench.stop + 1, dtype=complex)[k]
    each = zip(block.parts, block.mixes, strict=True)
    return np.concatenate([(unit if mix is None else mix[p] @ unit) @ rows[:, part] for part, mix in each])


@on_rows("begin", "end", "moving")
def _moving(xp: Any, basis: Rows, *, begin: int, end: int, moving: int) -> Rows:
    return _products(xp, basis[:, :moving, begin:end], basis[:, :, begin:end])


def _products(xp: Any, a: Rows, b: Rows) -> Rows:
    """(P, i, j) of rows (P, i, n) and (P, j, n)."""
    return a.conj() @ b.swapaxes(1, 2)


@on_rows("begin", "end")
def _made(xp: Any, basis: Rows, each: np.ndarray, *, begin: int, end: int) -> Rows:
    return (each[:, None] @ basis[:, :, begin:end])[:, 0]


@on_rows("order")
def _scatter(xp: Any, basis: Rows, rows: np.ndarray, *, order: int) -> Rows:
    """(P,) mean square of differences of what was recorded: of second ones at these rows, else of third ones
    of the rows in this order."""
    y = basis[:, -1]
    found = xp.diff(y, 2, axis=1)[:, rows] if order == 2 else xp.diff(y[:, rows], 3, axis=1)
    return xp.mean(found.real**2 + found.imag**2, axis=1)


@on_rows("first")
def _decaying(xp: Any, basis: Rows, since: np.ndarray, *, first: int) -> Rows:
    """(P, 2) p and c of `Step.start`."""
    recorded = basis[:, -1]
    y = recorded[:, first:] - xp.mean(recorded[:, :first], axis=1, keepdims=True)
    step = xp.concatenate([0 * since[:1], since[1:] - since[:-1]])
    area = xp.cumsum(0.5 * step * (y + xp.concatenate([y[:, :1], y[:, :-1]], axis=1)), axis=1)
    line, _ = xp.linalg.qr(xp.stack([since / since[-1], xp.ones_like(since)], axis=1))  # of c and d
    both = xp.stack([area, y], axis=1)
    straight = both @ (line + 0j)
    bent = _products(xp, both[:, :1], both)[:, 0] - _products(xp, straight[:, :1], straight)[:, 0]
    pole = bent[:, 1] / xp.maximum(bent[:, 0].real, 1e-300)
    left = straight[:, 1] - pole[:, None] * straight[:, 0]  # in terms of the line's columns
    ends = left @ (line[-1] - line[0])
    return xp.stack([pole, ends / (since[-1] - since[0])], axis=1)


@on_rows("row", "even")
def _growing(
    xp: Any,
    basis: Rows,
    pole: np.ndarray,
    elapsed: np.ndarray,
    since: np.ndarray,
    spacing: float,
    *,
    row: int,
    even: bool,
) -> Rows:
    """The basis of a step with exp(p t) and t exp(p t), t since the first row and, behind `row`, since the
    drive acts."""
    k = row + 1
    grown, before = _powers(xp, pole, elapsed[:k], since, spacing, even)
    basis = put(put(basis, np.s_[:, 0, :k], before), np.s_[:, 0, k:], grown)
    return put(basis, np.s_[:, 1], basis[:, 0] * xp.concatenate([elapsed[:k], since]))


def _powers(
    xp: Any, pole: Rows, elapsed: np.ndarray, since: np.ndarray, spacing: float, even: bool
) -> tuple[Rows, Rows]:
    """exp(p t) since the drive acts, (P, n - k), and from the first row to it, (P, k). On an even grid
    products of a coarse and a fine one."""
    if not even:
        return xp.exp(pole[:, None] * since), xp.exp(pole[:, None] * elapsed)
    n = max(len(since), len(elapsed))
    fine = int(np.ceil(np.sqrt(n)))
    near = xp.exp(pole[:, None] * (spacing * np.arange(fine)))
    far = xp.exp(pole[:, None] * (spacing * fine * np.arange(-(-n // fine))))
    every = (far[:, :, None] * near[:, None]).reshape(len(pole), -1)
    return every[:, : len(since)] * near[:, 1:2], every[:, : len(elapsed)]


@on_rows()
def _peaked(xp: Any, basis: Rows, u: np.ndarray) -> Rows:
    """(P,) the pole of `Sweep.start` over the scaled frequency."""
    y = basis[:, -1]
    shapes = xp.stack([y, *(xp.broadcast_to(u**k + 0j, y.shape) for k in range(3))], axis=1)
    weight, pole = xp.ones(y.shape), y[:, 0]
    for _ in range(4):
        pole = _least_squares(xp, shapes * weight[:, None], u * y * weight)[:, 0]
        weight = 1 / xp.maximum(xp.abs(u - pole[:, None]), 1e-3)
    return pole


@on_rows()
def _gain(xp: Any, basis: Rows) -> Rows:
    """(P,) by how much the response of a sweep exceeds its column, beside what the bench adds."""
    return _least_squares(xp, basis[:, np.array([0, 3, 4])], basis[:, -1])[:, 0]


@on_rows()
def _settled(xp: Any, basis: Rows, theta: np.ndarray, drive: np.ndarray, points: np.ndarray) -> Rows:
    """The basis of a sweep at theta (P, 3)."""
    tau, omega = xp.exp(theta[:, 1:2]), TWO_PI * points
    detuning = TWO_PI * (theta[:, 2:3] - points)
    amplitude = (xp.exp(theta[:, 0]) * drive)[:, None]
    forced = amplitude * steady(tau, detuning, omega, xp)
    # h = (1 + d/omega)/(1 - j x),  x = d (2 omega + d) tau/(2 omega)
    x = detuning * (2 * omega + detuning) / (2 * omega) * tau
    turned = 1j / (1 - 1j * x)
    by_f0 = TWO_PI * forced * (1 / (omega + detuning) + turned * (1 + detuning / omega) * tau)
    basis = put(basis, np.s_[:, 0], forced)
    return put(put(basis, np.s_[:, 1], forced * (x * turned)), np.s_[:, 2], by_f0)


def _least_squares(xp: Any, shapes: Rows, y: Rows) -> Rows:
    """(P, K) coefficients of shapes (P, K, n) in y (P, n), columns scaled to unit size."""
    size = xp.maximum(xp.linalg.norm(shapes, axis=2), 1e-300)
    unit = shapes / size[:, :, None]
    products = unit.conj() @ unit.swapaxes(1, 2) + REGULAR * xp.eye(unit.shape[1])
    return xp.linalg.solve(products, unit.conj() @ y[:, :, None])[:, :, 0] / size
