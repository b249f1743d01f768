"""A mapping file that leaves columns to be found by their heads, as a preset does, completed for one file;
and one that a file's heads amount to by themselves."""

import os
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sysid.columns.draft import template
from sysid.columns.labels import SCATTERING
from sysid.columns.mapfile import RESPONSES, checked
from sysid.columns.mapping import MappingFile
from sysid.columns.preset import PREFIX, Preset, named
from sysid.columns.roles import rivals
from sysid.columns.survey import Columns
from sysid.tables import layout, units
from sysid.tables.cells import Dialect, listed
from sysid.tables.csvfile import Head, LogError, read_head
from sysid.tables.scattered import RATIOS
from sysid.tables.workbook import file_of

SMALL = 1 << 22  # bytes of a file in which traces one below the other are looked for: instruments write less
REFLECTED = ("s11", "s22", "return", "vswr", "swr")  # unlike S21, which may be what a sensor makes of a drive
RESPONSE = {part for parts in RESPONSES for part in parts} | {"response"}


BY_HEADS = "the file"  # which says what a mapping file is read from
# of what a draft asks for, what a mapping file need not say: it is taken as usual then, and that is told
USUAL = ("amplitude", "quantity", "phase_sign")
TAKEN = {
    "amplitude": (
        "nothing says whether the amplitudes of drive and response are peak, rms or peak to peak: both are"
        " taken as peak, by which G goes; say amplitude in a mapping file (--columns)"
    ),
    "amplitude of the response": (
        "nothing says whether the amplitude of the response is peak, rms or peak to peak, as the drive's head"
        " does: it is taken as peak, by which G goes; say amplitude of it in a mapping file (--columns)"
    ),
    "quantity": (
        "nothing says what the signal shows: taken as a displacement; of a velocity, an acceleration or a"
        " current G has another unit; say quantity in a mapping file (--columns)"
    ),
}


Found = tuple[
    Head, MappingFile, tuple[str, ...], tuple[str, ...]
]  # what is to be said of it, and what is taken as usual


class Undecided(LogError):
    """Columns of which each may be the response."""


def as_drafted(head: Head, mapping: MappingFile | None, draft: str) -> Found:
    """The mapping file that the heads of a file's columns amount to, beside one that names none; with the
    head that it is for. Raises LogError where the draft leaves more open than what is taken as usual."""
    found = tomllib.loads(draft)
    usual = tuple(key for key in USUAL if found.get(key) == "?" and not (mapping and key in mapping.options))
    columns = Columns(head)
    usual = tuple(key for key in usual if key != "quantity" or not _of_waves(head))
    options = {key: value for key, value in found.items() if key not in usual}
    options |= mapping.options if mapping else {}
    rival = [head.names[k] for k in rivals(columns)]
    inputs = options["columns"].keys() | options.get("constants", {}).keys()
    open_ = not inputs & {"time", "frequency", *units.DRIVES} or not head.dialect.header
    if rival and not open_:
        read = options["columns"].items()
        one = next(entry["column"] for name, entry in read if name in RESPONSE - {"phase"})
        names = " or ".join([one, *rival])
        said = f"found {names} as what may be the response, expected a mapping file that says which"
        raise Undecided(f"{head.path}: {said}", draft)
    open_ = open_ or bool(rival) or any(value == "?" for _, value in _said(options))
    if open_ or found.get("kind") == "waveform":
        raise LogError(f"{head.path}: its heads do not tell all that is needed", draft)
    drafted = checked(BY_HEADS, options)
    read = {name: entry["column"] for name, entry in drafted.options["columns"].items()}
    named = ", ".join(f"{column!r} as {name}" for name, column in read.items())
    others = [name for k, name in enumerate(head.names) if name and not {k, name} & {*read.values()}]
    left = f"; not {listed(others)}" if others else ""
    told = f"read by the heads of its columns: {named}{left}; a mapping file (--columns) says otherwise"
    return joined(head, drafted.dialect), drafted, (told,), usual


def completed(head: Head, mapping: MappingFile) -> Found:
    """The head of the file, its traces side by side, and the mapping file with all its columns. Raises
    LogError with a mapping file to go on from where something is still open: of what an instrument writes,
    more than what is taken as usual."""
    head = joined(head, mapping.dialect)
    draft = template(head, {**mapping.base, **mapping.options})
    found = tomllib.loads(draft)
    options = _merged(mapping, found)
    responses = RESPONSE if "quantity" not in options else {"x", "magnitude", "response"}
    if not options["columns"].keys() & responses:
        names = listed([name for name in head.names if name]) or "columns without names"
        said = f"found no response ({names}), expected the columns that {mapping.path} is for"
        raise LogError(f"{head.path}: {said}", draft)
    left = tuple(key for key, value in _said(options) if value == "?")
    usual = {*USUAL} - ({"quantity"} if _of_waves(head, REFLECTED) else set())
    rows = "preset" in mapping.options and options.get("kind") != "waveform"
    if left and not (rows and {*left} <= usual):
        raise LogError(f"{head.path}: {_open(mapping, left)}", draft)
    options = {key: value for key, value in options.items() if key not in left}
    for name, entry in options["columns"].items():
        if "column" not in entry:
            raise mapping.fail(
                f"[columns] {name}", f"found no column of {head.path} that it may be, expected its name"
            )
    whole = replace(checked(mapping.path, options), base=mapping.base)
    return head, whole, _told(mapping, found, options), left


def _of_waves(head: Head, names: Collection[str] = SCATTERING) -> bool:
    """Whether columns are called S11 or alike, which are no response as they stand."""
    return any({*label.words}.intersection(names) for label in Columns(head).labels)


def joined(head: Head, dialect: Dialect) -> Head:
    """The head of a file whose traces stand one below the other for all of them side by side; any other as it
    is."""
    if head.sheet is None and dialect.join is None and os.path.getsize(file_of(head.path)) <= SMALL:
        try:
            found = layout.tables(head.path, replace(head.dialect, delimiter=None))
            if layout.can_be_joined(found):
                join = found[0].names[0] or 0
                return read_head(head.path, Dialect(comment=head.dialect.comment, join=join))
        except LogError:
            return head
    return head


def with_preset(mapping: MappingFile | None, of: Preset) -> MappingFile:
    """The facts of a preset, beside what a mapping file says that names no columns; what the preset assumes
    is left open."""
    facts = {key: value for key, value in of.options.items() if key not in of.assumed}
    mapping = mapping or MappingFile(f"{PREFIX}{of.name}", {})
    return replace(mapping, options={**mapping.options, "preset": of.name}, base=facts, finds=True)


def _merged(mapping: MappingFile, found: Mapping[str, Any]) -> dict[str, Any]:
    """What the mapping file says, what its file's heads tell where it says nothing, and last what its preset
    says."""
    given, base = mapping.options, mapping.base
    columns = _columns(given.get("columns", {}), _columns(base.get("columns", {}), found.get("columns", {})))
    driven = {*units.DRIVES} & ({*columns} | {*given.get("constants", {})} | {*found.get("constants", {})})
    usual = {
        name: text
        for name, text in base.get("constants", {}).items()
        if name not in units.DRIVES or not driven
    }
    if {*units.DRIVES} & {*given.get("constants", {})}:  # in the place of a column that seems to be the drive
        named = given.get("columns", {})
        columns = {
            name: entry for name, entry in columns.items() if name not in units.DRIVES or name in named
        }
    ratio = {**base, **found, **given}.get("quantity") in RATIOS
    constants = {} if ratio else usual
    constants |= {name: text for name, text in found.get("constants", {}).items() if name not in columns}
    constants |= given.get("constants", {})
    metadata = base.get("metadata", {}) | found.get("metadata", {}) | given.get("metadata", {})
    options = {**base, **{key: value for key, value in found.items() if value != "?" or key not in base}}
    options |= {key: value for key, value in given.items() if value is not None}
    options |= {"columns": columns, "constants": constants, "metadata": metadata}
    return {key: value for key, value in options.items() if key not in ("find", "preset", "units")}


def _columns(given: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Columns that are given, whole or in part, and those that are found beside them: no second response, and
    no second drive."""
    given = {name: entry if isinstance(entry, dict) else {"column": entry} for name, entry in given.items()}
    named = {name for name, entry in given.items() if "column" in entry}
    taken = (RESPONSE if named & RESPONSE else set()) | (
        {*units.DRIVES} if named & {*units.DRIVES} else set()
    )
    places = {entry["column"] for entry in given.values() if "column" in entry}
    beside = {n: e for n, e in found.items() if n not in taken and (n in given or e["column"] not in places)}
    return {
        name: {**({} if "column" in given.get(name, {}) else beside.get(name, {})), **given.get(name, {})}
        for name in {**given, **beside}
    }


def _said(options: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Each thing that is said, by a name that a reader knows."""
    for key, value in options.items():
        if key == "columns":
            yield from (
                (f"the {of} of {name}", x) for name, entry in value.items() for of, x in entry.items()
            )
        elif key == "constants":
            yield from (
                (f"the unit of {name}", "?") for name, text in value.items() if str(text).endswith(" ?")
            )
        elif key != "metadata":
            yield key, value


def _open(mapping: MappingFile, left: Sequence[str]) -> str:
    """What to say where something is left open: that the preset itself assumes it, if it does."""
    said = f"nothing in it tells {listed(left)}, expected in a mapping file"
    name = mapping.options.get("preset")
    usual = {key: named(name).options.get(key) for key in left} if name else {}
    if not name or None in usual.values():
        return f"read as {mapping.path} says, {said}"
    assumed = " and ".join(f'{key} = "{value}"' for key, value in usual.items())
    return f"{said} (preset = {name!r}, and that); --columns {PREFIX}{name} assumes {assumed}"


def _told(mapping: MappingFile, found: Mapping[str, Any], options: Mapping[str, Any]) -> tuple[str, ...]:
    """What is to be said of a preset: its name, and what of it is assumed and was neither told nor found."""
    name = mapping.options.get("preset")
    if name is None:
        return ()
    of = named(name)
    notes = [f"read as {PREFIX}{of.name} says: {of.title}"]
    open_ = [key for key in of.assumed if key in ("quantity", "columns") and key not in mapping.options]
    if "quantity" in open_ and options.get("quantity") == of.options.get("quantity") == found.get("quantity"):
        notes.append(
            f"the signal is taken as a {options['quantity']}, as {PREFIX}{of.name} assumes; say quantity"
            f" otherwise"
        )
    if "columns" in open_:
        pair = [f"{name} {options['columns'][name]['column']!r}" for name in ("drive", "response")]
        notes.append(
            f"taken, as {PREFIX}{of.name} assumes: {' and '.join(pair)}; say otherwise under [columns]"
        )
    return tuple(notes)
