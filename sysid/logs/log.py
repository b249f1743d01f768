"""Logs: what was driven and what answered, read from CSV. Units, column names and files end here.

A log is a table with a header whose names end in their units; lines `# key: value` above it are metadata:

    # plate: A7
    # temperature_degC: 24.0
    time_s,voltage_V,frequency_Hz,wd_um,wq_um
    0.0000,5.0,32300.0,0.0,0.0

`read_logs` reads such files, and those of other instruments through a mapping file (see `logs.mapping`).
"""

import dataclasses
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.logs import units
from sysid.logs.benchwords import bench_of, misread
from sysid.logs.cells import decimals, listed
from sysid.logs.csvbody import Body, read_body
from sysid.logs.csvfile import Head, LogError
from sysid.logs.header import INPUTS, counted, metadata_number, not_understood, planned, stated, table_plan
from sysid.logs.mapfile import load_mapping
from sysid.logs.mapping import (
    MappingFile,
    Plan,
    Source,
    decode,
    is_analysed,
    is_decibel,
    lock_in,
    select_rows,
    turned,
)
from sysid.logs.missing import refuse_row, rows_to_keep
from sysid.logs.opening import groups, opened
from sysid.logs.stated import ERRORS, errors, read_errors, stated_in
from sysid.logs.timed import decrease_of, timed
from sysid.logs.together import doubted, in_common_units, of_one_plate
from sysid.logs.waveform import from_samples, sample_times, uneven
from sysid.shown import Shown

__all__ = ["Log", "LogError", "read_logs"]

logger = logging.getLogger(__name__)
KINDS = ("transient", "steady")
SAMPLINGS = ("instant", "settled")
# What no bench records: a value beyond is in another unit than it is said to be, or of another sign.
POSSIBLE = {
    "temperature": (-273.15, np.inf, "a temperature above absolute zero"),
    "frequency": (0.0, np.inf, "a frequency of 0 or more"),
    "duty": (-1.0, 1.0, "a duty of -1 to 1; a percentage is duty [%]"),
}
DIGITS = 6  # decimals of a temperature, beyond which no thermometer reads
WHOLE = 1e-6  # of a digit, by which a number that is so many of them is off in float64


@dataclass(frozen=True, eq=False, repr=False)
class Log(Shown):
    """One experiment: n rows of inputs and the measured response, peak amplitudes, in rows as recorded.

    `response` is (n,) complex Wd + j Wq, or the real amplitude W where only that was recorded, in
    `response_unit`; `drive` is (n,) peak in `drive_unit`. What was not recorded is None; arrays are owned,
    read-only copies. `kind` None: not stated, and a frequency that changes on every row leaves it open
    (steady at a dwell of four tau). Raises LogError when lengths differ, a value is not finite, time
    decreases, or a word is unknown.
    """

    name: str
    response: np.ndarray
    time: np.ndarray | None = None  # s
    drive: np.ndarray | None = None
    frequency: np.ndarray | None = None  # Hz
    temperature: np.ndarray | None = None  # degC
    force: np.ndarray | None = None  # N
    kind: str | None = None
    sampling: str | None = None
    response_unit: str = "um"
    drive_unit: str = "V"
    metadata: Mapping[str, str] = field(default_factory=dict)
    bench: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[
        str, ...
    ] = ()  # what stands above the rows and was probably meant to be metadata; each names the file
    path: str = ""
    sha256: str = ""
    # standard error of each row's response, per channel, but for a factor of all
    std: np.ndarray | None = None
    theta: np.ndarray | None = None  # rad, the carrier's phase at each row's time; of raw waveforms
    # degC, one of the last digit that its temperature was written with; 0: not read from text
    temperature_digit: float = 0.0
    # read in decibels, or by an impedance analyser: the noise is a fraction of the response
    relative_noise: bool = False

    def __post_init__(self) -> None:
        for name in ("response", "time", "drive", "frequency", "temperature", "force", "std", "theta"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, self._own(name, values))
        if self.time is not None and (decrease := decrease_of(self.time)) is not None:
            raise LogError(
                f"{self.path or self.name}: time decreases at row {decrease} (counted from 0), expected it"
                f" to go on"
            )
        if self.std is not None and (row := int(np.argmin(self.std > 0))) >= 0 and not self.std[row] > 0:
            found = f"row {row} (counted from 0): found a standard error of {self.std[row]:g}"
            raise LogError(f"{self.path or self.name}, {found}, expected one above zero")
        if self.kind is None:
            object.__setattr__(self, "kind", self._tell_kind())
        for word, words in ((self.kind, KINDS), (self.sampling, SAMPLINGS)):
            if word is not None and word not in words:
                raise LogError(f"{self.path or self.name}: found {word!r}, expected {_either(word, words)}")
        if self.kind == "transient" and self.time is None:
            raise LogError(
                f"{self.path or self.name}: found a transient log without time, expected a column such as"
                f" time_s"
            )

    def _own(self, name: str, values: Any) -> np.ndarray:
        array = np.asarray(values)
        array = array.astype(np.complex128 if np.iscomplexobj(array) else np.float64, copy=False)
        if array.ndim != 1 or not len(array) or len(array) != len(self.response):
            raise LogError(
                f"{self.path or self.name}: found {name} of shape {array.shape}, expected"
                f" ({len(self.response)},), n > 0"
            )
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array))[0])
            raise LogError(
                f"{self.path or self.name}, row {row} (counted from 0): found {name} {array[row]}, expected"
                f" finite"
            )
        if (
            array.flags.writeable or not array.flags.owndata
        ):  # a log's own arrays may be shared with another log
            array = array.copy()
            array.flags.writeable = False
        return array

    def _tell_kind(self) -> str | None:
        if self.time is None:
            return "steady"
        if self.frequency is None or len(self) == 1:
            return "transient"
        return None if (self.frequency[1:] != self.frequency[:-1]).all() else "transient"

    @classmethod
    def from_frame(cls, frame: Any, name: str = "log", **constants: Any) -> "Log":
        """The log of a table, a pandas DataFrame or a mapping of columns (n,), whose names are the contract's
        and end in their units. `constants`: what a file states above its header. A frame's `attrs` that state
        something of the kind are taken too, as `log.to_frame()` has them. Raises LogError as `read_logs`
        does, and where the table holds several experiments.

        >>> columns = {"frequency_kHz": [32.2, 32.3], "wd_nm": [900, 2000], "wq_nm": [1000, 0]}
        >>> Log.from_frame(columns, voltage_V=100, temperature_degC=24).frequency
        array([32200., 32300.])
        """
        from sysid.logs.made import of_table

        return of_table(frame, name, constants)

    @classmethod
    def from_arrays(cls, response: Any, *, name: str = "log", **fields: Any) -> "Log":
        """The log of arrays (n,), in the units of the fields of a Log; a number stands for a constant.

        >>> Log.from_arrays([1j, 2, -1j], drive=100, frequency=[32200, 32300, 32400], temperature=24.0).drive
        array([100., 100., 100.])
        """
        from sysid.logs.made import of_arrays

        return of_arrays(response, name, fields)

    @classmethod
    def from_waveform(
        cls, drive: Any, response: Any, rate: float, *, name: str = "log", **constants: Any
    ) -> "Log":
        """The log of raw carrier samples (n,) of drive (V) and response (um) at `rate` Hz, demodulated by the
        drive's own phase. `drive_unit`, `response_unit`: other units; further constants as in `from_frame`.
        Raises LogError where the drive is no carrier, or is sampled too seldom.

        >>> t = np.arange(20_000) / 1e6
        >>> log = Log.from_waveform(100 * np.cos(2e5 * t), np.sin(2e5 * t), 1e6)
        >>> print(f"{log.frequency[0]:.0f} Hz, {abs(log.response[5]):.3f} {log.response_unit}")
        31831 Hz, 1.000 um
        """
        from sysid.logs.made import of_waveform

        return of_waveform(drive, response, rate, name, constants)

    @property
    def amplitude_only(self) -> bool:
        """Whether the response is the real amplitude W, not the vector Wd + j Wq."""
        return not np.iscomplexobj(self.response)

    def __len__(self) -> int:
        return len(self.response)

    def to_frame(self) -> Any:
        """A pandas DataFrame of the rows by the contract's names; what is known of the whole log stands in
        `attrs`."""
        from sysid.report.frames import of_log

        return of_log(self)

    def plot(self) -> Any:
        """A figure of matplotlib: the rows over time, or a sweep with its circle."""
        from sysid.report.plots import log_figure

        return log_figure(self)

    def _brief(self) -> Any:
        from sysid.report.brief import of_log

        return of_log(self)


def read_logs(paths: str | Path | Iterable[str | Path], columns: str | Path | None = None) -> list[Log]:
    """Logs of one plate from CSV files, in the order given; `columns` is a mapping file for other
    instruments' files.

    Patterns such as `logs/*.csv` are expanded. All responses (and drives) come in the first log's unit. A
    file whose bytes were read already counts once. Raises LogError, with `.mapping` to start from when one
    was not understood.
    """
    mapping = None if columns is None else load_mapping(columns)
    logs: dict[str, list[Log]] = {}
    for group in groups(paths, mapping):
        logger.info("%s", next(iter(group.values())))
        with opened(group, mapping) as head:
            read = logs_of(head, mapping)
        if known := logs.get(read[0].sha256):
            note = f"{next(iter(group.values()))} holds the same bytes: counted once"
            logs[read[0].sha256] = [dataclasses.replace(log, notes=(*log.notes, note)) for log in known]
        else:
            logs[read[0].sha256] = read
    return of_one_bench([log for read in logs.values() for log in read])


def of_one_bench(logs: list[Log]) -> list[Log]:
    """Logs of one plate, in the first one's units. Raises LogError where they are not."""
    return [doubted(log) for log in in_common_units(of_one_plate(logs))]


def logs_of(head: Head, mapping: MappingFile | None = None) -> list[Log]:
    """The logs of a file's table. Raises LogError."""
    head, mapping, plan = planned(head, mapping)
    wanted = sorted({source.column for source in plan.sources.values() if source.column is not None})
    dated = {source.column for source in plan.sources.values() if source.dated and source.column is not None}
    body = read_body(head, wanted, plan.split, dated)
    notes = (*counted(head, dated), *body.notes)
    values = [None] if body.keys is None else list(dict.fromkeys(body.keys))
    if isinstance(plan.rows, dict) and (unknown := sorted(plan.rows.keys() - set(values))):
        raise LogError(
            f"{head.path}: found rows of an experiment {unknown[0]!r}, expected one of {listed(values)}"
        )
    rows = [None if value is None else np.flatnonzero(body.keys == value) for value in values]
    tables = [None if body.tables is None else body.tables[int(value) - 1] for value in values]
    plans = [table_plan(head, metadata, plan, mapping) for metadata in tables]
    doubts = [misread(head, plan, mapping.options if mapping else ()) for plan in plans]
    plans = [
        dataclasses.replace(plan, notes=(*plan.notes, *notes), warnings=(*plan.warnings, *doubt))
        for plan, doubt in zip(plans, doubts, strict=True)
    ]
    return [_make_log(head, body, *of) for of in zip(plans, values, rows, strict=True)]


def _make_log(head: Head, body: Body, plan: Plan, value: str | None, rows: np.ndarray | None) -> Log:
    """The log of a file, or of its part in `rows` where the split column holds `value`."""
    name = head.name if value is None else f"{head.name}[{value}]"
    count = len(rows) if rows is not None else len(body)
    chosen = select_rows(plan.rows, value, count, head.path)
    if chosen is not None:
        rows = chosen if rows is None else rows[chosen]
        count = len(rows)
    arrays = {key: _values(key, body, source, rows, count) for key, source in plan.sources.items()}
    kind = _word(head, plan.metadata, "kind", (*KINDS, "waveform"))
    keep, note = rows_to_keep(head, body, plan, rows, arrays, kind)
    if keep is not None:
        arrays = {key: (values[keep], unit) for key, (values, unit) in arrays.items()}
        rows = np.flatnonzero(keep) if rows is None else rows[keep]
        plan, count = dataclasses.replace(plan, notes=(*plan.notes, note)), len(rows)
    plan = timed(head, body, plan, rows, arrays, kind)
    for key, (low, high, expected) in POSSIBLE.items():
        values = _internal(key, *arrays[key]) if key in arrays else np.zeros(1)
        if (beyond := (values < low) | (values > high)).any():
            refuse_row(head, body, plan.sources[key], rows, int(np.argmax(beyond)), expected)
    digit = _temperature_digit(head, plan.sources["temperature"], body) if "temperature" in arrays else 0.0
    inputs = {key: _internal(key, *arrays.pop(key)) for key in INPUTS if key in arrays}
    if "carrier" in arrays:
        inputs["theta"] = _internal("carrier", *arrays.pop("carrier"))
    drive, drive_unit = _drive(head, plan, arrays)
    stated_errors = stated_in(head, body, plan, rows, arrays)
    fields: dict[str, Any] = {
        "drive": drive,
        **inputs,
        "bench": bench_of(head, plan.metadata),
        "notes": plan.notes,
    }
    fields["warnings"] = plan.warnings
    fields |= {"kind": kind, "sampling": _word(head, plan.metadata, "sampling", SAMPLINGS)}
    if kind == "waveform":
        fields["time"] = sample_times(head, plan.metadata, inputs.get("time"), count)
        if (odd := uneven(fields["time"])) is not None:
            expected = "even steps: samples are missing, or the stamps are too coarse"
            refuse_row(head, body, plan.sources["time"], rows, odd, expected)
        fields |= from_samples(head, plan, fields, arrays.get("response"))
    else:
        driven = drive, drive_unit
        fields["response"], fields["response_unit"] = _response(
            head, plan, arrays, inputs.get("frequency"), driven
        )
        fields["std"] = errors(head.path, plan, arrays, stated_errors, inputs.get("frequency"), driven)
    for array in fields.values():
        if isinstance(array, np.ndarray):
            array.flags.writeable = False  # it is ours alone, so that the log need not copy it
    log = Log(
        name,
        **fields,
        drive_unit=drive_unit,
        metadata=plan.metadata,
        path=head.path,
        sha256=body.sha256,
        temperature_digit=digit,
        relative_noise=not stated_errors
        and (is_analysed(plan) or any(is_decibel(s.unit) for s in plan.sources.values())),
    )
    if log.kind == "steady" and log.frequency is None and log.drive is None:
        raise not_understood(
            head, "a steady log without frequency or drive", "one, such as frequency_Hz (or time_s)"
        )
    return log


def _values(
    name: str, body: Body, source: Source, rows: np.ndarray | None, count: int
) -> tuple[np.ndarray, str]:
    """Peak values of one source, NaN where a cell holds no number, and their unit."""
    read = read_errors if name in ERRORS else decode
    if source.column is None:
        return read(np.full(count, source.constant), source)
    numbers = body.numbers[source.column]
    return read(numbers if rows is None else numbers[rows], source)


def _temperature_digit(head: Head, source: Source, body: Body) -> float:
    """One of the last digit (degC) of what was written: of the first rows as text, and of all rows as far as
    numbers show it."""
    if source.column is None:
        texts, numbers = [source.written], np.array([source.constant])
    else:
        texts, numbers = (
            [row[source.column] for row in head.sample if source.column < len(row)],
            body.numbers[source.column],
        )
    mark, places = str(head.dialect.decimal), range(DIGITS)
    written = max(decimals(text, mark) for text in texts)
    numbers = np.unique(numbers[np.isfinite(numbers)])
    shown = next(
        (k for k in places if np.all(np.abs(numbers * 10.0**k - np.rint(numbers * 10.0**k)) < WHOLE)), DIGITS
    )
    zero, one = (float(decode(np.array([x]), source)[0][0]) for x in (0.0, 10.0 ** -max(written, shown)))
    return abs(
        float(_internal("temperature", one, source.unit) - _internal("temperature", zero, source.unit))
    )


def _internal(quantity: str, values: Any, unit: str) -> Any:
    return units.convert(values, unit, units.INTERNAL[quantity])


def _drive(
    head: Head, plan: Plan, arrays: dict[str, tuple[np.ndarray, str]]
) -> tuple[np.ndarray | None, str]:
    """Drive and its unit; a duty cycle becomes volts when `volts_per_duty` is known."""
    if "duty" not in arrays:
        drive = next((key for key in units.DRIVES if key in arrays), None)
        return arrays.pop(drive) if drive else (None, "V")
    duty = _internal("duty", *arrays.pop("duty"))
    if (text := stated(plan.metadata, "volts_per_duty")) is None:
        return duty, "duty"
    return duty * metadata_number(head, "volts_per_duty", text), "V"


def _response(
    head: Head,
    plan: Plan,
    arrays: dict[str, tuple[np.ndarray, str]],
    frequency: np.ndarray | None,
    drive: tuple[np.ndarray | None, str],
) -> tuple[np.ndarray, str]:
    """Wd + j Wq, or W, and its unit."""
    if "w" in arrays:
        return arrays["w"]
    first, second = (
        ("wd", "wq") if "wd" in arrays else ("x", "y") if "x" in arrays else ("magnitude", "phase")
    )
    signal, unit = arrays[first]
    if first == "magnitude" and "phase" in arrays:
        signal = signal * np.exp(1j * arrays["phase"][0])
    elif first != "magnitude":
        imaginary, other = arrays[second]
        if not units.same_kind(other, unit):
            raise LogError(
                f"{head.path}: found {first} in {unit} and {second} in {other}, expected units of one kind"
            )
        signal = _complex(signal, units.convert(imaginary, other, unit))
    return (
        (turned(signal, plan), unit)
        if first == "wd"
        else lock_in(signal, plan, frequency, unit, head.path, drive)
    )


def _complex(real: np.ndarray, imaginary: np.ndarray) -> np.ndarray:
    result = np.empty(len(real), np.complex128)  # real + 1j * imaginary would lose the sign of a zero
    result.real, result.imag = real, imaginary
    return result


def _word(head: Head, metadata: Mapping[str, str], key: str, words: tuple[str, ...]) -> str | None:
    word = stated(metadata, key)
    if word is None or word.casefold() in words:
        return word and word.casefold()
    raise LogError(f"{head.path}, metadata {key!r}: found {word!r}, expected {_either(word, words)}")


def _either(word: str, words: tuple[str, ...]) -> str:
    return " or ".join(words) + units.did_you_mean(word, words)
