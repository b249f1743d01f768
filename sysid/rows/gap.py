"""Missing rows where an input changed, who knows when."""

import numpy as np

from sysid.logs.log import Log

# rows of equal inputs before a change, at most, by which it is told that the response was still; two are
# needed
STILL = 12
SOME = 100_000  # rows of which the usual step is taken
LONGER = 1.5  # times the usual step from row to row is a gap
# times the usual change from row to row, and what the slope of the rows before makes: by noise in one of 500
MOVED = 3.0


def gaps(log: Log) -> np.ndarray:
    """(n,) length (s) of the gap before each row of a transient in which an input changed at an unknown time,
    as rows are missing; else 0.

    By contract a change happens at a row. For `instant` rows it did not if the response moved before although
    it had been still; for `settled` rows it may never have.
    """
    found = np.zeros(len(log))
    if log.time is None or log.theta is not None or len(log) < 3:
        return found
    changed = np.zeros(len(log) - 1, bool)
    for c in (log.drive, log.frequency):
        changed |= False if c is None else c[1:] != c[:-1]
    rows = np.flatnonzero(changed) + 1
    if not len(rows):
        return found
    some = np.linspace(1, len(log) - 1, min(len(log) - 1, SOME)).astype(int)
    usual = float(np.median(log.time[some] - log.time[some - 1]))
    moved = float(np.median(np.abs(log.response[some] - log.response[some - 1])))
    for row in rows[log.time[rows] - log.time[rows - 1] > LONGER * usual]:
        held = slice(max([row - STILL, 0, *(np.flatnonzero(changed[: row - 1]) + 1)]), row)
        if held.start > row - 2:
            continue
        gap = log.time[row] - log.time[row - 1]
        still = moved + _slope(log.time[held], log.response[held]) * gap
        if log.sampling == "settled" or abs(log.response[row] - log.response[row - 1]) > MOVED * still:
            found[row] = gap
    return found


def _slope(time: np.ndarray, response: np.ndarray) -> float:
    """Slope of rows, per second: from the mean of their first half to that of the second."""
    half = len(time) // 2
    rise, over = (np.mean(v[half:]) - np.mean(v[:half]) for v in (response, time))
    return float(np.abs(rise) / max(over, 1e-300))
