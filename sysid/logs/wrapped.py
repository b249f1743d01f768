"""A clock of 32 bits that begins anew at its end, as a microcontroller's micros() after 71.6 minutes: its
time goes on."""

import dataclasses

import numpy as np

from sysid.columns.plan import Plan
from sysid.tables.csvbody import Body

TURN = 2.0**32  # ticks
TICKS = (1.0, 1e-3, 1e-6)  # a tick in the column's own unit: of micros() in us, in ms, in s
LONGER = (
    2.0  # than all other steps, which the one across the end may be: by chance one in a million is as short
)


def unwrapped(plan: Plan, body: Body) -> tuple[Plan, Body]:
    """The plan with a note, and the rows with a time that goes on, where it goes back by a turn of its clock,
    a step aside, and nowhere else; as they are of any other."""
    source = plan.sources.get("time")
    if source is None or source.column is None or source.dated:
        return plan, body
    time = body.numbers[source.column]
    known = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[known])
    back = steps < 0
    longest = LONGER * steps.max(initial=0.0)
    ends = [TURN * tick for tick in TICKS if back.any()]
    turn = next((end for end in ends if (((on := steps[back] + end) > 0) & (on <= longest)).all()), None)
    if turn is None:
        return plan, body
    turns = np.zeros(len(time))
    turns[known[1:][back]] = turn
    note = f"column {source.label} goes back by {turn:.10g}, a turn of a clock of 32 bits: its time goes on"
    numbers = body.numbers | {source.column: time + np.cumsum(turns)}
    return dataclasses.replace(plan, notes=(*plan.notes, note)), dataclasses.replace(body, numbers=numbers)
