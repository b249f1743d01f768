"""Logs of millions of rows, averaged over blocks of neighbouring rows, without an assumption about tau.

Blocks are shortest after each change of the inputs and widen with the time since, as the response slows down. A block keeps the
mean and variance of its times, so that the model of its mean response is exact to fourth order in (block/tau); for a mean
amplitude, which is not the amplitude of a mean response, to second order. Rows behind a filter that are closer than it can
resolve are averaged in logs of any length.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.logs.log import Log
from sysid.rows.glitch import glitches
from sysid.rows.hold import Hold, contact, hold_inputs, settled_points
from sysid.rows.lost import filled, lost

LONG = 16384  # rows of a log that the fit looks at one by one
MOST = 4096  # rows of a longer one when it is condensed, and
LEAST = 16  # of each stretch of the same inputs, be these as many as they are


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a log as a fit uses them."""

    log: Log
    inputs: Hold
    count: np.ndarray  # (n,) rows of the file that each row is the mean of, less those without a signal
    there: np.ndarray  # (n,) rows that have any
    dark: int  # rows of the file without a signal
    spoilt: tuple[int, ...]  # and those that a recorder spoilt
    gap: float  # s, the longest without a row in which an input changed, who knows when
    most: int  # rows, if condensed no more than a filter asks for


def prepare(log: Log, kind: str, longest: int = LONG) -> Rows:
    """The log, condensed where it has more than `longest` rows; settled points without the delay of their sensor."""
    dark, steady = lost(log), kind == "steady"
    spoilt = glitches(filled(log, dark)) & ~dark
    gone = dark | spoilt
    log = levelled(undelayed(filled(log, gone)) if steady else filled(log, gone))
    unseen = np.zeros(len(log)) if steady else gaps(log)
    hold, n = _inputs(log, kind, unseen), len(log)
    blocks = None if steady else _alike(log, hold)
    most = n if blocks is None else len(blocks)
    gap, odd = float(np.max(unseen, initial=0.0)), tuple(np.flatnonzero(spoilt).tolist())
    rows = Rows(log, hold, np.ones(n), ~gone, int(np.sum(dark)), odd, gap, most)
    if (n <= longest and most == n) or log.kind is None:  # its kind may still change
        return rows
    if steady:
        if (log.drive is not None and np.ptp(log.drive) > 0) or log.frequency is None:
            return rows
        order = np.argsort(log.frequency, kind="stable")
        log, gone = taken(replace(log, time=None, kind="steady"), order), gone[order]
        edges = np.linspace(0, n, MOST + 1).astype(int)[:-1]
        weight, count, there = _weights(gone, edges)
        short = _means(log, edges, weight)
        return replace(rows, log=short, inputs=_inputs(short, kind, unseen), count=count, there=there)
    if 2 * LEAST * len(hold.drive) > max(2 * MOST, n) and most > longest:
        return rows
    edges = blocks if blocks is not None and most <= longest else _edges(hold, blocks)
    weight, count, there = _weights(gone, edges)
    elapsed = _mean(hold.elapsed, edges, weight)
    square = np.square(hold.elapsed)
    square += hold.spread
    spread = np.maximum(_mean(square, edges, weight) - elapsed**2, 0.0)
    spread = np.where((count > 1) & (not log.amplitude_only), spread, hold.spread[edges])
    hold = hold._replace(interval=hold.interval[edges], elapsed=elapsed, spread=spread)
    return replace(rows, log=_means(log, edges, weight), inputs=hold, count=count, there=there)


def _weights(gone: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
    """Weight of each row in the mean of its block (None: all one); for each block the number of rows with a signal, at least 1,
    and whether it has any."""
    length = np.diff(np.append(edges, len(gone)))
    if not np.any(gone):
        return None, length.astype(float), np.ones(len(length), bool)
    count = np.add.reduceat((~gone).astype(float), edges)
    return np.where(np.repeat(count == 0, length), 1.0, ~gone), np.maximum(count, 1.0), count > 0


def levelled(log: Log) -> Log:
    """The log with a measured drive that flickers about a few levels replaced by these levels, unless the response flickers with
    it; in a long log the frequency as well."""
    drive = _levels(log.drive, 2e-2)
    if len(log) > LONG:
        return replace(log, drive=drive, frequency=_levels(log.frequency, 1e-5))
    return replace(log, drive=drive) if drive is not log.drive and not _followed(log, drive) else log


def _followed(log: Log, level: np.ndarray) -> bool:
    """Whether the response follows the drive's deviations from its level: divided by the drive it is smoother from row to row, or
    it moves after the drive did. A drive of a few values is not a meter's noise."""
    beside = log.drive - level
    if len(np.unique(beside)) <= DIGITS * len(np.unique(level)):
        return True
    by_drive, by_level = (np.diff(log.response * (level / np.where(of == 0, np.inf, of)), 2) for of in (log.drive, level))
    if np.sum(np.abs(by_drive) ** 2) < np.sum(np.abs(by_level) ** 2):
        return True
    moves = np.diff(log.response)
    moves = moves / np.maximum(np.abs(moves), 3 * np.median(np.abs(moves)) or 1.0)  # of a step no more than of the rows about it
    size = float(np.sqrt(np.mean(np.abs(moves) ** 2) * np.sum(beside**2))) or 1.0
    return any(abs(np.sum(moves[k:] * beside[: len(moves) - k])) > FOLLOWED * size for k in range(min(AFTER, len(moves))))


def _levels(values: np.ndarray | None, most: float) -> np.ndarray | None:
    """(n,) the mean of each stretch between jumps; the values themselves where they vary more within a stretch than they flicker
    from row to row, or flicker by more than `most` of the largest."""
    if values is None:
        return None
    moves = np.abs(np.diff(values))
    usual = float(np.median(moves)) if len(moves) >= BLOCKS[0] else 0.0
    begins = np.append(0, np.flatnonzero(moves > JUMP * usual) + 1)
    if usual == 0 or len(begins) > min(MOST, len(values)) // 16:
        return values
    mean = _mean(values, begins)
    level = np.repeat(mean, np.diff(np.append(begins, len(values))))
    return level if usual <= most * np.max(np.abs(mean)) and _independent(values - level, STEADY * usual) else values


def _independent(values: np.ndarray, most: float) -> bool:
    """Whether values of zero mean are noise, independent from row to row, judged by their moves and the means of blocks."""
    moves = np.diff(values)
    back = -0.5 * float(moves @ moves)  # the product of a move and the next, if so
    blocks = [rows for rows in BLOCKS if rows <= len(values)]
    much = 0.7 - 2 / np.sqrt(len(values))  # of few rows by chance
    return float(moves[1:] @ moves[:-1]) < much * back and all(_off(values, rows) <= most for rows in blocks)


def _off(values: np.ndarray, rows: int) -> float:
    """The largest mean of a block of `rows`, times their root: of independent values a few of their standard deviations."""
    blocks = values[: len(values) // rows * rows].reshape(-1, rows)
    return float(np.max(np.abs(np.mean(blocks, axis=1)))) * float(np.sqrt(rows))


def undelayed(log: Log, sign: float = 1.0) -> Log:
    """Settled d/q points without the phase e^{-j omega t} of a stated delay t, except for the part common to all, which belongs
    to the demodulator. `sign` -1 applies the delay again."""
    late = log.bench.get("delay_s", 0.0)
    if not late or log.amplitude_only or log.frequency is None:
        return log
    turn = np.exp(sign * 2j * np.pi * late * (log.frequency - np.mean(log.frequency)))
    return replace(log, response=log.response * turn)


JUMP = 12.0  # usual moves from row to row, the median, that are a jump: normal ones exceed 9 in no log
BLOCKS = (16, 256, 4096)  # rows, of which means tell whether they are level:
DIGITS = 3  # values beside its level, at most, of a drive that is meant to vary
FOLLOWED, AFTER = 4.0, 8  # standard deviations of chance by which a response moves with the drive, of some of so many rows before
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


ALIKE = 0.5  # of the time constants of a filter's poles together: noise of few poles is then about an Ornstein-Uhlenbeck process
NEW, WIDER = 0.2, 0.25  # of the longest, the first after a change; of the time since, by which the others are longer
FEWEST = 20  # blocks of rows that hold about the same noise: a filter as long as the log is one that was not there
STILL = 12  # rows of equal inputs before a change, at most, by which it is told that the response was still; two are needed
SOME = 100_000  # rows of which the usual step is taken
LONGER = 1.5  # times the usual step from row to row is a gap
MOVED = 3.0  # times the usual change from row to row, and what the slope of the rows before makes: by noise in one of 500


def gaps(log: Log) -> np.ndarray:
    """(n,) length (s) of the gap before each row of a transient in which an input changed at an unknown time, as rows are
    missing; else 0.

    By contract a change happens at a row. For `instant` rows it did not if the response moved before although it had been still;
    for `settled` rows it may never have.
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


def _inputs(log: Log, kind: str, unseen: np.ndarray) -> Hold:
    drive = log.drive
    if drive is None:  # unknown: settled points have a gain of their own, a transient is taken as undriven
        drive = np.full(len(log), 1.0 if kind == "steady" else 0.0)
    if kind == "steady":
        return settled_points(drive, log.frequency, log.temperature, _contact(log))
    given = {"settled": log.sampling == "settled", "delay": log.bench.get("delay_s", 0.0), "theta": log.theta}
    given |= {"early": 0.5 * unseen} if np.any(unseen) and log.sampling != "settled" else {}
    hold = hold_inputs(log.time, drive, log.frequency, log.temperature, _contact(log), at_rest=from_rest(log), **given)
    width = log.bench.get("lockin_boxcar_s", 0.0)
    return hold._replace(spread=np.where(hold.elapsed > 0, width**2 / 12, 0.0))


def _contact(log: Log) -> np.ndarray | None:
    """Contact of the recorded force, of either sign, held from row to row, or at its middle where it changes over several rows;
    None where there is only the sensor's noise."""
    if log.force is None or np.max(np.abs(log.force)) < LEAST_FORCE:
        return None
    force = np.abs(log.force)
    force = np.where(force < LEAST_FORCE, 0.0, force)
    if log.kind != "steady" and log.sampling != "settled":
        move = np.append(np.diff(force), 0.0)
        beside = np.maximum(*(np.sign(move) * np.append(*pair) for pair in ((0.0, move[:-1]), (move[1:], 0.0))))
        force = force + np.where(beside > RUNS_ON * np.abs(move), 0.5 * move, 0.0)
    return contact(force, xp=np)


RUNS_ON = 0.2  # of a force's move from row to row, by which it also moves before or after: less is a step


def _alike(log: Log, hold: Hold) -> np.ndarray | None:
    """(blocks,) first rows of blocks that hold about the same noise; None: each row is one. Behind a filter of several poles
    noise is smoother than the Ornstein-Uhlenbeck process that it is taken for, which finds in the differences of rows what is not
    there."""
    tau, order = log.bench.get("lockin_tau_s", 0.0), log.bench.get("lockin_order", 1)
    if not tau or order < 2 or log.theta is not None or log.time[-1] <= log.time[0]:
        return None
    since = log.time - log.time[np.searchsorted(hold.interval, hold.interval)]
    longest = min(ALIKE * order * tau, (log.time[-1] - log.time[0]) / FEWEST)
    first, grown = NEW * longest, (1 - NEW) * longest / WIDER
    block = np.log1p(WIDER * np.minimum(since, grown) / first) / WIDER + np.maximum(since - grown, 0.0) / longest
    block = np.floor(block + 1e-6)
    return np.unique([0, 1, *(np.flatnonzero((np.diff(block) != 0) | (np.diff(hold.interval) != 0)) + 1)])


def _edges(hold: Hold, blocks: np.ndarray | None) -> np.ndarray:
    """(longer blocks,) their first rows: none crosses a change of the inputs, and within a stretch they widen linearly."""
    interval = hold.interval if blocks is None else hold.interval[blocks]
    starts = np.searchsorted(interval, np.arange(len(hold.drive)))
    stops = np.append(starts[1:], len(interval))
    share = np.linspace(0, 1, max(MOST // len(starts), LEAST), endpoint=False) ** 2
    edges = [a + np.unique((share * (b - a)).astype(int)) for a, b in zip(starts, stops, strict=True) if b > a]
    found = np.unique(np.concatenate([[0, 1], *edges]))
    return found if blocks is None else blocks[found]


def _mean(values: np.ndarray, edges: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    if weight is None:
        return np.add.reduceat(values, edges) / np.diff(np.append(edges, len(values)))
    return np.add.reduceat(values * weight, edges) / np.add.reduceat(weight, edges)


def _means(log: Log, edges: np.ndarray, weight: np.ndarray | None) -> Log:
    arrays: dict[str, Any] = {}
    for name in ("response", "time", "drive", "frequency", "theta", "temperature", "force"):
        values = getattr(log, name)
        constant = name in ("drive", "theta") or (name == "frequency" and log.kind != "steady")
        arrays[name] = None if values is None else values[edges] if constant else _mean(values, edges, weight)
    return replace(log, **arrays)


def taken(log: Log, rows: np.ndarray) -> Log:
    """These rows of the log."""
    names = ("response", "time", "drive", "frequency", "theta", "temperature", "force")
    taken: dict[str, Any] = {k: None if getattr(log, k) is None else getattr(log, k)[rows] for k in names}
    return replace(log, **taken)
