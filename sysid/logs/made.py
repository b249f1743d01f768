"""Logs made in Python: of tables, arrays and raw samples, read as a file of the same columns would be."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.asked import number, refuse
from sysid.logs.doubts import doubted
from sysid.logs.filled import direct, driven_frequency, not_direct, of_the_driven
from sysid.logs.log import Log, LogError
from sysid.logs.read import logs_of
from sysid.logs.within import within
from sysid.logs.written import label
from sysid.tables.cells import Dialect, listed
from sysid.tables.store import Store

SERIES = ("time", "drive", "frequency", "temperature", "force", "std", "theta")


def of_table(table: Any, name: str, constants: Mapping[str, Any]) -> Log:
    """The log of a DataFrame, or of columns by name."""
    if isinstance(table, str | Path | None):
        refuse("a table", table, "a DataFrame, or columns by name; sysid.read_logs(path) reads files")
    store = Store(name, "a table")
    store.constants = {key: str(value) for key, value in {**getattr(table, "attrs", {}), **constants}.items()}
    for column in table:
        store.add("", str(column), _empty(table[column]))
    head = store.head(Dialect())
    head = dataclasses.replace(head, sheet=dataclasses.replace(head.sheet, sha256=""))
    with np.errstate(all="ignore"):  # the log refuses what is not finite
        found = logs_of(head)
    if len(found) != 1:
        raise LogError(
            f"{name}: found {len(found)} experiments, expected one; make a log of each, by"
            f" frame.groupby('log')"
        )
    return dataclasses.replace(found[0], name=name, path="", sha256="")


def _empty(column: Any) -> np.ndarray:
    """A column of a table, its masked numbers as those of empty cells."""
    masked = isinstance(column, np.ma.MaskedArray) and np.ma.is_masked(column)
    if not masked or column.dtype.kind not in "biufc":
        return np.asarray(column)
    return column.astype(np.result_type(column.dtype, np.float64)).filled(np.nan)


def _unmasked(name: str, key: str, values: Any) -> Any:
    """Values that are all there. Raises LogError for masked ones: arrays have no rows to leave out."""
    if not np.ma.is_masked(values):
        return values
    row = int(np.argmax(np.ma.getmaskarray(values)))
    do = "leave the row out of all arrays, or give Log.from_frame the columns, as whose empty cell it counts"
    raise LogError(f"{name}, row {row} (counted from 0): found {key} masked, expected a number; {do}")


def of_arrays(response: Any, name: str, fields: Mapping[str, Any]) -> Log:
    """The log of arrays, numbers spread over its rows."""
    response = _unmasked(name, "response", response)
    fields = {
        key: _unmasked(name, key, values) if key in SERIES else values for key, values in fields.items()
    }
    rows = len(np.atleast_1d(response))
    series = {
        key: np.full(rows, value) for key, value in fields.items() if key in SERIES and np.ndim(value) == 0
    }
    series = {key: values for key, values in series.items() if fields[key] is not None}
    return doubted(within(_driven(Log(name, np.atleast_1d(response), **{**fields, **series}))))


def _driven(log: Log) -> Log:
    """The log without points at 0 Hz, and with frequencies where rows have neither a drive nor one."""
    if log.frequency is None:
        return log
    if (keep := not_direct(log.frequency, log.kind == "steady")) is not None:
        columns = {name: getattr(log, name) for name in ("response", *SERIES)}
        kept = {name: values[keep] for name, values in columns.items() if values is not None}
        rows = listed([f"row {row} (counted from 0)" for row in np.flatnonzero(~keep)])
        return dataclasses.replace(log, **kept, notes=(*log.notes, direct(rows)))
    if log.kind == "steady" or log.drive is None:
        return log
    if (found := driven_frequency(log.frequency, log.drive)) is None:
        return log
    note = of_the_driven(int(np.sum(found != log.frequency)))
    return dataclasses.replace(log, frequency=found, notes=(*log.notes, note))


def of_waveform(drive: Any, response: Any, rate: float, name: str, constants: Mapping[str, Any]) -> Log:
    """The log of samples."""
    drive, response = _unmasked(name, "drive", drive), _unmasked(name, "response", response)
    drive, response = np.asarray(drive, float), np.asarray(response, float)
    if drive.ndim != 1 or drive.shape != response.shape:
        raise LogError(
            f"{name}: found samples of shapes {drive.shape} and {response.shape}, expected two alike (n,)"
        )
    units = {"drive_unit": "V", "response_unit": "um", **constants}
    columns = {
        label(units.pop("drive_unit"), "drive"): drive,
        label(units.pop("response_unit"), "response"): response,
    }
    return of_table(
        columns, name, {**units, "kind": "waveform", "sample_rate_Hz": repr(number("rate", rate))}
    )
