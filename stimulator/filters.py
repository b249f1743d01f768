"""Filters of a sensed position: none, one pole, and a constant-velocity Kalman filter that predicts over
its latency.

Each takes readings (n, ...) with time along the first axis, `touched` (n, ...) where the finger is on the
plate (elsewhere the last position is held; `rest` before the first), the standard deviation of each reading
and the time between two.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sysid.scene.effects import number


@dataclass(frozen=True)
class Unfiltered:
    """The readings as they are. `latency`: from the sensors' sampling to the reference that it makes, s."""

    kind: ClassVar[str] = "none"
    latency: float = number(1e-3, "s")

    def __call__(
        self, read: np.ndarray, touched: np.ndarray, std: np.ndarray, step: float, rest: Any
    ) -> np.ndarray:
        return held(read, touched, rest)


@dataclass(frozen=True)
class OnePole:
    """y+ = y + (1 - exp(-step/tau)) (reading - y), which lags by tau. It starts anew where a finger comes
    down."""

    kind: ClassVar[str] = "one_pole"
    tau: float = number(5e-3, "s")
    latency: float = number(1e-3, "s")

    def __call__(
        self, read: np.ndarray, touched: np.ndarray, std: np.ndarray, step: float, rest: Any
    ) -> np.ndarray:
        share = -np.expm1(-step / self.tau)
        found = np.empty_like(read)
        state, before = np.broadcast_to(rest, read.shape[1:]), np.zeros(read.shape[1:], bool)
        for k, (z, on) in enumerate(zip(read, touched, strict=True)):
            moved = np.where(before, state + share * (z - state), z)
            state = found[k] = np.where(on, moved, state)
            before = on
        return found


@dataclass(frozen=True)
class Kalman:
    """A finger of constant velocity, pushed by an acceleration of rms value `acceleration` that lasts for
    `lasting`:

        x' = v,  v' = white noise of density q = 2 acceleration^2 lasting

    Its estimate is carried on by `latency` at its own velocity. The defaults are a fingertip that moves to
    and fro over 9 cm in 1.2 s: at most 1.2 m/s^2, 0.9 rms, which changes its sign every 0.6 s.
    """

    kind: ClassVar[str] = "kalman"
    acceleration: float = number(0.9, "m/s^2")
    lasting: float = number(0.2, "s")
    latency: float = number(1e-3, "s")

    def __call__(
        self, read: np.ndarray, touched: np.ndarray, std: np.ndarray, step: float, rest: Any
    ) -> np.ndarray:
        q = 2 * (1e3 * self.acceleration) ** 2 * self.lasting  # mm^2/s^3
        noise = (q * step**3 / 3, q * step**2 / 2, q * step)
        found, shown, before = (
            np.empty_like(read),
            np.broadcast_to(rest, read.shape[1:]),
            np.zeros(read.shape[1:], bool),
        )
        state = _Estimate.at(shown, 0.0)
        for k, (z, on, r) in enumerate(zip(read, touched, std**2, strict=True)):
            state = state.predicted(step, noise).updated(z, r)
            if not before.all():
                new = _Estimate.at(z, r)
                state = _Estimate(*(np.where(before, m, n) for m, n in zip(state, new, strict=True)))
            ahead = state.x + self.latency * state.v
            shown = found[k] = ahead if on.all() else np.where(on, ahead, shown)
            before = on
        return found


FILTERS: dict[str, Any] = {cls.kind: cls for cls in (Unfiltered, OnePole, Kalman)}
FASTEST = 1e3  # mm/s: what a finger's velocity may be before anything is known of it


class _Estimate(NamedTuple):
    """Position (mm), velocity (mm/s) and their covariance."""

    x: Any
    v: Any
    xx: Any
    xv: Any
    vv: Any

    @classmethod
    def at(cls, z: Any, r: Any) -> "_Estimate":
        """Where a finger comes down: at its reading of variance r, with any velocity."""
        zero = np.zeros_like(z)
        return cls(z, zero, zero + r, zero, zero + FASTEST**2)

    def predicted(self, step: float, noise: tuple[float, float, float]) -> "_Estimate":
        x, v, xx, xv, vv = self
        a, b, c = noise
        return _Estimate(x + step * v, v, xx + step * (2 * xv + step * vv) + a, xv + step * vv + b, vv + c)

    def updated(self, z: Any, r: Any) -> "_Estimate":
        x, v, xx, xv, vv = self
        total = (
            xx + r + 1e-12
        )  # mm^2: below what any sensor shows, so that a perfect one divides by something
        kx, kv, off = xx / total, xv / total, z - x
        return _Estimate(x + kx * off, v + kv * off, xx - kx * xx, xv - kx * xv, vv - kv * xv)


def held(read: np.ndarray, touched: np.ndarray, rest: Any) -> np.ndarray:
    """The last reading with a finger on the plate; `rest` before there was one."""
    rows = np.arange(len(read)).reshape(-1, *([1] * (read.ndim - 1)))
    last = np.maximum.accumulate(np.where(touched, rows, -1), axis=0)
    return np.where(last < 0, rest, np.take_along_axis(read, np.maximum(last, 0), axis=0))
