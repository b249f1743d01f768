"""Logs of many plates that are recorded alike, in closed form with a leading axis of plates.

A log of P plates is a stack of complex columns (P, m, n) over its n rows: the response of the plate per unit
rotation, how it changes with the slow pole, what the bench may add, and what was recorded, last. A fit needs
of it only the Gram matrix (P, m, m) and, in terms of these columns, the derivatives by log G, log tau, f0 and
the rotation, and the residual: `look` gives these as rows (P, 5, m) of coefficients. The plant is that of the
single fit (`model.plant`).

Both kinds have: `names` of the numbers that the bench adds, whose columns are at `bench`, and their `prior`
(P, K); `scale` (P,) largest response; `freedom`; `order` (n,) in which rows are neighbours, and their
`clock`; `rest` s before the step; `middle` (P,) Hz, from which a detuning is counted. `timed`: it is stated
that nothing is late.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.fleet.arrays import Rows, on_rows, put, there
from sysid.model.plant import poles, steady

LOOSE = 10.0  # times the largest response: the prior of what the bench adds, as `Trial.looseness` has it
REGULAR = 1e-13  # of a diagonal that is scaled to one: keeps starts of silent logs finite
TWO_PI = 2 * np.pi


@dataclass(eq=False)
class Step:
    """A transient at one frequency: rest, then one level of the drive.

    `time` (n,) s; `row`: from whose time on the drive acts, so that later rows show it; `drive` (P,) V,
    `frequency` (P,) Hz, `response` (P, n). Columns: forced, by the pole, free, rate, one, driven, recorded.
    """

    time: np.ndarray
    row: int
    drive: np.ndarray
    frequency: np.ndarray
    response: np.ndarray = field(repr=False)
    timed: bool = False

    names = ("start", "late", "offset", "feedthrough")  # of the columns that the bench adds, at `bench`
    bench = slice(2, 6)
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
        columns = np.zeros((plates, 7, n), complex)
        columns[:, 4], columns[:, 6] = 1, self.response
        columns[:, 5, self.first :] = np.sign(self.drive)[:, None]
        self.columns: Rows = there(columns)

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by second differences away from the step."""
        away = np.abs(np.arange(len(self.time) - 2) - self.row) > 2
        return np.sqrt(np.asarray(_scatter(self.columns, np.flatnonzero(away), order=2)) / 12)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: behind the step y(t) - y(0) = p int y + c t + d, p the
        slow pole, linear in p, c and d."""
        found = np.asarray(_decaying(self.columns, self.since, first=self.first))
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
        numbers = np.stack([p, push, push / s.fast, value[:, 0] / turn, value[:, 1] / turn])
        self.columns = _driven(
            self.columns, numbers, self.elapsed, self.since, self.spacing, row=self.row, even=self.even
        )
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
        columns = np.zeros((plates, 6, n), complex)
        columns[:, 3], columns[:, 4] = sign, sign * away / np.max(np.abs(away))
        columns[:, 5] = self.response
        self.columns: Rows = there(columns)

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by third differences."""
        return np.sqrt(np.asarray(_scatter(self.columns, self.order, order=3)) / 40)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: y = (A + B u + C u^2)/(u - p) over the scaled frequency u,
        linear in p, A, B and C with the weights of the last pole."""
        centre, half = np.mean(self.points), 0.5 * np.ptp(self.points)
        pole = np.asarray(_peaked(self.columns, (self.points - centre) / half))
        tau = 1 / (TWO_PI * half * np.maximum(np.abs(pole.imag), 1e-6))
        theta = np.stack([np.zeros(len(tau)), np.log(tau), centre + half * pole.real], axis=1)
        self.look(theta, np.ones(len(tau), complex), np.zeros((len(tau), 2)))
        gain = np.asarray(_gain(self.columns))
        theta[:, 0] = np.log(np.maximum(np.abs(gain), 1e-300))
        return theta

    def look(self, theta: np.ndarray, turn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """As that of `Step`; the bench's columns are the same at every plate."""
        self.columns = _settled(self.columns, theta, self.drive, self.points)
        rows = np.zeros((len(theta), 5, 6), complex)
        for k in range(3):
            rows[:, k, k] = turn
        rows[:, 3, 0], rows[:, 4, 5], rows[:, 4, 0] = 1j * turn, 1, -turn
        return rows


Block = Step | Sweep


@on_rows()
def gram(xp: Any, columns: Rows) -> Rows:
    """(P, m, m) products of columns (P, m, n)."""
    return columns.conj() @ columns.swapaxes(1, 2)


@on_rows("order")
def _scatter(xp: Any, columns: Rows, rows: np.ndarray, *, order: int) -> Rows:
    """(P,) mean square of differences of what was recorded: of second ones at these rows, else of third ones
    of the rows in this order."""
    y = columns[:, -1]
    found = xp.diff(y, 2, axis=1)[:, rows] if order == 2 else xp.diff(y[:, rows], 3, axis=1)
    return xp.mean(xp.abs(found) ** 2, axis=1)


@on_rows("first")
def _decaying(xp: Any, columns: Rows, since: np.ndarray, *, first: int) -> Rows:
    """(P, 3) p, c and d of `Step.start`."""
    recorded = columns[:, -1]
    y = recorded[:, first:] - xp.mean(recorded[:, :first], axis=1, keepdims=True)
    step = xp.concatenate([0 * since[:1], since[1:] - since[:-1]])
    area = xp.cumsum(0.5 * step * (y + xp.concatenate([y[:, :1], y[:, :-1]], axis=1)), axis=1)
    shapes = xp.stack([area, xp.broadcast_to(since, y.shape) + 0j, xp.ones_like(y)], axis=1)
    return _least_squares(xp, shapes, y)


@on_rows("row", "even")
def _driven(
    xp: Any,
    columns: Rows,
    numbers: np.ndarray,
    elapsed: np.ndarray,
    since: np.ndarray,
    spacing: float,
    *,
    row: int,
    even: bool,
) -> Rows:
    """The columns of a step; `numbers` (5, P): the slow pole, what pushes it, what the fast one settles at,
    start and lateness in the plate's frame."""
    p, push, fast, start, late = numbers
    k = row + 1
    grown, before = _powers(xp, p, elapsed[:k], since, spacing, even)
    target = (push / p)[:, None]
    columns = put(columns, np.s_[:, 2, :k], before)
    columns = put(columns, np.s_[:, 2, k:], grown * xp.exp(p * elapsed[row])[:, None])
    rate, slow = push[:, None] * grown, target * grown - target
    columns = put(columns, np.s_[:, 3, k:], rate)
    columns = put(columns, np.s_[:, 0, k:], slow + fast[:, None])
    by_pole = rate * (1 / p + late)[:, None] * since - slow / p[:, None]  # of forced + late rate
    begun = start[:, None] * elapsed * columns[:, 2]
    return put(put(columns, np.s_[:, 1, :k], begun[:, :k]), np.s_[:, 1, k:], by_pole + begun[:, k:])


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
def _peaked(xp: Any, columns: Rows, u: np.ndarray) -> Rows:
    """(P,) the pole of `Sweep.start` over the scaled frequency."""
    y = columns[:, -1]
    shapes = xp.stack([y, *(xp.broadcast_to(u**k + 0j, y.shape) for k in range(3))], axis=1)
    weight, pole = xp.ones(y.shape), y[:, 0]
    for _ in range(4):
        pole = _least_squares(xp, shapes * weight[:, None], u * y * weight)[:, 0]
        weight = 1 / xp.maximum(xp.abs(u - pole[:, None]), 1e-3)
    return pole


@on_rows()
def _gain(xp: Any, columns: Rows) -> Rows:
    """(P,) by how much the response of a sweep exceeds its column, beside what the bench adds."""
    return _least_squares(xp, columns[:, np.array([0, 3, 4])], columns[:, -1])[:, 0]


@on_rows()
def _settled(xp: Any, columns: Rows, theta: np.ndarray, drive: np.ndarray, points: np.ndarray) -> Rows:
    """The columns of a sweep at theta (P, 3)."""
    tau, omega = xp.exp(theta[:, 1:2]), TWO_PI * points
    detuning = TWO_PI * (theta[:, 2:3] - points)
    amplitude = (xp.exp(theta[:, 0]) * drive)[:, None]
    forced = amplitude * steady(tau, detuning, omega, xp)
    # h = (1 + d/omega)/(1 - j x),  x = d (2 omega + d) tau/(2 omega)
    x = detuning * (2 * omega + detuning) / (2 * omega) * tau
    turned = 1j / (1 - 1j * x)
    by_f0 = TWO_PI * forced * (1 / (omega + detuning) + turned * (1 + detuning / omega) * tau)
    columns = put(columns, np.s_[:, 0], forced)
    return put(put(columns, np.s_[:, 1], forced * (x * turned)), np.s_[:, 2], by_f0)


def _least_squares(xp: Any, shapes: Rows, y: Rows) -> Rows:
    """(P, K) coefficients of shapes (P, K, n) in y (P, n), columns scaled to unit size."""
    size = xp.maximum(xp.linalg.norm(shapes, axis=2), 1e-300)
    unit = shapes / size[:, :, None]
    products = unit.conj() @ unit.swapaxes(1, 2) + REGULAR * xp.eye(unit.shape[1])
    return xp.linalg.solve(products, unit.conj() @ y[:, :, None])[:, :, 0] / size
