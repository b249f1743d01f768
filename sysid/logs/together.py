"""Logs that are read together: those of one plate, in common units."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from sysid.logs import units
from sysid.logs.metadata import stated
from sysid.logs.textfile import LogError

if TYPE_CHECKING:
    from sysid.logs.log import Log

ROOM = (273.15, 333.15)  # K


def of_one_plate(logs: list["Log"]) -> list["Log"]:
    """The logs. Raises LogError where they name different plates."""
    named = [(log, plate) for log in logs if (plate := stated(log.metadata, "plate"))]
    for log, plate in named[1:]:
        if plate != named[0][1]:
            first = f"{named[0][0].path} names the plate {named[0][1]!r}"
            raise LogError(f"{first} and {log.path} the plate {plate!r}, expected logs of one plate")
    return logs


def doubted(log: "Log") -> "Log":
    """The log, with a note where its temperature is a room's in kelvin: it may be right, and moves k_T by
    far if it is not."""
    if log.temperature is None or np.max(log.temperature) < ROOM[0]:  # a median takes its time
        return log
    if not ROOM[0] <= (typical := float(np.median(log.temperature))) <= ROOM[1]:
        return log
    note = f"the temperature is taken as {typical:.4g} degC; if it is kelvin, call it temperature_K"
    return dataclasses.replace(log, notes=(*log.notes, note))


def in_common_units(logs: list["Log"]) -> list["Log"]:
    """All responses in the first log's unit, and all drives in the first recorded drive's."""
    responses = [_as_first(log, logs[0], "response") for log in logs]
    driven = next((log for log in responses if log.drive is not None), None)
    return [_as_first(log, driven, "drive") if driven and log.drive is not None else log for log in responses]


def _as_first(log: "Log", first: "Log", what: str) -> "Log":
    unit, wanted = getattr(log, f"{what}_unit"), getattr(first, f"{what}_unit")
    if unit == wanted:
        return log
    if "duty" in (unit, wanted) or not units.same_kind(unit, wanted):
        raise LogError(
            f"{log.path}: found the {what} in {unit}, expected a unit such as {wanted} as in {first.path}"
        )
    changed = {what: units.convert(getattr(log, what), unit, wanted), f"{what}_unit": wanted}
    if what == "response" and log.std is not None:
        changed["std"] = units.convert(log.std, unit, wanted)
    return dataclasses.replace(log, **changed)
