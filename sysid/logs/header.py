"""What a log's own header and metadata say, by the contract's names: from a file's head to the plan for
reading it.

A name that is nearly one of ours, where that one is missing, is refused with the name that was probably
meant; a file that is not understood is refused with a mapping file to start from.
"""

import contextlib
import dataclasses
import math
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise

from sysid.logs import units
from sysid.logs.cells import SHOWN, Dialect, amount, listed, to_number
from sysid.logs.csvfile import Head, LogError, read_head
from sysid.logs.draft import template
from sysid.logs.found import completed, joined, with_preset
from sysid.logs.mapping import MappingFile, Plan, Source, is_absent, is_decibel
from sysid.logs.preset import recognised
from sysid.logs.stamps import EXAMPLE, is_local, is_long
from sysid.logs.stated import ERRORS

INPUTS = ("time", "frequency", "temperature", "force")
# Other usual names of inputs, read as ours where ours is missing and the unit is of its kind; a note says so.
STAMPED = {
    "date": "time",
    "datetime": "time",
    "date/time": "time",
    "zeitstempel": "time",
}  # where the cells are dates
SYNONYMS = {
    "timestamp": "time", "freq": "frequency", "omega": "frequency", "\u03c9": "frequency",
    "temp": "temperature",
    "volt": "voltage", "volts": "voltage",
}  # fmt: skip
ANGULAR = ("omega", "\u03c9")  # of radians alone: one of hertz leaves open whether 2 pi is in it
STANDARD = re.compile(r"(?:(?P<of>w|wd|wq)[_ ])?(?:std|sigma|stderr)(?P<unit>[_ \[(/].*)", re.IGNORECASE)
SAMPLES = (
    "sample",
    "samples",
    "sample_no",
    "sample_number",
    "sample_index",
)  # what counts the rows of an even sampling
LETTERS = {"t": "time", "f": "frequency", "u": "voltage", "v": "voltage"}  # of columns alone


def planned(head: Head, mapping: MappingFile | None) -> tuple[Head, MappingFile | None, Plan]:
    """The plan for a file by the mapping file, or by its own names, or as the preset says that recognises it;
    with the head that it is for, and the mapping file with the columns that were found by their heads. Raises
    LogError."""
    if not (mapping and mapping.finds):
        try:
            return head, mapping, file_plan(head, mapping)
        except LogError as error:
            preset = recognised((*head.above, str(head.dialect.delimiter).join(head.names)))
            if error.mapping is None or preset is None or (mapping and mapping.names_columns):
                raise
            mapping = with_preset(mapping, preset)
    head, mapping, notes = completed(head, mapping)
    plan = file_plan(head, mapping)
    return head, mapping, dataclasses.replace(plan, notes=(*plan.notes, *notes))


def file_plan(head: Head, mapping: MappingFile | None) -> Plan:
    """The plan for a file, by the mapping file where that names columns, else by the file's own names."""
    if mapping and mapping.names_columns:
        plan = mapping.plan(head)
    elif mapping:
        plan = mapping.beside(contract_plan(dataclasses.replace(head, metadata=mapping.metadata(head))), head)
    else:
        plan = contract_plan(head)
    refuse_repeated(head, plan.metadata, ("kind", "sampling", "plate"))
    if plan.quantity != "impedance":
        _refuse_ohms(head, plan, mapping)
    return plan


def _refuse_ohms(head: Head, plan: Plan, mapping: MappingFile | None) -> None:
    """Raise LogError where a response is an impedance and nothing says so: its peak is the antiresonance."""
    for name in ("wd", "wq", "w", "x", "y", "magnitude", "response"):
        source = plan.sources.get(name)
        if source and not is_decibel(source.unit) and units.is_of(source.unit, "ohm"):
            found = (
                f"{head.path}, column {source.label!r}: found {source.unit}, of an impedance, expected"
                ' quantity = "impedance"'
            )
            where = mapping.path if mapping and mapping.names_columns else "a mapping file (--columns)"
            said = f"{found} in {where}, which inverts it: the response of the plate is the current, 1/Z"
            raise LogError(said, None if mapping and mapping.names_columns else drafted(head))


def table_plan(head: Head, metadata: dict[str, str] | None, plan: Plan, mapping: MappingFile | None) -> Plan:
    """The plan for a table of the file, which may state metadata of its own; `plan` is that of the first."""
    return (
        plan
        if metadata in (None, head.metadata)
        else file_plan(dataclasses.replace(head, metadata=metadata), mapping)
    )


def counted(head: Head, columns: Collection[int]) -> list[str]:
    """Notes on the columns of dates and the like, which are read as what passed since the first row."""
    return [
        f"column {head.names[column] or column} is counted from its first row, {head.first(column)}"
        for column in columns
    ]


def contract_plan(head: Head) -> Plan:
    """The plan for a file whose names follow the contract. Raises LogError with a mapping file to start
    from."""
    sources: dict[str, Source] = {}
    notes = list(head.notes)
    unknown = []
    waveform = _is_waveform(head)
    for index, label in enumerate(head.names):
        of_errors = _of_errors(label)
        ours = not of_errors if waveform else _first_word(label) != "response"
        ours = ours and _add_source(head, sources, of_errors or label, Source(label, "", column=index))
        if not ours and label.casefold() != "log":
            unknown.append(label)
    for key, value in head.metadata.items():
        name = None if f"{key.casefold()}_degc" in units.BENCH_NUMBERS else units.parse_name(key)
        remark = (
            name is not None and amount(value) is None and not units.is_known(name.unit)
        )  # as LabVIEW's Time_Pref: Relative
        if name and name.unit and name.quantity != "response" and not remark:
            number = metadata_number(head, key, value)
            _add_source(head, sources, key, Source(f"metadata {key!r}", "", constant=number, written=value))
    notes += _add_synonyms(head, sources, unknown)
    notes += _without_unit(head, sources)
    counter = None if waveform or "time" in sources else _counter(head, unknown)
    rate = sample_rate(head, head.metadata) if counter else None
    if counter and rate:
        sources["time"] = Source(counter, "s", column=head.names.index(counter), scale=1 / rate)
        unknown.remove(counter)
        notes.append(f"column {counter} is read as time, at a sample rate of {rate:.7g} Hz")
    if waveform:
        _check_waveform(head, sources, unknown)
    else:
        _check_understood(head, sources, unknown)
    notes += _kept_out(head, [label for label in unknown if label], "time" in sources)
    notes += [
        f"column {sources[name].label} is read as standard errors of the response"
        for name in ERRORS
        if name in sources
    ]
    split = [label.casefold() for label in head.names].count("log")
    if split > 1:
        raise LogError(f"{head.path}: found {split} columns 'log', expected one")
    return Plan(
        sources,
        head.metadata | ({"kind": "waveform"} if waveform else {}),
        split=[label.casefold() for label in head.names].index("log") if split else None,
        notes=tuple(notes),
        warnings=(_without_rate(head, counter),)
        if counter and not rate and _seems_timed(head, sources)
        else (),
    )


def _of_errors(label: str) -> str:
    """The name of a column of standard errors, `std_um`, `w_std_um`, `wd_std_um` or `wq_std_um`, with its
    unit in brackets; "" of any other."""
    if not (found := STANDARD.fullmatch(label.strip())):
        return ""
    _, unit, amplitude = units.split_unit(f"std{found['unit']}")
    return f"{'std_q' if (found['of'] or '').casefold() == 'wq' else 'std'} [{unit}] {amplitude}"


def _counter(head: Head, labels: Collection[str]) -> str | None:
    """The column that counts the samples, by its name and its first rows; None where there is none."""
    for label in labels:
        if label.strip().casefold() in SAMPLES:
            column = head.names.index(label)
            first = [
                to_number(row[column], str(head.dialect.decimal)) for row in head.sample if column < len(row)
            ]
            if all(after == before + 1 for before, after in pairwise(first)):
                return label
    return None


def _seems_timed(head: Head, sources: Mapping[str, Source]) -> bool:
    """Whether rows without a time look like those of a transient: at one frequency, and not said to be
    settled."""
    frequency = sources.get("frequency")
    if stated(head.metadata, "kind"):
        return False
    column = None if frequency is None else frequency.column
    return column is None or len({row[column] for row in head.sample if column < len(row)}) == 1


def _without_rate(head: Head, counter: str) -> str:
    """What to say of rows that are counted and have no time."""
    way = "state `# sample_rate_Hz: 10000`, say, above the header, or `# kind: steady` of settled points"
    return (
        f"{head.name}: found no time, and a column {counter!r} that counts the rows, taken as settled"
        f" points; {way}"
    )


def rate_key(metadata: Mapping[str, str]) -> str | None:
    """Under which key the metadata state a sample rate; its end is the unit."""
    return next((key for key in metadata if key.casefold().startswith("sample_rate")), None)


def sample_rate(head: Head, metadata: Mapping[str, str]) -> float | None:
    """The sample rate (Hz) that the metadata state; None where they do not."""
    if (key := rate_key(metadata)) is None:
        return None
    unit = key[len("sample_rate_") :]
    try:
        units.check_unit("frequency", unit)
    except ValueError as error:
        raise LogError(f"{head.path}, metadata {key!r}: {error}") from None
    rate = float(units.convert(metadata_number(head, key, metadata[key]), unit, "Hz"))
    if rate <= 0:
        raise LogError(f"{head.path}, metadata {key!r}: found {rate:.6g} Hz, expected a rate above zero")
    return rate


def _kept_out(head: Head, labels: list[str], timed: bool) -> list[str]:
    """A note on each column that is not read; one on all of them where there are many."""
    if len(labels) > SHOWN:
        return [f"{len(labels)} columns are kept out of the fit: {listed(labels)}"]
    return [
        f"column {label} is kept out of the fit{'' if timed else _why_no_time(head, label)}"
        for label in labels
    ]


def _why_no_time(head: Head, label: str) -> str:
    """Why a column that is called a time, in a file that has no other, is not read as one."""
    if units.split_unit(label)[0].casefold() not in {"timestamp", *STAMPED}:
        return ""
    if is_local(head.first(head.names.index(label))):
        return f": day and month cannot be told apart; write a time as {EXAMPLE}"
    return ": it states no unit of time; call it timestamp_s, timestamp_ms"


def _add_synonyms(head: Head, sources: dict[str, Source], unknown: list[str]) -> list[str]:
    """Enter inputs that have another usual name, columns before metadata; they leave `unknown`. Returns a
    note on each."""
    notes = []
    for label in list(unknown):
        if quantity := _meant(label, SYNONYMS | LETTERS, sources) or _dates_time(head, label, sources):
            name, column = units.split_unit(label)[0], head.names.index(label)
            source = Source(label, "", column=column, spare=head.dated(column))
            _add_source(head, sources, quantity + label.strip()[len(name) :], source)
            unknown.remove(label)
            notes.append(f"column {label} is read as {quantity}")
    for key, value in head.metadata.items():
        if quantity := _meant(key, SYNONYMS, sources):
            source = Source(
                f"metadata {key!r}", "", constant=metadata_number(head, key, value), written=value
            )
            _add_source(head, sources, quantity + key.strip()[len(units.split_unit(key)[0]) :], source)
            notes.append(f"metadata {key!r} is read as {quantity}")
    return notes


def _without_unit(head: Head, sources: Mapping[str, Source]) -> list[str]:
    """A note on metadata of ours without a unit; of a number that nothing else states there is a warning
    instead."""
    names = {key: name for key in head.metadata if (name := units.parse_name(key)) and not name.unit}
    lost = {
        key
        for key, name in names.items()
        if name.quantity in units.CONSTANTS and is_absent(name.quantity, sources)
    }
    kept_out = [key for key in names if key not in lost or amount(head.metadata[key]) is None]
    return [
        f"metadata {key!r} has no unit and is kept out; write it as in temperature_degC" for key in kept_out
    ]


def _meant(label: str, words: Mapping[str, str], sources: Mapping[str, Source]) -> str | None:
    """The input that a label names by another word, when that input is missing and the unit is of its kind;
    else None."""
    name, unit, _ = units.split_unit(label)
    quantity = words.get(name.casefold().rstrip("."))  # Freq. (Hz)
    if (
        quantity is None
        or not is_absent(quantity, sources)
        or (name.casefold() in ANGULAR and "rad" not in unit)
    ):
        return None
    said = units.parse_name(quantity + label.strip()[len(name) :])
    return quantity if said and units.fits(quantity, said.unit) else None


def _dates_time(head: Head, label: str, sources: Mapping[str, Source]) -> str | None:
    """`time` for a column of dates that is called so by another name, where no other holds the time; else
    None."""
    if "time" in sources or not {units.split_unit(label)[0].casefold(), label.casefold()} & {
        "timestamp",
        *STAMPED,
    }:
        return None
    return "time" if head.dated(head.names.index(label)) else None


def _add_source(head: Head, sources: dict[str, Source], label: str, source: Source) -> bool:
    """Enter what `label` names into `sources`; False when it is not one of our names."""
    name = units.parse_name(label)
    if name is None:
        return False
    dated = name.quantity == "time" and source.column is not None and head.dated(source.column)
    unit = "s" if dated else name.unit
    try:
        units.check_unit(name.quantity, unit)
    except ValueError as error:
        first = head.first(source.column) if source.column is not None else ""
        if name.quantity == "time" and is_local(first):
            expected = (
                f"the year first, as in {EXAMPLE}, or the seconds since the first row in a column time_s"
            )
            raise LogError(
                f"{head.path}, column {label!r}: found a date {first!r}, expected {expected}"
            ) from None
        if source.column is None:
            raise LogError(f"{head.path}, {source.label}: {error}") from None
        raise LogError(f"{head.path}, column {label!r}: {error}", drafted(head)) from None
    if name.quantity == "time" and source.column is not None and _is_waveform(head):
        dated = dated or is_long(head.first(source.column))
    same = units.DRIVES if name.quantity in units.DRIVES else (name.quantity,)
    if double := next((sources[quantity] for quantity in same if quantity in sources), None):
        what = "the drive" if name.quantity in units.DRIVES else name.quantity
        raise LogError(f"{head.path}: found {what} twice, as {double.label} and {label}, expected it once")
    sources[name.quantity] = dataclasses.replace(source, unit=unit, amplitude=name.amplitude, dated=dated)
    return True


def _is_waveform(head: Head) -> bool:
    """Whether a file holds the raw samples of a carrier: as it states, or by its columns drive and
    response."""
    kind = stated(head.metadata, "kind")
    if kind:
        return kind.casefold() == "waveform"
    words = {_first_word(label) for label in head.names}
    return {"drive", "response"} <= words and not words & {"w", "wd", "wq"}


def _first_word(label: str) -> str:
    return units.split_unit(label)[0].casefold().split("_")[0]


def _check_waveform(head: Head, sources: dict[str, Source], unknown: list[str]) -> None:
    """A waveform that is not whole, or demodulated already: LogError."""
    _refuse_misspelt(head, sources, unknown, [units.DRIVES, ("response",), *((name,) for name in INPUTS)])
    if rows := sources.keys() & {"w", "wd", "wq"}:
        found = " and ".join(sorted(rows))
        raise LogError(
            f"{head.path}: found {found} in a waveform, expected raw samples alone, such as drive_V and"
            f" response_um"
        )
    columns = {name for name, source in sources.items() if source.column is not None}
    missing = [
        name
        for name, names in (("drive_V", units.DRIVES[:2]), ("response_um", ("response",)))
        if not columns & {*names}
    ]
    if missing:
        raise not_understood(
            head, f"a waveform without a column {missing[0]}", "time_s, drive_V and response_um"
        )


def _check_understood(head: Head, sources: dict[str, Source], unknown: list[str]) -> None:
    """A misspelt name or a response that is not whole: LogError with a mapping file."""
    _refuse_misspelt(
        head, sources, unknown, [units.DRIVES, ("w", "wd"), ("w", "wq"), *((name,) for name in INPUTS)]
    )
    response = sources.keys() & {"w", "wd", "wq"}
    if response in ({"w"}, {"wd", "wq"}):
        if all(sources[name].column is None for name in response):
            raise LogError(
                f"{head.path}: found the response in the metadata alone, expected a column, such as wd_um"
            )
        if not sources.keys() & {"time", "frequency", *units.DRIVES}:
            raise not_understood(head, "neither time, frequency nor drive", "time_s or frequency_Hz at least")
        return
    found = " and ".join(sorted(response)) or "no response"
    raise not_understood(head, found, "columns such as wd_um and wq_um, or w_um alone")


def _refuse_misspelt(
    head: Head, sources: dict[str, Source], unknown: list[str], groups: list[tuple[str, ...]]
) -> None:
    """A name that is nearly one of ours, of a group none of which is there: LogError."""
    absent = [name for group in groups if not sources.keys() & set(group) for name in group]
    for label in unknown:
        name, unit, _ = units.split_unit(label)
        near = (
            [quantity for quantity in absent if _is_misspelt(name, quantity, unit)]
            if unit and len(name) > 2
            else []
        )
        if near:
            raise LogError(
                f"{head.path}: found column {label!r}, did you mean {near[0]}_{unit}?", drafted(head)
            )


def not_understood(head: Head, found: str, expected: str) -> LogError:
    """What to say of a file whose columns are not known: what was found, what was expected, and a mapping
    file to begin with."""
    path = head.path
    if head.dialect.header and (wide := min(map(_width, head.sample))) > len(head.names) + 1:
        across = "; a table that lies across, one quantity a line, is to be turned: one a column"
        said = f"found {wide} columns, expected {len(head.names)} as in the header{across}"
        return LogError(f"{path}, line {head.first_line}: {said}")
    names = listed(list(filter(None, head.names))) or f"{len(head.names)} columns without a header"
    first = (head.names[0] or head.sample[0][0])[:1]
    if first in (";", "/", "*"):  # it looks like another comment mark
        with contextlib.suppress(LogError):
            head = read_head(head.path, Dialect(comment=(first,)))
    return LogError(f"{path}: found {found} ({names}), expected {expected}", drafted(head))


def drafted(head: Head) -> str:
    """A mapping file to begin with; of a file whose traces stand one below the other for all of them side by
    side."""
    return template(joined(head, Dialect()))


def _width(row: Sequence[str]) -> int:
    """Cells of a row up to the last that holds something."""
    return max((k for k, cell in enumerate(row, 1) if cell.strip()), default=0)


def _is_misspelt(name: str, quantity: str, unit: str) -> bool:
    # The quicker of the two first, of a table with thousands of columns.
    return units.fits(quantity, unit) and units.nearest(name, [quantity], cutoff=0.75) is not None


def stated(metadata: Mapping[str, str], key: str) -> str | None:
    """What the metadata state under `key`, in upper or lower case; None where they are silent or empty."""
    return next((value for name, value in metadata.items() if name.casefold() == key and value), None)


def refuse_repeated(head: Head, metadata: Mapping[str, str], words: Collection[str]) -> None:
    """Raise LogError when the file states one of `words` twice with different values, and `metadata` has it
    from the file."""
    for key in sorted(head.repeated):
        if key.casefold() in words and metadata.get(key) == head.metadata[key]:
            raise LogError(
                f"{head.path}, metadata {key!r}: found it twice with different values, expected it once"
            )


def metadata_number(head: Head, key: str, text: str) -> float:
    """A number of the metadata. Raises LogError where it is none, or where the file states two."""
    refuse_repeated(head, {key: head.metadata.get(key, "")}, (key.casefold(),))
    if not math.isfinite(number := to_number(text, str(head.dialect.decimal))):
        raise LogError(f"{head.path}, metadata {key!r}: found {text!r}, expected a finite number")
    return number
