"""A long table, a reading a line beside the name of what it is, as databases export them: made wide, a column
a name."""

import dataclasses
from collections.abc import Collection

import numpy as np

from sysid.tables.cells import is_number
from sysid.tables.compound import rows_of
from sysid.tables.csvfile import SAMPLE, Head
from sysid.tables.sheet import Sheet
from sysid.tables.stamps import is_stamp
from sysid.tables.textfile import LogError

NAMES = {
    "channel",
    "field",
    "name",
    "variable",
    "quantity",
    "signal",
    "sensor",
    "key",
    "parameter",
    "topic",
    "tag",
}
VALUES = {"value", "values", "reading", "val", "payload"}
KEYS = ("time", "timestamp", "date", "datetime", "ts", "t", "frequency", "freq", "f")


def widened(head: Head, kept: Collection[str | int]) -> Head:
    """The head of a long table as of a wide one; of any other, or where some columns are `kept`, as it is.
    Raises LogError where a name has two readings at one time."""
    called = [name.strip("_ ").casefold() for name in head.names]
    names = [k for k, name in enumerate(called) if name in NAMES and _is_word(head.first(k))]
    values = [k for k, name in enumerate(called) if name in VALUES and is_number(head.first(k))]
    times = [k for k, name in enumerate(called) if name.split("_")[0].split(" ")[0] in KEYS]
    if {*head.names} & {*kept} or head.sheet is not None or not (len(names) == len(values) == 1 and times):
        return head
    (name,), (value,), time = names, values, times[0]
    rows, lines, _ = rows_of(head)
    if len({row[name] for row in rows}) < 2:
        return head
    order = list(dict.fromkeys(row[time] for row in rows))
    place = {stamp: k for k, stamp in enumerate(order)}
    columns: dict[str, np.ndarray] = {}
    at: dict[str, list[int]] = {}
    for row, line in zip(rows, lines, strict=True):
        column = columns.setdefault(row[name], np.full(len(order), "", object))
        of, k = at.setdefault(row[name], [0] * len(order)), place[row[time]]
        if of[k]:
            said = f"found {row[name]!r} again at {row[time]}, as in line {of[k]}"
            raise LogError(f"{head.path}, line {line}: {said}, expected one reading at each")
        column[k], of[k] = row[value], line
    held = (np.array(order, object), *columns.values())
    known = [[max(of[k] for of in at.values()) for k in range(len(order))], *at.values()]
    sheet = Sheet(held, lambda row, column: f"{head.path}, line {known[column][row] or known[0][row]}")
    note = f"a long table: the readings of each {head.names[name]} are read as a column"
    return dataclasses.replace(
        head,
        names=(head.names[time].strip("_"), *columns),
        sheet=sheet,
        sample=sheet.first(SAMPLE),
        notes=(*head.notes, note),
        header=(),
    )


def _is_word(cell: str) -> bool:
    return bool(cell) and not is_number(cell) and not is_stamp(cell)
