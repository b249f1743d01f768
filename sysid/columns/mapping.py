r"""Mapping files: what the columns of another instrument's log mean, in TOML. A full example:

    kind = "steady"                     # or "transient", "waveform"; left out: told from the columns
    sampling = "settled"                # or "instant"; only for transient logs
    amplitude = "rms"                   # how the file states drive and response: "peak", "rms" or "pp" (peak
                                        # to peak)
    quantity = "velocity"               # or "displacement", "acceleration", "charge", "current", "impedance":
                                        # what x and y (or magnitude) show; of a network analyser
                                        # "reflection" (S11) or "transmission" (S21)
    phase_sign = -1                     # -1 when the instrument's phase rises where e^{+j omega t} has it
                                        # fall; else 1
    phase_offset_deg = 90.0             # added to the phase, after the sign

    delimiter = ";"                     # "\t" is a tab, " " any run of blanks; left out: seen from the header
    decimal = ","                       # left out: seen from the first rows
    comment = "%"                       # lines above the header that begin so are metadata; left out: "#",
                                        # and a first % or !
    header = true                       # false: the first line holds numbers already; left out: seen from it
    skip = 2                            # lines at the top of the file to leave out; left out: a preamble is
                                        # seen from the rows
    join = "Frequency"                  # tables one below the other, as traces are saved, share this column:
                                        # read side by side
    table = "/sweep"                    # of a file of several tables, HDF5 groups say: which of them
    rows = [100, 380]                   # counted from 0, the last one out; or [[0, 90], [120, 380]]; or {2 =
                                        # [0, 90]}
    split_by = "sweep"                  # a column (name or position): each of its values is one experiment
    preset = "sr865"                    # what a preset says (`columns.preset`), and is not said here
    find = true                         # columns that are not named below are found by their heads, as a
                                        # draft does

    [columns]                           # name = "column", or position from 0, or table; number * scale
                                        # + offset in unit
    time = "time_unix_s"                # the unit may be the end of the column's own name ...
    frequency = { column = "f", unit = "kHz" }                                # ... or be stated
    x = { column = 3, unit = "mV", scale = 10.0, offset = 0.0, amplitude = "peak" }
    y = { column = 4, unit = "mV", scale = 10.0 }
    std = { column = 5, unit = "mV", scale = 10.0 }            # standard error of each row, per channel
                                        # `file = "*CH1.csv"` in each: one capture in several files, see
                                        # logs.capture

    [units]                             # of columns that are found, and whose heads state none
    time = "s"

    [constants]                         # what was constant and no column; peak, unless the unit says `V_rms`.
                                        # It goes before what the file's own metadata state (temperature_degC)
    voltage = "1 V"
    temperature = "20 degC"

    [metadata]                          # as in the metadata lines of a log
    plate = "A7"
    lockin_tau_s = 0.003

The names of columns and constants are time, frequency, temperature, force; voltage, drive or duty; for the
response wd with wq, or w, or x with y (a lock-in's in-phase and quadrature parts), or magnitude, alone or
with phase; of raw carrier samples (`kind = "waveform"`) response, with voltage or drive. Standard errors of
the response are `std`, or `std` of d and `std_q` of q, in the response's unit, in dB of one in dB, or in % of
it (`logs.stated`). Rows may be told for each value of the split column: `rows = {"0" = [100, 380], "1" = [90,
380]}`. The unit of magnitude or w may be dB, dBV, dBm (of a power, whose root is taken) or dB(mm/s), of any
unit: 10^(dB/20) in the unit of 0 dB; or that of a spectral density, V/sqrt(Hz), or V^2/Hz, whose root is
taken. A time may be a column of dates (ISO 8601), and
needs no unit then. Where the header stands again among the rows, `rows` are counted in each table.

A file without [columns] says the rest of logs whose columns have the contract's names: `phase_sign = -1`
alone, where their phase rises through the resonance, or `amplitude = "rms"`, of the drive and response whose
names do not say it.

A signal s = x + jy = magnitude e^{j phase}, measured against a drive cos(omega t) with e^{+j omega t}, gives
Wd + jWq = j s when it is a displacement or charge, s / omega when it is a velocity or current (its unit times
s; of a current in A it is a charge in C), -j s / omega^2 when it is an acceleration. An impedance Z = x + jy
(R and X), or magnitude e^{j phase}, in ohm, is read as the current 1/Z that 1 V drives, peak for peak and
with the phase of e^{+j omega t}: it wants neither a drive nor `amplitude`. (Its own peak is the
antiresonance, and no response.) An admittance is a current of so many S: that which the log's voltage drives,
or 1 V where none is stated; so is any signal that is stated by its drive, in m/s/V or um/N. A reflection or
transmission, in dB or linear, is read as the admittance that it means (`tables.scattered`), behind
`reference_ohm` of the metadata, or 50 ohm, with the plate where `device` says: "one port" of a reflection,
"in series" or "across the line" of a transmission; it too wants neither a drive nor `amplitude`. Of wd and wq
themselves `phase_sign = -1` turns the sign of Wq, and `phase_offset_deg` adds to the phase of Wd + jWq.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid.columns.metadata import constants_beside, overruled
from sysid.columns.plan import PHASES, Plan, Source, drive_as, in_gravity, per_drive
from sysid.tables import units
from sysid.tables.cells import Dialect, listed, to_number
from sysid.tables.csvfile import Head, LogError
from sysid.tables.densities import is_decibel, level_of_volts, plain, reference
from sysid.tables.scattered import RATIOS, SCATTERED, placed
from sysid.tables.stamps import is_long

_PLAIN_UNIT = re.compile(
    r"[pnuµmkMG]?(s|Hz|V|A|m|m/s|N|S|C|W|ohm)|deg[CF]|K|1|%|pct|min|h"
    r"|[mu]?rad|m?deg|rad/s|rpm|turns?|cycles?|gon|dB[mV]?"
)
WORDS: dict[str, tuple[Any, ...]] = {
    "kind": ("transient", "steady", "waveform"),
    "sampling": ("instant", "settled"),
    "amplitude": ("peak", "rms", "pp"),
    "quantity": ("displacement", "velocity", "charge", "acceleration", "current", "impedance", *SCATTERED),
    "phase_sign": (1, -1),
    "decimal": (".", ","),
}


@dataclass(frozen=True)
class MappingFile:
    """A mapping file, checked: every key is known, every value of its type."""

    path: str
    options: dict[str, Any]
    dialect: Dialect = field(default_factory=Dialect)
    base: Mapping[str, Any] = field(default_factory=dict)  # what its preset says, which the options go before
    finds: bool = False  # whether columns that it does not name are found by their heads (`columns.found`)

    def fail(self, key: str, message: str) -> LogError:
        """The error that names this file and one of its keys, to raise."""
        return LogError(f"{self.path}, {key}: {message}")

    @property
    def names_columns(self) -> bool:
        """Whether it says which column is which; else the file's own names hold."""
        return "columns" in self.options

    @property
    def files(self) -> list[str]:
        """The patterns of the files that hold a capture's columns; none where a file holds all."""
        entries = self.options.get("columns", {}).values()
        return list(dict.fromkeys(entry["file"] for entry in entries if "file" in entry))

    def metadata(self, head: Head) -> dict[str, str]:
        """The metadata of one file, and what takes their place or stands beside them here."""
        stated = {key: str(value) for key, value in self.options.get("metadata", {}).items()}
        stated |= {key: str(self.options[key]) for key in ("kind", "sampling") if key in self.options}
        ours = {key.casefold() for key in stated}
        return {key: value for key, value in head.metadata.items() if key.casefold() not in ours} | stated

    def plan(self, head: Head) -> Plan:
        """The plan for one file. Raises LogError when a column is not there or a unit does not fit."""
        columns = self.options.get("columns", {})
        sources = {
            name: self._column(name, entry, head) for name, entry in columns.items()
        } | self._constants()
        quantity, metadata = self.options.get("quantity"), self.metadata(head)
        assumed: tuple[str, ...] = ()
        sources = self._of_one_volt(sources) if quantity in RATIOS else sources
        told, read = constants_beside(head, metadata, sources, self.path)
        sources = sources | told if quantity in RATIOS else self._of_its_drive(sources | told)
        if quantity in SCATTERED:
            place, assumed = placed(head.path, quantity, metadata)
            metadata = metadata | place
        notes = (*head.notes, *self._notes(sources), *read, *assumed)
        warnings = overruled(head, self._constants(), self.path)
        return self._told(Plan(sources, metadata, notes=notes, warnings=warnings), head)

    def _of_one_volt(self, sources: dict[str, Source]) -> dict[str, Source]:
        """The sources of an impedance, a reflection or a transmission, with the 1 V that drives its current,
        or the voltage that is recorded beside an impedance; another drive, or another unit: LogError."""
        quantity = self.options["quantity"]
        of = "an impedance" if quantity == "impedance" else f"a {quantity}"
        for name in sources.keys() & {"x", "y", "magnitude"}:
            source, key = sources[name], f"[columns] {name}"
            if quantity in SCATTERED:
                fits, expected = source.unit == "dB" or units.same_kind(source.unit, "1"), "1, % or dB"
            else:
                fits, expected = units.is_of(source.unit, "ohm"), "ohm, kohm or Mohm"
            if not fits:
                raise self.fail(key, f"found the unit {source.unit!r} of {of}, expected {expected}")
            if (stated := source.amplitude) != "peak":
                raise self.fail(key, f"found amplitude {stated!r} of {of}, expected none: it is a ratio")
        volt = Source("[constants] voltage", "V", constant=1.0)
        drives = [replace(sources[name], written="") for name in units.DRIVES if name in sources]
        if quantity == "impedance" and drives and all(units.same_kind(x.unit, "V") for x in drives):
            return sources
        if other := next((drive for drive in drives if drive != volt), None):
            raise self.fail(
                "quantity",
                f"found {other.label} beside {of}, expected no drive: it is that of 1 V",
            )
        return sources | {"voltage": volt}

    def _of_its_drive(self, sources: dict[str, Source]) -> dict[str, Source]:
        """The sources of a signal, those of one that is stated by its drive (an admittance, m/s per V) with a
        drive of 1 where they have none; one of another kind: LogError."""
        shown = [name for name in ("x", "y", "magnitude") if name in sources]
        of = next(filter(None, (per_drive(reference(sources[name].unit)) for name in shown)), None)
        if of is None:
            return sources
        what = {("A", "V"): "an admittance", ("V", "A"): "an impedance"}.get(of, f"{of[0]} by {of[1]}")
        for name in shown:
            if (stated := sources[name].amplitude) != "peak":
                said = f"found amplitude {stated!r} of {what}, expected none: it is a ratio"
                raise self.fail(f"[columns] {name}", said)
        drives = [sources[name] for name in units.DRIVES if name in sources]
        for drive in drives:
            if not units.same_kind(drive.unit, of[1]):
                said = f"found {drive.label} in {drive.unit} beside {what}"
                expected = "a voltage" if of[1] == "V" else f"one in {of[1]}"
                raise self.fail("quantity", f"{said}, expected {expected}, or no drive")
        key = "voltage" if units.same_kind(of[1], "V") else "drive"
        return sources if drives else sources | {key: Source(f"[constants] {key}", of[1], constant=1.0)}

    def beside(self, plan: Plan, head: Head) -> Plan:
        """The `plan` of a file by its own names, with all that is said here: a mapping file without
        [columns]."""
        constants = self._constants()
        for name in constants:
            same = units.DRIVES if name in units.DRIVES else (name,)
            if known := next((plan.sources[other] for other in same if other in plan.sources), None):
                raise self.fail(
                    f"[constants] {name}", f"found {known.label} in {head.path} too, expected it once"
                )
        if "quantity" in self.options and "response" not in plan.sources:
            raise self.fail(
                "quantity",
                "belongs to x and y, or to magnitude, in [columns], or to a waveform; found neither",
            )
        sources = {name: self._as_stated(name, source) for name, source in plan.sources.items()}
        return self._told(replace(plan, sources=sources | constants), head)

    def _as_stated(self, name: str, source: Source) -> Source:
        """A source of a file's own names, as rms or peak to peak where that is said here and its name says
        nothing."""
        _, unit, stated = units.split_unit(source.label)
        silent = (
            name in units.AMPLITUDES
            and source.column is not None
            and not (stated or units.split_amplitude(unit)[1])
        )
        return (
            replace(source, amplitude=self.options.get("amplitude", source.amplitude)) if silent else source
        )

    def _told(self, plan: Plan, head: Head) -> Plan:
        """The plan with the rows to use, how they are split, and how the phase is read, where there is
        one."""
        split, given = self.options.get("split_by"), self.options
        waveform, phased = "response" in plan.sources, bool(plan.sources.keys() & {"wd", "x", "phase"})
        spare = [
            key
            for key in ("phase_sign", "phase_offset_deg")[: 1 if waveform else 2]
            if key in given and not phased
        ]
        why = "that of a waveform is known" if waveform else "an amplitude has no phase"
        told = given.get("quantity") not in RATIOS and plan.sources.keys() & {"x", "phase"}  # by the rows
        return replace(
            plan,
            split=plan.split if split is None else self._position("split_by", split, head),
            rows=given.get("rows"),
            quantity=given.get("quantity", "displacement"),
            phase_sign=given.get("phase_sign", 0 if told else 1) if phased else 1,
            phase_offset=math.radians(given.get("phase_offset_deg", 0.0)),
            notes=(*plan.notes, *(f"{key} of {self.path} is not used: {why}" for key in spare)),
        )

    def _constants(self) -> dict[str, Source]:
        return {name: self._constant(name, text) for name, text in self.options.get("constants", {}).items()}

    def position(self, key: str, entry: Mapping[str, Any], head: Head) -> int:
        """The place of a column in a file, or in the one of several that its `file` names, else the first."""
        if not head.parts:
            return self._position(key, entry["column"], head)
        begin, end = head.parts[entry["file"]] if "file" in entry else next(iter(head.parts.values()))
        part = replace(head, names=head.names[begin:end])
        return begin + self._position(key, entry["column"], part)

    def called(self) -> set[str | int]:
        """The names and the places of columns that it mentions."""
        entries = (*self.options.get("columns", {}).values(), self.options.get("split_by"))
        named = (entry.get("column") if isinstance(entry, dict) else entry for entry in entries)
        return {name for name in named if isinstance(name, str | int)}

    def _position(self, key: str, column: str | int, head: Head) -> int:
        if isinstance(column, str) and head.names.count(column) == 1:
            return head.names.index(column)
        if isinstance(column, str) and not any(head.names) and (of := re.search(r"\[(\d+)\]$", column)):
            column = int(of[1])  # data[0], of an array's columns
        if isinstance(column, int) and 0 <= column < len(head.names):
            return column
        if isinstance(column, int):
            raise self.fail(
                key, f"found position {column}, expected 0 to {len(head.names) - 1} in {head.path}"
            )
        if column in head.names:
            raise self.fail(
                key, f"{head.path} has several columns {column!r}, expected one; give its position"
            )
        named = [name for name in head.names if name]
        hint = units.did_you_mean(column, named)
        raise self.fail(
            key, f"{head.path} has no column {column!r}{hint}; it has {listed(named) or 'no header'}"
        )

    def _column(self, name: str, entry: dict[str, Any], head: Head) -> Source:
        key = f"[columns] {name}"
        index = self.position(key, entry, head)
        label = head.names[index] or f"column {index}"
        unit, amplitude = split_ending(entry.get("unit", head.says(index) or label), "unit" in entry)
        unit = in_gravity(unit) if self.options.get("quantity") == "acceleration" else unit
        stated = self.options.get("amplitude") if name in units.AMPLITUDES else None
        amplitude = entry.get("amplitude") or amplitude or stated or _usual(name, unit)
        dated = name == "time" and head.dated(index)
        unit = "s" if dated else unit
        dated = dated or (
            name == "time" and self.options.get("kind") == "waveform" and is_long(head.first(index))
        )
        self._check_unit(key, name, unit)
        unit, turn = ("rad", PHASES[unit]) if name == "phase" else (unit, 1.0)
        scale, offset = (turn * float(entry.get(of, usual)) for of, usual in (("scale", 1), ("offset", 0)))
        return Source(label, unit, amplitude, index, 0.0, scale, offset, dated)

    def _constant(self, name: str, text: Any) -> Source:
        key = f"[constants] {name}"
        number, _, unit = str(text).strip().partition(" ")
        if not math.isfinite(to_number(number)):
            raise self.fail(key, f'found {text!r}, expected a number and a unit such as "20 degC"')
        unit, amplitude = split_ending(unit.strip() or ("1" if name == "duty" else ""), True)
        self._check_unit(key, name, unit)
        return Source(key, unit, amplitude or _usual(name, unit), constant=float(number), written=number)

    def _check_unit(self, key: str, name: str, unit: str) -> None:
        if unit == "?":
            raise self.fail(key, 'found unit = "?", expected the unit')
        if name == "phase" and unit not in PHASES:
            raise self.fail(key, f"found the unit {unit!r}, expected rad, deg or turns")
        if name == "phase" or (name in ("magnitude", "w", "std", "std_q") and is_decibel(unit)):
            return
        try:
            units.check_unit(name, unit)
        except ValueError as error:
            raise self.fail(key, str(error)) from None

    def _notes(self, sources: dict[str, Source]) -> tuple[str, ...]:
        """What was taken for granted, so that it is never taken in silence."""
        notes = drive_as(self.options, sources)
        columns = self.options.get("columns", {})
        if "response" in sources:
            assumed = f"the response is taken as a displacement: {self.path} does not say quantity"
            return () if "quantity" in self.options else (assumed,)
        for name in (n for n in ("voltage", "drive", "wd", "w", "x", "magnitude") if n in columns):
            source = sources[name]
            silent = "amplitude" not in columns[name] and not source.label.startswith("[")
            stated = (
                "amplitude" in self.options
                or units.split_amplitude(columns[name].get("unit", source.label))[1]
                or _usual(name, source.unit) != "peak"
                or self.options.get("quantity") in RATIOS
            )
            if silent and not stated:
                notes.append(
                    f'{name} is taken as peak: {self.path} does not say amplitude = "peak", "rms" or "pp"'
                )
        if "x" in sources or "magnitude" in sources:
            if "quantity" not in self.options:
                notes.append(f"the signal is taken as a displacement: {self.path} does not say quantity")
            known = "phase_sign" in self.options or self.options.get("quantity") in RATIOS
            if not known and sources.keys() & {"x", "phase"}:
                notes.append(
                    "the phase is taken as that of e^(+j omega t), or of its conjugate where it rises with"
                    f" the frequency: {self.path} does not say phase_sign"
                )
        return tuple(notes)


def _usual(name: str, unit: str) -> str:
    """What an amplitude in this unit is where nothing else says it: of a drive in dBV rms."""
    return (level_of_volts(unit) if name in units.DRIVES else "") or "peak"


def select_rows(rows: Any, value: str | None, count: int, where: str) -> np.ndarray | None:
    """Row numbers that `rows` of a mapping file asks for, of `count` rows; None for all. Raises LogError."""
    ranges = rows.get(value) if isinstance(rows, dict) else rows
    if ranges is None:
        return None
    for edges in ranges:
        if not 0 <= edges[0] < edges[1] <= count:
            raise LogError(f"{where}: found rows = {edges!r}, expected [first, last] within 0 to {count}")
    return np.unique(np.concatenate([np.arange(*edges) for edges in ranges]))


def split_ending(text: str, is_unit: bool) -> tuple[str, str]:
    """Unit and amplitude word of a stated unit (`V_rms`), or of the end of a name, `X [V]` or `X_V_rms`."""
    if is_unit:
        unit, amplitude = units.split_amplitude(plain(text))
        return units.short(unit), amplitude
    stem, unit, amplitude = units.split_unit(text)
    if not unit:
        stem, amplitude = units.split_amplitude(stem)
        unit = stem.rpartition("_")[2] if "_" in stem else ""
    unit, inner = units.split_amplitude(unit)
    unit = units.short(unit)
    rate = "/" in unit and units.is_known(unit)
    if not (rate or text.endswith(("]", ")")) or _PLAIN_UNIT.fullmatch(unit)):
        return "", inner or amplitude  # the library would take S21_re for a temperature in degrees Réaumur
    return unit, inner or amplitude
