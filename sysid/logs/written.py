"""A log as a table by the contract's names, and as a CSV file that reads back equal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.asked import LOG, given
from sysid.logs.benchwords import BENCH
from sysid.logs.log import EVEN, MEASURED, RELATIVE, TERMINALS, Log
from sysid.tables import units
from sysid.whole import in_place_of


def columns(log: Log) -> dict[str, np.ndarray]:
    """What is recorded, (n,) each, by names that end in their units."""
    found = {"time_s": log.time, label(log.drive_unit, "drive"): log.drive, "frequency_Hz": log.frequency}
    found |= {"temperature_degC": log.temperature, "force_N": log.force, "carrier_rad": log.theta}
    if log.amplitude_only:
        found[label(log.response_unit, "w")] = log.response
    else:
        found[label(log.response_unit, "wd")] = log.response.real
        found[label(log.response_unit, "wq")] = log.response.imag
    found[label(log.response_unit, "std")] = log.std
    return {name: values for name, values in found.items() if values is not None}


def words(log: Log) -> dict[str, Any]:
    """What stands above the columns: metadata, kind, sampling and what is known of the bench."""
    said: dict[str, Any] = {"kind": log.kind, "sampling": log.sampling, **_as_measured(log), **log.bench}
    if log.temperature is not None and not log.temperature_digit and np.ptp(log.temperature) == 0:
        said.setdefault(
            "temperature_std_degC", 0.0
        )  # nobody read it: what is written of it is no step of a thermometer
    kept = {key: value for key, value in log.metadata.items() if not _is_interpreted(key, str(value))}
    return {key: value for key, value in (kept | said).items() if value is not None}


def _as_measured(log: Log) -> dict[str, str]:
    """What the rows do not show of how they were measured."""
    noise = RELATIVE if log.relative_noise else EVEN if log.even else ""
    said = zip(MEASURED, (noise, TERMINALS if log.analysed else ""), strict=True)
    return {key: word for key, word in said if word}


def write_log(
    log: Log, path: str | Path, append: bool = False, further: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write a log as a contract CSV, which reads back equal to the last bit (metadata that became columns
    aside; one temperature that was not read from text is stated to be exact).

    The carrier's phase theta of a log that was demodulated here is its column `carrier_rad`. `append`:
    more rows of the log that the file holds. `further`: columns that are no part of a log, by their names.
    """
    given("log", log, Log, LOG)
    recorded = {name: values.tolist() for name, values in (columns(log) | dict(further or {})).items()}
    rows = (",".join(map(repr, row)) + "\n" for row in zip(*recorded.values(), strict=True))
    if append:
        with open(path, "a", encoding="utf-8", newline="\n") as file:
            file.writelines(rows)
        return
    with in_place_of(path) as (fresh,), open(fresh, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {_one_line(key)}: {_one_line(value)}\n" for key, value in words(log).items())
        file.write(",".join(recorded) + "\n")
        file.writelines(rows)


def _one_line(value: Any) -> str:
    """Text that ends neither its line nor, by a NUL, the file's being text."""
    return " ".join(str(value).replace("\x00", " ").split())


def label(unit: str, quantity: str) -> str:
    """The contract's name of a quantity in a unit."""
    if quantity == "drive" and unit in ("V", "duty"):
        return "voltage_V" if unit == "V" else "duty"
    return f"{quantity} [{unit}]" if set(unit) & set("_ ,") else f"{quantity}_{unit}"


def _is_interpreted(key: str, value: str) -> bool:
    """Whether metadata are what the reader acts upon (`plate` aside)."""
    if key.casefold() in MEASURED:
        return value.casefold() in (RELATIVE, EVEN, TERMINALS)
    known = (
        key.casefold() in ("kind", "sampling", "volts_per_duty", *BENCH) or units.parse_name(key) is not None
    )
    return (
        known or units.split_unit(key.casefold())[0] in units.BENCH_TIMES or units.bench_time(key) is not None
    )
