"""A table in which each value has a column of times of its own before it, as data loggers save trends: read
at the times of the response, with each input as it was last recorded until then."""

import dataclasses
import re
from typing import NamedTuple

import numpy as np

from sysid.columns.labels import INPUTS, folded
from sysid.columns.mapping import MappingFile
from sysid.tables import units
from sysid.tables.cells import listed
from sysid.tables.csvbody import Body, read_body
from sysid.tables.csvfile import SAMPLE, Head, LogError
from sysid.tables.sheet import Sheet
from sysid.tables.stamps import seconds_since, told

RESPONSE = ("wd", "wq", "w")


class _Series(NamedTuple):
    """One value over its own times (s), in order, and the rows of the file where both stand."""

    time: np.ndarray
    values: np.ndarray
    rows: np.ndarray

    def until(self, time: np.ndarray) -> "_Series":
        """At other times what was recorded last until then; NaN before the first."""
        if np.array_equal(time, self.time):
            return self
        last = np.searchsorted(self.time, time, side="right") - 1
        values = np.where(last < 0, np.nan, np.append(self.values, np.nan)[last])
        return _Series(time, values, np.append(self.rows, 0)[last])


def at_one_time(head: Head, mapping: MappingFile | None) -> Head:
    """The head of a table with one time, where its own has one before each value; any other as it is. Raises
    LogError where the times of the response differ, or nothing says which value is the response."""
    if (mapping and mapping.names_columns) or not _is_paired(head):
        return head
    found, names = f"{head.path}: found a time before each value", head.names[1::2]
    quantities = [name and name.quantity for name in map(units.parse_name, names)]
    response = [k for k, quantity in enumerate(quantities) if quantity in RESPONSE]
    if not response:
        expected = "names such as voltage_V, wd_um and wq_um, or w_um alone; each may keep its time before it"
        raise LogError(f"{found} ({listed(names)}), expected {expected}")
    body = read_body(head, [*range(len(head.names))], dated=_dated(head))
    series = [_series(head, body, k, k in response) for k in range(len(names))]
    first, time = names[response[0]], series[response[0]].time
    if other := [names[k] for k in response if not np.array_equal(series[k].time, time)]:
        expected = "one time for both; save them at the same times, as the rows of one table"
        raise LogError(f"{found}, other times for {first} than for {other[0]}, expected {expected}")
    series = [one.until(time) for one in series]

    def where(row: int, column: int) -> str:
        return _where(head, body, int(series[max(column - 1, 0)].rows[row]))

    sheet = Sheet((time, *(one.values for one in series)), where)
    note = f"each value has times of its own: the others are read as they were last recorded before {first}"
    return dataclasses.replace(
        head,
        names=("time_s", *names),
        sheet=sheet,
        sample=sheet.first(SAMPLE),
        notes=(*head.notes, note),
        header=(),
    )


def _is_paired(head: Head) -> bool:
    """Whether a time stands before each value of a table of two values or more."""
    times = [_unit_of_time(head, k) is not None for k in range(len(head.names))]
    return len(times) >= 4 and len(times) % 2 == 0 and all(times[::2]) and not any(times[1::2])


def _unit_of_time(head: Head, column: int) -> str | None:
    """The unit of a column that is called a time, s where it holds dates; None of any other."""
    name, unit, _ = units.split_unit(head.names[column])
    if not {*re.split(r"[\W_]+", folded(name))} & {*INPUTS["time"]}:
        return None
    said = units.parse_name(f"time [{unit}]") if unit else None
    return "s" if head.dated(column) else said.unit if said and units.fits("time", said.unit) else None


def _dated(head: Head) -> list[int]:
    return [k for k in range(0, len(head.names), 2) if head.dated(k)]


def _series(head: Head, body: Body, place: int, whole: bool) -> _Series:
    """The value at a place among the values; a `whole` one keeps the rows in which it is empty. Raises
    LogError where its times go back."""
    column = 2 * place
    time = units.convert(body.numbers[column], str(_unit_of_time(head, column)), "s")
    if head.dated(column) and head.first(column) != head.first(0):
        time = time + float(told(seconds_since(head.first(0), [head.first(column)]))[0])
    values = body.numbers[column + 1]
    rows = np.flatnonzero(np.isfinite(time) & (whole | np.isfinite(values)))
    back = np.flatnonzero(np.diff(time[rows]) < 0)
    if len(back):
        where = _where(head, body, int(rows[back[0] + 1]))
        raise LogError(
            f"{where}: found a time of {head.names[column + 1]} below the one before it, expected later"
        )
    return _Series(time[rows], values[rows], rows)


def _where(head: Head, body: Body, row: int) -> str:
    return head.sheet.where(row, 0) if head.sheet else f"{head.path}, line {body.line(head, row)}"
