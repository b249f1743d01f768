"""Experiments that follow one another in one table, whose time begins anew: the column that tells them apart.

It holds one value in each of them, and another wherever the time goes back, whatever it is called. Where no
column may number them, the time tells them apart if it begins each time at the same. Rows whose time goes
back for another reason are refused; which column may be meant is said then.
"""

import dataclasses
from collections.abc import Collection
from itertools import pairwise

import numpy as np

from sysid.columns.plan import SPLITS, Plan
from sysid.tables import units
from sysid.tables.cells import to_number
from sysid.tables.csvbody import Body, read_body
from sysid.tables.csvfile import Head

CALLED = (*SPLITS, "repeat", "repetition", "cycle", "trace", "shot", "scan", "measurement", "pass", "n")


def parted(
    head: Head, plan: Plan, body: Body, wanted: list[int], dated: Collection[int]
) -> tuple[Plan, Body]:
    """The plan and the rows as they are told apart by the column that another value begins in wherever the
    time goes back; as they are where nothing goes back, or none does."""
    if not _may_be_parted(plan, body):
        return plan, body
    back = _begins_anew(body.numbers[plan.sources["time"].column])
    several = 0 < len(back) < len(body) // 2  # of experiments of a row each nothing tells that they are any
    for column in _candidates(head, plan) if several else ():
        again = read_body(head, wanted, column, dated)
        changes = np.flatnonzero(again.keys[1:] != again.keys[:-1])
        if np.array_equal(changes, back) and len({*again.keys}) == len(back) + 1:
            label = head.names[column] or str(column)
            spare = f"column {label} is kept out of the fit"
            note = f"column {label} tells {len(back) + 1} logs apart: the time begins anew where it changes"
            notes = (*(said for said in plan.notes if said != spare), note)
            return dataclasses.replace(plan, split=column, notes=notes), again
    return _by_time(plan, body, back) if several and not _may_count(head, plan) else (plan, body)


def _by_time(plan: Plan, body: Body, back: np.ndarray) -> tuple[Plan, Body]:
    """The rows as their time alone tells them apart, where it begins again each time where it first began, to
    a row: a clock that was started anew with its record. No clock that is set does so."""
    time = body.numbers[plan.sources["time"].column]
    begins = np.append(0, back + 1)
    if not np.ptp(time[begins]) <= np.median(np.abs(np.diff(time))):
        return plan, body
    keys = np.searchsorted(begins, np.arange(len(time)), side="right").astype(str).astype(object)
    note = f"its time begins anew {len(back)} time{'s' * (len(back) > 1)}: read as {len(begins)} logs"
    return dataclasses.replace(plan, notes=(*plan.notes, note)), dataclasses.replace(body, keys=keys)


def remedy(head: Head, plan: Plan) -> str:
    """What to do about a time that goes back, where experiments may follow one another."""
    if plan.split is not None:
        return ""
    spare = _may_count(head, plan)
    line = f'split_by = "{spare[0]}"' if spare else ""
    way = f", or {spare[0]!r} does by the line {line} in a mapping file (--columns)" if spare else ""
    return f"; experiments that follow one another are told apart by a column `log`{way}"


def _may_count(head: Head, plan: Plan) -> list[str]:
    """The names of columns that are not read and may number experiments."""
    open_ = [name for k, name in enumerate(head.names) if k not in _read(plan) and not _counts(head, k)]
    return [name for name in open_ if name.casefold() in CALLED]


def _read(plan: Plan) -> set[int | None]:
    """The columns that are read."""
    return {source.column for source in plan.sources.values()}


def _cells(head: Head, column: int) -> list[str]:
    """The first cells of a column."""
    return [row[column].strip() for row in head.sample if column < len(row)]


def _counts(head: Head, column: int) -> bool:
    """Whether each of the first rows has another value, as rows that are numbered."""
    cells = _cells(head, column)
    return len({*cells}) == len(cells)


def _may_be_parted(plan: Plan, body: Body) -> bool:
    """Whether nothing tells apart rows that have a time yet, which is a number and no date."""
    time = plan.sources.get("time")
    open_ = plan.split is None and plan.rows is None and body.keys is None
    return open_ and time is not None and time.column is not None and not time.dated


def _begins_anew(time: np.ndarray) -> np.ndarray:
    """The rows (k,), from 0, behind which the time goes back, over rows without one; none where it does not
    each time go back by more than half of what passed since it last did, as a clock that is set does not."""
    known = np.maximum.accumulate(np.where(np.isfinite(time), np.arange(len(time)), 0))
    filled = time[known]
    back = np.flatnonzero(filled[1:] < filled[:-1])
    begin, end, anew = filled[np.append(0, back[:-1] + 1)], filled[back], filled[back + 1]
    return back if (2 * anew < begin + end).all() else back[:0]


def _candidates(head: Head, plan: Plan) -> list[int]:
    """The columns that change in the first rows where the time goes back and nowhere else: first those whose
    names say that they number experiments, last those that are inputs, as each run's frequency."""
    place, read = plan.sources["time"].column, _read(plan)
    outputs = {of.column for name, of in plan.sources.items() if name not in units.CONSTANTS}
    times = [to_number(cell, str(head.dialect.decimal)) for cell in _cells(head, place)]
    back = [after < before for before, after in pairwise(times)]
    found = [
        column
        for column in range(len(head.names))
        if column not in outputs and [a != b for a, b in pairwise(_cells(head, column))] == back
    ]
    return sorted(found, key=lambda k: (k in read, head.names[k].casefold() not in CALLED))
