"""A drive that is switched between levels, as an inverter or a logic output does it, rather than a sine: its
fundamental.

Its edges stand at whole samples, so that its phase seems to jump. But those of one frequency lie, time over
number, within half a sample of a line, which they leave hardly any room.
"""

import numpy as np

SWITCHED = 0.8  # share of the samples that lie on a level, of which a sine has a third
# of the range of two periods, within which a sample lies on a level: the highest, the lowest, or half way
LEVEL = 0.1
LIT = 0.2  # of the largest range, from which on the drive counts as on
BLOCKS = 1000  # of two periods that are looked at, about
OFF = 0.6  # samples by which edges lie off their line at most, unless more than the sampling moves them
FEWEST, MOST = 4, 5000  # edges of a line


def is_switched(drive: np.ndarray, omega: float) -> bool:
    """Of a drive (samples) of about `omega` (rad/sample)."""
    n = int(np.ceil(4 * np.pi / omega))
    part = drive[: len(drive) // n * n].reshape(-1, n)
    low, high = part.min(axis=1, keepdims=True), part.max(axis=1, keepdims=True)
    lit = (high - low > LIT * np.max(high - low))[:, 0]
    lit[1:-1] &= lit[:-2] & lit[2:]  # a sine that begins or ends lies at zero, too
    if not np.any(lit):
        return False
    some = np.flatnonzero(lit)[:: max(np.count_nonzero(lit) // BLOCKS, 1)]
    v, low, high = part[some], low[some], high[some]
    off = np.min(np.abs(v - np.stack([low, high, 0.5 * (low + high)])), axis=0) / (high - low)
    return bool(np.mean(off < LEVEL) > SWITCHED)


def fundamental(drive: np.ndarray, omega: float) -> tuple[float, float, float] | None:
    """(level, t, omega) of a switched drive (samples) of about `omega` (rad/sample): level cos(omega (k -
    t)); None where its edges are too few. The level is 2/n sum_k v_k e^{-j omega k} over whole periods, in
    which what sampling does averages out."""
    high = 0.75 * np.max(drive) + 0.25 * np.min(drive)
    above = drive > high
    edges = [np.flatnonzero(above[1:] & ~above[:-1]), np.flatnonzero(~above[1:] & above[:-1])]
    if min(map(len, edges)) < FEWEST:
        return None
    period = 2 * np.pi / omega
    lines = [
        _line(k + (high - drive[k]) / (drive[k + 1] - drive[k]), period) for k in edges
    ]  # half a sample off, both ways
    period = 0.5 * (lines[0][1] + lines[1][1])
    width = (lines[1][0] - lines[0][0]) % period  # of the upper part
    n = int(np.floor(len(drive) / period) * period)
    z = 2 * np.mean((drive[:n] - np.mean(drive[:n])) * np.exp(-2j * np.pi * np.arange(n) / period))
    return abs(z), lines[0][0] + 0.5 * width, 2 * np.pi / period


def _line(times: np.ndarray, period: float) -> tuple[float, float]:
    """Start and period of edges: the middle of all lines off which none lies farther than it has to; of edges
    that are moved by more than their sampling, that of least squares."""
    from scipy.optimize import linprog  # a tenth of a second, which other logs need not wait for

    number = np.append(0.0, np.cumsum(np.rint(np.diff(times) / period)))
    slope, start = np.polyfit(number, times, 1)
    some = np.linspace(0, len(times) - 1, min(len(times), MOST)).astype(int)
    x, y = number[some] / number[-1], times[some] - start - slope * number[some]
    sides = np.concatenate(
        [np.column_stack([sign * np.ones(len(x)), sign * x, -np.ones(len(x))]) for sign in (1, -1)]
    )
    found = linprog([0, 0, 1], sides, np.concatenate([y, -y]), bounds=[(None, None), (None, None), (0, None)])
    if found.x is None or found.x[2] > OFF:
        return start, slope
    return start + found.x[0], slope + found.x[1] / number[-1]
