"""What a log's own header and metadata say, by the contract's names: from a file's head to the plan for
reading it.

A name that is nearly one of ours, where that one is missing, is refused with the name that was probably
meant; a file that is not understood is refused with a mapping file to start from.
"""

import dataclasses
import re
from collections.abc import Collection, Iterable, Mapping

from sysid.columns.factors import not_applied
from sysid.columns.found import TAKEN, Undecided, as_drafted, completed, with_preset
from sysid.columns.labels import parse
from sysid.columns.mapping import MappingFile
from sysid.columns.metadata import labelled, rate_key, refuse_repeated, stated, stated_constant
from sysid.columns.plan import ERRORS, Plan, Source, is_absent
from sysid.columns.preset import recognised
from sysid.columns.synonyms import (
    add_source,
    add_synonyms,
    first_word,
    is_waveform,
    refuse_misspelt,
)
from sysid.columns.timebase import (
    add_time,
    called,
    counter_of,
    evenly,
    numbered,
    passing_of,
    rate_of,
    seems_timed,
    untimed,
    why_no_time,
)
from sysid.columns.unknown import Unnamed, drafted, not_understood
from sysid.tables import units
from sysid.tables.cells import SHOWN, amount, listed
from sysid.tables.csvfile import Head, LogError
from sysid.tables.densities import amplitude_of, is_decibel, level_of_volts

SIGNS = {"1": 1, "+1": 1, "-1": -1}  # of a phase, as metadata state it
INPUTS = ("time", "frequency", "temperature", "force")
WHOLE = ("wd", "wq", "w", "response")
VOLTS = re.compile(r"[numk]?V")
STANDARD = re.compile(r"(?:(?P<of>w|wd|wq)[_ ])?(?:std|sigma|stderr)(?P<unit>[_ \[(/].*)", re.IGNORECASE)

Planned = tuple[Head, MappingFile | None, Plan]


def planned(head: Head, mapping: MappingFile | None) -> Planned:
    """The plan for a file by the mapping file, or by its own names, or as the preset says that recognises it;
    with the head that it is for, and the mapping file with the columns that were found by their heads. Raises
    LogError."""
    if not (mapping and mapping.finds):
        try:
            return head, mapping, file_plan(head, mapping)
        except LogError as error:
            preset = recognised((*head.above, str(head.dialect.delimiter).join(head.names)))
            if error.mapping is None or (mapping and mapping.names_columns):
                raise
            if preset is None:
                return _by_heads(mapping, error)
            mapping = with_preset(mapping, preset)
    return _found(*completed(head, mapping))


def _by_heads(mapping: MappingFile | None, error: LogError) -> Planned:
    """The plan for a file without a response, or an input beside it, by the contract's names, where a mapping
    file that is drafted from its heads leaves nothing open but what is taken as usual. Raises the error."""
    if not isinstance(error, Unnamed):
        raise error
    try:
        return _found(*as_drafted(error.head, mapping, str(error.mapping)))
    except Undecided:
        raise
    except LogError:
        raise error from None


def _found(head: Head, mapping: MappingFile, notes: Iterable[str], usual: tuple[str, ...]) -> Planned:
    """The plan for columns that were found by their heads, with what is said of them, and of what is taken as
    `usual`."""
    plan = file_plan(head, mapping)
    drive = next((plan.sources[name] for name in units.DRIVES if name in plan.sources), None)
    known = drive is not None and (parse(drive.label).amplitude or level_of_volts(drive.unit))
    names = {"amplitude": "amplitude of the response" if known else "amplitude" if drive else ""}
    told = [TAKEN[name] for key in usual if (name := names.get(key, key)) in TAKEN]
    return (
        head,
        mapping,
        dataclasses.replace(plan, notes=(*plan.notes, *notes), warnings=(*plan.warnings, *told), taken=usual),
    )


def file_plan(head: Head, mapping: MappingFile | None) -> Plan:
    """The plan for a file, by the mapping file where that names columns, else by the file's own names."""
    if mapping and mapping.names_columns:
        plan = _by_rate(head, mapping.plan(head))
    elif mapping:
        plan = mapping.beside(contract_plan(dataclasses.replace(head, metadata=mapping.metadata(head))), head)
    else:
        plan = contract_plan(head)
    refuse_repeated(head, plan.metadata, ("kind", "sampling", "plate", "phase_sign"))
    if (sign := stated(head.metadata, "phase_sign")) is not None:  # of this log, whatever that of others
        if sign not in SIGNS:
            raise LogError(f"{head.path}, metadata 'phase_sign': found {sign!r}, expected 1 or -1")
        if "response" in plan.sources:
            raise LogError(
                f"{head.path}, metadata 'phase_sign': found it of a waveform, whose phase is known"
            )
        plan = dataclasses.replace(plan, phase_sign=SIGNS[sign])
    if plan.quantity not in ("impedance", "velocity"):  # which the voltage of a coil in a magnet shows
        _refuse_ohms(head, plan, mapping)
    return dataclasses.replace(
        plan, notes=(*plan.notes, *_powers(head, plan), *not_applied(head, plan, mapping))
    )


def _by_rate(head: Head, plan: Plan) -> Plan:
    """The plan with a time of rows that have none, by a stated sample rate, and what is to be said of it."""
    if plan.sources.keys() & {"time", "response"}:
        return plan
    if not (rate := rate_of(dataclasses.replace(head, metadata=plan.metadata), plan.sources, None)):
        return plan
    told, key = evenly(head, rate), rate_key(head.metadata)
    notes, warnings = ((), (told,)) if key and key in plan.metadata else ((told,), ())
    return dataclasses.replace(
        plan,
        sources=plan.sources | {"time": numbered(rate)},
        notes=(*plan.notes, *notes),
        warnings=(*plan.warnings, *warnings),
    )


def _powers(head: Head, plan: Plan) -> list[str]:
    """A note on each column of a power density, whose root is read. Raises LogError where it is to be one of
    two parts, or has a phase: of a cross spectrum the root is no response."""
    powers = {name: source for name, source in plan.sources.items() if amplitude_of(source.unit)}
    parted = powers.keys() & {"wd", "wq", "x", "y", "phase", "response"}
    if powers and (parted or "phase" in plan.sources):
        source = powers[min(parted or powers)]
        found = f"{head.path}, column {source.label!r}: found {source.unit}, a power density"
        raise LogError(
            f"{found}, expected it alone, as w or magnitude: it is a square, without phase or parts"
        )
    return [
        f"column {source.label} is a power density, in {source.unit}: its root is read, in"
        f" {amplitude_of(source.unit)}"
        for source in powers.values()
    ]


def _refuse_ohms(head: Head, plan: Plan, mapping: MappingFile | None) -> None:
    """Raise LogError where a response is an impedance and nothing says so: its peak is the antiresonance; and
    where it is a resistance without a frequency, as a thermistor's."""
    for name in ("wd", "wq", "w", "x", "y", "magnitude", "response"):
        source = plan.sources.get(name)
        if source and not is_decibel(source.unit) and units.is_of(source.unit, "ohm"):
            place = f"{head.path}, column {source.label!r}: found {source.unit}"
            if "frequency" not in plan.sources:
                shows = "what it shows, such as a temperature: a thermistor's is no straight line of that"
                raise LogError(f"{place}, a resistance, and no frequency; expected {shows}")
            found = f'{place}, of an impedance, expected quantity = "impedance"'
            where = mapping.path if mapping and mapping.names_columns else "a mapping file (--columns)"
            said = (
                f"{found} in {where}, which inverts it: the response of the plate is the current, 1/Z;"
                ' or, of a coil in a magnet, "velocity", which its voltage shows'
            )
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
    notes, unknown = list(head.notes), list[str]()
    waveform = is_waveform(head)
    for index, label in enumerate(head.names):
        of_errors, says = _of_errors(label), head.says(index)
        ours = not of_errors if waveform else first_word(label) != "response"
        ours = ours and not ("." in label and label.rpartition(".")[2] in head.names)
        ours = ours and add_source(head, sources, of_errors or says, Source(label, "", column=index))
        notes += [f"column {label} is read as {says}, as settings say"] if ours and says != label else []
        if not ours and label.casefold() != "log":
            unknown.append(label)
    for key, value in head.metadata.items():
        label = labelled(key, value)
        name = None if f"{key.casefold()}_degc" in units.BENCH_NUMBERS else units.parse_name(label)
        remark = (
            name is not None and amount(value) is None and not units.is_known(name.unit)
        )  # as LabVIEW's Time_Pref: Relative
        if name and name.unit and name.quantity != "response" and not remark:
            add_source(head, sources, label, stated_constant(head, key, value, name))
    notes += add_synonyms(head, sources, unknown)
    notes += _without_unit(head, sources)
    counter = None if waveform or "time" in sources else counter_of(head, unknown)
    rate = None if waveform or "time" in sources else rate_of(head, sources, counter)
    said: tuple[str, ...] = ()
    if rate and counter is not None:
        sources["time"] = Source(counter, "s", column=head.names.index(counter), scale=1 / rate)
        unknown.remove(counter)
        notes.append(f"{called(counter)} is read as time, at a sample rate of {rate:.7g} Hz")
    elif rate:
        sources["time"] = numbered(rate)
        said = (evenly(head, rate),)
    if waveform:
        _check_waveform(head, sources, unknown)
    else:
        refuse_misspelt(
            head, sources, unknown, [units.DRIVES, ("w", "wd"), ("w", "wq"), *((name,) for name in INPUTS)]
        )
        notes += add_time(head, unknown, sources)
        notes += _told_twice(sources)
        _check_understood(head, sources)
    notes += _kept_out(head, [label for label in unknown if label], sources)
    notes += [
        f"column {sources[name].label} is read as standard errors of the response"
        for name in ERRORS
        if name in sources
    ]
    passing = None if waveform or counter is not None or "time" in sources else passing_of(head, unknown)
    split = [label.casefold() for label in head.names].count("log")
    if split > 1:
        raise LogError(f"{head.path}: found {split} columns 'log', expected one")
    return Plan(
        sources,
        head.metadata | ({"kind": "waveform"} if waveform else {}),
        split=[label.casefold() for label in head.names].index("log") if split else None,
        notes=tuple(notes),
        warnings=untimed(head, counter, passing) if not rate and seems_timed(head, sources) else said,
    )


def _of_errors(label: str) -> str:
    """The name of a column of standard errors, `std_um`, `w_std_um`, `wd_std_um` or `wq_std_um`, with its
    unit in brackets; "" of any other."""
    if not (found := STANDARD.fullmatch(label.strip())):
        return ""
    _, unit, amplitude = units.split_unit(f"std{found['unit']}")
    return f"{'std_q' if (found['of'] or '').casefold() == 'wq' else 'std'} [{unit}] {amplitude}"


def _kept_out(head: Head, labels: list[str], sources: Mapping[str, Source]) -> list[str]:
    """A note on each column that is not read; on all of them where there are many."""
    if len(labels) > SHOWN:
        return [f"{len(labels)} columns are kept out of the fit: {listed(labels)}"]
    each = []
    for label in labels:
        why = ("" if "time" in sources else why_no_time(head, label)) or _why_no_drive(label, sources)
        if "w" in sources and parse(label).part == "phase":
            magnitude = sources["w"].label
            why = (
                f": with {magnitude} it tells d and q, which a mapping file (--columns) of"
                f' magnitude = "{magnitude}" and phase = "{label}" reads'
            )
        each.append(f"column {label} is kept out of the fit{why}")
    return each


def _why_no_drive(label: str, sources: Mapping[str, Source]) -> str:
    """What to call a column of volts that may be the drive, where there is none and the response is in
    another unit."""
    unit = units.split_amplitude(units.split_unit(label)[1])[0]
    sensed = any(VOLTS.fullmatch(source.unit) for name, source in sources.items() if name in WHOLE)
    open_ = VOLTS.fullmatch(unit) and not sensed and is_absent("voltage", sources)
    stated = parse(label).amplitude
    if not open_:
        return ""
    if stated:
        return f"; if it is the drive, call it voltage_{unit}_{stated}"
    kinds = f"voltage_{unit}, voltage_{unit}_rms or voltage_{unit}_pp"
    return f"; if it is the drive, call it {kinds} (its peak, rms, or from peak to peak)"


def _without_unit(head: Head, sources: Mapping[str, Source]) -> list[str]:
    """A note on metadata of ours without a unit; of a number that nothing else states there is a warning
    instead."""
    names = {
        key: name
        for key, value in head.metadata.items()
        if (name := units.parse_name(labelled(key, value))) and not name.unit
    }
    lost = {
        key
        for key, name in names.items()
        if name.quantity in units.CONSTANTS and is_absent(name.quantity, sources)
    }
    kept_out = [key for key in names if key not in lost or amount(head.metadata[key]) is None]
    return [
        f"metadata {key!r} has no unit and is kept out; write it as in temperature_degC" for key in kept_out
    ]


def _told_twice(sources: dict[str, Source]) -> list[str]:
    """Leave out an amplitude beside its parts; a note on it."""
    twice = sources.keys() >= {"w", "wd", "wq"}
    return [f"{sources.pop('w').label} is kept out: wd and wq tell it"] if twice else []


def _check_waveform(head: Head, sources: dict[str, Source], unknown: list[str]) -> None:
    """A waveform that is not whole, or demodulated already: LogError."""
    refuse_misspelt(head, sources, unknown, [units.DRIVES, ("response",), *((name,) for name in INPUTS)])
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


def _check_understood(head: Head, sources: dict[str, Source]) -> None:
    """A response that is not whole: LogError with a mapping file."""
    response = sources.keys() & {"w", "wd", "wq"}
    if response in ({"w"}, {"wd", "wq"}):
        if all(sources[name].column is None for name in response):
            raise LogError(
                f"{head.path}: found the response in the metadata alone, expected a column, such as wd_um"
            )
        if not sources.keys() & {"time", "frequency", *units.DRIVES}:
            found = "neither time, frequency nor drive"
            raise not_understood(head, found, "time_s or frequency_Hz at least", unnamed=True)
        return
    found = " and ".join(sorted(response)) or "no response"
    expected = "columns such as wd_um and wq_um, or w_um alone"
    raise not_understood(head, found, expected, unnamed=not response)
