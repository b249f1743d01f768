"""A text table as it lies on the disk: comments, header and dialect. It knows lines and cells, no physics.

`read_head` reads down to the first row. What cannot be read ends in a `LogError` that names the file, the
line and the column.
"""

import itertools
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import BinaryIO, NamedTuple

from sysid.tables import axis, layout, units
from sysid.tables.cells import (
    GROUPED,
    RECTANGULAR,
    WHITESPACE,
    Dialect,
    amount,
    find_delimiter,
    is_number,
    listed,
    split_line,
    to_number,
    uncounted,
)
from sysid.tables.preamble import (
    DEEPEST,
    Top,
    find_top,
    header_line,
    increment,
    is_own_header,
    is_table,
    is_unit_row,
    left_out,
    numbers_columns,
    numbers_its_rows,
    settings,
    with_units,
)
from sysid.tables.sheet import Sheet
from sysid.tables.stamps import is_stamp
from sysid.tables.textfile import LogError, code_page, decoded, open_text, read_line, refuse_binary

OTHERS = "%!*"  # comments too, where the first line begins so: of lock-ins, network analysers, REW
SAMPLE = 50  # lines below the header that tell how the numbers are written


@dataclass(frozen=True)
class Head:
    """A table's file down to its first row."""

    path: str
    metadata: dict[str, str]
    repeated: frozenset[str]  # metadata keys that stand there twice, capitals aside, with different values
    names: tuple[
        str, ...
    ]  # as in the header; "" where the header has nothing; empty texts when there is no header
    dialect: Dialect  # with nothing left open
    start: int  # byte in the (decompressed) file where the rows begin
    first_line: int  # line number of that byte, counted from 1
    sample: tuple[tuple[str, ...], ...]  # the first rows as text
    notes: tuple[str, ...] = ()
    preamble: bool = False  # whether lines without a comment mark stand above the header
    header: tuple[bytes, ...] = ()  # its lines as they stand in the file, without their ends
    remarks: Mapping[str, str] = field(default_factory=dict)  # of comments `key = value` that are no metadata
    sheet: Sheet | None = None  # the whole table, where it does not lie in its file as one row a line
    parts: Mapping[str, tuple[int, int]] = field(
        default_factory=dict
    )  # of several files: the columns of each
    above: tuple[
        str, ...
    ] = ()  # lines above the table, comments without marks, or the kind of a file: which instrument wrote it
    # columns that settings name, with their units, and that do not say it themselves
    told: Mapping[int, str] = field(default_factory=dict)

    def says(self, column: int) -> str:
        """What is said of a column: its own name, or that which settings give it where its cells hold
        something."""
        return (self.told if self.first(column) else {}).get(column, self.names[column])

    def first(self, column: int) -> str:
        """The column's cell in the first row, "" where that is too short."""
        return self.sample[0][column].strip() if column < len(self.sample[0]) else ""

    def dated(self, column: int) -> bool:
        """Whether the column holds dates or times of day."""
        return is_stamp(self.first(column))

    @property
    def name(self) -> str:
        """The file's name without its folder, on one line."""
        return called(self.path)


def called(path: str) -> str:
    """A file's name without its folder, on one line."""
    return os.path.basename(path).replace("\n", " ")


def read_head(path: str, dialect: Dialect) -> Head:
    """Metadata, column names and dialect of the file at `path`. Raises LogError when there is no table in
    it."""
    if dialect.skip is dialect.header is dialect.join is None and (top := _uncommented(path)):
        if told := axis.beside(top, dialect.delimiter or find_delimiter(top[0])):
            return _with_settings_beside(_read_top(path, replace(dialect, header=False)), told, top)
        if above := tuple(line.strip() for line in top[: settings(top, dialect)]):
            head = _read_top(path, replace(dialect, skip=len(above), header=False))
            note = f"lines 1 to {len(above)}, settings above rows without a header, left out"
            return replace(head, notes=(*head.notes, note), above=above, preamble=True)
    head = _read_top(path, dialect)
    if dialect.join is not None:
        found = layout.tables(path, dialect)
        sheet, names = layout.joined(path, found, dialect.join, str(head.dialect.decimal))
        lines = listed([str(table.lines[0]) for table in found])
        return _on_sheet(head, sheet, names, f"the tables that begin in lines {lines} are read side by side")
    names = uncounted(head.names)
    before = layout.names_across(names, head.sample)
    if before is not None and dialect.header is not False:
        header = names if head.dialect.header else ("",) * before
        sheet, names = layout.across(path, head.dialect, head.start, head.first_line, header, before)
        head = replace(head, above=(*head.above, ";".join(header)))
        return _on_sheet(
            head, sheet, names, "a table that lies across: each of its lines is read as a column"
        )
    return head


def _uncommented(path: str) -> list[str]:
    """The first lines of a file that does not begin with a comment, with nothing, or with a long header;
    empty of any other."""
    with open_text(path) as file:
        first = read_line(path, file, 1)
        long = len(first) > units.LONGEST and not re.search(rb"[,;\t ]\s*[-+.\d]", first)
        if not first.strip() or long or first.startswith((b"#", b"%", b"!")):
            return []
        raws = [first, *_read_lines(path, file, 1, DEEPEST - 1)]
    return [decoded(raw) for raw in raws]


def _with_settings_beside(head: Head, told: Mapping[int, str], lines: list[str]) -> Head:
    """The head of rows that have settings beside them, with names of the columns that hold numbers."""
    names = tuple(told.get(k, "").partition(" ")[0] for k in range(len(head.names)))
    note = f"column{'s' if min(told) > 1 else ''} 0 to {min(told) - 1}, settings beside the rows, left out"
    return replace(head, names=names, told=told, notes=(*head.notes, note), above=tuple(lines[:1]))


def _on_sheet(head: Head, sheet: Sheet, names: tuple[str, ...], note: str) -> Head:
    return replace(
        head, names=names, sheet=sheet, sample=sheet.first(SAMPLE), notes=(*head.notes, note), header=()
    )


def _read_top(path: str, dialect: Dialect) -> Head:
    """The head of a table that lies in its file as one row a line, or as far as it looks like one."""
    notes: list[str] = []
    with open_text(path) as file:
        comments, last, line, raw, number, encoding, marks = _read_comments(path, file, dialect, notes)
        dialect = replace(dialect, comment=marks)
        start = file.tell() - len(raw)
        raws = [raw, *_read_lines(path, file, number, SAMPLE)]
        lines = [line, *map(decoded, raws[1:])]
        top = None
        if dialect.skip is None and dialect.header is not False and not is_table(lines, dialect):
            raws += _read_lines(path, file, number + SAMPLE, DEEPEST - SAMPLE)
            lines += map(decoded, raws[len(lines) :])
            top = find_top(lines, dialect)
    if top:
        among = [k for k in range(top.names) if lines[k].startswith(marks)]
        for k in (*among, top.names) if top.names else ():
            lines[k], encoding = _decoded(raws[k], encoding, number + k, notes)
        comments += [comment_of(lines[k], marks) for k in among]
        notes += left_out(lines, number, top, among)
        line, above, depth = header_line(lines, top), top.rows, top.rows - top.names
        dialect = replace(dialect, delimiter=top.delimiter)
    else:
        line, above, comments = _usual_header(lines, comments, dialect)
        depth = above
    header = tuple(map(bytes.strip, raws[above - depth : above] if above else [last] if line else []))
    delimiter = dialect.delimiter or _delimiter(line.strip(), lines[above] if above < len(lines) else "")
    rows = tuple(tuple(split_line(text, delimiter)) for text in lines[above : above + SAMPLE] if text.strip())
    if not rows:
        raise LogError(f"{path}: found a header and no rows, expected at least one row of numbers")
    names, step, said = _names(path, line, lines[above:], delimiter, rows)
    metadata, repeated = metadata_of(comments)
    decimal = dialect.decimal or _find_decimal(path, rows, delimiter)
    told, rate, remark = _explained(path, lines, top, names, rows[0], decimal) if top else ({}, step, said)
    if rate and not any(key.casefold().startswith("sample_rate") for key in metadata):
        metadata["sample_rate_Hz"] = rate
        notes.append(remark)
    equations = (_stated(comment, "=") for comment in comments)
    remarks = {key: value for key, value in equations if key and key not in metadata}
    known = Dialect(delimiter, dialect.comment, decimal, bool(line), join=dialect.join)
    start, below = start + sum(map(len, raws[:above])), bool(top and top.names)
    lines = [*comments, *(lines[: top.names] if top else ())]
    more = (tuple(notes), below, header, remarks)
    return Head(
        path,
        metadata,
        repeated,
        names,
        known,
        start,
        number + above,
        rows,
        *more,
        above=tuple(lines),
        told=told,
    )


def _names(
    path: str, line: str, below: list[str], delimiter: str, rows: tuple[tuple[str, ...], ...]
) -> tuple[tuple[str, ...], str, str]:
    """The names of the columns, by the header `line`; and what stands at their end (`axis.stated_at_end`)."""
    names = tuple(name.strip() for name in split_line(line, delimiter)) if line else _unnamed(rows)
    while names and not names[-1] and line:
        names = names[:-1]
    names, step, said = axis.stated_at_end(names)
    if line and numbers_its_rows(line, below[0], {len(row) for row in rows}, len(names)):
        names = ("", *names)
    if not names:
        raise LogError(f"{path}: found a header without a name, expected names such as time_s")
    return names, step, said


def _explained(
    path: str, lines: list[str], top: Top, names: tuple[str, ...], row: tuple[str, ...], decimal: str
) -> tuple[dict[int, str], str, str]:
    """What settings above a table call its axis; the sample rate (Hz) that they state, "" where they do not,
    and a note on it."""
    above = lines[: top.names]
    told = axis.named(above, names, top.delimiter)
    if rate := axis.sample_rate(path, above, told, row, top.delimiter, decimal):
        return told, rate, f"sampled at {rate} Hz, as Delta_X says above the header"
    step = increment(lines, top)
    rate = f"{1 / step:.12g}" if step else ""
    return told, rate, f"sampled every {step:g} s, as the line of units says below Increment" if step else ""


def _unnamed(rows: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """A name for each column of a table without a header, but those at its end that are empty throughout."""
    widths = (max((k for k, cell in enumerate(row, 1) if cell.strip()), default=1) for row in rows)
    return ("",) * (len(rows[0]) if len(rows[0]) < 3 else max(widths))


def _delimiter(header: str, row: str) -> str:
    """The mark that parts a header ("": none), or the row below it where that is parted by another one into
    as many numbers: names of several words may hold a comma."""
    first, second = find_delimiter(header or row), find_delimiter(row)
    cells = split_line(row, second)
    alike = len(cells) > 1 and len(split_line(header, second)) == len(cells)
    numbers = alike and all(is_number(cell) for cell in cells if cell.strip())
    return second if (first == "," or second == "|") and numbers else first


class _Above(NamedTuple):
    """What stands above a table: the comments, the last of them as bytes; the first line below them, as text,
    as bytes and by its number; the encoding of the lines below it; what comments begin with."""

    comments: list[str]
    last: bytes
    line: str
    raw: bytes
    number: int
    encoding: str
    marks: tuple[str, ...]


def _read_comments(path: str, file: BinaryIO, dialect: Dialect, notes: list[str]) -> _Above:
    comments: list[str] = []
    number, skip, encoding, last, marks = 0, dialect.skip or 0, "utf-8-sig", b"", dialect.comment
    while raw := read_line(path, file, number + 1):
        number += 1
        if number <= skip:
            continue
        refuse_binary(path, raw, number)
        line, encoding = _decoded(raw, encoding, number, notes)
        if marks is None and line.strip():
            marks = ("#", line[0]) if line[0] in OTHERS else ("#",)
        if mark := next((mark for mark in marks or () if line.startswith(mark)), ""):
            comments.append(comment_of(line, (mark,)))
            last = raw
        elif line.replace(",", "").replace(";", "").strip():
            return _Above(comments, last, line, raw, number, encoding, marks or ("#",))
    if skip and number:
        raise LogError(
            f"{path}: found {number} lines and no table below the {skip} that skip leaves out, expected rows"
        )
    raise LogError(f"{path}: found {'only comment lines' if comments else 'an empty file'}, expected rows")


def comment_of(line: str, marks: tuple[str, ...]) -> str:
    """What a line says that begins with one of the marks."""
    return line[next(len(mark) for mark in marks if line.startswith(mark)) :].strip()


def _read_lines(path: str, file: BinaryIO, number: int, count: int) -> list[bytes]:
    """The lines below line `number`, where the file stands: `count` of them, or fewer at its end."""
    return list(itertools.takewhile(bool, (read_line(path, file, number + k) for k in range(1, count + 1))))


def _decoded(raw: bytes, encoding: str, number: int, notes: list[str]) -> tuple[str, str]:
    """A line as text, and the encoding of the lines below it; `notes` gets one where that is not UTF-8."""
    try:
        line = raw.decode(encoding)
    except UnicodeDecodeError:
        encoding = code_page(raw)
        line = raw.decode(encoding, errors="replace")
        notes.append(f"line {number} is not UTF-8: read as Windows-{encoding.removeprefix('cp')}")
    return line, encoding.removesuffix("-sig")


def _usual_header(lines: list[str], comments: list[str], dialect: Dialect) -> tuple[str, int, list[str]]:
    """The header of a table that begins with the first line ("": none), how many lines are above its rows,
    and the comments."""
    if dialect.header is False or (dialect.header is None and _holds_numbers(lines[0], dialect)):
        line, comments = _header_in_comments(comments, lines[0], dialect)
        return line, 0, comments
    if dialect.header is None and lines[1:] and is_own_header(lines[1], dialect):  # below a row of groups
        return lines[1], 2, comments
    if dialect.header is None and len(lines) > 2 and numbers_columns(lines[1], dialect):
        return lines[0], 2, comments
    if dialect.header is None and is_unit_row(lines[0], lines[1:], dialect):
        return with_units(lines[0], lines[1], dialect), 2, comments
    return lines[0], 1, comments


def _stated(comment: str, mark: str) -> tuple[str, str]:
    """What stands before the mark and behind it; two empty texts where there is none."""
    key, found, value = comment.partition(mark)
    return (key.strip(), value.strip()) if found else ("", "")


def _equation(comment: str) -> tuple[str, str] | None:
    """Key and value of `key = value`, where logs have such a key and the value is a number, with a unit
    or without, or the word that is expected; else it may be a sentence, or an instrument's setting."""
    key, value = _stated(comment, "=")
    word = key.casefold()
    said = (
        value.isalpha()
        if word in ("kind", "sampling")
        else bool(value)
        if word == "plate"
        else is_number(value) or ((of := amount(value)) is not None and units.is_known(of[1]))
    )
    return (key, value) if said and units.is_key(key) else None


def metadata_of(comments: list[str]) -> tuple[dict[str, str], frozenset[str]]:
    """Metadata, and the keys that stand there twice: `key: value`, or `key = value` of a key that logs
    have."""
    found: dict[str, str] = {}
    values: dict[str, set[str]] = {}
    for comment in comments:
        key, value = _stated(comment, ":") if (named := _equation(comment)) is None else named
        if key:
            found[key] = value
            values.setdefault(key.casefold(), set()).add(value)
    return found, frozenset(key for key in found if len(values[key.casefold()]) > 1)


def _find_decimal(path: str, rows: tuple[tuple[str, ...], ...], delimiter: str) -> str:
    """A comma when cells such as `1,5` stand in the first rows and the comma does not part the columns, or
    none has a point."""
    if delimiter == "," and any("." in cell and is_number(cell) for row in rows for cell in row):
        return "."
    cells = [cell.strip() for row in rows for cell in row if "," in cell]
    commas = [cell for cell in cells if not math.isnan(to_number(cell, ","))]
    if commas and all(map(GROUPED.fullmatch, commas)):
        raise LogError(
            f"{path}: found {commas[0]!r}, which is {commas[0].replace(',', '.')} with a decimal comma and"
            f" {commas[0].replace(',', '')} otherwise; expected that a mapping file says decimal = ',' or '.'"
        )
    return "," if commas else "."


def _holds_numbers(line: str, dialect: Dialect) -> bool:
    """Whether a line is a row, not a header: no name is a number, but those that count the columns."""
    cells = uncounted(split_line(line, dialect.delimiter or find_delimiter(line)))
    return any(is_number(cell) or RECTANGULAR.fullmatch(cell.strip()) for cell in cells)


def _header_in_comments(comments: list[str], row: str, dialect: Dialect) -> tuple[str, list[str]]:
    """A last comment line with as many cells as the rows have is the header (`numpy.savetxt` writes it
    so)."""
    if comments and dialect.header is None:
        delimiter = dialect.delimiter or find_delimiter(row)
        width = len(split_line(row, delimiter))
        if width > 1 and len(split_line(comments[-1], delimiter)) == width:
            return comments[-1], comments[:-1]
        apart = re.split(r"\t+|\s{2,}", comments[-1])  # names of several words, in columns of blanks
        if width > 1 and delimiter == WHITESPACE and len(apart) == width:
            return " ".join(f'"{name}"' for name in apart), comments[:-1]
    return "", comments
