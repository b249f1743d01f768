"""Tables that lie otherwise in their file: across, one quantity a line; or one below the other, a trace of an
analyser each.

Both become a `Sheet`, columns with a name each, which the rest of the reader takes like any other table.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.tables.cells import Dialect, find_delimiter, is_number, listed, split_line, to_number
from sysid.tables.sheet import Sheet
from sysid.tables.textfile import LogError, open_text

LARGEST = 1 << 28  # bytes of such a file, which is in memory as text: instruments write some megabytes
ALIKE = 1e-9  # of a stimulus, by which it may differ from trace to trace: the rounding of what is written
TITLE = 40  # characters of a title that tells tables apart


@dataclass(frozen=True)
class Table:
    """One of a file's tables: the lines above it, its names ("" each where it has no header), its rows as
    text, and the line of the first, counted from 1, with those of the others."""

    above: tuple[str, ...]
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]


def names_across(header: Sequence[str], rows: Sequence[Sequence[str]]) -> int | None:
    """How many cells stand before the numbers of each line of a table that lies across, the last of which
    names its quantity; None of any other table. `header` names these cells, or there is none. A bad cell here
    and there is left to be refused by its name."""
    places = (len(header) - 1, len(header) - 2) if any(header) else (0,)  # the last may name all the numbers
    return next((place + 1 for place in places if place >= 0 and _lies_across(place, rows)), None)


def _lies_across(place: int, rows: Sequence[Sequence[str]]) -> bool:
    """Whether the cell at this place of most rows names what the numbers behind it are of."""
    may = [cell for row in rows for cell in row[place : place + 1] if cell.strip() and not is_number(cell)]
    if 2 * len(may) <= len(rows):
        return False
    wide = [row for row in rows if len([cell for cell in row if cell.strip()]) >= place + 4]
    named = [row for row in wide if row[place].strip() and not is_number(row[place])]
    whole = [row for row in named if all(is_number(cell) for cell in row[place + 1 :] if cell.strip())]
    return len(rows) > 1 and len(wide) >= len(rows) - 1 and 2 * len(whole) > len(rows)


def across(
    path: str, dialect: Dialect, start: int, line: int, header: Sequence[str], before: int
) -> tuple[Sheet, tuple[str, ...]]:
    """The sheet of a table that lies across, whose lines begin at byte `start`, which begins line `line`, and
    its names; the cells in front of a line's name tell its experiment."""
    groups: dict[tuple[str, ...], dict[str, tuple[int, list[str]]]] = {}
    for number, text in enumerate(texts(path, start), line):
        if not text.strip() or text.startswith(dialect.comment or ()):
            continue
        cells = _cells(text, str(dialect.delimiter))
        key, name = tuple(cells[: before - 1]), "".join(cells[before - 1 : before])
        if not name or is_number(name):
            raise LogError(
                f"{path}, line {number}: found {name!r} as the name of a quantity, expected one before its"
                f" numbers"
            )
        if name in (known := groups.setdefault(key, {})):
            raise LogError(
                f"{path}, line {number}: found {name!r} again, as in line {known[name][0]}, expected it once"
            )
        known[name] = (number, cells[before:])
    first = next(iter(groups.values()))
    for group in groups.values():
        _even(path, group)
        if odd := sorted(group.keys() ^ first.keys()):
            at = next(iter(group.values()))[0]
            raise LogError(
                f"{path}, line {at}: found other quantities than in line {line} ({listed(odd)}), expected"
                f" the same"
            )
    counts = [len(next(iter(group.values()))[1]) for group in groups.values()]
    leading = [np.repeat(np.array([key[k] for key in groups], object), counts) for k in range(before - 1)]
    columns = [
        np.array([cell for group in groups.values() for cell in group[name][1]], object) for name in first
    ]
    begins = np.cumsum([0, *counts])

    def where(row: int, column: int) -> str:
        """The line and cell of the file in which a cell stands; rows and columns of the turned table are
        counted from 0."""
        k = int(np.searchsorted(begins, row, side="right")) - 1
        group = list(groups.values())[k]
        at = [*group.values()][max(column - before + 1, 0)][0]
        return f"{path}, line {at}, cell {before + 1 + row - int(begins[k])}"

    return Sheet((*leading, *columns), where), (*header[: before - 1], *first)


def _even(path: str, group: dict[str, tuple[int, list[str]]]) -> None:
    """Make all quantities of a group as long as the longest, where the cells are there and empty; else
    LogError."""
    longest = max(
        max((k for k, cell in enumerate(cells, 1) if cell), default=0) for _, cells in group.values()
    )
    if not longest:
        raise LogError(
            f"{path}, line {next(iter(group.values()))[0]}: found no numbers, expected at least one behind"
            f" the name"
        )
    line = next(at for at, cells in group.values() if len(cells) >= longest and cells[longest - 1])
    for at, cells in group.values():
        if len(cells) < longest:
            found = f"found {len(cells)} numbers, expected {longest} as in line {line}"
            raise LogError(f"{path}, line {at}: {found}; was the file still being written?")
        del cells[longest:]


def tables(path: str, dialect: Dialect) -> list[Table]:
    """The tables that stand one below the other in a file, with what stands above each. What is no row among
    rows: LogError."""
    found: list[Table] = []
    lines, above, place = texts(path, 0), [], 0
    while place < len(lines):
        delimiter = dialect.delimiter or find_delimiter(lines[place].strip())
        cells = _cells(lines[place], delimiter)
        if len(cells) < 2 or not any(cells) or not all(map(is_number, filter(None, cells))):
            above.append((place + 1, lines[place].strip()))
            place += 1
            continue
        rows = _rows(lines, place, delimiter, len(cells))
        names, context = _header([text for _, text in above if text], delimiter, len(cells))
        if found and not any(names):
            number, text = next((pair for pair in reversed(above) if pair[1]), (place + 1, ""))
            expected = "a row of numbers, or the header of another table"
            raise LogError(f"{path}, line {number}: found {text!r} among the rows, expected {expected}")
        found.append(Table(tuple(context), names, tuple(rows.values()), tuple(rows)))
        above, place = [], max(rows)
    return found


def _rows(lines: Sequence[str], place: int, delimiter: str, width: int) -> dict[int, tuple[str, ...]]:
    """The rows from line `place` (from 0) on, by their numbers (from 1), up to a line that is none, blank
    ones aside."""
    found: dict[int, tuple[str, ...]] = {}
    for number, text in enumerate(lines[place:], place + 1):
        cells = _cells(text, delimiter)
        cells = cells[:-1] if len(cells) == width + 1 and not cells[-1] else cells
        if len(cells) == width and any(map(is_number, cells)):
            found[number] = tuple(cells)
        elif text.strip():
            break
    return found


def _cells(text: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in split_line(text, delimiter)]


def _header(above: Sequence[str], delimiter: str, width: int) -> tuple[tuple[str, ...], list[str]]:
    """The names in the last line above a table, where it has as many cells as the rows and no number; and the
    other lines."""
    cells = tuple(_cells(above[-1].lstrip("#%! "), delimiter)) if above else ()
    if len(cells) != width or any(map(is_number, cells)):
        return ("",) * width, [*above]
    return cells, [*above[:-1]]


def can_be_joined(found: Sequence[Table]) -> bool:
    """Whether tables are traces over one stimulus: as many rows, and the same numbers in their first columns.
    Under the same lines, titles and all, they are one table again."""
    if len(found) < 2 or len({len(table.rows) for table in found}) > 1:
        return False
    if any(
        any(found[0].names) and (table.names, table.above) == (found[0].names, found[0].above)
        for table in found[1:]
    ):
        return False
    return all(_same(_stimulus(found[0], 0), _stimulus(table, 0)).all() for table in found[1:])


def joined(path: str, found: Sequence[Table], join: str | int, decimal: str) -> tuple[Sheet, tuple[str, ...]]:
    """The sheet of several tables side by side, and its names: that of the column `join`, which they share,
    once; a name that stands in several of them with the title of its table before it. Tables that do not fit:
    LogError."""
    if len(found) < 2:
        raise LogError(
            f"{path}: found {len(found)} table, expected two or more that share the column {join!r}"
        )
    places = [_place(path, table, join) for table in found]
    first = _stimulus(found[0], places[0], decimal)
    for table, place in zip(found[1:], places[1:], strict=True):
        if len(table.rows) != len(found[0].rows):
            said = (
                f"found {len(table.rows)} rows in the table that begins there, expected {len(found[0].rows)}"
            )
            raise LogError(
                f"{path}, line {table.lines[0]}: {said} as in the one that begins in line {found[0].lines[0]}"
            )
        same = _same(first, _stimulus(table, place, decimal))
        if not same.all():
            row = int(np.argmin(same))
            said = (
                f"found {table.rows[row][place]}, expected {found[0].rows[row][places[0]]} as in line"
                f" {found[0].lines[row]}"
            )
            raise LogError(
                f"{path}, line {table.lines[row]}, column {join!r}: {said}: the traces of one measurement"
            )
    cells = [
        (k, c) for k, table in enumerate(found) for c in range(len(table.names)) if k == 0 or c != places[k]
    ]
    titles = _titles(found)
    own = [found[k].names[c] for k, c in cells]
    names = [
        f"{titles[k]}: {name}" if own.count(name) > 1 else name
        for (k, _), name in zip(cells, own, strict=True)
    ]
    columns = tuple(np.array([row[c] for row in found[k].rows], object) for k, c in cells)
    return Sheet(columns, lambda row, column: f"{path}, line {found[cells[column][0]].lines[row]}"), tuple(
        names
    )


def _place(path: str, table: Table, join: str | int) -> int:
    if isinstance(join, int) and 0 <= join < len(table.names):
        return join
    if isinstance(join, str) and table.names.count(join) == 1:
        return table.names.index(join)
    held = listed(list(filter(None, table.names))) or f"{len(table.names)} columns without a header"
    raise LogError(
        f"{path}, line {table.lines[0]}: found a table of {held}, expected the column {join!r} once"
    )


def _stimulus(table: Table, place: int, decimal: str = ".") -> np.ndarray:
    return np.array([to_number(row[place], decimal) for row in table.rows])


def _same(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.abs(first - second) <= ALIKE * np.max(np.abs(first), initial=0.0)


def _titles(found: Sequence[Table]) -> list[str]:
    """What tells the tables apart: the values of those lines above them that all have, with different
    values."""
    stated = [dict(_stated(text) for text in table.above) for table in found]
    keys = [
        key for key in stated[-1] if all(key in of for of in stated) and len({of[key] for of in stated}) > 1
    ]
    titles = [" ".join(of[key] for key in keys)[:TITLE].strip() for of in stated]
    return titles if len(set(titles)) == len(titles) else [f"table {k}" for k in range(1, len(titles) + 1)]


def _stated(text: str) -> tuple[str, str]:
    """Key and value of a line such as "TRACE: A" or BEGIN CH1_DATA."""
    text = text.strip('"#%! \t')
    key, _, value = text.partition(":") if ":" in text else text.partition(" ")
    return re.sub(r"\W", "", key).casefold(), value.strip(' "')


def texts(path: str, start: int) -> list[str]:
    """The lines from byte `start` on. Too many bytes: LogError."""
    with open_text(path) as file:
        file.seek(start)
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise LogError(
            f"{path}: found more than {LARGEST >> 20} MiB of a table that does not lie row by row, expected"
            f" less"
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")  # as of a file that is one row a line
    return text.split("\n")
