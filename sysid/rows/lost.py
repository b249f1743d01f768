"""Rows in which the signal was lost: the recorder writes exactly zero, as for a vibrometer's dark speckle, or
repeats its last reading.

A plate at rest before its first drive may read exactly zero, and a decaying response passes through small
numbers; lost rows are exact zeros among rows far larger than the recorder's finest step. A coarse recorder
repeats itself; but where both Wd and Wq stand still among rows that move by hundreds of steps, they were not
measured anew: in one row, in a stretch, or in every second row of a recorder that samples faster than its
lock-in. A row that is the one before in every column is a copy of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.logs.log import Log

BESIDE = 8  # rows on each side that are looked at
FAR = 10.0  # times the finest step, above which the typical one of them lies
LEVELS = 100_000  # rows of which the finest step is taken
MORE = 3.0  # times as many zeros as chance makes
MOST = 0.5  # of the rows; where more are zero, it is the rest that is strange
BLOCK = 1 << 18  # rows that are looked at together, so that a long log needs little memory
STRETCH = 64  # rows among whose moves those of one size are counted
# times the least of them, above which those beside a row lie: what comes to rest moves by a step or two
# before
AMID = 3.0
ROUNDING = 1e-6  # of a typical move, by which two of as many steps may differ
RARE = 0.01  # repeats by chance that may be expected, over those that are there


def lost(log: Log) -> np.ndarray:
    """(n,) which rows of a log hold no signal."""
    return _zero(log) | _held(log)


def copies(log: Log) -> np.ndarray:
    """(n,) rows that are the row before once more: all that were recorded at the same inputs, and at the same
    time, read the same, and no noise of their own."""
    columns = [getattr(log, name) for name in ("time", "frequency", "drive", "temperature", "force")]
    at = [c[1:] == c[:-1] for c in columns if c is not None]
    alike = np.append(False, np.logical_and.reduce(at)) if at else np.zeros(len(log), bool)
    again = np.append(False, log.response[1:] == log.response[:-1])
    timed = log.time is not None or log.kind == "steady"
    return alike if timed and np.all(again[alike]) and not np.all(again[1:]) else np.zeros(len(log), bool)


def _zero(log: Log) -> np.ndarray:
    size = np.abs(log.response)
    zero, found = size == 0, np.zeros(len(log), bool)
    if not MORE * _by_chance(log) < np.sum(zero) <= MOST * len(log) or not np.any(zero):
        return found
    finest, signal = _finest(log), np.flatnonzero(~zero)
    for begin, end in runs(zero):
        at = int(np.searchsorted(signal, begin))
        sides = [
            size[rows] for rows in (signal[max(at - BESIDE, 0) : at], signal[at : at + BESIDE]) if len(rows)
        ]
        found[begin:end] = begin > 0 and all(np.median(side) > FAR * finest for side in sides)
    return found


def _by_chance(log: Log) -> float:
    """Rows that noise about zero makes exactly zero, by how often one of Wd and Wq is where the other is
    not."""
    if log.amplitude_only:
        return 0.0
    d, q = log.response.real == 0, log.response.imag == 0
    return float(np.sum(d & ~q)) * float(np.sum(q & ~d)) / len(log)


def _held(log: Log) -> np.ndarray:
    """Rows of Wd and Wq that both repeat the row before, among rows that move by so many steps that chance
    makes none."""
    found = np.zeros(len(log), bool)
    if log.amplitude_only:  # an amplitude that is clipped stands still as well
        return found
    still, changed = _still(log.response), change(log)
    for begin in range(0, len(log), BLOCK):
        if not np.any(still[begin : begin + BLOCK]):
            continue
        rows = slice(max(begin - STRETCH, 0), begin + BLOCK + STRETCH)
        amid = _amid(log.response[rows], still[rows], changed[rows])
        found[begin : begin + BLOCK] = amid[begin - rows.start :][:BLOCK]
    return found


def _still(response: np.ndarray) -> np.ndarray:
    """(n,) rows of which both channels repeat the row before; none where no more of them do than chance
    makes, by how often one channel does where the other does not."""
    d, q = (part[1:] == part[:-1] for part in (response.real, response.imag))
    both = d & q
    found = np.append(False, both)
    if np.sum(both) <= MORE * float(np.sum(d & ~q)) * float(np.sum(q & ~d)) / len(response):
        return np.zeros(len(response), bool)
    return found & ~(_at_an_end(response.real) & _at_an_end(response.imag))  # where both are clipped


def _amid(response: np.ndarray, still: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Which of the rows that stand still do so amid rows that move."""
    found, moves = np.zeros(len(response), bool), np.diff(response, prepend=response[:1])
    before = np.append(False, change[:-1])
    quiet, anew = ~change & ~before, change & before
    # A response without noise stands still once it has settled, and then until its inputs change; where each
    # row is driven anew, as in a sweep, it does not settle.
    moving = moves != 0
    strange = _unlike(moves, still & quiet, moving & quiet, np.cumsum(change)) | _unlike(
        moves, still & anew, moving & anew
    )
    for begin, end in runs(still) if np.any(strange) else ():
        found[begin:end] = np.any(strange[begin:end])
    return found


def _at_an_end(values: np.ndarray) -> np.ndarray:
    return (values == np.max(values)) | (values == np.min(values))


def change(log: Log, inputs: Sequence[str] = ("drive", "frequency")) -> np.ndarray:
    """(n,) rows whose drive or frequency is not that of the row before."""
    changed = np.zeros(len(log), bool)
    for name in inputs:
        if (c := getattr(log, name)) is not None:
            changed[1:] |= c[1:] != c[:-1]
    return changed


def _unlike(
    moves: np.ndarray, still: np.ndarray, moving: np.ndarray, hold: np.ndarray | None = None
) -> np.ndarray:
    """Which of the rows that stand still do so amid rows that are moving, and not by chance. `hold`: of the
    inputs, in which the response has to move on."""
    found, others, rows = np.zeros(len(moves), bool), np.flatnonzero(moving), np.flatnonzero(still)
    if not len(rows) or len(others) < STRETCH // 2:
        return found
    (least_d, chance_d), (least_q, chance_q) = (_least(part, others) for part in (moves.real, moves.imag))
    far = np.abs(moves[others]) > AMID * np.maximum(least_d, least_q)
    far = np.concatenate([[True, True], far, [True, True]])
    at = np.searchsorted(others, rows)  # two that move before each, and two after
    amid = far[at] & far[at + 1] & far[at + 2] & far[at + 3]
    near = np.minimum(at, len(others) - 1)
    if hold is not None:
        amid &= (at < len(others)) & (hold[others[near]] == hold[rows])
    found[rows] = amid & (len(rows) + len(others) < RARE * np.sum(amid) / (chance_d * chance_q)[near])
    return found


def _least(moves: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each of the `rows`, of a STRETCH of them: the least of the moves, 0 where no two are of one size, so
    that no step shows; and the chance of none, which is below that of two of one size where moves are rather
    small than large: the share of the pairs that are, and one more."""
    begins = np.maximum(np.minimum(np.arange(0, len(rows), STRETCH), len(rows) - STRETCH), 0)
    count = min(STRETCH, len(rows))
    size = np.sort(np.abs(moves[rows[begins[:, None] + np.arange(count)]]), axis=1)
    again = np.diff(size, axis=1, prepend=-1.0) <= ROUNDING * np.median(size, axis=1, keepdims=True)
    place = np.arange(count)
    pairs = np.sum(
        place - np.maximum.accumulate(np.where(again, 0, place), axis=1), axis=1
    )  # with those of its size before it
    least = np.where(pairs > 0, np.min(np.where(size > 0, size, np.inf), axis=1), 0.0)
    chance = (pairs + 1) / (count * (count - 1) / 2)
    own = np.arange(len(rows)) // STRETCH
    return np.where(np.isfinite(least), least, 0.0)[own], chance[own]


def _finest(log: Log) -> float:
    """The recorder's finest step."""
    few = log.response[:: len(log) // LEVELS + 1]
    return float(np.min(np.diff(np.unique(np.concatenate([[0.0], few.real, few.imag]))), initial=np.inf))


def runs(chosen: np.ndarray) -> zip:
    """(begin, end) of each stretch of chosen rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return zip(edges[::2], edges[1::2], strict=True)


def filled(log: Log, rows: np.ndarray) -> Log:
    """The log with a straight line through these rows: for starting values, which need some number there."""
    n = np.arange(len(log))
    return replace(log, response=np.interp(n, n[~rows], log.response[~rows])) if np.any(rows) else log
