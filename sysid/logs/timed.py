"""The time of a log's rows, as far as it serves: one that goes back is refused, and dates that are too coarse
are kept out."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from sysid.logs.csvbody import Body
from sysid.logs.csvfile import Head
from sysid.logs.missing import refuse_row
from sysid.logs.plan import Plan
from sysid.logs.stamps import coarse

FINER = (
    "a later one than in the row before; record fractions of a second, or say kind: steady where the rows"
    " are settled points"
)


def timed(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: dict, kind: str | None
) -> Plan:
    """The plan without a time that does not serve. Raises LogError where one that is wanted goes back, or is
    too coarse."""
    if "time" in arrays and plan.sources["time"].spare and coarse(arrays["time"][0]) is not None:
        return _without_time(plan, arrays)
    if "time" in arrays and (decrease := decrease_of(arrays["time"][0])) is not None:
        refuse_row(head, body, plan.sources["time"], rows, decrease, "a time not below the one before")
    if "time" in arrays and plan.sources["time"].dated and (same := coarse(arrays["time"][0])) is not None:
        if kind != "steady" and not _sweeps(arrays):
            refuse_row(head, body, plan.sources["time"], rows, same, FINER)
        return _without_time(plan, arrays)
    return plan


def _without_time(plan: Plan, arrays: dict[str, tuple[np.ndarray, str]]) -> Plan:
    """The plan with a note that the dates are kept out, as they now are of `arrays`."""
    del arrays["time"]
    note = (
        f"column {plan.sources['time'].label} is kept out of the fit: its dates are too coarse, go back or"
        f" are missing"
    )
    return dataclasses.replace(plan, notes=(*plan.notes, note))


def _sweeps(arrays: Mapping[str, tuple[np.ndarray, str]]) -> bool:
    """Whether the frequency changes at every tenth row or more, as in a sweep, which is steady without its
    time."""
    return "frequency" in arrays and bool(np.mean(np.diff(arrays["frequency"][0]) != 0) > 0.1)


def decrease_of(time: np.ndarray) -> int | None:
    """The first row whose time lies below the one before."""
    below = time[1:] < time[:-1]
    return int(np.argmax(below)) + 1 if below.any() else None
