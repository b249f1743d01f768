"""The rows of a text table as numbers, in blocks, so that memory is bounded by the numbers themselves.

What is no row ends in a `LogError` that names the file, the line and the column. Where the header stands
again a table of its own begins.
"""

import io
import itertools
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np

from sysid.tables import axis, units
from sysid.tables.cells import (
    NO_NUMBER,
    WHITESPACE,
    Dialect,
    is_number,
    listed,
    means_none,
    split_line,
    to_number,
)
from sysid.tables.csvfile import Head, LogError, comment_of, metadata_of
from sysid.tables.pieces import Gap, find_gaps, pieces, rows_like, without_end, without_remarks
from sysid.tables.preamble import DEEPEST, names_below
from sysid.tables.stamps import EXAMPLE, is_date, is_local, seconds_since, told
from sysid.tables.textfile import decoded, digest, is_packed, open_text

BLOCK = 1 << 24  # bytes parsed at a time
UNPACKED = 1 << 27  # numbers, and lines, of a packed file, whose size says nothing of what it unpacks to
RANGES = 8  # of good rows that a message names
PLAIN = b"0123456789+-.eE\r\n"  # of which a table of plain numbers consists, its delimiter aside
SMALL = 1 << 18  # bytes of such a table, below which pandas takes longer to begin than Python to read them


@dataclass(frozen=True)
class Body:
    """The wanted columns: `numbers[index]` is (n,) float64 with NaN where a cell is no number; `keys` is (n,)
    text, the cell of the key column, or which of the file's tables the row belongs to."""

    numbers: dict[int, np.ndarray]
    keys: np.ndarray | None
    sha256: str
    blank_lines: list[int] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    tables: tuple[dict[str, str], ...] | None = None  # metadata of each table, where `keys` tells those apart

    def __len__(self) -> int:
        return len(next(iter(self.numbers.values())))

    def line(self, head: Head, row: int) -> int:
        """Line number, counted from 1, of a row counted from 0."""
        number = head.first_line + row
        for blank in self.blank_lines:
            number += blank <= number
        return number


def read_body(head: Head, columns: list[int], key: int | None = None, dated: Collection[int] = ()) -> Body:
    """The columns at `columns` as numbers and the one at `key` as text; every row must have its number of
    cells.

    Those of `dated` hold dates, which become seconds since the first row's. Where the header stands again,
    and there is no key column, each table has a key of its own, "1" first.
    """
    if head.sheet is not None:
        return _of_sheet(head, columns, key, dated)
    joined: dict[int, np.ndarray] = {column: np.empty(0) for column in columns}
    keys: list[Any] = []
    blank_lines: list[int] = []
    remarks: list[tuple[int, str]] = []
    line = head.first_line
    delimiter, marks = (
        str(head.dialect.delimiter),
        tuple(mark.encode() for mark in head.dialect.comment or ()),
    )
    sha256, packed = digest(head.path), is_packed(head.path)
    with open_text(head.path) as file:
        like = rows_like(head.sample[0], delimiter)
        gaps = find_gaps(file, (*head.header, b"")[0], head.start, line, like, BLOCK)
        tables = (head.metadata, *(_of_table(head, gap) for gap in gaps))
        file.seek(head.start)
        blocks = pieces(file, BLOCK, delimiter == WHITESPACE, gaps)
        blocks = without_remarks(blocks, marks, line, remarks) if marks else blocks
        for block in without_end(blocks, like, head.preamble, line, remarks):
            blank, count = _check_counts(head, block, line)
            blank_lines += blank
            if rows := count - len(blank):
                text = block if block.isascii() else decoded(block).encode()
                numbers, texts = _parse(head, text, line, rows, columns, key, dated)
                for column, known in joined.items():  # longer in place: the numbers are in memory once
                    known.resize((len(known) + rows, *numbers[column].shape[1:]), refcheck=False)
                    known[-rows:] = numbers[column]
                keys.append(texts)
            line += count
            if packed and (line - head.first_line) * max(len(columns), 1) > UNPACKED:
                found = f"found more than {UNPACKED} numbers in a packed file"
                raise LogError(
                    f"{head.path}, line {line}: {found}, expected fewer; unpack it, or save a part of it"
                )
    if not keys:
        raise LogError(f"{head.path}: found no rows, expected at least one row of numbers")
    joined = {column: told(values) for column, values in joined.items()}
    notes = [_of_remarks(head, remarks, line)] if remarks else []
    notes += [_of_gap(gap, key is None) for gap in gaps]
    if key is not None:
        if odd := next(
            (gap for gap, table in zip(gaps, tables[1:], strict=True) if table != head.metadata), None
        ):
            found = (
                "found other metadata than above, expected them once; the column tells the experiments apart"
            )
            raise LogError(f"{head.path}, lines {odd.line} to {odd.line + odd.lines - 1}: {found}")
        return Body(joined, np.concatenate(keys), sha256, blank_lines, tuple(notes))
    table = _tables(gaps, head.first_line, line, blank_lines)
    return Body(joined, table, sha256, blank_lines, tuple(notes), None if table is None else tables)


def _of_sheet(head: Head, columns: list[int], key: int | None, dated: Collection[int]) -> Body:
    """The same of a table that is in memory."""
    sheet, decimal = head.sheet, str(head.dialect.decimal)
    texts = [column for column in dated if column in columns and sheet.columns[column].dtype == object]
    numbers = {column: sheet.numbers(column, decimal) for column in columns if column not in texts}
    for column in texts:
        numbers[column] = told(seconds_since(head.first(column), sheet.texts(column).tolist()))
    sha256 = sheet.sha256 if sheet.sha256 is not None else digest(head.path)
    return Body(numbers, None if key is None else sheet.texts(key), sha256)


def _of_remarks(head: Head, remarks: list[tuple[int, str]], end: int) -> str:
    """A note on comments among the rows, or below the last of them, which is above line `end`. Raises
    LogError where one among them states what holds of the rows below it alone, if of any."""
    marks, remarks = head.dialect.comment or (), sorted(remarks)
    for line, text in remarks:
        if line >= end:
            break
        stated = [key for key in metadata_of([comment_of(text, marks)])[0] if units.is_key(key)]
        if stated:
            found = f"found metadata {stated[0]!r} among the rows, expected it above the header"
            raise LogError(f"{head.path}, line {line}: {found}; a log of other rows is a file of its own")
    where = f"line{'s' if remarks[1:] else ''} {listed([str(line) for line, _ in remarks])}"
    return f"{where}: comments among or below the rows, left out: {listed([text for _, text in remarks])}"


def _of_gap(gap: Gap, own: bool) -> str:
    where = f"line {gap.line}" if gap.lines == 1 else f"lines {gap.line} to {gap.line + gap.lines - 1}"
    return f"{where}: the header again, left out{'; the rows below it are a log of their own' if own else ''}"


def _of_table(head: Head, gap: Gap) -> dict[str, str]:
    """The metadata of the table below a gap: those of the file, and what is stated anew. Other units in the
    header: LogError."""
    lines = [raw.strip() for raw in gap.text.split(b"\n")]
    place = lines.index(head.header[0])
    if tuple(lines[place : place + len(head.header)]) != head.header:
        found = f"found the header again with other units, expected those of line {head.first_line - 1}"
        raise LogError(
            f"{head.path}, line {gap.line + place + 1}: {found}; save each table in a file of its own"
        )
    texts = [decoded(raw) for raw in lines if raw]
    marks, known = head.dialect.comment or (), head.dialect
    told = (head.told, head.sample[0], str(known.delimiter), str(known.decimal))
    rate = axis.sample_rate(head.path, texts, *told)
    return (
        head.metadata
        | ({"sample_rate_Hz": rate} if rate else {})
        | metadata_of([text[len(mark) :] for text in texts for mark in marks if text.startswith(mark)])[0]
    )


def _tables(gaps: list[Gap], first: int, end: int, blank_lines: list[int]) -> np.ndarray | None:
    """Which table each row belongs to, as text, "1" first; None where there is one."""
    lines = np.setdiff1d(np.arange(first, end), blank_lines, assume_unique=True) if gaps else np.zeros(1)
    numbers = np.searchsorted([gap.line for gap in gaps], lines, side="right") + 1
    return None if np.ptp(numbers) == 0 else numbers.astype(str).astype(object)


def refuse_cell(head: Head, body: Body, row: int, column: int, expected: str, more: str = "") -> NoReturn:
    """Raise the LogError of one bad cell: what stands there is read again from the file. `more`: why it is
    needed."""
    label = head.names[column] or column
    if head.sheet is not None:
        where, text, cell = head.sheet.where(row, column), "\n", head.sheet.text(row, column)
    else:
        number = body.line(head, row)
        where, text = f"{head.path}, line {number}", _line(head.path, number)
        cell = "".join(split_line(text, str(head.dialect.delimiter))[column : column + 1]).strip()
    local = is_local(cell)
    found = f"a date {cell!r}" if local or is_date(cell) else repr(cell) if cell else "an empty cell"
    found += ", whose day and month cannot be told apart" if local and head.dated(column) else ""
    found += ", which instruments write for no number" if means_none(cell) else ""
    last = (
        ""
        if text.endswith("\n")
        else " (the last line, without a line end: was the file still being written?)"
    )
    mark = " with a decimal comma" if head.dialect.decimal == "," and "." in cell else ""
    if local or (is_date(cell) and not head.dated(column)):
        mark += f"; write a time as {EXAMPLE} in every row, or as the seconds since the first row"
    elif expected == "a finite number":  # of an experiment's rows the numbers are its own
        mark += _without(np.isfinite(body.numbers[column]), body.keys is None)
    mark += f" ({more})" if more else ""
    raise LogError(f"{where}, column {label!r}: found {found}{last}, expected {expected}{mark}")


def _line(path: str, number: int) -> str:
    """A line of the file, counted from 1."""
    with open_text(path) as file:
        return decoded(next(itertools.islice(file, number - 1, None), b""))


def _without(good: np.ndarray, whole: bool) -> str:
    """How to do without the rows that are not good; of a part of the file (not `whole`) a mapping file counts
    them otherwise."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]]))).reshape(-1, 2).tolist()
    bad = len(good) - int(good.sum())
    if bad == len(good) > 1:
        return f"; none of the {bad} rows holds one there"
    others = (
        f", or read the others by rows = {edges} in a mapping file"
        if whole and 0 < len(edges) <= RANGES
        else ""
    )
    return (
        f"; leave {'the row' if bad == 1 else f'the {bad} rows that hold no number there'} out of the"
        f" file{others}"
    )


def _check_counts(head: Head, block: bytes, line: int) -> tuple[list[int], int]:
    """The blank lines' numbers and the count of lines in `block`, which begins at `line`. Odd rows:
    LogError."""
    text = np.frombuffer(block if block.endswith(b"\n") else block + b"\n", np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    marks = np.flatnonzero(text == ord(str(head.dialect.delimiter)))
    counts = np.diff(np.searchsorted(marks, ends), prepend=0)
    lengths = np.diff(ends, prepend=-1) - 1
    last = text[np.maximum(ends - 1, 0)]
    returned = (last == ord("\r")) & (lengths > 0)  # lines that end in CR LF
    last = np.where(returned, text[np.maximum(ends - 2, 0)], last)
    blank = lengths - returned == 0
    returns = np.flatnonzero(text == ord("\r"))
    if len(returns) > returned.sum():
        index = int(np.searchsorted(ends, np.setdiff1d(returns, ends - 1)[0]))
        raise LogError(
            f"{head.path}, line {line + index}: found a carriage return alone, expected lines that end in a"
            f" line feed"
        )
    spare = (counts == len(head.names)) & (last == ord(str(head.dialect.delimiter)))
    for index in map(int, np.flatnonzero(~blank & (counts != len(head.names) - 1) & ~spare)):
        row = decoded(bytes(text[ends[index] - lengths[index] : ends[index] + 1]))
        cells = split_line(row, str(head.dialect.delimiter))
        if len(cells) < len(head.names) or any(cell.strip() for cell in cells[len(head.names) :]):
            unfinished = index == len(ends) - 1 and not block.endswith(b"\n")
            last_line = (
                " (the last line, without a line end: was the file still being written?)"
                if unfinished
                else ""
            )
            model = "the header" if head.dialect.header else f"the first row, line {head.first_line}"
            lone = len(cells) == 1 and not is_number(cells[0])
            remark = "; leave it out of the file, or begin it with #, if it is a remark" if lone else ""
            remark = _other_table(block[ends[index] - lengths[index] :], line + index, head.dialect) or remark
            raise LogError(
                f"{head.path}, line {line + index}: found {len(cells)} columns{last_line}, "
                f"expected {len(head.names)} as in {model}{remark}"
            )
    return [int(line + index) for index in np.flatnonzero(blank)], len(ends)


def _other_table(below: bytes, line: int, dialect: Dialect) -> str:
    """What to do about a table of another header that begins among the lines from `line` on; "" where none
    does."""
    lines = [decoded(raw) for raw in below.split(b"\n", DEEPEST)[:DEEPEST]]
    names = names_below(lines, replace(dialect, delimiter=None))
    return (
        ""
        if names is None
        else f"; another table begins in line {line + names}: save each in a file of its own, or join them"
    )


def _parse(
    head: Head,
    block: bytes,
    line: int,
    rows: int,
    columns: list[int],
    key: int | None,
    dated: Collection[int],
) -> tuple[dict[int, Any], Any]:
    """Columns of a block of `rows` as numbers, NaN where a cell is none, and the key column as text."""
    if key is None and not dated and (plain := _plain(head, block, rows)) is not None:
        return {column: plain[:, column].copy() for column in columns}, None
    import pandas as pd

    truths = {column for column in columns if head.first(column).casefold() in ("true", "false")}
    wanted: dict[Any, Any] = {k: str if k in dated or k in truths else np.float64 for k in columns}
    if key is not None:
        wanted[key] = str
    options: dict[str, Any] = {
        "header": None, "index_col": False, "usecols": sorted(wanted), "sep": head.dialect.delimiter,
        "decimal": head.dialect.decimal, "skipinitialspace": True, "encoding_errors": "replace",
        "engine": "c",
        "keep_default_na": False,  # or experiments that are called NA and None would be one
    }  # fmt: skip
    if tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1):
        options["float_precision"] = "round_trip"  # later versions read every float to the last bit as it is
    try:
        frame = pd.read_csv(io.BytesIO(block), dtype=wanted, **options)
    except ValueError:  # some cell is no number: it matters only when its row is used
        try:
            frame = pd.read_csv(io.BytesIO(block), dtype=str, **options)
        except ValueError as error:
            raise _not_a_row_a_line(head, block, line, str(error)) from None
    if len(frame) != rows or not wanted.keys() <= set(frame):
        raise _not_a_row_a_line(head, block, line, f"{len(frame)} rows on {rows} lines")
    numbers: dict[int, Any] = {}
    for column in columns:
        cells = frame[column]
        if column in dated:
            numbers[column] = seconds_since(head.first(column), cells.fillna("").tolist())
        elif cells.dtype != np.float64:
            numbers[column] = np.array([to_number(c, str(head.dialect.decimal)) for c in cells.fillna("")])
        else:
            numbers[column] = cells.to_numpy(np.float64)
    texts = frame[key].str.strip().to_numpy(object) if key is not None else None
    for column, values in numbers.items():
        if (none := np.abs(values) >= NO_NUMBER).any():
            numbers[column] = np.where(none, np.nan, values)
    return numbers, texts


def _plain(head: Head, block: bytes, rows: int) -> np.ndarray | None:
    """(rows, columns) of a small block of nothing but finite numbers with decimal points; None of any other,
    which pandas reads. Both read each number to its last bit."""
    delimiter, width = str(head.dialect.delimiter).encode(), len(head.names)
    if len(block) > SMALL or head.dialect.decimal != "." or delimiter not in (b",", b";", b"\t"):
        return None
    if block.translate(None, PLAIN + delimiter):
        return None
    cells = block.rstrip().replace(b"\r\n", b"\n").replace(b"\n", delimiter).split(delimiter)
    if len(cells) != rows * width:
        return None
    try:
        numbers = np.fromiter(map(float, cells), np.float64, len(cells)).reshape(rows, width)
    except ValueError:
        return None
    return numbers if (np.abs(numbers) < NO_NUMBER).all() else None


def _not_a_row_a_line(head: Head, block: bytes, line: int, said: str) -> LogError:
    """What to say of a block that is no table of one row a line: a quote that goes on over lines would
    swallow their rows."""
    odd = next((index for index, row in enumerate(block.split(b"\n")) if row.count(b'"') % 2), None)
    where = ": found no table" if odd is None else f", line {line + odd}: found a quote that is not closed"
    return LogError(f"{head.path}{where} ({said}), expected one row a line")
