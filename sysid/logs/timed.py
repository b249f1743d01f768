"""The time of a log's rows, as far as it serves: one that goes back is refused, times of day go on past
midnight, and dates that are too coarse are kept out."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from sysid.columns.plan import Plan
from sysid.logs.filled import Arrays
from sysid.logs.missing import placed, refuse_row
from sysid.logs.parted import remedy
from sysid.tables.csvbody import Body
from sysid.tables.csvfile import Head
from sysid.tables.stamps import DAY, EXAMPLE, coarse, is_clock, is_local, past_midnight

FINER = (
    "a later one than in the row before; record fractions of a second, or say kind: steady where the rows"
    " are settled points"
)


def timed(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: dict, kind: str | None
) -> Plan:
    """The plan without a time that does not serve; `arrays` gets times of day that go on past midnight.
    Raises LogError where a time that is wanted goes back, or is too coarse."""
    plan = _past_midnight(head, body, plan, rows, arrays)
    if "time" in arrays and plan.sources["time"].spare and coarse(arrays["time"][0]) is not None:
        return _without_time(head, plan, arrays)
    if "time" in arrays and (decrease := decrease_of(arrays["time"][0])) is not None:
        expected = f"a time not below the one before{remedy(head, plan)}"
        refuse_row(head, body, plan.sources["time"], rows, decrease, expected)
    if "time" in arrays and plan.sources["time"].dated and (same := coarse(arrays["time"][0])) is not None:
        if kind != "steady" and not _sweeps(arrays):
            refuse_row(head, body, plan.sources["time"], rows, same, FINER)
        return _without_time(head, plan, arrays)
    return plan


def oldest_first(plan: Plan, rows: np.ndarray, arrays: Arrays) -> tuple[Plan, np.ndarray, Arrays]:
    """The plan, the rows and the arrays in the order of time, where each row's lies below that of the row
    before: newest first, as some recorders save."""
    time = arrays["time"][0] if "time" in arrays else np.zeros(0)
    time = time[np.isfinite(time)]
    if len(time) < 3 or not (np.diff(time) < 0).all():
        return plan, rows, arrays
    note = "its rows stand newest first: read in the order of their times"
    turned = {key: (values[::-1], unit) for key, (values, unit) in arrays.items()}
    return dataclasses.replace(plan, notes=(*plan.notes, note)), rows[::-1], turned


def _past_midnight(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: dict[str, tuple[np.ndarray, str]]
) -> Plan:
    """The plan with a note where times of day begin anew, from where on they are now those of a day later."""
    column = plan.sources["time"].column if "time" in arrays and plan.sources["time"].dated else None
    if column is None or not is_clock(head.first(column)):
        return plan
    time, unit = arrays["time"]
    if (row := past_midnight(time)) is None:
        return plan
    later = np.round(time[row:] + DAY, 9)  # to the nanosecond, as stamps are read
    arrays["time"] = (np.append(time[:row], later), unit)
    where = placed(head, body, row if rows is None else int(rows[row]))
    note = f"column {plan.sources['time'].label} holds times of day, which pass midnight before {where}"
    return dataclasses.replace(plan, notes=(*plan.notes, note))


def _without_time(head: Head, plan: Plan, arrays: dict[str, tuple[np.ndarray, str]]) -> Plan:
    """The plan with a note that the dates are kept out, as they now are of `arrays`."""
    column = plan.sources["time"].column
    local = column is not None and is_local(head.first(column))
    lost = bool(np.isnan(arrays.pop("time")[0]).any())
    why = (
        f"day and month cannot be told apart in all of its dates; write a time as {EXAMPLE}"
        if local and lost
        else "its dates are too coarse, go back or are missing"
    )
    note = f"column {plan.sources['time'].label} is kept out of the fit: {why}"
    return dataclasses.replace(plan, notes=(*plan.notes, note))


def _sweeps(arrays: Mapping[str, tuple[np.ndarray, str]]) -> bool:
    """Whether the frequency changes at every tenth row or more, as in a sweep, which is steady without its
    time."""
    return "frequency" in arrays and bool(np.mean(np.diff(arrays["frequency"][0]) != 0) > 0.1)


def decrease_of(time: np.ndarray) -> int | None:
    """The first row whose time lies below the one before."""
    below = time[1:] < time[:-1]
    return int(np.argmax(below)) + 1 if below.any() else None
