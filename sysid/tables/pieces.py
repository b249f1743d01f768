"""The rows of a file in pieces of bounded size, without what stands among and below them that is no row.

A logger that is started anew, and an instrument that writes block after block, repeat the header: there a
table of its own begins. The lines from the last row above such a header to the first below it are a `Gap`.
"""

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import BinaryIO, NamedTuple

from sysid.tables.cells import is_number, split_line
from sysid.tables.stamps import is_stamp

DEEPEST = 200  # lines of a gap, above its header and below
_END = re.compile(rb"[A-Za-z][\w ]*")
NEAR = 1 << 16  # bytes above a repeated header in which its gap begins


class Gap(NamedTuple):
    """Lines that are no rows around a header that stands again: bytes `start` to `end`, from line `line`
    (from 1) on."""

    start: int
    end: int
    line: int
    lines: int
    text: bytes


class Rows(NamedTuple):
    """What tells a row from other lines: how cells are parted, and which cells of the first row are numbers
    or dates."""

    delimiter: str
    width: int
    numbers: tuple[int, ...]
    before: tuple[int, ...] = ()  # empty cells before the first number

    def holds(self, raw: bytes) -> bool:
        """Whether a line has a number where the first row has its first, and no word before it where that has
        nothing."""
        cells = self._cells(raw)
        words = any(cells[k].strip() and not _is_value(cells[k]) for k in self.before if k < len(cells))
        return not words and all(len(cells) > k and _is_value(cells[k]) for k in self.numbers[:1])

    def is_like(self, raw: bytes) -> bool:
        """Whether a line has as many cells as the first row, and a number where that has one: a row, if a bad
        one."""
        cells = self._cells(raw)
        return len(cells) == self.width and any(_is_value(cells[k]) for k in self.numbers)

    def is_blank(self, raw: bytes) -> bool:
        """Whether a line holds delimiters and blanks alone."""
        return not raw.strip(f" \t\r\n{self.delimiter}".encode())

    def is_apart(self, raw: bytes) -> bool:
        """Whether a line of text is no row, not even a part of one: of another width, without a number."""
        cells, text = self._cells(raw), raw.decode("utf-8", errors="replace").strip()
        words = text.isprintable() and any(map(str.isalpha, text))
        return words and len(cells) != self.width and not any(map(_is_value, cells))

    def _cells(self, raw: bytes) -> list[str]:
        return split_line(raw.decode("utf-8", errors="replace"), self.delimiter)


def rows_like(first: Sequence[str], delimiter: str) -> Rows:
    """What tells rows like the `first` from other lines: how many cells, and which of them are numbers."""
    numbers = tuple(k for k, cell in enumerate(first) if _is_value(cell))
    before = tuple(k for k in range(next(iter(numbers), 0)) if not first[k].strip())
    return Rows(delimiter, len(first), numbers, before)


def find_gaps(file: BinaryIO, header: bytes, start: int, line: int, rows: Rows, size: int) -> list[Gap]:
    """Where `header` stands again below byte `start`, which begins line `line`; the file is read `size` bytes
    at a time."""
    gaps: list[Gap] = []
    for place in list(_repeats(file, header, start, size)) if header else ():
        if place >= start:
            first, end = _edges(file, start, place, rows)
            line += _lines(file, start, first, size)
            gaps.append(Gap(first, end, line, *_text(file, first, end)))
            start, line = end, line + gaps[-1].lines
    return gaps


def pieces(file: BinaryIO, size: int, whitespace: bool, gaps: Sequence[Gap] = ()) -> Iterator[bytes]:
    """The rest of the file in pieces that end at a line end; the lines of gaps are blank."""
    place, rest = file.tell(), b""
    while chunk := file.read(size):
        whole, end, rest = (rest + chunk).rpartition(b"\n")
        if end:
            yield _cleaned(whole + end, place, whitespace, gaps)
            place += len(whole + end)
        else:
            rest = whole + rest
    if rest:
        yield _cleaned(rest, place, whitespace, gaps)


def without_remarks(
    blocks: Iterator[bytes], marks: tuple[bytes, ...], line: int, remarks: list[tuple[int, str]]
) -> Iterator[bytes]:
    """The blocks, which begin at line `line`, with lines that begin with one of `marks` blank: comments,
    which are put into `remarks` with their lines' numbers."""
    comment = re.compile(rb"(?m)^(?:" + b"|".join(map(re.escape, marks)) + rb")[^\r\n]*")
    for block in blocks:
        for found in comment.finditer(block) if any(mark in block for mark in marks) else ():
            text = found[0].decode("utf-8", errors="replace").strip()
            remarks.append((line + block.count(b"\n", 0, found.start()), text))
        line += block.count(b"\n")
        yield comment.sub(b"", block) if remarks else block


def without_end(
    blocks: Iterator[bytes], rows: Rows, ends: bool, line: int, remarks: list[tuple[int, str]]
) -> Iterator[bytes]:
    """The blocks, which begin at line `line`, without what is no row below the last one: delimiters and
    blanks alone, the END that a preamble began (`ends`), and words that are not as wide as rows, which are
    put into `remarks`."""
    held = b""  # until a row follows: only the file's end tells which is the last
    for block in blocks:
        held += block
        if end := _end_of_rows(held, rows, ends):
            yield held[:end]
            line += held.count(b"\n", 0, end)
            held = held[end:]
    for number, raw in enumerate(held.splitlines(), line):
        if raw.strip() and not rows.is_blank(raw) and not (ends and _END.fullmatch(raw.strip())):
            remarks.append((number, raw.decode("utf-8", errors="replace").strip()))


def _end_of_rows(block: bytes, rows: Rows, ends: bool) -> int:
    """Where the last line that may be a row ends: one with a number, or as wide as a row."""
    end = len(block)
    while end:
        start = block.rfind(b"\n", 0, end - 1) + 1
        raw = block[start:end]
        if not (rows.is_blank(raw) or rows.is_apart(raw) or (ends and _END.fullmatch(raw.strip()))):
            break
        end = start
    return end


def _repeats(file: BinaryIO, header: bytes, start: int, size: int) -> Iterator[int]:
    """The bytes at which lines begin that are the header."""
    file.seek(start)
    place = start
    for block in pieces(file, size, False):
        found = block.find(header)
        while found >= 0:
            first, last = block.rfind(b"\n", 0, found) + 1, _end_of_line(block, found + 1)
            if block[first:last].strip() == header:
                yield place + first
            found = block.find(header, last)
        place += len(block)


def _edges(file: BinaryIO, start: int, place: int, rows: Rows) -> tuple[int, int]:
    """The gap around the header that begins at byte `place`: from the last row above it to the first
    below."""
    near = max(start, place - NEAR)
    file.seek(near)
    above = file.read(place - near).splitlines(keepends=True)[-DEEPEST:]
    above = list(itertools.takewhile(lambda raw: not rows.holds(raw), reversed(above)))[::-1]
    first = place - sum(map(len, itertools.dropwhile(rows.is_like, above)))
    file.seek(place)
    end = place + len(file.readline())
    below = itertools.islice(iter(file.readline, b""), DEEPEST)
    return first, end + sum(map(len, itertools.takewhile(lambda raw: not rows.holds(raw), below)))


def _lines(file: BinaryIO, start: int, end: int, size: int) -> int:
    """How many lines end in the bytes from `start` to `end`."""
    file.seek(start)
    return sum(file.read(min(size, end - place)).count(b"\n") for place in range(start, end, size))


def _text(file: BinaryIO, start: int, end: int) -> tuple[int, bytes]:
    """How many lines there are from byte `start` to `end`, and their bytes."""
    file.seek(start)
    text = file.read(end - start)
    return text.count(b"\n"), text


def _cleaned(block: bytes, place: int, whitespace: bool, gaps: Sequence[Gap]) -> bytes:
    """A block that begins at byte `place`, with the lines of gaps blank, and runs of blanks as one where
    those part the cells."""
    for gap in reversed(gaps):
        first, end = max(gap.start - place, 0), min(gap.end - place, len(block))
        if first < end:
            block = block[:first] + b"\n" * block.count(b"\n", first, end) + block[end:]
    return re.sub(rb"(?m)^ | (?=\r?$)", b"", re.sub(rb"[ \t]+", b" ", block)) if whitespace else block


def _end_of_line(block: bytes, place: int) -> int:
    """Where the line that holds the byte before `place` ends."""
    return (block.find(b"\n", place) + 1 or len(block)) if place else 0


def _is_value(cell: str) -> bool:
    return is_number(cell) or is_stamp(cell)
