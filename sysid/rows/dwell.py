"""Sweeps whose points dwell until the plate has settled: what their rows belong to, where that is not
stated."""

from dataclasses import replace

import numpy as np
from scipy.special import gammaincc

from sysid.logs.log import Log

# dwell in units of tau from which a point of a timed sweep counts as settled: e^-4 of the change is left
SETTLED = 4.0
LEFT = float(np.exp(-SETTLED))  # of a change, behind a filter


def dwells(log: Log, tau: float) -> bool:
    """Whether a timed log's frequency changes, and after each change SETTLED or more pass before the next row
    is read."""
    if log.time is None or log.frequency is None:
        return False
    last = np.flatnonzero(log.frequency[1:] != log.frequency[:-1])
    return len(last) > 0 and bool(np.min(log.time[last + 1] - log.time[last]) >= SETTLED * tau)


def of_single_points(log: Log) -> bool:
    """Whether every row of a sweep is a point of its own."""
    return log.frequency is not None and bool(np.all(np.diff(log.frequency) != 0))


def remembered(log: Log) -> float:
    """Share of the change from one point of a timed sweep to the next that the lock-in's filter still holds
    as the next is read, by the filter that is stated: Q(k, t/T) after a time t, of k poles of T."""
    tau = float(log.bench.get("lockin_tau_s", 0.0))
    if tau <= 0 or log.time is None or len(log) < 2:
        return 0.0
    step = float(np.median(np.diff(log.time)))
    return float(gammaincc(int(log.bench.get("lockin_order", 1)), max(step, 0.0) / tau))


def of_own_inputs(log: Log) -> bool:
    """Whether the rows of a sweep that dwells show what their own inputs have led to, not those of the row
    before: rows of the same inputs then agree with one another."""
    inputs = np.stack([c for c in (log.drive, log.frequency) if c is not None], axis=1)
    return _apart(inputs[1:], log.response[1:]) < _apart(inputs[:-1], log.response[1:])


def of_the_row_before(log: Log) -> Log:
    """Rows that show what the inputs of the row before have led to, as rows of those inputs; of the first
    nothing is known."""
    columns = {name: getattr(log, name) for name in ("drive", "frequency", "temperature", "force")}
    earlier = {name: column[:-1] for name, column in columns.items() if column is not None}
    return replace(log, response=log.response[1:], time=log.time[1:], sampling="settled", **earlier)


def _apart(inputs: np.ndarray, response: np.ndarray) -> float:
    """Sum of squares of the responses about the mean of those of the same inputs."""
    _, group = np.unique(inputs, axis=0, return_inverse=True)
    group, count = group.ravel(), np.bincount(group.ravel())
    mean = np.bincount(group, response.real) / count + 1j * np.bincount(group, response.imag) / count
    return float(np.sum(np.abs(response - mean[group]) ** 2))
