"""A text table as it lies on the disk: comments, header, dialect and numbers. It knows lines and cells, no physics.

`read_head` reads down to the first row, `read_body` then the wanted columns, in blocks, so that memory is bounded by
the numbers themselves. What cannot be read ends in a `LogError` that names the file, the line and the column.
"""

import hashlib
import io
import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np

from sysid.cells import GROUPED, WHITESPACE, Dialect, find_delimiter, is_date, is_number, split_line, to_number, with_unit_cells
from sysid.preamble import DEEPEST, find_top, header_line, is_table, left_out
from sysid.textfile import LogError, open_text, read_line, refuse_binary

BLOCK = 1 << 24  # bytes parsed at a time
SAMPLE = 50  # lines below the header that tell how the numbers are written


@dataclass(frozen=True)
class Head:
    """A table's file down to its first row."""

    path: str
    metadata: dict[str, str]
    repeated: frozenset[str]  # metadata keys that stand there twice, capitals aside, with different values
    names: tuple[str, ...]  # as in the header; "" where the header has nothing; empty texts when there is no header
    dialect: Dialect  # with nothing left open
    start: int  # byte in the (decompressed) file where the rows begin
    first_line: int  # line number of that byte, counted from 1
    sample: tuple[tuple[str, ...], ...]  # the first rows as text
    notes: tuple[str, ...] = ()
    preamble: bool = False  # whether lines without a comment mark stand above the header

    @property
    def name(self) -> str:
        return Path(self.path).name.replace("\n", " ")


@dataclass(frozen=True)
class Body:
    """The wanted columns: `numbers[index]` is (n,) float64 with NaN where a cell is no number; `keys` is (n,) text."""

    numbers: dict[int, np.ndarray]
    keys: np.ndarray | None
    sha256: str
    blank_lines: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return len(next(iter(self.numbers.values())))

    def line(self, head: Head, row: int) -> int:
        """Line number, counted from 1, of a row counted from 0."""
        number = head.first_line + row
        for blank in self.blank_lines:
            number += blank <= number
        return number


def read_head(path: str, dialect: Dialect) -> Head:
    """Metadata, column names and dialect of the file at `path`. Raises LogError when there is no table in it."""
    notes: list[str] = []
    with open_text(path) as file:
        comments, line, raw, number, encoding = _read_comments(path, file, dialect, notes)
        start = file.tell() - len(raw)
        raws = [raw, *_read_lines(path, file, number, SAMPLE)]
        lines = [line, *(text.decode("utf-8", errors="replace") for text in raws[1:])]
        top = None
        if dialect.skip is None and dialect.header is not False and not is_table(lines, dialect):
            raws += _read_lines(path, file, number + SAMPLE, DEEPEST - SAMPLE)
            lines += [text.decode("utf-8", errors="replace") for text in raws[len(lines) :]]
            top = find_top(lines, dialect)
    if top:
        if top.names:
            lines[top.names] = _decoded(raws[top.names], encoding, number + top.names, notes)[0]
        notes += left_out(lines, number, top)
        line, above = header_line(lines, top), top.names + top.units + 1
        dialect = replace(dialect, delimiter=top.delimiter)
    else:
        line, above, comments = _usual_header(lines, comments, dialect)
    delimiter = dialect.delimiter or find_delimiter(line.strip() or lines[above])
    rows = tuple(tuple(split_line(text, delimiter)) for text in lines[above : above + SAMPLE] if text.strip())
    if not rows:
        raise LogError(f"{path}: found a header and no rows, expected at least one row of numbers")
    names = tuple(name.strip() for name in split_line(line, delimiter)) if line else ("",) * len(rows[0])
    while names and not names[-1] and line:
        names = names[:-1]
    if not names:
        raise LogError(f"{path}: found a header without a name, expected names such as time_s")
    metadata, repeated = _metadata(comments)
    decimal = dialect.decimal or _find_decimal(path, rows, delimiter)
    known = Dialect(delimiter, dialect.comment, decimal, bool(line))
    start += sum(map(len, raws[:above]))
    return Head(path, metadata, repeated, names, known, start, number + above, rows, tuple(notes), bool(top and top.names))


def read_body(head: Head, columns: list[int], key: int | None = None) -> Body:
    """The columns at `columns` as numbers and the one at `key` as text; every row must have its number of cells."""
    joined: dict[int, np.ndarray] = {column: np.empty(0) for column in columns}
    keys: list[Any] = []
    blank_lines: list[int] = []
    line = head.first_line
    with open(head.path, "rb") as raw:
        digest = hashlib.file_digest(raw, "sha256").hexdigest()
    with open_text(head.path) as file:
        file.seek(head.start)
        for block in _without_end(_blocks(file, head.dialect.delimiter == WHITESPACE), head):
            blank, count = _check_counts(head, block, line)
            blank_lines += blank
            if rows := count - len(blank):
                numbers, texts = _parse(head, block, line, rows, columns, key)
                for column, known in joined.items():  # longer in place: the numbers are in memory once
                    known.resize(len(known) + rows, refcheck=False)
                    known[-rows:] = numbers[column]
                keys.append(texts)
            line += count
    if not keys:
        raise LogError(f"{head.path}: found no rows, expected at least one row of numbers")
    return Body(joined, np.concatenate(keys) if key is not None else None, digest, blank_lines)


def refuse_cell(head: Head, body: Body, row: int, column: int, expected: str) -> NoReturn:
    """Raise the LogError of one bad cell: what stands there is read again from the file."""
    label = head.names[column] or column
    number = body.line(head, row)
    with open_text(head.path) as file:
        text = next(itertools.islice(file, number - 1, None), b"").decode("utf-8", errors="replace")
    cell = "".join(split_line(text, str(head.dialect.delimiter))[column : column + 1]).strip()
    found = f"a date {cell!r}" if is_date(cell) else repr(cell) if cell else "an empty cell"
    last = "" if text.endswith("\n") else " (the last line, without a line end: was the file still being written?)"
    mark = " with a decimal comma" if head.dialect.decimal == "," and "." in cell else ""
    if is_date(cell):
        mark += "; of a time, write the seconds since the first row"
    elif expected == "a finite number":  # of an experiment's rows the numbers are its own
        mark += _without(row, len(body) if body.keys is None else 0)
    raise LogError(f"{head.path}, line {number}, column {label!r}: found {found}{last}, expected {expected}{mark}")


def _read_comments(path: str, file: BinaryIO, dialect: Dialect, notes: list[str]) -> tuple[list[str], str, bytes, int, str]:
    """The comments at the top; the first line below them as text, as bytes and by its number; the encoding of those below it."""
    comments: list[str] = []
    number, skip, encoding = 0, dialect.skip or 0, "utf-8-sig"
    while raw := read_line(path, file, number + 1):
        number += 1
        if number <= skip:
            continue
        refuse_binary(path, raw, number)
        line, encoding = _decoded(raw, encoding, number, notes)
        if line.startswith(dialect.comment):
            comments.append(line[len(dialect.comment) :].strip())
        elif line.replace(",", "").replace(";", "").strip():
            return comments, line, raw, number, encoding
    if skip and number:
        raise LogError(f"{path}: found {number} lines and no table below the {skip} that skip leaves out, expected rows")
    raise LogError(f"{path}: found {'only comment lines' if comments else 'an empty file'}, expected rows")


def _read_lines(path: str, file: BinaryIO, number: int, count: int) -> list[bytes]:
    """The lines below line `number`, where the file stands: `count` of them, or fewer at its end."""
    return list(itertools.takewhile(bool, (read_line(path, file, number + k) for k in range(1, count + 1))))


def _decoded(raw: bytes, encoding: str, number: int, notes: list[str]) -> tuple[str, str]:
    """A line as text, and the encoding of the lines below it; `notes` gets one where that is not UTF-8."""
    try:
        line = raw.decode(encoding)
    except UnicodeDecodeError:
        encoding = "cp1252"
        line = raw.decode(encoding, errors="replace")
        notes.append(f"line {number} is not UTF-8: read as Windows-1252")
    return line, encoding.removesuffix("-sig")


def _usual_header(lines: list[str], comments: list[str], dialect: Dialect) -> tuple[str, int, list[str]]:
    """The header of a table that begins with the first line ("": none), how many lines are above its rows, and the comments."""
    if dialect.header is False or (dialect.header is None and _holds_numbers(lines[0], dialect)):
        line, comments = _header_in_comments(comments, lines[0], dialect)
        return line, 0, comments
    if dialect.header is None and _is_unit_row(lines[0], lines[1:], dialect):
        return _with_units(lines[0], lines[1], dialect), 2, comments
    return lines[0], 1, comments


def _metadata(comments: list[str]) -> tuple[dict[str, str], frozenset[str]]:
    found: dict[str, str] = {}
    values: dict[str, set[str]] = {}
    for comment in comments:
        key, colon, value = (part.strip() for part in comment.partition(":"))
        if colon and key:
            found[key] = value
            values.setdefault(key.casefold(), set()).add(value)
    return found, frozenset(key for key in found if len(values[key.casefold()]) > 1)


def _find_decimal(path: str, rows: tuple[tuple[str, ...], ...], delimiter: str) -> str:
    """A comma when cells such as `1,5` stand in the first rows and the comma does not part the columns."""
    if delimiter == ",":
        return "."
    commas = [cell.strip() for row in rows for cell in row if "," in cell and not math.isnan(to_number(cell, ","))]
    if commas and all(map(GROUPED.fullmatch, commas)):
        raise LogError(
            f"{path}: found {commas[0]!r}, which is {commas[0].replace(',', '.')} with a decimal comma and"
            f" {commas[0].replace(',', '')} otherwise; expected that a mapping file says decimal = ',' or '.'"
        )
    return "," if commas else "."


def _holds_numbers(line: str, dialect: Dialect) -> bool:
    """Whether a line is a row, not a header: no name is a number."""
    return any(map(is_number, split_line(line, dialect.delimiter or find_delimiter(line))))


def _header_in_comments(comments: list[str], row: str, dialect: Dialect) -> tuple[str, list[str]]:
    """A last comment line with as many cells as the rows have is the header (`numpy.savetxt` writes it so)."""
    if comments and dialect.header is None:
        delimiter = dialect.delimiter or find_delimiter(row)
        width = len(split_line(row, delimiter))
        if width > 1 and len(split_line(comments[-1], delimiter)) == width:
            return comments[-1], comments[:-1]
    return "", comments


def _is_unit_row(line: str, following: list[str], dialect: Dialect) -> bool:
    """Whether the line below the header holds units: short texts and no number, where the header has names alone."""
    if not following:
        return False
    delimiter = dialect.delimiter or find_delimiter(line)
    names, units = split_line(line, delimiter), split_line(following[0], delimiter)
    bare = not any(re.search(r"[_\[(]", name) for name in names)
    texts = [unit.strip() for unit in units if unit.strip()]
    return bare and len(names) == len(units) and bool(texts) and not any(map(is_number, texts))


def _with_units(line: str, units: str, dialect: Dialect) -> str:
    delimiter = dialect.delimiter or find_delimiter(line)
    return with_unit_cells(split_line(line, delimiter), split_line(units, delimiter), delimiter)


def _without(row: int, count: int) -> str:
    """How to do without one row of so many; 0: a mapping file counts them otherwise."""
    ranges = [edges for edges in ([0, row], [row + 1, count]) if edges[0] < edges[1]]
    others = f", or read the others by rows = {ranges} in a mapping file" if row < count and ranges else ""
    return f"; leave the row out of the file{others}"


def _blocks(file: BinaryIO, whitespace: bool) -> Iterator[bytes]:
    """The rest of the file in pieces that end at a line end."""
    rest = b""
    while chunk := file.read(BLOCK):
        whole, end, rest = (rest + chunk).rpartition(b"\n")
        if end:
            yield _single_blanks(whole + end) if whitespace else whole + end
        else:
            rest = whole + rest
    if rest:
        yield _single_blanks(rest) if whitespace else rest


def _without_end(blocks: Iterator[bytes], head: Head) -> Iterator[bytes]:
    """The blocks without what is no row below the last one: delimiters and blanks alone, and the END that a preamble began."""
    nothing = f" \t\r\n{head.dialect.delimiter}".encode()
    held = b""  # until something follows: only the file's end tells which row is the last
    for block in blocks:
        if held and block.strip(nothing):
            yield held
            held = block
        else:
            held += block
    held = held[: _end_of_line(held, len(held.rstrip(nothing)))]
    above, _, last = held.rstrip().rpartition(b"\n")
    if head.preamble and re.fullmatch(rb"[A-Za-z][\w ]*", last):
        held = above[: len(above.rstrip(nothing))] + b"\n"
    if held.strip(nothing):
        yield held


def _end_of_line(block: bytes, place: int) -> int:
    """Where the line that holds the byte before `place` ends."""
    return (block.find(b"\n", place) + 1 or len(block)) if place else 0


def _single_blanks(block: bytes) -> bytes:
    return re.sub(rb"(?m)^ | (?=\r?$)", b"", re.sub(rb"[ \t]+", b" ", block))


def _check_counts(head: Head, block: bytes, line: int) -> tuple[list[int], int]:
    """The blank lines' numbers and the count of lines in `block`, which begins at `line`. Odd rows: LogError."""
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
        raise LogError(f"{head.path}, line {line + index}: found a carriage return alone, expected lines that end in a line feed")
    spare = (counts == len(head.names)) & (last == ord(str(head.dialect.delimiter)))
    for index in map(int, np.flatnonzero(~blank & (counts != len(head.names) - 1) & ~spare)):
        row = bytes(text[ends[index] - lengths[index] : ends[index] + 1]).decode("utf-8", errors="replace")
        cells = split_line(row, str(head.dialect.delimiter))
        if len(cells) < len(head.names) or any(cell.strip() for cell in cells[len(head.names) :]):
            unfinished = index == len(ends) - 1 and not block.endswith(b"\n")
            last_line = " (the last line, without a line end: was the file still being written?)" if unfinished else ""
            model = "the header" if head.dialect.header else f"the first row, line {head.first_line}"
            remark = "; leave it out of the file if it is a remark" if _is_remark(row, cells, head) else ""
            raise LogError(
                f"{head.path}, line {line + index}: found {len(cells)} columns{last_line}, "
                f"expected {len(head.names)} as in {model}{remark}"
            )
    return [int(line + index) for index in np.flatnonzero(blank)], len(ends)


def _is_remark(row: str, cells: list[str], head: Head) -> bool:
    """Whether a line among the rows looks like words, not like a row."""
    return row.startswith(head.dialect.comment) or (len(cells) == 1 and not is_number(cells[0]))


def _parse(head: Head, block: bytes, line: int, rows: int, columns: list[int], key: int | None) -> tuple[dict[int, Any], Any]:
    """Columns of a block of `rows` as numbers, NaN where a cell is none, and the key column as text."""
    import pandas as pd

    wanted: dict[Any, Any] = dict.fromkeys(columns, np.float64)
    if key is not None:
        wanted[key] = str
    options: dict[str, Any] = {
        "header": None, "index_col": False, "usecols": sorted(wanted), "sep": head.dialect.delimiter,
        "decimal": head.dialect.decimal, "skipinitialspace": True, "encoding_errors": "replace", "engine": "c",
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
    for column in columns:
        if frame[column].dtype != np.float64:
            frame[column] = [to_number(cell, str(head.dialect.decimal)) for cell in frame[column].fillna("")]
    texts = frame[key].str.strip().to_numpy(object) if key is not None else None
    return {column: frame[column].to_numpy(np.float64) for column in columns}, texts


def _not_a_row_a_line(head: Head, block: bytes, line: int, said: str) -> LogError:
    """What to say of a block that is no table of one row a line: a quote that goes on over lines would swallow their rows."""
    odd = next((index for index, row in enumerate(block.split(b"\n")) if row.count(b'"') % 2), None)
    where = ": found no table" if odd is None else f", line {line + odd}: found a quote that is not closed"
    return LogError(f"{head.path}{where} ({said}), expected one row a line")
