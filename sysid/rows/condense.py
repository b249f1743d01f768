"""Logs of millions of rows, averaged over blocks of neighbouring rows, without an assumption about tau.

Blocks are shortest after each change of the inputs and widen with the time since, as the response slows down.
A block keeps the mean and variance of its times, so that the model of its mean response is exact to fourth
order in (block/tau); for a mean amplitude, which is not the amplitude of a mean response, to second order.
Rows behind a filter that are closer than it can resolve are averaged in logs of any length.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from sysid.logs.log import Log
from sysid.rows.hold import Hold

ARRAYS = (
    "response",
    "time",
    "drive",
    "frequency",
    "theta",
    "temperature",
    "force",
    "std",
)  # of a log, a value for each row
LONG = 16384  # rows of a log that the fit looks at one by one
MOST = 4096  # rows of a longer one when it is condensed, and
LEAST = 16  # of each stretch of the same inputs, be these as many as they are
# of the time constants of a filter's poles together: noise of few poles is then about an Ornstein-Uhlenbeck
# process
ALIKE = 0.5
NEW, WIDER = (
    0.2,
    0.25,
)  # of the longest, the first after a change; of the time since, by which the others are longer
# blocks of rows that hold about the same noise: a filter as long as the log is one that was not there
FEWEST = 20


def alike(log: Log, hold: Hold) -> np.ndarray | None:
    """(blocks,) first rows of blocks that hold about the same noise; None: each row is one. Behind a filter
    of several poles noise is smoother than the Ornstein-Uhlenbeck process that it is taken for, which finds
    in the differences of rows what is not there."""
    tau, order = log.bench.get("lockin_tau_s", 0.0), log.bench.get("lockin_order", 1)
    if not tau or order < 2 or log.theta is not None or log.time[-1] <= log.time[0]:
        return None
    since = log.time - log.time[np.searchsorted(hold.interval, hold.interval)]
    longest = min(ALIKE * order * tau, (log.time[-1] - log.time[0]) / FEWEST)
    first, grown = NEW * longest, (1 - NEW) * longest / WIDER
    block = (
        np.log1p(WIDER * np.minimum(since, grown) / first) / WIDER + np.maximum(since - grown, 0.0) / longest
    )
    block = np.floor(block + 1e-6)
    return np.unique([0, 1, *(np.flatnonzero((np.diff(block) != 0) | (np.diff(hold.interval) != 0)) + 1)])


def edges(hold: Hold, blocks: np.ndarray | None) -> np.ndarray:
    """(longer blocks,) their first rows: none crosses a change of the inputs, and within a stretch they widen
    linearly."""
    interval = hold.interval if blocks is None else hold.interval[blocks]
    starts = np.searchsorted(interval, np.arange(len(hold.drive)))
    stops = np.append(starts[1:], len(interval))
    share = np.linspace(0, 1, max(MOST // len(starts), LEAST), endpoint=False) ** 2
    within = [
        a + np.unique((share * (b - a)).astype(int)) for a, b in zip(starts, stops, strict=True) if b > a
    ]
    found = np.unique(np.concatenate([[0, 1], *within]))
    return found if blocks is None else blocks[found]


def mean(values: np.ndarray, edges: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """(blocks,) the mean of each block of rows; `weight` (n,) weighs them."""
    if weight is None:
        return np.add.reduceat(values, edges) / np.diff(np.append(edges, len(values)))
    return np.add.reduceat(values * weight, edges) / np.add.reduceat(weight, edges)


def means(log: Log, edges: np.ndarray, weight: np.ndarray | None) -> Log:
    """The log with a mean for each block, and the inputs of its first row where they are set."""
    arrays: dict[str, Any] = {}
    for name in ARRAYS:
        values = getattr(log, name)
        constant = name in ("drive", "theta") or (name == "frequency" and log.kind != "steady")
        arrays[name] = None if values is None else values[edges] if constant else mean(values, edges, weight)
    if log.std is not None:
        arrays["std"] = np.sqrt(
            mean(np.square(log.std), edges, weight)
        )  # of a row; the mean of many has less
    return replace(log, **arrays)


def weights(there: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
    """Weight of each row in the mean of its block (None: all one); for each block the number of rows with a
    signal, at least 1, and whether it has any."""
    length = np.diff(np.append(edges, len(there)))
    if np.all(there):
        return None, length.astype(float), np.ones(len(length), bool)
    count = np.add.reduceat(there.astype(float), edges)
    return np.where(np.repeat(count == 0, length), 1.0, there), np.maximum(count, 1.0), count > 0


def taken(log: Log, rows: np.ndarray) -> Log:
    """These rows of the log."""
    arrays: dict[str, Any] = {
        name: values if (values := getattr(log, name)) is None else values[rows] for name in ARRAYS
    }
    return replace(log, **arrays)
