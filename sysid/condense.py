"""Logs of millions of rows, as the means of neighbouring rows: what the fit then takes, with nothing assumed about tau.

Blocks are densest after each change of the inputs and widen with the time since, as the response slows down. A block keeps
the mean and the variance of its times, so that the model of its mean response is exact to fourth order in (block / tau); of a
mean amplitude, which is none of a mean response, to second order. Rows behind a filter that are closer than it can tell apart
are taken together in logs of any length.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from sysid.hold import Hold, contact, hold_inputs, settled_points
from sysid.log import Log

LONG = 16384  # rows of a log that the fit looks at one by one
MOST = 4096  # rows of a longer one when it is condensed


def prepare(log: Log, kind: str, longest: int = LONG, means: bool = False) -> tuple[Log, Hold, np.ndarray]:
    """The log, condensed where it has more than `longest` rows, settled points without the delay of their sensor; its inputs; and
    how many rows each of its rows is the mean of. `means`: it has been condensed."""
    log = levelled(undelayed(log) if kind == "steady" else log)
    hold = _inputs(log, kind)
    n = len(log)
    blocks = np.arange(n) if kind == "steady" or means else _alike(log, hold)
    if means or (n <= longest and len(blocks) == n) or log.kind is None:  # its kind may still change
        return log, hold, np.ones(n)
    if kind == "steady":
        if (log.drive is not None and np.ptp(log.drive) > 0) or log.frequency is None:
            return log, hold, np.ones(n)
        order = np.argsort(log.frequency, kind="stable")
        log = taken(replace(log, time=None, kind="steady"), order)
        edges = np.linspace(0, n, MOST + 1).astype(int)[:-1]
        short = _means(log, edges)
        return short, _inputs(short, kind), np.diff(np.append(edges, n)).astype(float)
    if len(hold.drive) > MOST // 8 and len(blocks) > longest:
        return log, hold, np.ones(n)
    edges = blocks if len(blocks) <= longest else _edges(hold, blocks)
    count = np.diff(np.append(edges, n)).astype(float)
    elapsed = _mean(hold.elapsed, edges, count)
    square = np.square(hold.elapsed)
    square += hold.spread
    spread = np.maximum(_mean(square, edges, count) - elapsed**2, 0.0)
    spread = np.where((count > 1) & (not log.amplitude_only), spread, hold.spread[edges])
    hold = hold._replace(interval=hold.interval[edges], elapsed=elapsed, spread=spread)
    return _means(log, edges), hold, count


def levelled(log: Log) -> Log:
    """A long log whose drive and frequency were measured and flicker about levels: with these levels, where they are few."""
    if len(log) <= LONG:
        return log
    return replace(log, drive=_levels(log.drive, 2e-2), frequency=_levels(log.frequency, 1e-5))


def _levels(values: np.ndarray | None, most: float) -> np.ndarray | None:
    """(n,) the mean of each stretch between jumps, unless the values do more within one than flicker from row to row, or by more
    than `most` of the largest."""
    if values is None:
        return None
    moves = np.abs(np.diff(values))
    usual = float(np.median(moves))
    begins = np.append(0, np.flatnonzero(moves > JUMP * usual) + 1)
    if usual == 0 or len(begins) > MOST // 16:
        return values
    count = np.diff(np.append(begins, len(values)))
    mean = _mean(values, begins, count)
    level = np.repeat(mean, count)
    return level if usual <= most * np.max(np.abs(mean)) and _independent(values - level, STEADY * usual) else values


def _independent(values: np.ndarray, most: float) -> bool:
    """Whether values of zero mean are noise of their own in each row, as far as their moves and the means of blocks tell."""
    moves = np.diff(values)
    back = -0.5 * float(moves @ moves)  # the product of a move and the next, if so
    return float(moves[1:] @ moves[:-1]) < 0.7 * back and all(_off(values, rows) <= most for rows in BLOCKS)


def _off(values: np.ndarray, rows: int) -> float:
    """The largest mean of a block of `rows`, times their root: of independent values a few of their standard deviations."""
    blocks = values[: len(values) // rows * rows].reshape(-1, rows)
    return float(np.max(np.abs(np.mean(blocks, axis=1)))) * float(np.sqrt(rows))


def undelayed(log: Log, sign: float = 1.0) -> Log:
    """Settled d/q points without the turn e^{-j omega t} of a stated delay t, but for what is common to all of them, which is the
    demodulator's. `sign` -1: with it again."""
    late = log.bench.get("delay_s", 0.0)
    if not late or log.amplitude_only or log.frequency is None:
        return log
    turn = np.exp(sign * 2j * np.pi * late * (log.frequency - np.mean(log.frequency)))
    return replace(log, response=log.response * turn)


JUMP = 12.0  # usual moves from row to row, the median, that are a jump: normal ones exceed 9 in no log
BLOCKS = (16, 256, 4096)  # rows, of which means tell whether they are level:
STEADY = 6.0  # usual moves over the root of their rows, no more than which they are then off
LEAST_FORCE = 0.01  # N; less is a force sensor's own
OFFSET_UNITS = {"degC", "degF", "K"}  # scales whose zero means nothing: a start value is an offset, not a response


def one_level(log: Log) -> bool:
    """A transient whose inputs never change: nothing in it tells an offset from a response."""
    inputs = [c for c in (log.drive, log.frequency) if c is not None]
    return log.drive is not None and bool(np.any(log.drive != 0)) and all(np.all(c == c[0]) for c in inputs)


def from_rest(log: Log) -> bool:
    """A transient of a single level that begins near zero: read as a step at the first row."""
    if not one_level(log):
        return False
    return log.response_unit in OFFSET_UNITS or bool(abs(log.response[0]) < 0.1 * np.max(np.abs(log.response)))


ALIKE = 0.2  # of the time constants of a filter's poles together
FEWEST = 64  # blocks of rows that hold about the same noise: a filter as long as the log is one that was not there
STILL = 12  # rows of equal inputs before a change, at most, by which it is told that the response was still; two are needed
SOME = 100_000  # rows of which the usual step is taken
LONGER = 1.5  # times the usual step from row to row is a gap
MOVED = 3.0  # times the usual change from row to row, and what the slope of the rows before makes: by noise in one of 500


def gaps(log: Log) -> np.ndarray:
    """(n,) s before each row of a transient in which an input changed, who knows when, as rows are missing; else 0.

    By the contract a change is at a row. Of `instant` rows it was not where the response moved before, though it had been still;
    of `settled` ones it may never be.
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
    """Of rows, per second: from the mean of their first half to that of the second."""
    half = len(time) // 2
    rise, over = (np.mean(v[half:]) - np.mean(v[:half]) for v in (response, time))
    return float(np.abs(rise) / max(over, 1e-300))


def _inputs(log: Log, kind: str) -> Hold:
    drive = log.drive
    if drive is None:  # unknown: settled points have a gain of their own, a transient is taken as undriven
        drive = np.full(len(log), 1.0 if kind == "steady" else 0.0)
    if kind == "steady":
        return settled_points(drive, log.frequency, log.temperature, _contact(log))
    given = {"settled": log.sampling == "settled", "delay": log.bench.get("delay_s", 0.0), "theta": log.theta}
    unseen = gaps(log)
    given |= {"early": 0.5 * unseen} if np.any(unseen) and log.sampling != "settled" else {}
    hold = hold_inputs(log.time, drive, log.frequency, log.temperature, _contact(log), at_rest=from_rest(log), **given)
    width = log.bench.get("lockin_boxcar_s", 0.0)
    return hold._replace(spread=np.where(hold.elapsed > 0, width**2 / 12, 0.0))


def _contact(log: Log) -> np.ndarray | None:
    """Of the recorded force, of either sign, from row to row at its middle; None where there is none but the sensor's own."""
    if log.force is None or np.max(np.abs(log.force)) < LEAST_FORCE:
        return None
    force = np.abs(log.force)
    force = np.where(force < LEAST_FORCE, 0.0, force)
    if log.kind != "steady" and log.sampling != "settled":
        force = 0.5 * (force + np.append(force[1:], force[-1]))
    return contact(force, xp=np)


def _alike(log: Log, hold: Hold) -> np.ndarray:
    """(blocks,) first rows of blocks that hold about the same noise. Behind a filter of several poles it is smoother than the
    Ornstein-Uhlenbeck process that it is taken for, which finds in the differences of rows what is not there."""
    tau, order = log.bench.get("lockin_tau_s", 0.0), log.bench.get("lockin_order", 1)
    if not tau or order < 2 or log.theta is not None:
        return np.arange(len(log))
    since = log.time - log.time[np.searchsorted(hold.interval, hold.interval)]
    block = np.floor(since / min(ALIKE * order * tau, (log.time[-1] - log.time[0]) / FEWEST) + 1e-6)
    return np.unique([0, 1, *(np.flatnonzero((np.diff(block) != 0) | (np.diff(hold.interval) != 0)) + 1)])


def _edges(hold: Hold, blocks: np.ndarray) -> np.ndarray:
    """(longer blocks,) their first rows: none crosses a change of the inputs, and within a stretch they widen linearly."""
    starts = np.searchsorted(hold.interval[blocks], np.arange(len(hold.drive)))
    stops = np.append(starts[1:], len(blocks))
    share = np.linspace(0, 1, MOST // len(starts), endpoint=False) ** 2
    edges = [a + np.unique((share * (b - a)).astype(int)) for a, b in zip(starts, stops, strict=True) if b > a]
    return blocks[np.unique(np.concatenate([[0], *edges]))]


def _mean(values: np.ndarray, edges: np.ndarray, count: np.ndarray) -> np.ndarray:
    return np.add.reduceat(values, edges) / count


def _means(log: Log, edges: np.ndarray) -> Log:
    count = np.diff(np.append(edges, len(log))).astype(float)
    arrays: dict[str, Any] = {}
    for name in ("response", "time", "drive", "frequency", "theta", "temperature", "force"):
        values = getattr(log, name)
        constant = name in ("drive", "theta") or (name == "frequency" and log.kind != "steady")
        arrays[name] = None if values is None else values[edges] if constant else _mean(values, edges, count)
    return replace(log, **arrays)


def taken(log: Log, rows: np.ndarray) -> Log:
    """These rows of the log."""
    names = ("response", "time", "drive", "frequency", "theta", "temperature", "force")
    taken: dict[str, Any] = {k: None if getattr(log, k) is None else getattr(log, k)[rows] for k in names}
    return replace(log, **taken)
