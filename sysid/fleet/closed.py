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

import numpy as np

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
        self.columns = np.zeros((plates, 7, n), complex)
        self.columns[:, 4], self.columns[:, 6] = 1, self.response
        self.columns[:, 5, self.first :] = np.sign(self.drive)[:, None]

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by second differences away from the step."""
        second = np.diff(self.response, 2, axis=1)
        away = np.abs(np.arange(second.shape[1]) - self.row) > 2
        return np.sqrt(np.mean(np.abs(second[:, away]) ** 2, axis=1) / 12)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: behind the step y(t) - y(0) = p int y + c t + d, p the
        slow pole, linear in p, c and d."""
        y = self.response[:, self.first :] - np.mean(self.response[:, : self.first], axis=1, keepdims=True)
        step = np.diff(self.since, prepend=self.since[0])
        area = np.cumsum(0.5 * step * (y + np.concatenate([y[:, :1], y[:, :-1]], axis=1)), axis=1)
        shapes = np.stack([area, np.broadcast_to(self.since, y.shape) + 0j, np.ones_like(y)], axis=1)
        found = _least_squares(shapes, y)
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
        grown, before = self._powers(p)
        c, k, target = self.columns, self.first, (push / p)[:, None]
        c[:, 2, :k] = before
        np.multiply(grown, np.exp(p * self.elapsed[self.row])[:, None], out=c[:, 2, k:])
        rate = np.multiply(push[:, None], grown, out=c[:, 3, k:])
        slow = target * grown - target
        np.add(slow, (push / s.fast)[:, None], out=c[:, 0, k:])
        start, late = value[:, 0] / turn, value[:, 1] / turn
        by_pole = c[:, 1, k:]  # of forced + start free + late rate
        np.multiply(rate, (1 / p + late)[:, None], out=by_pole)
        by_pole *= self.since
        by_pole -= slow / p[:, None]
        c[:, 1, :k] = 0
        c[:, 1] += start[:, None] * self.elapsed * c[:, 2]
        rows = np.zeros((len(p), 5, 7), complex)
        rows[:, 0, 0], rows[:, 0, 3] = turn, value[:, 1]
        rows[:, 1, 1], rows[:, 1, 0], rows[:, 1, 3] = turn / tau, -turn, -value[:, 1]
        rows[:, 2, 1], rows[:, 3, 0] = TWO_PI * 1j * turn, 1j * turn
        rows[:, 4, 6], rows[:, 4, 0] = 1, -turn
        return rows

    def _powers(self, pole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """exp(p t) since the drive acts, (P, n - k), and from the first row to it, (P, k). On an even grid
        products of a coarse and a fine one."""
        if not self.even:
            return np.exp(pole[:, None] * self.since), np.exp(pole[:, None] * self.elapsed[: self.first])
        n = max(len(self.since), self.first)
        fine = int(np.ceil(np.sqrt(n)))
        near = np.exp(pole[:, None] * (self.spacing * np.arange(fine)))
        far = np.exp(pole[:, None] * (self.spacing * fine * np.arange(-(-n // fine))))
        every = (far[:, :, None] * near[:, None]).reshape(len(pole), -1)
        return every[:, : len(self.since)] * near[:, 1:2], every[:, : self.first]


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
        self.columns = np.zeros((plates, 6, n), complex)
        self.columns[:, 3], self.columns[:, 4] = sign, sign * away / np.max(np.abs(away))
        self.columns[:, 5] = self.response

    def noise(self) -> np.ndarray:
        """(P,) level of white noise per channel, by third differences."""
        third = np.diff(self.response[:, self.order], 3, axis=1)
        return np.sqrt(np.mean(np.abs(third) ** 2, axis=1) / 40)

    def start(self) -> np.ndarray:
        """(P, 3) log G, log tau, f0 from the data: y = (A + B u + C u^2)/(u - p) over the scaled frequency u,
        linear in p, A, B and C with the weights of the last pole."""
        centre, half, y = np.mean(self.points), 0.5 * np.ptp(self.points), self.response
        u = (self.points - centre) / half
        shapes = np.stack([y, *(np.broadcast_to(u**k + 0j, y.shape) for k in range(3))], axis=1)
        weight = np.ones((len(y), len(u)))
        for _ in range(4):
            pole = _least_squares(shapes * weight[:, None], u * y * weight)[:, 0]
            weight = 1 / np.maximum(np.abs(u - pole[:, None]), 1e-3)
        tau = 1 / (TWO_PI * half * np.maximum(np.abs(pole.imag), 1e-6))
        theta = np.stack([np.zeros(len(y)), np.log(tau), centre + half * pole.real], axis=1)
        self.look(theta, np.ones(len(y), complex), np.zeros((len(y), 2)))
        gain = _least_squares(self.columns[:, [0, 3, 4]], y)[:, 0]
        theta[:, 0] = np.log(np.maximum(np.abs(gain), 1e-300))
        return theta

    def look(self, theta: np.ndarray, turn: np.ndarray, value: np.ndarray) -> np.ndarray:
        """As that of `Step`; the bench's columns are the same at every plate."""
        tau, omega = np.exp(theta[:, 1:2]), TWO_PI * self.points
        detuning = TWO_PI * (theta[:, 2:3] - self.points)
        c, amplitude = self.columns, (np.exp(theta[:, 0]) * self.drive)[:, None]
        np.multiply(amplitude, steady(tau, detuning, omega, np), out=c[:, 0])
        # h = (1 + d/omega)/(1 - j x),  x = d (2 omega + d) tau/(2 omega)
        x = detuning * (2 * omega + detuning) / (2 * omega) * tau
        turned = 1j / (1 - 1j * x)
        np.multiply(c[:, 0], x * turned, out=c[:, 1])
        np.multiply(
            TWO_PI * c[:, 0], 1 / (omega + detuning) + turned * (1 + detuning / omega) * tau, out=c[:, 2]
        )
        rows = np.zeros((len(theta), 5, 6), complex)
        for k in range(3):
            rows[:, k, k] = turn
        rows[:, 3, 0], rows[:, 4, 5], rows[:, 4, 0] = 1j * turn, 1, -turn
        return rows


Block = Step | Sweep


def gram(columns: np.ndarray) -> np.ndarray:
    """(P, m, m) products of columns (P, m, n)."""
    return columns.conj() @ columns.swapaxes(1, 2)


def _least_squares(shapes: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(P, K) coefficients of shapes (P, K, n) in y (P, n), columns scaled to unit size."""
    size = np.maximum(np.linalg.norm(shapes, axis=2), 1e-300)
    unit = shapes / size[:, :, None]
    found = np.linalg.solve(gram(unit) + REGULAR * np.eye(unit.shape[1]), unit.conj() @ y[:, :, None])
    return found[:, :, 0] / size
