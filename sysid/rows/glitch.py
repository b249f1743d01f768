"""Rows spoilt by a recorder: one to three in succession that deviate from their neighbours by more than
anything else in the log.

A fit that saw them would take them for the resonance. Where the inputs are constant, or change steadily as in
a sweep, the six rows about a window of one to three lie on a line, apart from their own scatter and the
curvature of the response. Smaller deviations are left to the noise (`trials.noise`). A resonance narrower
than the steps of a sweep also looks like a row or two: it is recognised by its tails, G V/(j (omega - omega0)
tau), in the rest of the sweep.
"""

import numpy as np

from sysid.logs.log import Log
from sysid.rows.lost import change, runs

# rows about a window, which say what it should hold: three on each side, or at an end at least one
BESIDE = 6
LONGEST = 3  # rows of a window; a response that is elsewhere for longer is no single fault
# times what the rows beside it are off their line: of a step or a decay within a row no more than 7
FAR = 10.0
LARGE = 1.0  # times what the rest of the log is off its median
FEW = 0.1  # of the rows, of which they are at most
# of what the rest of the log is off its median, the least by which a spoilt row is off the one before
JUMP = 0.25
# of what is farthest off the median: rows that are looked at, again until none of them is spoilt
LIVELY = 0.5
LEAST_ROWS = 20  # of a log in which it can be told
PLACES = 64  # of a sweep in which its resonance is looked for
WIDTHS = 13  # of it that are tried, from NARROW to all of the sweep
LIVELIEST = 8  # of its rows, which may be its resonance
ENOUGH = 400  # rows of a sweep in which it is looked for
BETWEEN = np.linspace(-1, 1, 21)  # steps beside the spoilt rows, where a narrow resonance may be
NARROW = 0.1  # step: half of its width, on which its tails do not depend
EXPLAINED = 0.5  # of the rest of a sweep, by its own resonance, and
# times what that leaves of it, by one of the spoilt rows; of a narrow resonance both leave as little
WORSE = 3.0


def glitches(log: Log) -> np.ndarray:
    """(n,) which rows of a log are spoilt."""
    found = np.zeros(len(log), bool)
    if len(log) < LEAST_ROWS:
        return found
    order, y, changed = _in_order(log)
    with np.errstate(all="ignore"):  # what overflows, as an instrument's 9.9e37 may, is far off indeed
        spoilt = _spoilt(y, changed)
    if np.any(spoilt) and log.frequency is not None and np.ptp(log.frequency) > 0:
        f, alone = log.frequency[order], spoilt.copy()
        for begin, end in runs(spoilt):
            alone[begin:end] = not _is_resonance(f, y, spoilt, begin, end)
        spoilt = alone
    found[order[spoilt]] = True
    return found


def _in_order(log: Log) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The order in which rows are neighbours, the response in it, and before which of its rows an input
    changed."""
    n, y = len(log), log.response
    driven = log.drive is not None and np.all(log.drive != 0)
    if log.kind == "steady" and log.frequency is not None:
        order = np.argsort(log.frequency, kind="stable")
        y = (y / log.drive if driven else y)[order]
        return order, y, np.zeros(n, bool)
    swept = log.frequency is not None and np.mean(np.diff(log.frequency) != 0) > 0.5
    return np.arange(n), y, change(log, ("drive",) if swept else ("drive", "frequency"))


def _spoilt(y: np.ndarray, changed: np.ndarray) -> np.ndarray:
    """(n,) rows that those beside them do not predict, by more than the rest shows."""
    found = np.zeros(len(y), bool)
    changes, usual = np.cumsum(changed), float(np.median(np.abs(np.diff(y)))) / np.sqrt(2)
    while True:
        off = np.abs(y - _median(y[~found]))
        off[found] = 0.0
        rows = np.flatnonzero(off > LIVELY * np.max(off))
        if len(rows) > FEW * len(y) or not np.any(off):
            rows = rows[np.argsort(-off[rows], kind="stable")[: int(FEW * len(y))]]
        rows = rows[_behind_a_jump(y, found, off)[rows]]
        away = _away(y, found, changes, rows, usual)
        trial = found.copy()
        trial[rows[away > 0]] = True
        rest = y[~trial]
        new = rows[away > LARGE * float(np.max(np.abs(rest - _median(rest)), initial=0.0))]
        if not len(new):
            return found
        found[new] = True
        if np.sum(found) > FEW * len(y):
            return np.zeros(len(y), bool)


def _behind_a_jump(y: np.ndarray, found: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(n,) rows that a window may hold which is farther off its neighbours than the rest is `off` the median.
    The first row of such a window is off the row before by four fifths of that at least, less what the line
    of the neighbours rises in a row."""
    there = np.flatnonzero(~found)
    jumps = np.abs(np.diff(y[there])) > JUMP * np.quantile(off[there], 1 - FEW)
    behind = np.zeros(len(y), bool)
    for k in range(LONGEST):
        behind[there[1 + k :][jumps[: len(jumps) - k]]] = True
    return behind


def _median(y: np.ndarray) -> complex:
    return np.median(y.real) + (1j * np.median(y.imag) if np.iscomplexobj(y) else 0.0)


def _away(
    y: np.ndarray, found: np.ndarray, changes: np.ndarray, rows: np.ndarray, least: float
) -> np.ndarray:
    """How far the rows are off what those beside a window say, of which all are FAR off, those `found` before
    left out; 0 where there is no such window. `least` is what rows scatter by, be it by chance less."""
    there = np.flatnonzero(~found)
    at, answer, stretch = np.searchsorted(there, rows), np.zeros(len(rows)), changes[there]
    lowest, highest = (np.searchsorted(stretch, changes[rows], side=side) for side in ("left", "right"))
    for length in range(1, LONGEST + 1):
        for first in (at + begin for begin in range(1 - length, 1)):
            before, after = first - lowest, highest - first - length  # rows of the same inputs
            right = np.minimum(after, BESIDE - np.minimum(before, BESIDE // 2))
            left = BESIDE - right
            enough = (left > 0) & (left <= before) & (right > 0)
            beside = (first - left)[:, None] + np.arange(BESIDE)
            beside += length * (np.arange(BESIDE) >= left[:, None])
            window = first[:, None] + np.arange(length)
            near, inside = (there[np.clip(k, 0, len(there) - 1)] for k in (beside, window))
            off, scatter = _off_line(near, y[near], inside, y[inside])
            enough &= np.min(off, axis=1) > FAR * np.maximum(scatter, least)
            answer = np.maximum(answer, np.where(enough, np.min(off, axis=1), 0.0))
    return answer


def _off_line(
    x: np.ndarray, y: np.ndarray, at: np.ndarray, there: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far what is `there`, (n, m) at rows `at`, is off the lines of y (n, k) at rows x; and y itself,
    root mean square."""
    middle, level = np.mean(x, axis=1, keepdims=True), np.mean(y, axis=1, keepdims=True)
    slope = np.sum((x - middle) * y, axis=1, keepdims=True) / np.sum((x - middle) ** 2, axis=1, keepdims=True)
    left = y - level - slope * (x - middle)
    return np.abs(there - level - slope * (at - middle)), np.sqrt(
        np.sum(np.abs(left) ** 2, axis=1) / (BESIDE - 2)
    )


def _is_resonance(f: np.ndarray, y: np.ndarray, spoilt: np.ndarray, begin: int, end: int) -> bool:
    """Whether rows `begin` to `end` may be all that a sweep has of its resonance."""
    step = float(np.median(np.diff(f)[max(begin - BESIDE, 0) : end + BESIDE])) or float(np.ptp(f)) / (
        len(f) - 1
    )
    rest = np.flatnonzero(~spoilt)
    rest = rest[:: len(rest) // ENOUGH + 1]
    u, w = (f[rest] - f[begin]) / step, y[rest]
    shown = _left(u, w, None)
    liveliest = u[np.argsort(-np.abs(w - _median(w)), kind="stable")[:LIVELIEST]]
    places = np.concatenate([np.linspace(u[0], u[-1], PLACES), liveliest])
    its_own = min(_left(u, w, p + 1j * x) for p in places for x in np.geomspace(NARROW, np.ptp(u), WIDTHS))
    inside = np.linspace(0, (f[end - 1] - f[begin]) / step, 2 * (end - begin) - 1)
    narrow = min(_left(u, w, p + b + 1j * NARROW) for p in inside for b in BETWEEN)
    return not (its_own < EXPLAINED * shown and narrow > WORSE * its_own)


def _left(u: np.ndarray, y: np.ndarray, pole: complex | None) -> float:
    """Sum of squares of what a pole, a background and its slope leave; of an amplitude, of its square."""
    columns = [np.ones(len(u)), u / np.ptp(u)]
    if pole is not None:
        columns.append(1 / (u - pole) if np.iscomplexobj(y) else 1 / np.abs(u - pole) ** 2)
    units = np.linalg.qr(np.column_stack(columns))[0]
    y = y if np.iscomplexobj(y) else y**2
    return float(np.sum(np.abs(y - units @ (units.conj().T @ y)) ** 2))
