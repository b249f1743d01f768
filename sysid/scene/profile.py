"""Profiles: one input over the time of a scene; constants, steps, ramps and tables are one type."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np


@dataclass(frozen=True, eq=False)
class Profile:
    """Values (k,) from `times` (k,) s on: held until the next time, or on straight lines between them.

    Before the first time the first value holds, after the last one the last. Raises ValueError for times that
    do not increase, or values that are not finite.

    >>> Profile([0.0, 1.0], [0.0, 5.0]).at(np.array([0.5, 1.0])).tolist()
    [0.0, 5.0]
    >>> Profile([0.0, 1.0], [0.0, 5.0], held=False).at(np.array([0.5])).tolist()
    [2.5]
    """

    times: np.ndarray
    values: np.ndarray
    held: bool = True

    def __post_init__(self) -> None:
        for name in ("times", "values"):
            object.__setattr__(self, name, np.atleast_1d(np.asarray(getattr(self, name), float)))
        if self.times.shape != self.values.shape or self.times.ndim != 1:
            raise ValueError(
                f"found {self.times.shape} times and {self.values.shape} values, expected one value for"
                f" each time"
            )
        if not (np.isfinite(self.times).all() and np.isfinite(self.values).all()):
            raise ValueError("found a time or a value that is not finite, expected numbers")
        if np.any(np.diff(self.times) <= 0):
            at = int(np.argmax(np.diff(self.times) <= 0))
            raise ValueError(
                f"found time {self.times[at + 1]:g} s after {self.times[at]:g} s, expected times that"
                f" increase"
            )

    @classmethod
    def constant(cls, value: float) -> "Profile":
        """One value for ever."""
        return cls(np.zeros(1), np.array([value]))

    @property
    def is_constant(self) -> bool:
        """Whether it has the same value at all times."""
        return bool(np.all(self.values == self.values[0]))

    def at(self, time: np.ndarray) -> np.ndarray:
        """Values at `time` (n,) s; at a step, those after it."""
        if self.is_constant:
            return np.full(len(time), self.values[0])
        if not self.held:
            return np.interp(time, self.times, self.values)
        return self.values[np.maximum(np.searchsorted(self.times, time, side="right") - 1, 0)]

    def snapped(self, rate: float, near: float) -> "Profile":
        """The same, with times within `near` rows of a row, at `rate` Hz, moved to that row, whatever
        rounding made of them."""
        row = np.round(self.times * rate)
        times = np.where(np.abs(self.times * rate - row) < near, row / rate, self.times)
        return (
            self
            if np.array_equal(times, self.times) or np.any(np.diff(times) <= 0)
            else Profile(times, self.values, self.held)
        )

    def sampled(self, every: float) -> "Profile":
        """The values at every `every` s, held until the next: a ramp as the stairs that a program makes of
        it."""
        count = int((self.times[-1] - self.times[0]) / every * (1 + 1e-9)) + 1
        begin, step = (
            Fraction(repr(float(x))) for x in (self.times[0], every)
        )  # as written: 3 * 0.0008 s is 0.0024 s
        times = np.array([float(begin + k * step) for k in range(count)])
        return Profile(times, self.at(times))

    def edges(self, begin: float, end: float) -> np.ndarray:
        """Times strictly between `begin` and `end` at which the profile steps or bends."""
        if self.is_constant:
            return np.empty(0)
        first, last = np.searchsorted(self.times, [begin, end], side="right")
        inside = self.times[first:last]
        return inside[(inside > begin) & (inside < end)]

    def integral(self, time: np.ndarray, less: float = 0.0) -> np.ndarray:
        """The integral of the profile minus `less` from 0 to `time` (n,) s, exact."""
        values = self.values - less
        pieces = np.diff(self.times) * (values[:-1] if self.held else 0.5 * (values[1:] + values[:-1]))
        sums = np.append(0.0, np.cumsum(pieces))

        def since_first(t: np.ndarray) -> np.ndarray:
            k = np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)
            here = t - self.times[k]
            slope = 0.0 if self.held else np.append(np.diff(values) / np.diff(self.times), 0.0)[k]
            return sums[k] + here * (values[k] + 0.5 * np.where(here > 0, slope, 0.0) * here)

        return since_first(time) - since_first(np.zeros(1))
