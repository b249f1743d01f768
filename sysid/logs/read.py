"""Logs of files: what is planned of a head is read, and made a log."""

import dataclasses
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.columns.abreast import stacked
from sysid.columns.header import INPUTS, counted, planned, table_plan
from sysid.columns.mapfile import load_mapping
from sysid.columns.mapping import MappingFile, select_rows
from sysid.columns.metadata import metadata_number, stated
from sysid.columns.owntimes import at_one_time
from sysid.columns.plan import ERRORS, Plan, Source
from sysid.columns.signal import decode, is_analysed, lock_in, turned
from sysid.columns.unknown import drafted, not_understood
from sysid.demodulation.waveform import from_samples, sample_times, uneven
from sysid.logs.benchwords import bench_of, misread
from sysid.logs.copies import once
from sysid.logs.doubts import doubted, unfolded
from sysid.logs.filled import Arrays, filled, without_direct
from sysid.logs.log import EVEN, KINDS, MEASURED, RELATIVE, SAMPLINGS, TERMINALS, Log, either
from sysid.logs.missing import refuse_row, rows_to_keep
from sysid.logs.opening import groups, opened
from sysid.logs.parted import parted
from sysid.logs.stated import WIDE, errors, of_derivative, of_scattering, read_errors, stated_in
from sysid.logs.timed import oldest_first, timed
from sysid.logs.together import in_common_units, of_one_plate, temperatures_in_names
from sysid.logs.within import within
from sysid.logs.wrapped import unwrapped
from sysid.tables import units
from sysid.tables.cells import decimals, listed, to_number
from sysid.tables.csvbody import Body, read_body
from sysid.tables.csvfile import Head, LogError, called
from sysid.tables.densities import amplitude_of, is_decibel
from sysid.tables.melted import widened
from sysid.tables.scattered import SCATTERED

logger = logging.getLogger(__name__)
OFFSET = "of one from a centre say find = true and columns.frequency.offset = 32300, say, in a mapping file"
# What no bench records: a value beyond is in another unit than it is said to be, or of another sign.
POSSIBLE = {
    "temperature": (-273.15, np.inf, "a temperature above absolute zero"),
    "frequency": (0.0, np.inf, f"a frequency of 0 or more; {OFFSET}"),
    "duty": (-1.0, 1.0, "a duty of -1 to 1; a percentage is duty [%]"),
}
NO_MAGNITUDE = 'a magnitude of 0 or more; is it in dB? then say unit = "dB"; of what has a sign, call it w'
DIGITS = 6  # decimals of a temperature, beyond which no thermometer reads
WHOLE = 1e-6  # of a digit, by which a number that is so many of them is off in float64


def read_logs(paths: str | Path | Iterable[str | Path], columns: str | Path | None = None) -> list[Log]:
    """Logs of one plate from CSV files, in the order given; `columns` is a mapping file for other
    instruments' files.

    Patterns such as `logs/*.csv` are expanded. All responses (and drives) come in the first log's unit. A
    log that is there twice counts once, be it the same bytes or the same rows with fewer digits. Raises
    LogError, with `.mapping` to start from when one was not understood.
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
    """Logs of one plate, each once, in the first one's units. Raises LogError where they are not."""
    return temperatures_in_names(once(in_common_units(of_one_plate(logs))))


def logs_of(head: Head, mapping: MappingFile | None = None) -> list[Log]:
    """The logs of a file's table. Raises LogError."""
    return logs_in(*tabled(head, mapping))


def tabled(head: Head, mapping: MappingFile | None) -> tuple[Head, MappingFile | None, Plan, Body]:
    """A file's head as it is planned, with its rows and how they are told apart. Raises LogError."""
    named = mapping.called() if mapping else ()
    head = stacked(widened(head, named), named)
    head, mapping, plan = planned(at_one_time(head, mapping), mapping)
    wanted = sorted({source.column for source in plan.sources.values() if source.column is not None})
    body = read_body(head, wanted, plan.split, _dated(plan))
    return head, mapping, *parted(head, *unwrapped(plan, body), wanted, _dated(plan))


def _dated(plan: Plan) -> set[int]:
    """The columns of dates."""
    return {source.column for source in plan.sources.values() if source.dated and source.column is not None}


def logs_in(head: Head, mapping: MappingFile | None, plan: Plan, body: Body) -> list[Log]:
    """The logs of a table. Raises LogError."""
    notes = (*counted(head, _dated(plan)), *body.notes)
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
    return [log_of(head, body, *of) for of in zip(plans, values, rows, strict=True)]


def log_of(
    head: Head, body: Body, plan: Plan, value: str | None = None, rows: np.ndarray | None = None
) -> Log:
    """The log of a file, or of its part in `rows` where the split column holds `value`."""
    name = head.name if value is None else f"{head.name}[{value}]"
    count = len(rows) if rows is not None else len(body)
    chosen = select_rows(plan.rows, value, count, head.path)
    place = np.arange(count) if chosen is None else chosen
    if chosen is not None:
        rows = chosen if rows is None else rows[chosen]
    arrays = {key: _values(key, body, source, rows, place) for key, source in plan.sources.items()}
    kind = _word(head, plan.metadata, "kind", (*KINDS, "waveform"))
    plan, turned, arrays = oldest_first(plan, place if rows is None else rows, arrays)
    rows = turned if rows is not None or turned is not place else None
    plan, rows, arrays = _kept(head, body, plan, rows, arrays, kind)
    count = len(next(iter(arrays.values()))[0])
    plan = unfolded(name, timed(head, body, plan, rows, arrays, kind), arrays)
    _refuse_impossible(head, body, plan, rows, arrays)
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
        "warnings": plan.warnings,
        "kind": kind,
        "sampling": _word(head, plan.metadata, "sampling", SAMPLINGS),
    }
    if kind == "waveform":
        fields["time"] = _sample_times(head, body, plan, rows, inputs.get("time"), count)
        fields |= from_samples(head, plan, fields, arrays.get("response"))
    else:
        frequency, driven = inputs.get("frequency"), (drive, drive_unit)
        _refuse_open(head, plan, frequency)
        fields["response"], fields["response_unit"] = _response(head, plan, arrays, frequency, driven)
        fields["std"] = _errors(head, plan, arrays, stated_errors, frequency, driven)
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
        **_as_measured(plan, fields.get("std") is not None, bool(stated_errors)),
    )
    if log.kind == "steady" and log.frequency is None and log.drive is None:
        raise not_understood(
            head, "a steady log without frequency or drive", "one, such as frequency_Hz (or time_s)"
        )
    celsius = "temperature" in plan.sources and plan.sources["temperature"].unit == "degC"
    return doubted(within(log), celsius)


def _as_measured(plan: Plan, known: bool, stated_errors: bool) -> dict[str, Any]:
    """What `Log` has of how a response was measured; `known`: its rows have standard errors, which follow
    from that where none are stated, and in files of scattering parameters, which tell their reference."""
    noise, place = ((stated(plan.metadata, key) or "").casefold() for key in MEASURED)
    return {
        "relative_noise": not known and (noise == RELATIVE or _in_proportion(plan)),
        "analysed": place == TERMINALS or is_analysed(plan),
        "even": known and (noise == EVEN or not stated_errors or "reference_ohm" in plan.metadata),
    }


def _in_proportion(plan: Plan) -> bool:
    """Whether noise may go with the response, as of a ratio and of decibels; by how much, the rows tell."""
    decibels = any(is_decibel(source.unit) for source in plan.sources.values())
    return is_analysed(plan) or decibels


def _refuse_open(head: Head, plan: Plan, frequency: np.ndarray | None) -> None:
    """What is taken as usual, and makes a difference at these frequencies (n,): LogError with a mapping
    file."""
    if frequency is None:
        return
    at = frequency[frequency > 0]
    low, high = (float(np.min(at)), float(np.max(at))) if len(at) else (0.0, 0.0)
    found, expected = f"found a signal from {low:.6g} to {high:.6g} Hz", ""
    if "quantity" in plan.taken and high > WIDE * low:
        expected = "quantity: over so wide a sweep a displacement and a velocity differ by more than a gain"
    if "phase_sign" in plan.taken and high == low:
        expected = "phase_sign: at one frequency nothing shows which way the phase turns"
    if expected:
        raise LogError(f"{head.path}: {found}, expected a mapping file that says {expected}", drafted(head))


def _kept(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays, kind: str | None
) -> tuple[Plan, np.ndarray | None, Arrays]:
    """The plan, the rows and the arrays of those that are kept, each with a number in all of its cells."""
    arrays = dict(arrays)
    plan = filled(head, body, plan, rows, arrays, kind)
    for choose in (without_direct, rows_to_keep):
        keep, note = choose(head, body, plan, rows, arrays, kind)
        if keep is not None:
            arrays = {key: (values[keep], unit) for key, (values, unit) in arrays.items()}
            rows = np.flatnonzero(keep) if rows is None else rows[keep]
            plan = dataclasses.replace(plan, notes=(*plan.notes, note))
    return plan, rows, arrays


def with_response(
    log: Log, path: str, metadata: Mapping[str, str], head: Head, body: Body, plan: Plan
) -> Log:
    """The log of the file at `path` with the inputs of `log` and its `head` and `plan`, but with metadata and
    a response of its own, of nothing but numbers. Raises LogError, which does not name the file."""
    arrays: dict[str, tuple[np.ndarray, str]] = {
        key: _values(key, body, plan.sources[key], None, np.arange(len(body)))
        for key in ("w", "wd", "wq")
        if key in plan.sources
    }
    response, unit = _response(head, plan, arrays, log.frequency, (log.drive, log.drive_unit))
    response.flags.writeable = False
    return log.again(
        response,
        name=called(path),
        response_unit=unit,
        metadata=metadata,
        path=path,
        sha256=body.sha256,
    )


def _refuse_impossible(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Mapping[str, tuple[np.ndarray, str]]
) -> None:
    """A value that cannot be, such as a temperature below absolute zero: LogError with its row."""
    for key, (low, high, expected) in POSSIBLE.items():
        values = _internal(key, *arrays[key]) if key in arrays else np.zeros(1)
        if (beyond := (values < low) | (values > high)).any():
            refuse_row(head, body, plan.sources[key], rows, int(np.argmax(beyond)), expected)
    for key, (values, _) in arrays.items():
        power = bool(amplitude_of(plan.sources[key].unit))
        if (power or key == "magnitude") and (values < 0).any():
            expected = "a power density of 0 or more" if power else NO_MAGNITUDE
            refuse_row(head, body, plan.sources[key], rows, int(np.argmax(values < 0)), expected)


def _sample_times(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, stamps: np.ndarray | None, count: int
) -> np.ndarray:
    """Times (s) of raw samples, which stand in even steps: LogError with the row of the first that does
    not."""
    times = sample_times(head, plan.metadata, stamps, count)
    if (odd := uneven(times)) is not None:
        expected = "even steps: samples are missing, or the stamps are too coarse"
        refuse_row(head, body, plan.sources["time"], rows, odd, expected)
    return times


def _values(
    name: str, body: Body, source: Source, rows: np.ndarray | None, place: np.ndarray
) -> tuple[np.ndarray, str]:
    """Peak values of one source, NaN where a cell holds no number, and their unit; `place` (n,): which rows
    of the experiment they are."""
    read = read_errors if name in ERRORS else decode
    if source.counted:
        return read(place.astype(float), source)
    if source.column is None:
        return read(np.full(len(place), source.constant), source)
    numbers = body.numbers[source.column]
    return read(numbers if rows is None else numbers[rows], source)


def _temperature_digit(head: Head, source: Source, body: Body) -> float:
    """One of the last digit (degC) of what was written: of the first rows as text, and of all rows as far as
    numbers show it."""
    mark, places = str(head.dialect.decimal), range(DIGITS)
    if source.column is None:
        texts, numbers = [source.written], np.array([to_number(source.written, mark)])
    else:
        texts, numbers = (
            [row[source.column] for row in head.sample if source.column < len(row)],
            body.numbers[source.column],
        )
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
    return duty * metadata_number(head, "volts_per_duty", text, units.Name("voltage", "V", "peak")), "V"


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
    signal, unit = _recorded(head, arrays)
    if "wd" in arrays:
        return turned(signal, plan), unit
    return lock_in(signal, plan, frequency, unit, head.path, drive)


def _errors(
    head: Head,
    plan: Plan,
    arrays: dict[str, tuple[np.ndarray, str]],
    stated_errors: Mapping[str, tuple[np.ndarray, str]],
    frequency: np.ndarray | None,
    drive: tuple[np.ndarray | None, str],
) -> np.ndarray | None:
    """(n,) standard errors that are stated, or follow from how the response was measured."""
    found = errors(head.path, plan, arrays, stated_errors, frequency, drive)
    if plan.quantity in SCATTERED:
        return of_scattering(_recorded(head, arrays)[0], plan, frequency, drive)
    return of_derivative(plan, arrays, frequency, drive) if found is None else found


def _recorded(head: Head, arrays: dict[str, tuple[np.ndarray, str]]) -> tuple[np.ndarray, str]:
    """What two columns, or a magnitude alone, show, and its unit."""
    first, second = (
        ("wd", "wq") if "wd" in arrays else ("x", "y") if "x" in arrays else ("magnitude", "phase")
    )
    signal, unit = arrays[first]
    if first == "magnitude":
        return (signal * np.exp(1j * arrays["phase"][0]) if "phase" in arrays else signal), unit
    imaginary, other = arrays[second]
    if not units.same_kind(other, unit):
        raise LogError(
            f"{head.path}: found {first} in {unit} and {second} in {other}, expected units of one kind"
        )
    return _complex(signal, units.convert(imaginary, other, unit)), unit


def _complex(real: np.ndarray, imaginary: np.ndarray) -> np.ndarray:
    result = np.empty(len(real), np.complex128)  # real + 1j * imaginary would lose the sign of a zero
    result.real, result.imag = real, imaginary
    return result


def _word(head: Head, metadata: Mapping[str, str], key: str, words: tuple[str, ...]) -> str | None:
    word = stated(metadata, key)
    if word is None or word.casefold() in words:
        return word and word.casefold()
    raise LogError(f"{head.path}, metadata {key!r}: found {word!r}, expected {either(word, words)}")
