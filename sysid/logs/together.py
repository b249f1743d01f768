"""Logs that are read together: those of one plate, in common units."""

import dataclasses
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from sysid.columns.metadata import stated
from sysid.tables import units
from sysid.tables.cells import listed
from sysid.tables.csvfile import called
from sysid.tables.textfile import LogError

if TYPE_CHECKING:
    from sysid.logs.log import Log

# a temperature in a file's name: 18C, 24.5degC, 35_deg, -5 °C
IN_NAME = re.compile(
    r"(?:^|(?<=[^a-z\d.,]))(?P<number>(?:(?<=[_ (=])-)?\d+(?:[.,]\d+)?)"
    r"[ _]?(?:°C?|deg_?C?|grad|C)(?![a-z\d])",
    re.IGNORECASE,
)


def of_one_plate(logs: list["Log"]) -> list["Log"]:
    """The logs. Raises LogError where they name different plates."""
    named = [(log, plate) for log in logs if (plate := stated(log.metadata, "plate"))]
    for log, plate in named[1:]:
        if plate != named[0][1]:
            first = f"{named[0][0].path} names the plate {named[0][1]!r}"
            raise LogError(f"{first} and {log.path} the plate {plate!r}, expected logs of one plate")
    return logs


def temperatures_in_names(logs: list["Log"]) -> list["Log"]:
    """The logs, the first with a warning where none has a temperature and all files' names seem to hold one,
    in one pattern: `sweep_18C.csv`, `sweep_24C.csv`. It is no data: a name may mean something else."""
    names = list(dict.fromkeys(called(log.path) for log in logs if log.path))
    if any(log.temperature is not None or log.frequency is None or not log.path for log in logs):
        return logs
    found = [IN_NAME.search(name) for name in names]
    held = [one["number"].replace(",", ".") for one in found if one]
    alike = {re.sub(r"-?\d+([.,]\d+)?", "#", name) for name in names}
    if len(held) < len(names) or len({*map(float, held)}) < 2 or len(alike) > 1:
        return logs
    said = (
        f"{names[0]} and {len(names) - 1} more: no temperature is recorded, and their names seem to hold one"
    )
    do = f"state it above each header, as in # temperature_degC: {held[0]}"
    warning = f"{said} ({listed(list(dict.fromkeys(held)))} degC); {do}"
    return [dataclasses.replace(logs[0], warnings=(*logs[0].warnings, warning)), *logs[1:]]


def in_common_units(logs: Sequence["Log"]) -> list["Log"]:
    """All responses in the first log's unit, and all drives in the first recorded drive's, with a note on
    each that was in another. Raises LogError where one is of another kind."""
    responses = [_as_first(log, logs[0], "response") for log in logs]
    driven = next((log for log in responses if log.drive is not None), None)
    return [_as_first(log, driven, "drive") if driven and log.drive is not None else log for log in responses]


def _as_first(log: "Log", first: "Log", what: str) -> "Log":
    unit, wanted = getattr(log, f"{what}_unit"), getattr(first, f"{what}_unit")
    if unit == wanted:
        return log
    theirs = first.path or first.name
    if "duty" in (unit, wanted) or not units.same_kind(unit, wanted):
        raise LogError(
            f"{log.path or log.name}: found the {what} in {unit}, expected a unit such as {wanted} as in"
            f" {theirs}"
        )
    changed: dict[str, Any] = {
        what: units.convert(getattr(log, what), unit, wanted),
        f"{what}_unit": wanted,
        "notes": (*log.notes, f"its {what} in {unit} is read in {wanted}, the unit of {theirs}"),
    }
    if what == "response" and log.std is not None:
        changed["std"] = units.convert(log.std, unit, wanted) - units.convert(0.0, unit, wanted)
    return dataclasses.replace(log, **changed)
