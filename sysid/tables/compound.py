"""Cells that hold more than a number: complex ones, as Python, MATLAB and circuit simulators write them, and
numbers with their unit. A column of these becomes two, or one that states the unit."""

import dataclasses
import re
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from sysid.tables import units
from sysid.tables.cells import RECTANGULAR, amount, is_number, split_line, to_number
from sysid.tables.csvfile import SAMPLE, Head
from sysid.tables.layout import texts
from sysid.tables.sheet import Sheet
from sysid.tables.textfile import LogError

_NUMBER = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
PAIR = re.compile(rf"\(?\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\)?")  # 0.1,0.2 of a cell, where tabs part the cells
DECIBELS = re.compile(rf"\(?\s*{_NUMBER}\s*dB\s*,\s*{_NUMBER}\s*(?:°|\ufffd|deg)\s*\)?")  # (-3.1dB,-12°)
NAMED = re.compile(rf"([^\W\d][^:=]*)[:=]\s*{_NUMBER}\s*([^\d\s:=][^:=]*)?")  # time_ms:0.5, x = 0.5 um
PREFIXES = {"p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "k": 3, "K": 3, "M": 6, "G": 9}
Parted = list[tuple[str, list[str]]]  # names and cells of the columns that one becomes


def simple(head: Head) -> Head:
    """The head of a table of numbers, where cells of its first rows hold more than that; as it is, where none
    do. Raises LogError where a row further down has other cells."""
    if (names := _named(head)) and head.sheet is None:
        return _without_names(head, names)
    if head.sheet is not None or not any(map(_is_compound, zip_longest(*head.sample, fillvalue=""))):
        return head
    rows, lines, steps = rows_of(head)
    columns: Parted = [("log", steps)] if any(steps) else []
    notes = []
    for index, name in enumerate(head.names):
        name = name or ("" if any(head.names) else f"column {index}")
        parted = _parted(name, [row[index] for row in rows], str(head.dialect.decimal))
        if len(parted) > 1 or parted[0][0] != name:
            said = " and ".join(repr(of) for of, _ in parted)
            notes.append(f"column {name or index} is read as {said}, as its cells ({rows[0][index]}) say")
        columns += parted
    sheet = Sheet(
        tuple(np.array(cells, object) for _, cells in columns),
        lambda row, _: f"{head.path}, line {lines[row]}",
    )
    names = tuple(name for name, _ in columns)
    return dataclasses.replace(
        head, names=names, sheet=sheet, sample=sheet.first(SAMPLE), notes=(*head.notes, *notes), header=()
    )


def _named(head: Head) -> tuple[str, ...]:
    """The names that stand in each cell before its number, as a microcontroller prints them for a plotter;
    empty where most of the first rows do not have those of the first."""
    rows = [[NAMED.fullmatch(cell.strip()) for cell in row] for row in (head.names, *head.sample)]
    names = tuple(map(_called, rows[0]))
    same = [[*map(_called, row)] == [*names] for row in rows]
    return names if all(names) and len(names) > 1 and _most(same) else ()


def _called(found: re.Match[str] | None) -> str:
    """The name, with its unit, that stands in a cell beside its number; "" in any other cell."""
    return (
        "" if found is None else f"{found[1].strip()} [{found[3].strip()}]" if found[3] else found[1].strip()
    )


def _without_names(head: Head, names: tuple[str, ...]) -> Head:
    """The table of such cells, whose first line is a row."""
    rows, lines, _ = rows_of(head)
    rows, lines = [[*head.names], *rows], [head.first_line - 1, *lines]
    found = [[NAMED.fullmatch(cell) for cell in column] for column in zip(*rows, strict=True)]
    columns = (
        np.array(
            [one[2] if one and _called(one) == name else cell for one, cell in zip(of, cells, strict=True)],
            object,
        )
        for name, of, cells in zip(names, found, zip(*rows, strict=True), strict=True)
    )
    sheet = Sheet(tuple(columns), lambda row, _: f"{head.path}, line {lines[row]}")
    return dataclasses.replace(head, names=names, sheet=sheet, sample=sheet.first(SAMPLE), header=())


def _is_compound(cells: Sequence[str]) -> bool:
    filled = [cell.strip() for cell in cells if cell.strip()]
    return bool(filled) and not is_number(filled[0]) and (bool(_form(filled)) or _are_amounts(filled))


def _form(cells: Sequence[str]) -> re.Pattern[str] | None:
    forms = (RECTANGULAR, DECIBELS, PAIR)
    return next((form for form in forms if _most([bool(form.fullmatch(cell)) for cell in cells])), None)


def _are_amounts(cells: Sequence[str]) -> bool:
    """Whether most are a number and its unit, all of one kind."""
    stated = [units.split_amplitude(one[1])[0] for cell in cells if (one := amount(cell)) and one[1]]
    return bool(stated) and _most(
        [units.is_known(unit) and units.same_kind(unit, stated[0]) for unit in stated], len(cells)
    )


def _most(said: Sequence[bool], of: int | None = None) -> bool:
    """Whether more than half are true: a bad cell is left to be refused by its place."""
    return 2 * sum(said) > (len(said) if of is None else of)


def rows_of(head: Head) -> tuple[list[list[str]], list[int], list[str]]:
    """The cells of all rows, the line of each, and the step that it belongs to: a simulator that steps
    a value begins each with a line of words, the first of them right below the header."""
    rows: list[list[str]] = []
    lines: list[int] = []
    steps: list[str] = []
    marks, step = head.dialect.comment or (), ""
    for line, text in enumerate(texts(head.path, head.start), head.first_line):
        if not text.strip() or text.startswith(marks):
            continue
        cells = [cell.strip() for cell in split_line(text, str(head.dialect.delimiter))]
        cells = cells[:-1] if len(cells) == len(head.names) + 1 and not cells[-1] else cells
        if (
            len(cells) == 1 < len(head.names)
            and (step or not rows)
            and text.split()[:1] == head.sample[0][0].split()[:1]
        ):
            step = cells[0]
            continue
        if len(cells) != len(head.names):
            raise LogError(f"{head.path}, line {line}: found {len(cells)} cells, expected {len(head.names)}")
        rows.append(cells)
        lines.append(line)
        steps.append(step)
    return rows, lines, steps


def _parted(name: str, cells: list[str], decimal: str) -> Parted:
    """A column as one or two of plain cells; what is of another form than its first cells stays as it is, to
    be refused by its place where it is used."""
    filled = [cell for cell in cells[:SAMPLE] if cell]
    if not filled or not _is_compound(filled):
        return [(name, cells)]
    stem, unit = _split(name)
    if (form := _form(filled)) is not None:
        found = [form.fullmatch(cell) for cell in cells]
        parts = [
            [one[k].replace(" ", "") if one else cell for one, cell in zip(found, cells, strict=True)]
            for k in (1, 2)
        ]
        if form is RECTANGULAR and not any(
            map(to_number, parts[1])
        ):  # as of a frequency among complex numbers
            return [(name, parts[0])]
        ends = (" [dB]", " phase [deg]") if form is DECIBELS else (f" re{unit}", f" im{unit}")
        return [(f"{stem}{end}", part) for end, part in zip(ends, parts, strict=True)]
    own, amplitude = unit.strip(" []"), _amplitude(filled)
    if amplitude:  # 50 Vpk
        cells, filled = ([_without_amplitude(cell) for cell in of] for of in (cells, filled))
    if own in ("degC", "°C", "degF", "°F", "K"):  # where C is no coulomb
        cells, filled = (
            [re.sub(r"(?<=[\d.\s])([CF])$", r"deg\1", cell) for cell in of] for of in (cells, filled)
        )
    stated = [one[1] for cell in filled if (one := amount(cell)) and one[1]]
    alike = bool(own) and units.same_kind(own, stated[0])
    if alike and "m" in stated and units.same_kind(own, "m") and {*stated} <= PREFIXES.keys():
        return [(name, cells)]  # a metre, or a milli
    if not alike and {*stated} <= PREFIXES.keys() - ({"m", "K"} if not own else set()):  # not of 300K
        return [(name, [*map(_unprefixed, cells)])]
    if own and not alike:
        return [(name, cells)]
    wanted = own or stated[0]
    head = f"{stem} [{wanted} {amplitude}]" if amplitude else name if own else f"{name} [{wanted}]"
    return [(head, [_in(cell, wanted, decimal) for cell in cells])]


def _amplitude(cells: Sequence[str]) -> str:
    """The word that says what an amplitude is behind the unit of each cell; "" where they have none, or
    several."""
    said = {units.split_amplitude(one[1])[1] for cell in cells if (one := amount(cell)) and one[1]}
    return said.pop() if len(said) == 1 else ""


def _without_amplitude(cell: str) -> str:
    """A number with its unit, without what that says of an amplitude; any other cell as it is."""
    found = amount(cell)
    return f"{found[0]} {units.split_amplitude(found[1])[0]}" if found and found[1] else cell


def _unprefixed(cell: str) -> str:
    """A number with a prefix behind it, 32.3k, as one without; any other cell as it is."""
    found = amount(cell)
    return f"{found[0]}e{PREFIXES[found[1]]}" if found and found[1] in PREFIXES else cell


def _in(cell: str, wanted: str, decimal: str) -> str:
    """A number with its unit as one in the wanted unit; any other cell as it is."""
    found = amount(cell)
    if found is None or not found[1] or not units.same_kind(found[1], wanted):
        return cell
    if found[1] == wanted:
        return found[0]
    return repr(float(units.convert(to_number(found[0], decimal), found[1], wanted)))


def _split(name: str) -> tuple[str, str]:
    """A head without its unit, and the unit in brackets, or ""."""
    stem, unit, _ = units.split_unit(name)
    return (stem, f" [{unit}]") if unit and units.is_known(unit) else (name, "")
