"""The noise of one log as it is known at present, and how rows are whitened by it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.model.span import times
from sysid.trials.noise import Level


class Jitter(NamedTuple):
    """Phase noise of `std` (rad) and of the correlation time `time`, in the unit of the log's clock, beside
    white noise of `level` per channel; and the share of a log's information that it leaves."""

    std: float
    time: float
    level: float
    left: float = 1.0


@dataclass(frozen=True, eq=False)
class Noise:
    """An Ornstein-Uhlenbeck process over the rows of one log, and how each row's noise differs from it.
    Arrays are (n,)."""

    clock: np.ndarray = field(repr=False)  # what orders it, as `clock_of` has it
    count: np.ndarray = field(repr=False)  # rows of the file that each row is the mean of
    kept: np.ndarray = field(repr=False)  # rows with a signal that are no outliers of coloured noise
    std: float  # per channel
    time: float = 0.0  # correlation time in the unit of `clock`; 0: white
    levels: tuple[
        Level, ...
    ] = ()  # of d and q, where their noise differs: `std` is then its root mean square
    share: float = 0.0  # of its variance at the largest response, which is proportional to the response
    spread: np.ndarray | None = field(
        default=None, repr=False
    )  # of each row's noise over the level, where it is not 1
    # the same, as the log states it of each row, or as what undoes a sensor makes it
    stated: np.ndarray | None = field(default=None, repr=False)
    rounded: np.ndarray | None = field(
        default=None, repr=False
    )  # the same as `spread` for rounding; complex of d and q
    own: np.ndarray | None = field(
        default=None, repr=False
    )  # part of each row's noise that is not that of others, beside it
    tail: np.ndarray | None = field(
        default=None, repr=False
    )  # weight of each row where the noise has outliers
    # information of a row over that of one whose noise is as simple as the weights have it
    efficiency: float = 1.0
    slow: float = 1.0  # information left beside noise that lasts longer
    jitter: Jitter | None = None  # of its phase
    scatter: float = 0.0  # s, by which the rows' time stamps do, over its level

    @property
    def told(self) -> float:
        """`efficiency`, less what phase noise and slow noise cost."""
        return self.efficiency * self.firm

    @property
    def firm(self) -> float:
        """What phase noise and slow noise leave, for which a misfit may be taken."""
        return self.slow * (self.jitter.left if self.jitter else 1.0)

    @property
    def coloured(self) -> bool:
        """Whether neighbouring rows of a channel share noise."""
        return any(p.time for p in self.parts)

    @property
    def parts(self) -> tuple["Noise", ...]:
        """The noise of each channel, d and q, where they differ; else itself alone."""
        parts = tuple(replace(self, std=x.std, time=x.time, levels=()) for x in self.levels) or (self,)
        if self.rounded is None or self.own is None or not self.levels:
            return parts
        pairs = ((self.rounded.real, self.own.real), (self.rounded.imag, self.own.imag))
        return tuple(replace(p, rounded=r, own=own) for p, (r, own) in zip(parts, pairs, strict=True))

    @property
    def used(self) -> np.ndarray:
        """The rows that are not left out."""
        return np.flatnonzero(self.kept)

    @property
    def order(self) -> np.ndarray:
        """All rows in the order of an experiment: those that are left out come last."""
        return np.argsort(~self.kept, kind="stable")

    @property
    def left_out(self) -> int:
        """Number of rows that are left out."""
        return int(np.sum(~self.kept))

    @cached_property
    def weight(self) -> np.ndarray:
        """(n,) factor by which each row's noise is smaller than the level: for the mean of many rows, or
        where noise goes with the response."""
        weight = np.sqrt(self.count)
        if self.time > 0 and np.any(self.count > 1):
            # The variance of an OU process averaged over x correlation times is 2 (x - 1 + exp(-x))/x^2 of a
            # row's.
            x = np.maximum(self.count * np.ptp(self.clock) / self.count.sum() / self.time, 1e-4)
            weight = np.sqrt(x**2 / (2 * (x + np.expm1(-x))))
        weight = weight if self.spread is None else weight / self.spread
        weight = weight if self.stated is None else weight / self.stated
        if self.rounded is not None and not np.iscomplexobj(self.rounded):  # of d and q it is that of `parts`
            weight = weight / self.rounded
        return weight if self.tail is None else weight * np.sqrt(self.tail)

    def memory(self) -> np.ndarray:
        """Correlation of the noise of each used row with the one before."""
        clock = self.clock[self.used]
        if self.time <= 0:
            return np.zeros(len(clock))
        rho = np.exp(-np.diff(clock) / self.time)
        return np.concatenate([[0.0], np.minimum(rho, 1 - 1e-9)])

    def relative_error(self, dof: float) -> float:
        """Of the level: that of `dof` numbers, of which correlated ones count (1 - rho^2)/(1 + rho^2)."""
        square = np.mean(self.memory()[1:] ** 2) if len(self.used) > 1 else 0.0
        return float(np.sqrt((1 + square) / (1 - square) / (2 * max(dof, 1))))

    def whitening(self, coloured: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(a, b) of `whitened` for the used rows, in units of the noise (OU, any time grid); complex where d
        and q have noise of their own. `coloured`: False ignores what neighbours share."""
        if self.levels:
            now, before = zip(*(p.whitening(coloured) for p in self.parts), strict=True)
            return joined(now), joined(before)
        weight = self.weight[self.used] / self.std
        memory = self.memory() if coloured else np.zeros(len(weight))
        left = np.sqrt(1 - memory**2)
        return weight / left, memory * np.roll(weight, 1) / left

    def at(self, std: float, time: float, levels: tuple[Level, ...], least: float) -> "Noise":
        """The noise with another level, at `least` that, and correlation time; `levels`: those of d and q."""
        levels = levels if all(x.std > least for x in levels) else ()
        new = replace(self, std=max(std, least), time=time if std > least else 0.0, levels=levels)
        apart = np.iscomplexobj(self.rounded)  # which rows share their rounding is of d and of q
        return replace(new, rounded=None, own=None) if apart and not levels else new

    def of_rows(
        self, log: Log, count: np.ndarray, kept: np.ndarray, scale: float, stated: np.ndarray | None
    ) -> "Noise":
        """The same process over other rows of the log, without knowledge of single rows but what is `stated`
        of them. `scale`: of the clock."""
        levels = tuple(x._replace(time=scale * x.time) for x in self.levels)
        told = self.efficiency if self.tail is None else 1.0
        process = (self.std, scale * self.time, levels, self.share)
        new = Noise(clock_of(log), count, kept, *process, stated=stated, efficiency=told)
        return replace(new, jitter=self.jitter, slow=self.slow)


def clock_of(log: Log) -> np.ndarray:
    """What orders the noise: time, with equal stamps spread evenly; the row number where no time is
    recorded."""
    if log.time is None:
        return np.arange(len(log), dtype=float)
    if np.all(np.diff(log.time) > 0):
        return np.asarray(log.time)
    stamps, first, count = np.unique(log.time, return_index=True, return_counts=True)
    if len(stamps) == 1:
        return np.arange(len(log), dtype=float)
    end = np.append(stamps[1:], 2 * stamps[-1] - stamps[-2])
    within = np.arange(len(log)) - np.repeat(first, count)
    return np.repeat(stamps, count) + within * np.repeat((end - stamps) / count, count)


def uneven(share: float, response: np.ndarray) -> np.ndarray | None:
    """(n,) noise of each row over that at the largest response, where a `share` of its variance is
    proportional to the response; None for a share of zero."""
    if not share:
        return None
    size = np.abs(response)
    return np.sqrt(1 - share + share * np.minimum(size / (np.max(size) or 1.0), 1.0) ** 2)


def joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """One array of the parts: that of q becomes its imaginary part."""
    return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]


def whitened(v: np.ndarray, now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """now_k v_k - before_k v_(k-1) of rows (..., n); the first has none before it."""
    found = times(now, v)
    found[..., 1:] -= times(before[1:], v[..., :-1])
    return found
