"""Measured drives and frequencies that flicker about a few levels: the levels."""

from dataclasses import replace

import numpy as np

from sysid.logs.log import Log
from sysid.rows.condense import LONG, MOST, mean

JUMP = 12.0  # usual moves from row to row, the median, that are a jump: normal ones exceed 9 in no log
BLOCKS = (16, 256, 4096)  # rows, of which means tell whether they are level
DIGITS = 3  # values beside its level, at most, of a drive that is meant to vary
FOLLOWED, AFTER = (
    4.0,
    8,
)  # standard deviations of chance by which a response moves with the drive, of some of so many rows before
STEADY = 6.0  # usual moves over the root of their rows, no more than which they are then off


def levelled(log: Log) -> Log:
    """The log with a measured drive that flickers about a few levels replaced by these levels, unless the
    response flickers with it; in a long log the frequency as well."""
    drive = _levels(log.drive, 2e-2)
    if len(log) > LONG:
        return replace(log, drive=drive, frequency=_levels(log.frequency, 1e-5))
    return replace(log, drive=drive) if drive is not log.drive and not _followed(log, drive) else log


def _followed(log: Log, level: np.ndarray) -> bool:
    """Whether the response follows the drive's deviations from its level: divided by the drive it is smoother
    from row to row, or it moves after the drive did. A drive of a few values is not a meter's noise."""
    beside = log.drive - level
    if len(np.unique(beside)) <= DIGITS * len(np.unique(level)):
        return True
    by_drive, by_level = (
        np.diff(log.response * (level / np.where(of == 0, np.inf, of)), 2) for of in (log.drive, level)
    )
    if np.sum(np.abs(by_drive) ** 2) < np.sum(np.abs(by_level) ** 2):
        return True
    moves = np.diff(log.response)
    moves = moves / np.maximum(
        np.abs(moves), 3 * np.median(np.abs(moves)) or 1.0
    )  # of a step no more than of the rows about it
    size = float(np.sqrt(np.mean(np.abs(moves) ** 2) * np.sum(beside**2))) or 1.0
    return any(
        abs(np.sum(moves[k:] * beside[: len(moves) - k])) > FOLLOWED * size
        for k in range(min(AFTER, len(moves)))
    )


def _levels(values: np.ndarray | None, most: float) -> np.ndarray | None:
    """(n,) the mean of each stretch between jumps, and where these are many, of stretches that are alike; the
    values themselves where they vary more within a stretch than they flicker from row to row, or flicker by
    more than `most` of the largest."""
    if values is None:
        return None
    moves = np.abs(np.diff(values))
    usual = float(np.median(moves)) if len(moves) >= BLOCKS[0] else 0.0
    if usual == 0:
        return values
    begins, few = np.append(0, np.flatnonzero(moves > JUMP * usual) + 1), min(MOST, len(values)) // 16
    which = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(values))))
    if len(begins) > few:
        which = _alike(mean(values, begins), usual)[which]
    if which.max() >= few:
        return values
    level = (np.bincount(which, values) / np.bincount(which))[which]
    return (
        level
        if usual <= most * np.max(np.abs(level)) and _independent(values - level, STEADY * usual)
        else values
    )


def _alike(means: np.ndarray, usual: float) -> np.ndarray:
    """(m,) to which level each of the means belongs: between two levels is a gap that is wider than a usual
    move."""
    order = np.argsort(means)
    found = np.empty(len(means), int)
    found[order] = np.append(0, np.cumsum(np.diff(means[order]) > usual))
    return found


def _independent(values: np.ndarray, most: float) -> bool:
    """Whether values of zero mean are noise, independent from row to row, judged by their moves and the means
    of blocks."""
    moves = np.diff(values)
    back = -0.5 * float(moves @ moves)  # the product of a move and the next, if so
    blocks = [rows for rows in BLOCKS if rows <= len(values)]
    much = 0.7 - 2 / np.sqrt(len(values))  # of few rows by chance
    return float(moves[1:] @ moves[:-1]) < much * back and all(_off(values, rows) <= most for rows in blocks)


def _off(values: np.ndarray, rows: int) -> float:
    """The largest mean of a block of `rows`, times their root: of independent values a few of their standard
    deviations."""
    blocks = values[: len(values) // rows * rows].reshape(-1, rows)
    return float(np.max(np.abs(np.mean(blocks, axis=1)))) * float(np.sqrt(rows))
