"""Workbooks of spreadsheet programs (.xlsx, .xlsm) as text, a line for each row.

Each sheet that holds a table is a log of its own, which `book.xlsx[sheet]` names; a workbook stands for its
first one. What is no table, such as a sheet of notes, stands above each.
"""

import csv
import io
import os
import re
import warnings
import zipfile
from contextlib import closing
from datetime import date, datetime, time, timedelta
from functools import lru_cache
from itertools import islice, zip_longest
from typing import Any, NamedTuple

ENDINGS = r"\.(xlsx|xlsm)"
ZIP = b"PK\x03\x04"
HELD = "xl/workbook.xml"  # what a zip archive holds that is a workbook
UNPACKED = 1 << 30  # bytes that a workbook may unpack to: thirty million cells
ROWS = 3  # rows of two numbers or more, of which a table has as many at least
MARK = "\t"  # between cells: one that no cell holds
Rows = list[list[str]]


class NoWorkbook(ValueError):
    """Why a file gives no text."""


class Book(NamedTuple):
    """The visible sheets that hold anything: `tables` by their names, and what is in others."""

    tables: dict[str, Rows]
    notes: list[Rows]


def file_of(path: str) -> str:
    """The file that holds what a path names, which may be a sheet."""
    return _parted(path)[0]


def sheets(path: str) -> list[str]:
    """The paths of what is to be read of a file: of a workbook with several tables each sheet. Raises
    NoWorkbook, OSError."""
    if not re.search(rf"{ENDINGS}$", path, re.IGNORECASE) or not os.path.isfile(path):
        return [path]
    with open(path, "rb") as file:
        if not is_workbook(path, file.read(8)):
            return [path]
    tables = _book(path).tables
    return [f"{path}[{name}]" for name in tables] if len(tables) > 1 else [path]


def is_workbook(path: str, first: bytes) -> bool:
    """Whether a file that begins so is one."""
    if not first.startswith(ZIP):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return HELD in archive.namelist()
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError):
        return False


def as_text(path: str) -> bytes:
    """The text of one sheet of a workbook, below what others note. Raises NoWorkbook, OSError."""
    path, sheet = _parted(path)
    book = _book(path)
    if sheet and sheet not in book.tables:
        found = ", ".join(book.tables) or "none"
        raise NoWorkbook(f"found no sheet {sheet!r} with a table, expected one of: {found}")
    tables = [book.tables[sheet]] if sheet else [*book.tables.values()][:1]
    text = io.StringIO()
    writer = csv.writer(text, delimiter=MARK, lineterminator="\n")
    above, table = _parts(tables[0]) if tables else ([], [])
    for rows in (*book.notes, above):
        text.writelines(f"# {_noted(row)}\n" for row in rows)
    writer.writerows(table)
    return text.getvalue().encode()


def _noted(row: list[str]) -> str:
    """A line of notes: a name, and what stands behind it."""
    name, *more = [cell for cell in row if cell] or [""]
    name = name.lstrip("# ")
    return f"{name.rstrip(':= ')}: {' '.join(more)}" if more else name


def _parts(rows: Rows) -> tuple[Rows, Rows]:
    """What is noted above a table, and the table: a sheet has no mark of its own for a note. What has the
    name of a column stays where it is."""
    begin = next((k for k, row in enumerate(rows) if sum(map(_is_number, row)) > 1), 0)
    head = {_name(cell) for row in rows[:begin] if len(_filled(row)) > 1 for cell in row if not _notes(row)}
    above = [row for row in rows[:begin] if _notes(row) and _name(_filled(row)[0]) not in head]
    return above, [*(row for row in rows[:begin] if row not in above), *rows[begin:]]


def _filled(row: list[str]) -> list[str]:
    return [cell for cell in row if cell]


def _notes(row: list[str]) -> bool:
    """Whether a row is a text, or a name with a number, and a unit perhaps."""
    name, *more = _filled(row) or [""]
    numbers = [*map(_is_number, more)]
    return bool(name) and not _is_number(name) and numbers in ([], [True], [True, False])


def _name(text: str) -> str:
    """The first word of a head."""
    return re.split(r"[\s\[(_:=]", text.lstrip("# "), maxsplit=1)[0].casefold()


def _parted(path: str) -> tuple[str, str]:
    """A file, and the sheet of it that a path names, "" where it names none."""
    found = re.fullmatch(rf"(.*{ENDINGS})\[(.+)\]", path, re.IGNORECASE | re.DOTALL)
    return (found[1], found[3]) if found and not os.path.exists(path) else (path, "")


def _book(path: str) -> Book:
    stat = os.stat(path)
    return _read(path, stat.st_ino, stat.st_size, stat.st_mtime_ns)


@lru_cache(1)  # a text is opened several times, and so are the sheets of a book
def _read(path: str, *_: int) -> Book:
    found = {name: rows for name, rows in _cells(path).items() if rows}
    tables = {name: rows for name, rows in found.items() if _is_table(rows)}
    return Book(tables, [rows for name, rows in found.items() if name not in tables])


def _cells(path: str) -> dict[str, Rows]:
    """The cells of each visible sheet, formulas by what they gave. Raises NoWorkbook."""
    try:
        import openpyxl
    except ImportError:
        said = "found a workbook, which is read with openpyxl; expected that it is installed"
        raise NoWorkbook(f"{said}: pip install 'sysid[excel]', or save the log as CSV") from None
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(info.file_size for info in archive.infolist()) > UNPACKED:
                raise NoWorkbook(f"found a workbook that unpacks to more than {UNPACKED} bytes")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            with closing(book):
                visible = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
                return {sheet.title: _texts(sheet) for sheet in visible}
    except NoWorkbook:
        raise
    except Exception as error:  # the library answers damaged files with errors of many types
        found = f"found a damaged workbook ({type(error).__name__}: {error})"
        raise NoWorkbook(f"{found}, expected one that can be read") from None


def _texts(sheet: Any) -> Rows:
    """As text, without the columns before and behind all that there is, and the rows behind it."""
    sheet.reset_dimensions()  # what it says of its size may be anything
    rows = [[_text(cell) for cell in row] for row in sheet.iter_rows(values_only=True)]
    while rows and not any(rows[-1]):
        rows.pop()
    used = [k for k, column in enumerate(zip_longest(*rows, fillvalue="")) if any(column)]
    return [[*row, *[""] * (used[-1] + 1 - len(row))][used[0] : used[-1] + 1] for row in rows]


def _text(cell: Any) -> str:
    """A cell as a text file has it; a time as hours, minutes and seconds."""
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, float):
        return repr(int(cell)) if cell.is_integer() and abs(cell) < 1 << 53 else repr(cell)
    if isinstance(cell, datetime):
        return cell.isoformat(" ")
    if isinstance(cell, date | time):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        minutes, seconds = divmod(cell.total_seconds(), 60)
        return f"{int(minutes) // 60:02d}:{int(minutes) % 60:02d}:{seconds:09.6f}"
    return "" if cell is None else " ".join(str(cell).split())


def _is_table(rows: Rows) -> bool:
    """Whether there are rows of numbers."""
    found = (row for row in rows if sum(map(_is_number, row)) > 1)
    return len([*islice(found, ROWS)]) == ROWS


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
