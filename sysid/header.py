"""What a log's own header and metadata say, by the contract's names: from a file's head to the plan for reading it.

A name that is nearly one of ours, where that one is missing, is refused with the name that was probably meant; a file
that is not understood is refused with a mapping file to start from.
"""

import contextlib
import dataclasses
import math
from collections.abc import Mapping

from sysid import units
from sysid.csvfile import Dialect, Head, LogError, is_number, read_head
from sysid.mapping import Plan, Source, template

DRIVES = ("voltage", "drive", "duty")
INPUTS = ("time", "frequency", "temperature", "force")


def contract_plan(head: Head) -> Plan:
    """The plan for a file whose names follow the contract. Raises LogError with a mapping file to start from."""
    sources: dict[str, Source] = {}
    notes = list(head.notes)
    unknown = []
    for index, label in enumerate(head.names):
        if not _add_source(head, sources, label, Source(label, "", column=index)) and label.casefold() != "log":
            unknown.append(label)
    for key, value in head.metadata.items():
        name = units.parse_name(key)
        if name and not name.unit:
            notes.append(f"metadata {key!r} has no unit and is kept out; write it as in temperature_degC")
        elif name:
            number = metadata_number(head, key, value)
            _add_source(head, sources, key, Source(f"metadata {key!r}", "", constant=number))
    _check_waveform(head)
    _check_understood(head, sources, unknown)
    notes += [f"column {label} is kept out of the fit" for label in unknown if label]
    split = [label.casefold() for label in head.names].count("log")
    if split > 1:
        raise LogError(f"{head.path}: found {split} columns 'log', expected one")
    return Plan(
        sources,
        head.metadata,
        split=[label.casefold() for label in head.names].index("log") if split else None,
        notes=tuple(notes),
    )


def _add_source(head: Head, sources: dict[str, Source], label: str, source: Source) -> bool:
    """Enter what `label` names into `sources`; False when it is not one of our names."""
    name = units.parse_name(label)
    if name is None:
        return False
    try:
        units.check_unit(name.quantity, name.unit)
    except ValueError as error:
        raise LogError(f"{head.path}, column {label!r}: {error}", template(head)) from None
    same = DRIVES if name.quantity in DRIVES else (name.quantity,)
    if double := next((sources[quantity] for quantity in same if quantity in sources), None):
        what = "the drive" if name.quantity in DRIVES else name.quantity
        raise LogError(f"{head.path}: found {what} twice, as {double.label} and {label}, expected it once")
    sources[name.quantity] = dataclasses.replace(source, unit=name.unit, amplitude=name.amplitude)
    return True


def _check_waveform(head: Head) -> None:
    first_words = {label.casefold().split("_")[0] for label in head.names}
    if stated(head.metadata, "kind") == "waveform" or {"drive", "response"} <= first_words:
        raise LogError(
            f"{head.path}: found a raw waveform, which is not supported yet; "
            "expected demodulated rows, such as time_s, voltage_V, frequency_Hz, wd_um, wq_um"
        )


def _check_understood(head: Head, sources: dict[str, Source], unknown: list[str]) -> None:
    """A misspelt name or a response that is not whole: LogError with a mapping file."""
    groups = [DRIVES, ("w", "wd"), ("w", "wq"), *((name,) for name in INPUTS)]
    absent = [name for group in groups if not sources.keys() & set(group) for name in group]
    for label in unknown:
        name, unit, _ = units.split_unit(label)
        near = [quantity for quantity in absent if len(name) > 2 and _is_misspelt(name, quantity, unit)]
        if near:
            raise LogError(f"{head.path}: found column {label!r}, did you mean {near[0]}_{unit}?", template(head))
    response = sources.keys() & {"w", "wd", "wq"}
    if response in ({"w"}, {"wd", "wq"}):
        if any(sources[name].column is None for name in response):
            raise LogError(f"{head.path}: found the response in the metadata, expected a column")
        if not sources.keys() & {"time", "frequency", *DRIVES}:
            raise not_understood(head, "neither time, frequency nor drive", "time_s or frequency_Hz at least")
        return
    found = " and ".join(sorted(response)) or "no response"
    raise not_understood(head, found, "columns such as wd_um and wq_um, or w_um alone")


def not_understood(head: Head, found: str, expected: str) -> LogError:
    path = head.path
    names = ", ".join(filter(None, head.names)) or f"{len(head.names)} columns without a header"
    first = (head.names[0] or head.sample[0][0])[:1]
    if first in ("%", "!", ";", "/", "*"):  # it looks like another comment mark
        with contextlib.suppress(LogError):
            head = read_head(head.path, Dialect(comment=first))
    return LogError(f"{path}: found {found} ({names}), expected {expected}", template(head))


def _is_misspelt(name: str, quantity: str, unit: str) -> bool:
    if units.nearest(name, [quantity], cutoff=0.75) is None:
        return False
    try:
        units.check_unit(quantity, unit)
    except ValueError:
        return False
    return True


def stated(metadata: Mapping[str, str], key: str) -> str | None:
    return next((value for name, value in metadata.items() if name.casefold() == key and value), None)


def metadata_number(head: Head, key: str, text: str) -> float:
    text = text.replace(str(head.dialect.decimal), ".")
    if key in head.repeated:
        raise LogError(f"{head.path}, metadata {key!r}: found it twice with different values, expected it once")
    if not is_number(text) or not math.isfinite(float(text)):
        raise LogError(f"{head.path}, metadata {key!r}: found {text!r}, expected a finite number")
    return float(text)
