"""The rows of a log as a fit uses them: what holds a signal, the inputs of each row, and blocks of rows where
there are many."""

from dataclasses import dataclass, replace

import numpy as np

from sysid.logs.log import Log
from sysid.rows import condense
from sysid.rows.condense import LEAST, LONG, MOST
from sysid.rows.gap import gaps
from sysid.rows.glitch import glitches
from sysid.rows.hold import Hold, contact, hold_inputs, settled_points
from sysid.rows.level import levelled
from sysid.rows.lost import filled, lost

LEAST_FORCE = 0.01  # N; less is a force sensor's own
OFFSET_UNITS = {
    "degC",
    "degF",
    "K",
}  # scales whose zero means nothing: a start value is an offset, not a response
RUNS_ON = 0.2  # of a force's move from row to row, by which it also moves before or after: less is a step


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


def prepare(log: Log, kind: str, longest: int = LONG, spoilt: np.ndarray | None = None) -> Rows:
    """The log, condensed where it has more than `longest` rows; settled points without the delay of their
    sensor. `spoilt` (n,): what a recorder spoilt, if that is known."""
    dark, steady = lost(log), kind == "steady"
    spoilt = (glitches(filled(log, dark)) if spoilt is None else spoilt) & ~dark
    gone = dark | spoilt
    log = levelled(undelayed(filled(log, gone)) if steady else filled(log, gone))
    unseen = None if steady else gaps(log)
    hold, n = _inputs(log, kind, unseen), len(log)
    blocks = None if steady else condense.alike(log, hold)
    most = n if blocks is None else len(blocks)
    gap, odd = 0.0 if unseen is None else float(np.max(unseen)), tuple(np.flatnonzero(spoilt).tolist())
    rows = Rows(log, hold, np.ones(n), ~gone, int(np.sum(dark)), odd, gap, most)
    if (n <= longest and most == n) or log.kind is None:  # its kind may still change
        return rows
    return _fewer_points(rows) if steady else _fewer_rows(rows, blocks, longest)


def _fewer_points(rows: Rows) -> Rows:
    """Means of settled points beside each other in frequency, if nothing else changes."""
    log, n = rows.log, len(rows.log)
    if (log.drive is not None and np.ptp(log.drive) > 0) or log.frequency is None:
        return rows
    order = np.argsort(log.frequency, kind="stable")
    edges = np.linspace(0, n, MOST + 1).astype(int)[:-1]
    weight, count, there = condense.weights(rows.there[order], edges)
    short = condense.means(condense.taken(replace(log, time=None, kind="steady"), order), edges, weight)
    return replace(rows, log=short, inputs=_inputs(short, "steady", None), count=count, there=there)


def _fewer_rows(rows: Rows, blocks: np.ndarray | None, longest: int) -> Rows:
    """Means of a transient's rows, with the mean and the variance of their times; not where its inputs change
    too often."""
    log, hold = rows.log, rows.inputs
    if 2 * LEAST * len(hold.drive) > max(2 * MOST, len(log)) and rows.most > longest:
        return rows
    edges = blocks if blocks is not None and rows.most <= longest else condense.edges(hold, blocks)
    weight, count, there = condense.weights(rows.there, edges)
    elapsed = condense.mean(hold.elapsed, edges, weight)
    square = np.square(hold.elapsed)
    square += hold.spread
    spread = np.maximum(condense.mean(square, edges, weight) - elapsed**2, 0.0)
    spread = np.where((count > 1) & (not log.amplitude_only), spread, hold.spread[edges])
    hold = hold._replace(interval=hold.interval[edges], elapsed=elapsed, spread=spread)
    return replace(rows, log=condense.means(log, edges, weight), inputs=hold, count=count, there=there)


def undelayed(log: Log, sign: float = 1.0) -> Log:
    """Settled d/q points without the phase e^{-j omega t} of a stated delay t, except for the part common to
    all, which belongs to the demodulator. `sign` -1 applies the delay again."""
    late = log.bench.get("delay_s", 0.0)
    if not late or log.amplitude_only or log.frequency is None:
        return log
    turn = np.exp(sign * 2j * np.pi * late * (log.frequency - np.mean(log.frequency)))
    return replace(log, response=log.response * turn)


def one_level(log: Log) -> bool:
    """A transient whose inputs never change: nothing in it tells an offset from a response."""
    inputs = [c for c in (log.drive, log.frequency) if c is not None]
    return log.drive is not None and bool(np.any(log.drive != 0)) and all(np.all(c == c[0]) for c in inputs)


def from_rest(log: Log) -> bool:
    """A transient of a single level that begins near zero: read as a step at the first row."""
    if not one_level(log):
        return False
    return log.response_unit in OFFSET_UNITS or bool(
        abs(log.response[0]) < 0.1 * np.max(np.abs(log.response))
    )


def _inputs(log: Log, kind: str, unseen: np.ndarray | None) -> Hold:
    drive = log.drive
    if drive is None:  # unknown: settled points have a gain of their own, a transient is taken as undriven
        drive = np.full(len(log), 1.0 if kind == "steady" else 0.0)
    if kind == "steady":
        return settled_points(drive, log.frequency, log.temperature, _contact(log))
    given = {"settled": log.sampling == "settled", "delay": log.bench.get("delay_s", 0.0), "theta": log.theta}
    given |= (
        {"early": 0.5 * unseen} if unseen is not None and np.any(unseen) and log.sampling != "settled" else {}
    )
    hold = hold_inputs(
        log.time, drive, log.frequency, log.temperature, _contact(log), at_rest=from_rest(log), **given
    )
    width = log.bench.get("lockin_boxcar_s", 0.0)
    return hold._replace(spread=np.where(hold.elapsed > 0, width**2 / 12, 0.0))


def _contact(log: Log) -> np.ndarray | None:
    """Contact of the recorded force, of either sign, held from row to row, or at its middle where it changes
    over several rows; None where there is only the sensor's noise."""
    if log.force is None or np.max(np.abs(log.force)) < LEAST_FORCE:
        return None
    force = np.abs(log.force)
    force = np.where(force < LEAST_FORCE, 0.0, force)
    if log.kind != "steady" and log.sampling != "settled":
        move = np.append(np.diff(force), 0.0)
        beside = np.maximum(
            *(np.sign(move) * np.append(*pair) for pair in ((0.0, move[:-1]), (move[1:], 0.0)))
        )
        force = force + np.where(beside > RUNS_ON * np.abs(move), 0.5 * move, 0.0)
    return contact(force)
