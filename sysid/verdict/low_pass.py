"""Whether sweeps without a resonance are those of a plant that has none, driven at its input's own frequency,

    W = G e^{j phi} V/(1 + j omega tau)

as a filter, a heater, the current of a coil: the plant of a step without a frequency. Currents and velocities
are divided by omega where they are read: W omega may be such a response as well."""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from sysid.effects.number import Number, number
from sysid.minimum.minimise import State
from sysid.trials.trial import numbers_taken

TRIED = 200  # of tau, between which there is no more than one minimum
BEYOND = 30.0  # times the reciprocal of all frequencies, where a tau shows in none of them
SMOOTH = 0.01  # of the power, a tenth of the response: beside a plant of two poles the nearest leaves less
EXACT = 1e-24  # of the rows' sum of squares, less than which a residual has is rounding


def low_pass(state: State, free: int) -> dict[str, Number] | None:
    """G and tau of such a plant in sweeps; None where what fitted them best, by `free` numbers and the
    nuisances', describes them better (by BIC; Schwarz, Ann. Statist. 6, 461, 1978), or neither does."""
    trials = state.trials
    alike = len({t.signed for t in trials}) == 1
    if not (alike and all(t.steady and t.driven and t.resonant for t in trials)):
        return None
    ways = (_Sweeps.of(state, *how) for how in product((0, 1), (False, True)))
    rows, log_tau, left = min(((x, *x.best()) for x in ways), key=lambda found: found[2] / found[0].known)
    columns = rows.columns(log_tau)
    count, numbers = rows.reals, len(columns)
    more = free + sum(numbers_taken(t) for t in trials) - numbers
    if count * np.log(left / rows.known) > more * np.log(count) or rows.smooth(log_tau) > SMOOTH:
        return None
    std = np.sqrt(np.diag(np.linalg.inv(columns @ columns.T)) * left / (count - numbers))
    gain, tau, log = abs(rows.gain(log_tau)), np.exp(log_tau), trials[0].log
    unit = _rate(log.response_unit) if rows.order else log.response_unit
    return {
        "G": number(gain, gain * std[0], f"{unit}/{log.drive_unit}"),
        "tau": number(tau, tau * std[1], "s"),
    }


class _Sweeps(NamedTuple):
    """Weighted rows (n,) of all sweeps as they were recorded: `response`, complex or an amplitude, and
    `drive`; j omega (n,); by how many factors of omega the response was divided where it was read; and the
    sum of squares of what fitted them best, `known`."""

    response: np.ndarray
    drive: np.ndarray
    turning: np.ndarray
    order: int
    known: float

    @classmethod
    def of(cls, state: State, order: int, conjugate: bool) -> "_Sweeps":
        """`conjugate`: of a demodulator whose sign of q is the other one."""
        trials = state.trials
        omega = 2 * np.pi * np.abs(np.concatenate([t.log.frequency for t in trials]))
        weight = np.concatenate([t.noise.weight * (t.there & (t.log.frequency != 0)) for t in trials])
        left = [t.residual(m) for t, m in zip(trials, state.models, strict=True)]
        response, left = (
            weight * omega**order * np.concatenate(x) for x in ([t.log.response for t in trials], left)
        )
        drive = weight * np.concatenate([t.log.drive for t in trials])
        turning = (-1j if conjugate else 1j) * omega
        known = np.sum(np.abs(left) ** 2) + EXACT * np.sum(np.abs(response) ** 2)
        return cls(response, drive, turning, order, float(known))

    @property
    def reals(self) -> int:
        """Real numbers in them."""
        return len(self.response) * (2 if np.iscomplexobj(self.response) else 1)

    def shape(self, log_tau: float) -> np.ndarray:
        """(n,) response per unit G."""
        h = self.drive / (1 + self.turning * np.exp(log_tau))
        return h if np.iscomplexobj(self.response) else np.abs(h)

    def gain(self, log_tau: float) -> complex:
        """G e^{j phi} that fits best."""
        h = self.shape(log_tau)
        return complex(np.vdot(h, self.response) / max(np.vdot(h, h).real, 1e-300))

    def left(self, log_tau: float) -> float:
        """The sum of squares beside it."""
        return float(np.sum(np.abs(self.response - self.gain(log_tau) * self.shape(log_tau)) ** 2))

    def smooth(self, log_tau: float) -> float:
        """The share of the power that is left from row to row alike, which is no noise: of even noise half of
        the mean square of its steps is its own."""
        r = self.response - self.gain(log_tau) * self.shape(log_tau)
        alike = np.sum(np.abs(r) ** 2) - 0.5 * np.sum(np.abs(np.diff(r)) ** 2)
        return float(alike / np.sum(np.abs(self.response) ** 2))

    def best(self) -> tuple[float, float]:
        """log tau, and the sum of squares there, which is the least."""
        at = np.abs(self.turning[self.turning != 0])
        grid = np.linspace(-np.log(BEYOND * at.max()), np.log(BEYOND / at.min()), TRIED)
        k = int(np.argmin([self.left(x) for x in grid]))
        within = grid[max(k - 1, 0)], grid[min(k + 1, TRIED - 1)]
        found = minimize_scalar(self.left, bounds=within, method="bounded", options={"xatol": 1e-9})
        return float(found.x), float(found.fun)

    def columns(self, log_tau: float) -> np.ndarray:
        """(numbers, reals) derivatives by log G, log tau and phi."""
        h, lag = self.gain(log_tau) * self.shape(log_tau), self.turning * np.exp(log_tau)
        share = -lag / (1 + lag)
        if not np.iscomplexobj(self.response):
            return np.stack([h.real, h.real * share.real])
        return np.stack([h, h * share, 1j * h]).view(float)


def _rate(unit: str) -> str:
    """The unit of the time derivative of a response."""
    return f"{unit[:-1]}A" if unit.endswith("C") else f"{unit}/s"
