"""A file of text as its bytes: packed or not, in UTF-16, what it is when it is no text, and whether it stays
the same."""

import bz2
import codecs
import gzip
import hashlib
import io
import lzma
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from sysid.tables.ruled import is_ruled, unruled
from sysid.tables.workbook import NoWorkbook, as_text, file_of, is_workbook, sheets

LONGEST = (
    1 << 24
)  # bytes in a line above the rows: a hundred thousand columns fit, a file without line ends is told early
# What a file is, told by its first bytes, not by its name.
PACKED: dict[bytes, Callable[..., Any]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\x00": lzma.open,
}
FOREIGN = {
    b"PK\x03\x04": "a zip archive",
    b"\xd0\xcf\x11\xe0": "a workbook of an old kind (.xls), or with a password",
    codecs.BOM_UTF32_LE: "UTF-32 text",
    b"SQLite format 3": "a database (SQLite)",
    b"CDF\x01": "a netCDF file of version 3",
    b"CDF\x02": "a netCDF file of version 3",
    b"<?xml": "XML",
    b"<html": "a web page",
    b"<!DOCTYPE": "a web page",
    b"{\\rtf": "formatted text (.rtf)",
    b"\x80\x04\x95": "a pickle of Python, which is never opened",
    b"\x80\x05\x95": "a pickle of Python, which is never opened",
}
NEAR = 1 << 16  # bytes in which a file that is one long line to others shows what ends its lines
DOUBLED = b"\r\r\n"  # of a line end that went through a file in text mode of Windows
# A time that a serial monitor writes before each line that it receives.
_RECEIVED = re.compile(rb"^(\d\d:\d\d:\d\d\.\d{3}) -> ", re.MULTILINE)
DAY = 86400.0
_RECEIVED_LINE = re.compile(rb"^(\d\d):(\d\d):(\d\d\.\d{3}) -> ([^\r\n]*)", re.MULTILINE)
_NAMED = re.compile(rb"\s*[^\W\d][^:=]*[:=]\s*[-+.\d]")  # a cell that says its name, as x:0.5
# The names of columns on the first line, with lines of their own in quotes; no comment that holds a quote.
_CELL = rb'(?:"[^"]{1,200}"|[^",;\t\r\n]*)'
_HEADER = re.compile(rb"(?![#%!])" + _CELL + rb"(?:[,;\t]" + _CELL + rb")*(?=\r?\n)")


def decoded(raw: bytes) -> str:
    """Text of a line, or of rows: UTF-8 or, as programs of Windows may write, its usual code page."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def code_page(raw: bytes) -> str:
    """The code page of Windows that a line which is no UTF-8 was probably written in: Japanese where two
    kana, or signs of the first level, stand side by side; Chinese where all signs are of two bytes, some
    below those of Russian letters; Russian where most letters are such; else Western."""
    if re.search(rb"(?:[\x82\x83\x88-\x97][\x40-\x7e\x80-\xfc]){2}", raw) and _decodes(raw, "cp932"):
        return "cp932"
    runs = re.findall(rb"[\x80-\xff]+", raw)
    if (
        all(len(run) % 2 == 0 for run in runs)
        and re.search(rb"[\xb0-\xf7][\xa1-\xb7]", raw)
        and _decodes(raw, "gbk")
    ):
        return "gbk"
    letters = re.findall(rb"[A-Za-z\x80-\xff]", raw)
    return "cp1251" if 2 * sum(letter >= b"\xc0" for letter in letters) > len(letters) else "cp1252"


def _decodes(raw: bytes, encoding: str) -> bool:
    try:
        raw.decode(encoding)
    except UnicodeDecodeError:
        return False
    return True


class LogError(ValueError):
    """Unusable input: the message names file, line or column, what was found and what was expected.

    `mapping` is a mapping file (TOML text) to start from when the file was not understood, else None.
    """

    def __init__(self, message: str, mapping: str | None = None) -> None:
        super().__init__(message.replace("\n", "\\n"))  # one line: the name of a file may hold a line end
        self.mapping = mapping


@contextmanager
def unchanged(path: str) -> Iterator[None]:
    """Raise LogError when the file is another one, or of another length or time, at the end of the block."""
    before = os.stat(file_of(path))
    yield
    refuse_changed(path, before)


def refuse_changed(path: str, before: os.stat_result) -> None:
    """Raise LogError when the file is another one than it was, or of another length or time."""
    after = os.stat(file_of(path))
    if any(getattr(before, name) != getattr(after, name) for name in ("st_ino", "st_size", "st_mtime_ns")):
        raise LogError(
            f"{path}: found that it changed while it was read, expected a log that is written to its end"
        )


def open_text(path: str) -> BinaryIO:
    """The file's bytes, decompressed when they are packed. A file that is no text: LogError."""
    with open(file := file_of(path), "rb") as raw:
        first = raw.read(NEAR)
        padded = b"\n" in first and raw.seek(-1, os.SEEK_END) and raw.read() == b"\0"
    if is_workbook(file, first):
        return _from_workbook(path)
    if found := next((name for mark, name in FOREIGN.items() if first.startswith(mark)), None):
        raise LogError(f"{path}: found {found}, expected a text table; save it as CSV (UTF-8)")
    if first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _from_utf16(path)
    opener = next((opener for mark, opener in PACKED.items() if first.startswith(mark)), None)
    returns = b"\r" in first and (b"\n" not in first or DOUBLED in first)
    broken = first.partition(b"\n")[0].count(b'"') % 2 == 1
    if opener is None and (returns or padded or broken or _RECEIVED.match(first) or is_ruled(first)):
        return _from_lines(path)
    return (opener or open)(path, "rb")


def is_packed(path: str) -> bool:
    """Whether what a file unpacks to may be larger than it is by any factor."""
    with open(file_of(path), "rb") as file:
        return file.read(20).startswith(tuple(PACKED))


def digest(path: str) -> str:
    """sha256 of a file's bytes; of a sheet that of this and its name."""
    with open(file := file_of(path), "rb") as raw:
        found = hashlib.file_digest(raw, "sha256").hexdigest()
    return found if file == path else hashlib.sha256(f"{found} {path[len(file) :]}".encode()).hexdigest()


def parts(path: str) -> list[str]:
    """The paths of what is to be read of a file: itself, or each sheet of a workbook. One that cannot be read
    is refused as it is opened."""
    try:
        return sheets(path)
    except (NoWorkbook, OSError):
        return [path]


def _from_workbook(path: str) -> BinaryIO:
    """The text of its sheets, whole in memory."""
    try:
        return io.BytesIO(as_text(path))
    except NoWorkbook as error:
        raise LogError(f"{path}: {error}") from None


def _from_utf16(path: str) -> BinaryIO:
    """The text as UTF-8, whole in memory: spreadsheets save it so, which hold a million rows."""
    try:
        with open(path, encoding="utf-16", newline="") as file:
            return io.BytesIO(file.read().encode())
    except UnicodeError as error:
        raise LogError(
            f"{path}: found damaged UTF-16 text ({error}), expected a text table; save it as CSV"
        ) from None


def _from_lines(path: str) -> BinaryIO:
    """The text with line feeds where it has carriage returns alone, of a Macintosh, the times of a serial
    monitor as a column, a header whose cells have lines of their own on the last of them, and without returns
    that were written twice, the zero bytes of a file that a logger laid out beforehand, and what is drawn
    around cells; whole in memory."""
    with open(path, "rb") as file:
        text = file.read().rstrip(b"\0").replace(DOUBLED, b"\r\n")
    text = text if b"\n" in text else text.replace(b"\r", b"\n")
    if _RECEIVED.match(text):
        first = text.partition(b"\n")[0]
        mark = next((mark for mark in (b",", b";", b"\t") if mark in first), b" ")
        cells = _RECEIVED.sub(b"", first).strip().split(mark)
        if all(_NAMED.match(cell) for cell in cells):
            text = _clocked(text, mark)
        else:
            text = _RECEIVED.sub(rb"\1" + mark, text)
            text = b"timestamp" + text[text.index(mark) :] if re.search(rb"[A-Za-z]", first) else text
    header = _HEADER.match(text := text.removeprefix(codecs.BOM_UTF8))
    if header and (lines := header[0].count(b"\n")):
        text = b"\n" * lines + re.sub(rb"\s*\n\s*", b" ", header[0]) + text[header.end() :]
    return io.BytesIO(unruled(text) if is_ruled(text[:NEAR]) else text)


def _clocked(text: bytes, mark: bytes) -> bytes:
    """Lines of cells that say their names, the time of a serial monitor, which goes on past midnight, as the
    last of them; without those on which nothing was received."""
    last, days = 0.0, 0

    def clocked(line: re.Match[bytes]) -> bytes:
        nonlocal last, days
        hours, minutes, seconds = (float(part) for part in line.groups()[:3])
        now = 3600 * hours + 60 * minutes + seconds
        days, last = days + (now < last - DAY / 2), now
        return line[4] + mark + f"timestamp_s:{now + DAY * days:.3f}".encode() if line[4].strip() else b""

    return _RECEIVED_LINE.sub(clocked, text)


def read_line(path: str, file: BinaryIO, number: int) -> bytes:
    """The next line, b"" at the end. One of unreasonable length: LogError."""
    raw = file.readline(LONGEST)
    if len(raw) == LONGEST and not raw.endswith(b"\n"):
        raise LogError(
            f"{path}, line {number}: found more than {LONGEST} bytes without a line end, expected lines of"
            f" text"
        )
    return raw


def refuse_binary(path: str, raw: bytes, number: int) -> None:
    """Raise LogError where the line `number` is not text of UTF-8 with line feeds."""
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):  # of a packed file
        raise LogError(f"{path}: found UTF-16 text, expected UTF-8; save it again as CSV (UTF-8)")
    if b"\x00" in raw:
        raise LogError(f"{path}, line {number}: found binary data, expected a text table (CSV)")
    if b"\r" in raw.rstrip(b"\r\n"):
        raise LogError(
            f"{path}, line {number}: found a carriage return alone, expected lines that end in a line feed"
        )
