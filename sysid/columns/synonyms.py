"""Columns of a header that have another usual name, or that are nearly one of ours."""

import dataclasses
import re
from collections.abc import Mapping

from sysid.columns.labels import ANGULAR, INPUTS, STAMPED, folded
from sysid.columns.metadata import labelled, stated, stated_constant
from sysid.columns.plan import Source, is_absent
from sysid.columns.unknown import Unnamed, drafted
from sysid.tables import units
from sysid.tables.cells import is_number
from sysid.tables.csvfile import Head, LogError
from sysid.tables.stamps import EXAMPLE, is_local, is_long

# Other usual names of inputs, read as ours where ours is missing and the unit is of its kind; a note says so.
SYNONYMS = {
    word: name
    for name in ("time", "frequency", "temperature", "force", "voltage")
    for word in INPUTS[name]
    if word not in units.DRIVES and (word[1:] or word == "\u03c9")
}
LETTERS = {"t": "time", "f": "frequency", "u": "voltage", "v": "voltage"}  # of columns alone


def add_synonyms(head: Head, sources: dict[str, Source], unknown: list[str]) -> list[str]:
    """Enter inputs that have another usual name, columns before metadata; they leave `unknown`. Returns a
    note on each."""
    notes = []
    # a time before a date beside it: the clock of whatever wrote the file, which may be a coarse one
    for label in sorted(unknown, key=lambda x: (folded(x) in STAMPED, head.dated(head.names.index(x)))):
        if quantity := _meant(label, SYNONYMS | LETTERS, sources) or _dates_time(head, label, sources):
            name, column = units.split_unit(label)[0], head.names.index(label)
            source = Source(label, "", column=column, spare=head.dated(column))
            add_source(head, sources, quantity + label.strip()[len(name) :], source)
            unknown.remove(label)
            notes.append(f"column {label or 'without a name'} is read as {quantity}")
    for key, value in head.metadata.items():
        if (quantity := _meant(key, SYNONYMS, sources)) in units.CONSTANTS:
            label = labelled(quantity + key.strip()[len(units.split_unit(key)[0]) :], value)
            add_source(head, sources, label, stated_constant(head, key, value, units.parse_name(label)))
            notes.append(f"metadata {key!r} is read as {quantity}")
    return notes


def _meant(label: str, words: Mapping[str, str], sources: Mapping[str, Source]) -> str | None:
    """The input that a label names by another word, when that input is missing and the unit is of its kind;
    else None."""
    name, unit, _ = units.split_unit(label)
    quantity = words.get(folded(name).rstrip("."))  # Freq. (Hz)
    if (
        quantity is None
        or not is_absent(quantity, sources)
        or (name.casefold() in ANGULAR and "rad" not in unit)
    ):
        return None
    said = units.parse_name(quantity + label.strip()[len(name) :])
    return quantity if said and units.fits(quantity, said.unit) else None


def _dates_time(head: Head, label: str, sources: Mapping[str, Source]) -> str | None:
    """`time` for a column of dates that is called so by another name, or by none (an index of pandas), where
    no other holds the time; else None."""
    called = is_called_time(label) or not label.strip()
    return "time" if "time" not in sources and called and head.dated(head.names.index(label)) else None


def is_called_time(label: str) -> bool:
    """Whether a column is called a time, or a date, or both."""
    known, name = {*INPUTS["time"], *STAMPED}, units.split_unit(label)[0]
    words = re.findall(r"\w+", folded(name))
    said = {*words} - {"and", "und", "et", "y", "e"}
    return bool({folded(label), folded(name)} & known) or (bool(said) and known.issuperset(said))


def add_source(head: Head, sources: dict[str, Source], label: str, source: Source) -> bool:
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
        if name.quantity == "time" and not name.unit and first and not is_number(first):
            found = f"a date {first!r}" if is_local(first) else repr(first)
            expected = (
                f"the year first, as in {EXAMPLE}, or the seconds since the first row in a column time_s"
            )
            raise LogError(f"{head.path}, column {label!r}: found {found}, expected {expected}") from None
        if source.column is None:
            raise LogError(f"{head.path}, {source.label}: {error}") from None
        raise LogError(f"{head.path}, column {label!r}: {error}", drafted(head)) from None
    if name.quantity == "time" and source.column is not None and is_waveform(head):
        dated = dated or is_long(head.first(source.column))
    same = units.DRIVES if name.quantity in units.DRIVES else (name.quantity,)
    if double := next((sources[quantity] for quantity in same if quantity in sources), None):
        what = "the drive" if name.quantity in units.DRIVES else name.quantity
        own = "; a mapping file (--columns) can name the column to read, by its place from 0 on"
        raise LogError(
            f"{head.path}: found {what} twice, as {double.label} and {label}, expected it once{own}"
        )
    sources[name.quantity] = dataclasses.replace(source, unit=unit, amplitude=name.amplitude, dated=dated)
    return True


def is_waveform(head: Head) -> bool:
    """Whether a file holds the raw samples of a carrier: as it states, or by its columns drive and
    response."""
    kind = stated(head.metadata, "kind")
    if kind:
        return kind.casefold() == "waveform"
    words = [first_word(label) for label in head.names]
    return "drive" in words and words.count("response") == 1 and not {*words} & {"w", "wd", "wq"}


def first_word(label: str) -> str:
    """Of a label, without unit and case."""
    return units.split_unit(label)[0].casefold().split("_")[0]


def refuse_misspelt(
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
            said = f"{head.path}: found column {label!r}, did you mean {near[0]}_{unit}?"
            # of no file of ours: one of its words may be all that is alike
            other = near[0] in folded(name).split() and not sources.keys() & {"w", "wd", "wq"}
            raise Unnamed(said, head) if other else LogError(said, drafted(head))


def _is_misspelt(name: str, quantity: str, unit: str) -> bool:
    # The quicker of the two first, of a table with thousands of columns.
    return units.fits(quantity, unit) and units.nearest(name, [quantity], cutoff=0.75) is not None
