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


def without_end(blocks: Iterator[bytes], delimiter: str, ends: bool) -> Iterator[bytes]:
    """The blocks without what is no row below the last one: delimiters and blanks alone, and the END that a
    preamble began (`ends`)."""
    nothing = f" \t\r\n{delimiter}".encode()
    held = b""  # until something follows: only the file's end tells which row is the last
    for block in blocks:
        if held and block.strip(nothing):
            yield held
            held = block
        else:
            held += block
    held = held[: _end_of_line(held, len(held.rstrip(nothing)))]
    above, _, last = held.rstrip().rpartition(b"\n")
    if ends and re.fullmatch(rb"[A-Za-z][\w ]*", last):
        held = above + b"\n" if above else b""
    held = held[: _end_of_line(held, len(held.rstrip(nothing)))]
    if held.strip(nothing):
        yield held


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
