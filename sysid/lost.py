"""Rows in which the signal was lost: a recorder then writes exactly zero, as for a vibrometer whose speckle is dark.

A plate at rest before its first drive may read exactly zero, and a response that decays passes through small numbers on its way
there; exact zeros among rows that are far larger than the recorder's finest step are neither.
"""

from dataclasses import replace

import numpy as np

from sysid.log import Log

BESIDE = 8  # rows on each side that are looked at
FAR = 10.0  # times the finest step, above which the typical one of them lies
LEVELS = 100_000  # rows of which the finest step is taken
MOST = 0.5  # of the rows; where more are zero, it is the rest that is strange


def lost(log: Log) -> np.ndarray:
    """(n,) which rows of a log hold no signal."""
    size = np.abs(log.response)
    zero, found = size == 0, np.zeros(len(log), bool)
    if not 0 < np.sum(zero) <= MOST * len(log):
        return found
    few = log.response[:: len(log) // LEVELS + 1]
    levels = np.unique(np.concatenate([[0.0], few.real, few.imag]))
    finest, signal = np.min(np.diff(levels)), np.flatnonzero(~zero)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], zero, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        at = int(np.searchsorted(signal, begin))
        sides = [size[rows] for rows in (signal[max(at - BESIDE, 0) : at], signal[at : at + BESIDE]) if len(rows)]
        found[begin:end] = begin > 0 and all(np.median(side) > FAR * finest for side in sides)
    return found


def filled(log: Log, rows: np.ndarray) -> Log:
    """The log with a straight line through these rows: for starting values, which need some number there."""
    n = np.arange(len(log))
    return replace(log, response=np.interp(n, n[~rows], log.response[~rows])) if np.any(rows) else log
