"""Rows in which the signal was lost: a recorder then writes exactly zero, as for a vibrometer whose speckle is dark, or goes on
with what it read last.

A plate at rest before its first drive may read exactly zero, and a response that decays passes through small numbers on its way
there; exact zeros among rows that are far larger than the recorder's finest step are neither. A coarse recorder repeats itself,
and so does one that is asked more often than it measures; Wd and Wq that both stand still among rows that move are neither.
"""

from dataclasses import replace

import numpy as np

from sysid.log import Log

BESIDE = 8  # rows on each side that are looked at
FAR = 10.0  # times the finest step, above which the typical one of them lies
LEVELS = 100_000  # rows of which the finest step is taken
MOST = 0.5  # of the rows; where more are zero, it is the rest that is strange
HELD = 4  # rows that repeat the one before them
OFTEN = 0.2  # of the rows that repeat the one before them, above which that is how they are recorded


def lost(log: Log) -> np.ndarray:
    """(n,) which rows of a log hold no signal."""
    return _zero(log) | _held(log)


def _zero(log: Log) -> np.ndarray:
    size = np.abs(log.response)
    zero, found = size == 0, np.zeros(len(log), bool)
    if not 0 < np.sum(zero) <= MOST * len(log):
        return found
    finest, signal = _finest(log), np.flatnonzero(~zero)
    for begin, end in _runs(zero):
        at = int(np.searchsorted(signal, begin))
        sides = [size[rows] for rows in (signal[max(at - BESIDE, 0) : at], signal[at : at + BESIDE]) if len(rows)]
        found[begin:end] = begin > 0 and all(np.median(side) > FAR * finest for side in sides)
    return found


def _held(log: Log) -> np.ndarray:
    """Rows of Wd and Wq that both repeat the row before, several at once, among rows that do not."""
    found = np.zeros(len(log), bool)
    if log.amplitude_only:  # an amplitude that is clipped stands still as well
        return found
    moves = np.abs(np.diff(log.response, prepend=log.response[:1]))
    still = moves == 0
    still[0] = False
    if not HELD <= np.sum(still) <= OFTEN * len(log):
        return found
    finest = _finest(log)
    for begin, end in _runs(still):
        sides = moves[max(begin - BESIDE, 1) : begin][::-1], moves[end : end + BESIDE]
        # What comes to rest without noise moves less and less before it stands still.
        moving = all(len(side) >= HELD and min(np.median(side), *side[:2]) > FAR * finest for side in sides)
        found[begin:end] = end - begin >= HELD and moving
    return found


def _finest(log: Log) -> float:
    """The recorder's finest step."""
    few = log.response[:: len(log) // LEVELS + 1]
    return float(np.min(np.diff(np.unique(np.concatenate([[0.0], few.real, few.imag]))), initial=np.inf))


def _runs(chosen: np.ndarray) -> zip:
    """(begin, end) of each stretch of chosen rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return zip(edges[::2], edges[1::2], strict=True)


def filled(log: Log, rows: np.ndarray) -> Log:
    """The log with a straight line through these rows: for starting values, which need some number there."""
    n = np.arange(len(log))
    return replace(log, response=np.interp(n, n[~rows], log.response[~rows])) if np.any(rows) else log
