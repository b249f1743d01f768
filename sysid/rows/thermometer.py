"""The plate's temperature from a thermometer's readings, whose noise is not the plate's.

A reading is y_k = T_k + sqrt(r) e_k. T is constant, or a straight line plus a random walk (m = 1: the local
level model of Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 2.3) or
a random walk of its slope (m = 2: a smoothing spline). The cosine coefficients c_k (DCT-II) of the readings
less the line are then nearly independent, of variance r (1 + s/e_k^m), e_k = 2 - 2 cos(pi k/n). So r has a
closed form for each s, the likelihood of s is a sum, and T has the coefficients times s/(s + e_k^m). Readings
without noise have the largest possible s and stay as they are.

A reading in steps of q is off by up to half a step, uniformly: by q/sqrt(12) (JCGM 100:2008, F.2.2.1). Logs
with one whole degree each have set points, which were not read. Logs with the same reading share its error,
so each of k of them is given sqrt(k) times the error: their mean is then no better than one of them. Readings
that pass several steps, or flicker about them, show where the steps lie.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.rows.rounding import shared

FEW = 8  # readings, of which no noise is told
LONG = 16384  # readings that are looked at one by one
# of a longer log: a temperature that went on changing from row to row would be an input that does
LEVELS = 256
HELD = 64  # rows of a long log, at least, that a level stands for: twice what is condensed to one
AGAIN = 2.0  # times that each level is come to, on average, by readings that are held
JUMP, FAR = (
    1.0,
    8.0,
)  # degC, and usual moves from row to row: what moves by more than both is another set point
NOISY = 1.0  # degC; what differs by more from row to row is not a thermometer's noise
# degC, the largest step, where it is not known, between which the temperature goes on; set points lie farther
# apart
COARSE = 0.3
WALKS = np.append(0.0, np.logspace(-9, 2, 111))  # s that are tried; the last: no noise
SURE = 4.0  # of log-likelihood, by which a temperature that changes is told from one that does not
WHOLE = 1e-6  # of a digit, by which a reading that is so many of them is off in float64
STRAIGHT = 1e-12  # of the largest reading, by which numbers on a straight line bend in float64
APART = 5.0  # errors, by which the temperatures of logs lie apart where they are not one and the same


class Reading(NamedTuple):
    """The plate's temperature (n,) in each row of a log, and its typical error, degC."""

    temperature: np.ndarray
    error: float


def of_plates(
    logs: Sequence[np.ndarray | None], digits: Sequence[float] | None = None
) -> list[Reading | None]:
    """The temperature from the readings of each log; None where there are none. Logs whose temperatures
    differ by no more than their noise are taken as recorded at one temperature. `digits` (degC): the last
    digit each was written with; 0 where it is not known."""
    digits = [0.0] * len(logs) if digits is None else digits
    step = step_of(logs, digits)
    steps = [
        step if digit and not exact else 0.0 for digit, exact in zip(digits, _set_points(logs), strict=True)
    ]
    found = [None if y is None else _steady(y, q) for y, q in zip(logs, steps, strict=True)]
    read = [x for x in found if x is not None]
    if any(x.error for x in read):
        mean = float(np.mean([x.temperature.mean() for x in read]))
        spread = np.sqrt(np.mean([np.mean((x.temperature - mean) ** 2) for x in read]))
        if spread <= APART * np.sqrt(np.mean([x.error**2 for x in read])):
            return [None if x is None else Reading(np.full(len(x.temperature), mean), 0.0) for x in found]
    return _rounded(logs, found, steps)


def step_of(logs: Sequence[np.ndarray | None], digits: Sequence[float]) -> float:
    """The coarsest step (degC) of 1 or less of which all written readings are multiples: 0.5 for 22 and 30.5;
    0.1 for 22.0 and 30.0, whose zeros count as read. 0 where none were written."""
    written = [y for y, digit in zip(logs, digits, strict=True) if y is not None and digit]
    if not written:
        return 0.0
    digit = min(d for d in digits if d)
    counts = np.concatenate([np.unique(y) for y in written]) / digit
    if np.any(np.abs(counts - np.rint(counts)) > WHOLE) or digit > 1:  # read in another unit
        return digit
    many = int(np.gcd.reduce(np.append(np.rint(counts), np.rint(1 / digit)).astype(np.int64)))
    return digit if many % 10 == 0 else many * digit


def _set_points(logs: Sequence[np.ndarray | None]) -> list[bool]:
    """Which logs have a temperature that was set rather than read: one each, if those of all such logs are
    whole degrees."""
    alone = [y is not None and np.ptp(y) == 0 for y in logs]
    whole = all(y[0] == np.rint(y[0]) for y, one in zip(logs, alone, strict=True) if one and y is not None)
    return [one and whole for one in alone]


def _rounded(
    logs: Sequence[np.ndarray | None], found: list[Reading | None], steps: Sequence[float]
) -> list[Reading | None]:
    """The temperatures with the error of the step in which they were read."""
    means = np.array([np.nan if x is None else x.temperature.mean() for x in found])
    new = list(found)
    for k, (y, x, q) in enumerate(zip(logs, found, steps, strict=True)):
        if y is not None and x is not None and q:
            alike = np.count_nonzero(np.abs(means - means[k]) < 0.5 * q)
            new[k] = x._replace(error=float(np.sqrt(x.error**2 + alike * _rounding(y, x, q))))
    return new


def _rounding(y: np.ndarray, x: Reading, step: float) -> float:
    """Variance (degC^2) of the error common to all readings of a log; where they pass the steps, only that of
    the rows before the first and after the last of these counts."""
    if x.temperature is not y and np.ptp(x.temperature) >= step:
        passed = np.flatnonzero(np.diff(y))
        return (1 - (passed[-1] - passed[0]) / len(y)) * step**2 / 12
    variance = max(float(np.mean((y - x.temperature) ** 2)) / step**2, 1 / 12)
    return shared(variance) * variance * step**2


def _steady(y: np.ndarray, step: float = 0.0) -> Reading:
    """The temperature from the readings of one log; `step`: their step, 0 where it is not known."""
    if _held(y):
        return Reading(_crept(y, max(COARSE, 1.01 * step)) if len(y) <= LONG else y, 0.0)
    moves = np.abs(np.diff(y))
    jumps = np.flatnonzero(moves > max(JUMP, FAR * np.median(moves))) + 1
    if len(y) > LONG and len(jumps) > LEVELS // 16:  # the spikes of a long log are no set points
        jumps = jumps[:0]
    parts = [_smooth(part) for part in np.split(y, jumps)]
    return Reading(np.concatenate([x.temperature for x in parts]), max(x.error for x in parts))


def _crept(y: np.ndarray, coarse: float) -> np.ndarray:
    """The temperature of a reading that creeps in equal steps, no larger than `coarse`: at each step halfway
    between the two readings, and linear from one step to the next. Set points are kept."""
    rows = np.flatnonzero(np.diff(y))
    steps = np.abs(np.diff(y)[rows])
    if len(rows) < 2 or steps.max() > min(1.5 * steps.min(), coarse):
        return y
    at, between = rows + 0.5, 0.5 * (y[rows] + y[rows + 1])
    first = _end(at, between, y[0], -0.5)
    last = _end(-at[::-1], between[::-1], y[-1], 0.5 - len(y))
    knots = np.array(
        [*first, *zip(at, between, strict=True), *((-row, value) for row, value in reversed(last))]
    )
    return np.interp(np.arange(len(y)), knots[:, 0], knots[:, 1])


def _end(at: np.ndarray, between: np.ndarray, reading: float, begin: float) -> list[tuple[float, float]]:
    """What passes `between` two readings `at` some rows, before the first of these: as straight as there,
    unless it would have passed another step since the `begin`; then it had rested, for all that is known in
    the middle of the first reading."""
    slope = (between[1] - between[0]) / (at[1] - at[0])
    back = between[0] + slope * (begin - at[0])
    if abs(back - reading) <= abs(between[0] - reading):
        return [(begin, back)]
    middle = (
        at[0] + (reading - between[0]) / slope
        if (reading - between[0]) * slope < 0
        else at[0] - abs(at[1] - at[0]) / 2
    )
    return [(begin, reading), (middle, reading)]


def _held(y: np.ndarray) -> bool:
    """Set points, or a coarse reading that goes one way: most readings repeat the one before, and few values
    come again."""
    moves = y[1:] != y[:-1]
    many = np.count_nonzero(moves)
    return bool(many <= 0.5 * len(moves) and many <= AGAIN * len(np.unique(y[1:][moves])))


def _smooth(y: np.ndarray) -> Reading:
    """The temperature from readings without a jump."""
    if len(y) < FEW:
        return Reading(y, 0.0)
    if (knots := _knots(y)) is not None:
        level, error = _smooth(y[knots])
        return Reading(np.interp(np.arange(len(y)), knots, level), error)
    if len(y) > LONG:
        begins = np.linspace(0, len(y), max(LEVELS, len(y) // HELD) + 1).astype(int)
        level, error = _steady(np.add.reduceat(y, begins[:-1]) / np.diff(begins))
        return Reading(np.repeat(level, np.diff(begins)), error)
    n = len(y)
    stiff = 2 - 2 * np.cos(np.pi * np.arange(1, n) / n)
    found = [_walk(y, np.full(n, y.mean()), stiff, WALKS[:1])]
    along = np.arange(n) - 0.5 * (n - 1)
    line = y.mean() + along * (along @ y) / (along @ along)
    found += [_walk(y, line, stiff**m, WALKS) for m in (1, 2)]
    best = max(found, key=lambda f: f.likely - (0 if f is found[0] else SURE))
    if best.walk == WALKS[-1] or best.noise > NOISY**2:
        return Reading(y, 0.0)
    return Reading(best.level, float(np.sqrt(best.noise * best.kept)))


def _knots(y: np.ndarray) -> np.ndarray | None:
    """The rows between which readings were interpolated, as of a thermometer that is read every so many rows;
    None where they were not: in steps of a digit a smooth curve is straight for a while as well, but bends
    wherever it happens to."""
    bends = np.flatnonzero(np.abs(np.diff(y, 2)) > STRAIGHT * np.max(np.abs(y)))
    between = np.diff(bends)
    every = between[between > 1]  # a reading between two rows bends at both
    if not FEW <= len(bends) <= 0.5 * len(y) or (len(every) and np.ptp(every)) > 2:
        return None
    return np.concatenate([[0], bends + 1, [len(y) - 1]])


class _Walk(NamedTuple):
    """A temperature that walks: log-likelihood, s, r in degC^2, T (n,), and the variance of its error over
    r."""

    likely: float
    walk: float
    noise: float
    level: np.ndarray
    kept: float


def _walk(y: np.ndarray, line: np.ndarray, stiff: np.ndarray, walks: np.ndarray) -> _Walk:
    """The likeliest of `walks` beside a line; `stiff` (n - 1,): e_k^m."""
    from scipy.fft import (
        dct,
        idct,
    )  # a tenth of a second, which logs without noise in their temperature need not wait for

    cosines = dct(y - line, norm="ortho")[1:]
    spread = 1 + walks[:, None] / stiff
    noise = np.maximum(np.mean(cosines**2 / spread, axis=1), np.finfo(float).tiny)
    likely = -0.5 * len(cosines) * np.log(noise) - 0.5 * np.sum(np.log(spread), axis=1)
    best = int(np.argmax(likely))
    kept = walks[best] / (walks[best] + stiff)
    beside = idct(np.append(0.0, cosines * kept), norm="ortho")
    return _Walk(
        float(likely[best]),
        float(walks[best]),
        float(noise[best]),
        line + beside,
        (2 + np.sum(kept)) / len(y),
    )


def was_read(log: Log) -> bool:
    """Whether its temperature is its own, not that of the other logs (`reading.trials`)."""
    return log.temperature is not None and "temperature_std_degC" in log.bench
