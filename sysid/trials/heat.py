"""The heat of what a plate dissipates while a log is recorded."""

import numpy as np

from sysid.logs.log import Log
from sysid.model.carry import accumulated

HEATED = np.array([0.03, 0.3, 3.0])  # of a log, the time constant of its heat: of more it is all kept


def clock(log: Log) -> np.ndarray:
    """(n,) from 0 at the first row to 1 at the last; rows are counted where no time is recorded."""
    time = np.arange(len(log)) if log.time is None else log.time
    return (time - time[0]) / (np.ptp(time) or 1.0)


def warmed(clock: np.ndarray, power: np.ndarray, time: float, own: float = 0.5) -> np.ndarray:
    """(n,) heat h, at most 1, of a plate that dissipates in proportion to `power` (n,) and loses it with the
    time constant `time`, in the unit of the clock: dh/dt = power - h/time. `own`: the share of the time from
    row to row in which the power is the later one's."""
    if len(power) < 2:
        return np.zeros(len(power))
    decay = np.exp(-np.diff(clock) / time)
    gained = (1 - decay) * (power[:-1] + own * np.diff(power))
    heat = np.append(0.0, accumulated(decay, gained).real)
    return heat / (np.max(heat) or 1.0)
