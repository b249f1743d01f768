"""Where a table begins in a file whose first lines are neither marked as comments nor part of it.

Oscilloscopes, LabVIEW and network analysers write such lines: settings, `BEGIN`, two rows of header. Comments
may stand among them, and are read as those of any file.
"""

import re
from collections.abc import Collection
from itertools import groupby
from typing import NamedTuple

from sysid.tables import units
from sysid.tables.cells import (
    WHITESPACE,
    Dialect,
    amount,
    find_delimiter,
    is_number,
    listed,
    split_line,
    to_number,
    unbracketed,
    with_unit_cells,
)
from sysid.tables.densities import plain
from sysid.tables.stamps import is_stamp

DEEPEST = 200  # lines among which the first row is looked for
ALIKE = 3  # rows of numbers, one below the other, that are a table


class Top(NamedTuple):
    """Where a table begins: the line of its names, counted from 0, whether a row of units follows, how many
    columns it has, and the line of its first row."""

    names: int
    units: bool
    width: int
    delimiter: str
    rows: int


def is_table(lines: list[str], dialect: Dialect) -> bool:
    """Whether the first line is a row of numbers itself, or names the columns of the row below it."""
    if _shape(lines[0], dialect):
        return True
    below = [line for line in lines[1:] if line.strip()]
    sure = next((k for k, line in enumerate(below) if _shape(line, dialect)), len(below))
    if 1 < sure < len(below) and find_top(lines, dialect):  # names, units and a line more
        return False
    shape = next(iter(_shapes(below[: sure + 1], dialect)), None)  # of which those further down tell nothing
    return shape is not None and _is_texts(
        lines[0], shape[0], max(_width(line, shape[0]) for line in lines[1 : 1 + ALIKE])
    )


def find_top(lines: list[str], dialect: Dialect) -> Top | None:
    """Where the table below a preamble begins; None where the first line is a header, or no header is found.

    What begins with a number is a row, if a bad one, and no line of a preamble: it is left to be refused by
    its name.
    """
    shapes = _shapes(lines, dialect)
    first = next(
        (k for k, shape in enumerate(shapes) if shape and shapes[k : k + ALIKE] == [shape] * ALIKE), 0
    )
    if not (shape := shapes[first]) or not first:
        return None
    delimiter = shape[0]
    width = max(_width(line, delimiter) for line in lines[first : first + ALIKE])
    texts = [k for k in range(first) if lines[k].strip()]
    names, has_units = _names(lines, texts, Top(0, False, width, delimiter, first), dialect)
    if names is None or any(is_number(_cells(lines[k], delimiter)[0]) for k in texts if k <= names):
        return None
    alone = all(_is_texts(lines[k], delimiter, width) for k in texts if k <= names)
    if alone and not (
        has_units and len(texts) > 2
    ):  # names one below the other: the first of them are the header
        return None
    return Top(names, has_units, width, delimiter, first)


def _names(lines: list[str], texts: list[int], top: Top, dialect: Dialect) -> tuple[int | None, bool]:
    """Which of the lines `texts` above the first row names its columns (None: none); if units follow.

    A line of remarks may stand between the units and the rows, a word alone above these."""
    below = [_cells(line, top.delimiter) for line in lines[top.rows : top.rows + ALIKE]]
    held = [k for k in range(top.width) if any(k < len(row) and row[k] for row in below)]

    def wide(k: int) -> bool:
        return k >= 0 and _is_wide(lines[k], top.delimiter, top.width, dialect)

    def full(k: int) -> bool:
        cells = _cells(lines[k], top.delimiter)
        return wide(k) and all(cells[of] for of in held)

    def texts_in(k: int) -> bool:
        return wide(k) and not any(map(is_number, _cells(lines[k], top.delimiter)[: top.width]))

    def units_in(k: int) -> bool:
        return texts_in(k) and _are_units(_cells(lines[k], top.delimiter)[: top.width])

    *_, third, second, last = (-1, -1, -1, *texts)
    if full(second) and units_in(last):
        return second, True
    if full(third) and units_in(second) and texts_in(last):
        return third, True
    lone = len([cell for cell in _cells(lines[last], top.delimiter) if cell]) == 1
    if lone and full(second) and texts_in(second) and top.width > 2:  # a setting has a name and a value
        return second, False
    return (last, False) if last > 0 and full(last) and texts_in(last) else (None, False)


def settings(lines: list[str], dialect: Dialect) -> int:
    """How many lines of settings, a name and its value each, stand above rows of numbers without a header, as
    spectrum analysers save traces; 0 where no such rows follow. Names are different ones, and the last line
    states a number, or is a word such as DATA: it is no header."""
    shapes = _shapes(lines, dialect)
    first = next((k for k, x in enumerate(shapes) if x and shapes[k : k + ALIKE] == [x] * ALIKE), 0)
    if not (shape := shapes[first]):
        return 0
    above = [[cell for cell in _cells(line, shape[0]) if cell] for line in lines[:first] if line.strip()]
    stated = [is_number(cells[1]) for cells in above if len(cells) > 1]
    names = [cells[0].casefold() for cells in above if len(cells) > 1]
    named = all(cells and not is_number(cells[0]) and cells[0][0] not in "#%!" for cells in above)
    told = bool(stated) and (stated[-1] or len(above[-1]) == 1)
    return first if named and len({*names}) == len(names) and sum(stated) >= ALIKE and told else 0


def names_below(lines: list[str], dialect: Dialect) -> int | None:
    """The line, counted from 0, that names the columns of a table which begins among these lines; None where
    none does."""
    if not _shape(lines[0], dialect) and is_table(lines, dialect):
        return 0
    top = find_top(lines, dialect)
    return top.names if top else None


def header_line(lines: list[str], top: Top) -> str:
    """The header in one line, with the units that stand below it, as wide as the rows are."""
    names = _cells(lines[top.names], top.delimiter)[: top.width]
    units_below = _cells(lines[top.names + 1], top.delimiter)[: top.width] if top.units else [""] * top.width
    return with_unit_cells(names, units_below, top.delimiter)


def numbers_its_rows(header: str, row: str, widths: set[int], count: int) -> bool:
    """Whether rows have a name or a number each in front, which the header of `count` names leaves out.

    R puts it alone in quotes, pandas leaves blanks above it. Elsewhere the last name may be what lacks."""
    quoted = row.startswith('"') and row.count('"') == 2
    return widths == {count + 1} and (quoted or (header[:1] == " " and row[:1].isalnum()))


def numbers_columns(line: str, dialect: Dialect) -> bool:
    """Whether a line numbers three columns or more, from 0 or 1 on."""
    cells = _cells(line, dialect.delimiter or find_delimiter(line))
    return len(cells) > 2 and any(cells == [str(k + first) for k in range(len(cells))] for first in (0, 1))


def is_own_header(line: str, dialect: Dialect) -> bool:
    """Whether all cells of a line that hold something are names of a log's columns with their units."""
    cells = _cells(line, dialect.delimiter or find_delimiter(line))
    names = [units.parse_name(cell) for cell in cells if cell]
    return len(names) > 1 and all(
        name and name.unit and units.fits(name.quantity, name.unit) for name in names
    )


def is_unit_row(line: str, following: list[str], dialect: Dialect) -> bool:
    """Whether the line below the header holds units: short texts and no number, where the header has names
    alone; nothing but units, where some of its names state one."""
    if not following:
        return False
    delimiter = dialect.delimiter or find_delimiter(line)
    names, below = split_line(line, delimiter), split_line(following[0], delimiter)
    texts = [unit.strip() for unit in below if unit.strip()]
    row = 2 * sum(bool(re.match(r"\(?\s*[+-]?\.?\d", text)) for text in texts) > len(
        texts
    )  # 25.1 kHz, (1+2j)
    if len(names) != len(below) or not texts or row or any(is_number(text) or "=" in text for text in texts):
        return False
    if not any(re.search(r"[_\[(]", name) for name in names):
        return True
    some = any(not units.split_unit(name)[1] for name in names)  # W_D beside TIME, and not time_s beside w_um
    return some and all(units.is_known(unbracketed(text)) for text in texts)


def with_units(line: str, below: str, dialect: Dialect) -> str:
    """The header in one line, of a line of names and the units below it."""
    delimiter = dialect.delimiter or find_delimiter(line)
    return with_unit_cells(split_line(line, delimiter), split_line(below, delimiter), delimiter)


def increment(lines: list[str], top: Top) -> float | None:
    """Seconds from sample to sample, where they stand below a name Increment behind the units (Rigol); else
    None."""
    names = [name.casefold() for name in _cells(lines[top.names], top.delimiter)]
    if not top.units or "increment" not in names[top.width :]:
        return None
    step = dict(enumerate(_cells(lines[top.names + 1], top.delimiter))).get(names.index("increment"), "")
    return to_number(step) if to_number(step) > 0 else None


def left_out(lines: list[str], number: int, top: Top, comments: Collection[int]) -> list[str]:
    """Notes on the preamble, which begins at line `number` and of which the lines `comments` (from 0) are
    read, and on names at the header's end that have no column."""
    runs = [
        [k for k in run if lines[k].strip()]
        for read, run in groupby(range(top.names), lambda k: k in comments)
        if not read
    ]
    where = [str(number + run[0]) + (f" to {number + run[-1]}" if run[1:] else "") for run in runs if run]
    lone = len(where) == 1 and where[0].isdigit()
    notes = [f"line{'' if lone else 's'} {listed(where)}, above the header, left out"] if where else []
    told = [
        text for k in range(top.names) if k not in comments and (text := _stated(lines[k], top.delimiter))
    ]
    notes = [f"{note}; to have them read, write '# {told[0]}'" for note in notes] if told else notes
    below = [k for k in range(top.names + 1 + top.units, top.rows) if lines[k].strip()]
    notes += [f"line {number + k}, between the header and the rows, left out" for k in below]
    spare = [name for name in _cells(lines[top.names], top.delimiter)[top.width :] if name]
    return notes + ([f"names without a column, left out: {listed(spare)}"] if spare else [])


def _stated(line: str, delimiter: str) -> str:
    """A line without a comment mark as metadata, if it may state what is constant over a log, with its unit:
    `Temperature (degC),24`, `Temperature: 24 °C`; else "". An instrument's own temperature may be called
    so."""
    name, *more = [cell for cell in _cells(line, delimiter) if cell] or [""]
    told = f"{name.rstrip(':= ')}: {' '.join(more)}" if more else re.sub(r"\s*[:=]\s*", ": ", name, count=1)
    key, _, value = told.partition(": ")
    found = amount(value)
    if found is None:
        return ""
    keys = [key, f"{key} [{found[1]}]"] if found[1] else [key]
    names = [own for own in map(units.parse_name, filter(units.is_key, keys)) if own and own.unit]
    return told if names and len(more) < 3 else ""


def _shapes(lines: list[str], dialect: Dialect) -> list[tuple[str, int] | None]:
    """The shape of each line; a row with empty cells has that of the row below it, as an oscilloscope's first
    may."""
    shapes = [_shape(line, dialect) for line in lines]
    for k in reversed(range(len(lines) - 1)):
        if shapes[k] is None and (below := shapes[k + 1]) is not None:
            cells = split_line(lines[k], below[0])
            filled = [cell for cell in cells if cell.strip()]
            shapes[k] = below if len(cells) == below[1] and filled and all(map(is_number, filled)) else None
    return shapes


def _shape(line: str, dialect: Dialect) -> tuple[str, int] | None:
    """Delimiter and number of cells of a row of two numbers or more, of which all but one may be dates; None
    for any other line."""
    delimiter = dialect.delimiter or find_delimiter(line.strip())
    cells = split_line(line, delimiter)
    filled = [cell for cell in cells if cell.strip()]
    others = [cell for cell in filled if not is_number(cell)]
    row = 1 < len(filled) > len(others) and all(map(is_stamp, others))
    return (delimiter, len(cells)) if row else None


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in split_line(line, delimiter)]


def _width(line: str, delimiter: str) -> int:
    """Cells of a line up to the last that holds something."""
    return max((k for k, cell in enumerate(_cells(line, delimiter), 1) if cell), default=0)


def _is_texts(line: str, delimiter: str, width: int) -> bool:
    """Whether a line has so many cells, none of which is a number."""
    return _width(line, delimiter) == width and not any(map(is_number, _cells(line, delimiter)))


def _is_wide(line: str, delimiter: str, width: int, dialect: Dialect) -> bool:
    """Whether a line may head columns: as many as the rows have, or more where cells are parted by a mark."""
    count = len(split_line(line, delimiter))
    return not line.startswith(dialect.comment or ()) and (
        count == width or (count > width and delimiter != WHITESPACE)
    )


def _are_units(cells: list[str]) -> bool:
    """Whether all cells are units, the first aside, which may be a word such as Sequence, and the empty
    ones."""
    stated = [unbracketed(cell) for cell in cells[1:] if cell]
    return bool(stated) and all(unit == "#" or units.is_known(plain(unit)) for unit in stated)
