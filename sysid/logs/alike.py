"""Files that are alike: of one head the plan is made once, by the exact reader, and holds for all files whose
lines above the rows are the same but for the plate, its date and serial number, and constant inputs.

What is taken so is a small table of plain numbers, each line with as many cells as the header has names, by
the contract's names; every other file goes to the exact reader, and so does every log in which something is
wrong. Both read each number to its last bit.
"""

import hashlib
import os
import re
import stat
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sysid.columns.header import planned
from sysid.columns.metadata import stated
from sysid.columns.plan import Plan
from sysid.columns.timebase import SAMPLES
from sysid.logs.log import Log
from sysid.logs.opening import opened
from sysid.logs.read import log_of, logs_of, of_one_bench, read_logs, with_response
from sysid.tables import units
from sysid.tables.cells import NO_NUMBER
from sysid.tables.csvbody import PLAIN, SMALL, Body
from sysid.tables.csvfile import SAMPLE, Head, LogError
from sysid.tables.joined import parsed
from sysid.tables.textfile import refuse_changed

ENDINGS = (".csv", ".txt", ".tsv", ".dat")  # other kinds of files are told by theirs
OWN = ("plate", "date", "serial")  # metadata that each file has for itself, and that change no number
TOP = 1 << 13  # bytes of a file that hold its head and, as a rule, its first rows
MOST = 64  # patterns of files whose heads differ in numbers alone
LINE = re.compile(rb"#[ \t]*(\w+)[ \t]*:[ \t]*([!-<>-~]+(?:[ \t]+[!-<>-~]+)*)[ \t]*\r?\n", re.ASCII)
NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
MARKS = ",;\t"
INPUTS = ("time", *units.CONSTANTS)


@dataclass(frozen=True)
class _Top:
    """What stands above the rows of a file: its lines, without what may differ from file to file, which is in
    `told`, a value for each key; the byte at which its rows begin."""

    lines: bytes
    told: tuple[tuple[str, str], ...]
    start: int

    @classmethod
    def of(cls, text: bytes) -> "_Top | None":
        """That of a file that begins so; None where it is not known to be one of comments and a header."""
        lines, told, start = [], [], 0
        while text.startswith(b"#", start):
            end = text.find(b"\n", start) + 1
            if not end:
                return None
            line = text[start:end]
            found = LINE.fullmatch(line)
            if found and (found[1].lower().decode() in OWN or NUMBER.fullmatch(found[2])):
                told.append((found[1].decode(), found[2].decode()))
                line = b"#" + found[1] + b":\n"
            lines.append(line)
            start = end
        end = text.find(b"\n", start) + 1
        whole = b"".join([*lines, text[start:end]])
        keys = [key.casefold() for key, _ in told]
        distinct = len({*keys}) == len(keys)  # what a file says twice is not for us to judge
        named = text[start : start + 1].isalpha()
        return cls(whole, tuple(told), end) if end and named and distinct and whole.isascii() else None


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Files of one head: that of the first, with its `plan`, and the log that it gave; `told` as its `_Top`
    has it, of which `constants` may differ, by key, and are quantities of the plan; `cells`: the texts of the
    columns that are inputs."""

    head: Head
    plan: Plan
    log: Log
    told: tuple[tuple[str, str], ...]
    constants: dict[str, str]
    cells: dict[int, list[bytes]] = field(repr=False)

    @cached_property
    def wanted(self) -> set[int]:
        """The columns that hold something."""
        return {s.column for s in self.plan.sources.values() if s.column is not None}

    @cached_property
    def inputs(self) -> dict[int, np.ndarray]:
        """The numbers of those that are inputs."""
        return {c: np.fromiter(map(float, cells), np.float64, len(cells)) for c, cells in self.cells.items()}

    @property
    def numeric(self) -> bool:
        """Whether nothing hangs on how a number is written, as the digits of a temperature."""
        source = self.plan.sources.get("temperature")
        return source is None or source.column is None

    def holds(self, top: _Top) -> bool:
        """Whether it is that of a file with such a head."""
        both = zip(self.told, top.told, strict=True)
        return all(
            a == b or a[0].casefold() in OWN or (a[0] in self.constants and abs(float(b[1])) < NO_NUMBER)
            for a, b in both
        )

    def log_of(self, path: str, top: _Top, rows: "_Rows | _Parsed", sha256: str) -> Log | None:
        """The log of another file with such a head; None where it holds what is no plain number. Raises
        LogError."""
        own = {
            key: value for (key, value), known in zip(top.told, self.told, strict=True) if value != known[1]
        }
        others = {self.constants[key]: text for key, text in own.items() if key in self.constants}
        same = not others and rows.have(self)
        numbers: dict[int, np.ndarray] = {}
        for column in self.wanted - self.cells.keys() if same else self.wanted:
            if (found := rows.column(column)) is None:
                return None
            numbers[column] = found
        metadata, body = {**self.plan.metadata, **own}, Body(numbers, None, sha256)
        if same:
            return with_response(self.log, path, metadata, self.head, body, self.plan)
        head = replace(
            self.head,
            path=path,
            metadata=metadata,
            start=top.start,
            first_line=top.lines.count(b"\n") + 1,
            sample=rows.sample,
        )
        sources = self.plan.sources | {
            quantity: replace(self.plan.sources[quantity], constant=float(text), written=text)
            for quantity, text in others.items()
        }
        return log_of(head, body, replace(self.plan, metadata=metadata, sources=sources))


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a small table of plain cells, `width` in each, one after the other."""

    cells: list[bytes]
    width: int

    @classmethod
    def of(cls, text: bytes, delimiter: bytes, width: int) -> "_Rows | None":
        """Those of a text; None where a line has another number of cells, or something looks like no
        number."""
        if (plain := _plain(text, delimiter, width)) is None:
            return None
        return cls(plain.replace(b"\n", delimiter).split(delimiter), width)

    def have(self, pattern: _Pattern) -> bool:
        """Whether their inputs are those of the pattern."""
        return all(self.cells[c :: self.width] == known for c, known in pattern.cells.items())

    def column(self, index: int) -> np.ndarray | None:
        """(n,) numbers; None where a cell is none."""
        cells = self.cells[index :: self.width]
        try:
            found = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            return None
        return found if (np.abs(found) < NO_NUMBER).all() else None

    @property
    def sample(self) -> tuple[tuple[str, ...], ...]:
        """The first rows as text."""
        texts = [cell.decode() for cell in self.cells[: SAMPLE * self.width]]
        edges = range(0, len(texts) + 1, self.width)
        return tuple(tuple(texts[a:b]) for a, b in pairwise(edges))


@dataclass(frozen=True, eq=False)
class _Parsed:
    """The rows of such a table, parsed together with others: the columns that hold something; its text."""

    columns: dict[int, np.ndarray]
    text: bytes
    delimiter: bytes

    def have(self, pattern: _Pattern) -> bool:
        """As that of `_Rows`."""
        return all(np.array_equal(self.columns[c], known) for c, known in pattern.inputs.items())

    def column(self, index: int) -> np.ndarray | None:
        """As that of `_Rows`."""
        found = self.columns[index]
        return found if (np.abs(found) < NO_NUMBER).all() else None

    @property
    def sample(self) -> tuple[tuple[str, ...], ...]:
        """The first rows as text."""
        lines = self.text.split(b"\n", SAMPLE)[:SAMPLE]
        return tuple(tuple(cell.decode() for cell in line.split(self.delimiter)) for line in lines)


class _File(NamedTuple):
    """A file of a known head, as it was on the disk `before` it was read: what is `below` its head."""

    path: str
    before: os.stat_result
    top: _Top
    pattern: _Pattern
    below: bytes
    sha256: str

    @property
    def form(self) -> tuple[bytes, int]:
        """What parts the cells of a line, and how many of them there are."""
        return str(self.pattern.head.dialect.delimiter).encode(), len(self.pattern.head.names)


class Alike:
    """Reads files as `read_logs` does, those quickly that are like one that it has read before."""

    def __init__(self) -> None:
        self.known: dict[bytes, list[_Pattern]] = {}
        self.met: set[bytes] = set()  # heads, of which the second makes a pattern: most may be there once
        self.strange: set[bytes] = set()  # those that are always for the exact reader
        self.waiting: dict[str, tuple[_File, _Parsed]] = {}  # what was read ahead

    def read(self, paths: Sequence[str]) -> list[Log]:
        """The logs of one plate, as `read_logs` gives them. Raises LogError."""
        try:
            logs = [self._log(path) for path in paths]
        except (LogError, OSError):  # the exact reader finds it again, and says what it is
            return read_logs(paths)
        found = [log for log in logs if log is not None]
        if len(found) < len(paths) or len({log.sha256 for log in found}) < len(paths):
            return read_logs(paths)
        return of_one_bench(found)

    def ahead(self, paths: Sequence[str]) -> None:
        """Parse files of known heads together, which `read` then takes over, if they are as they were."""
        files: dict[_Pattern, list[_File]] = {}
        self.waiting = {}
        for path in paths:
            with suppress(LogError, OSError):  # `read` finds it again
                if (file := self._file(path)) is not None and file.pattern.numeric:
                    files.setdefault(file.pattern, []).append(file)
        for pattern, some in files.items():
            mark, width = some[0].form
            each = [(file, plain) for file in some if (plain := _plain(file.below, mark, width)) is not None]
            if not each:
                continue
            with suppress(ImportError, ValueError):  # each by itself, then
                mark, width = some[0].form
                found = (
                    parsed([plain for _, plain in each], mark.decode(), width, pattern.wanted) if each else ()
                )
                for (file, plain), columns in zip(each, found, strict=True):
                    self.waiting[file.path] = file, _Parsed(columns, plain, mark)

    def plate(self, path: str) -> tuple[str | None, bool]:
        """The plate that a file states, and whether it is surely one that can be read down to its first rows:
        else the exact reader has to tell."""
        unsure = None, False
        if not _is_small_text(path):
            return unsure
        try:
            with open(path, "rb") as file:
                text = file.read(TOP)
        except OSError:
            return unsure
        whole = len(text) < TOP
        text = text if whole else text[: text.rfind(b"\n") + 1]
        if (top := _Top.of(text)) is None or (pattern := self._pattern(path, top)) is None:
            return unsure
        below = text[top.start :].split(b"\n", SAMPLE)
        if len(below) <= SAMPLE and not whole:
            return unsure
        rows = _rows(b"\n".join(below[:SAMPLE]), pattern.head)
        if rows is None or _Rows(rows.cells[: rows.width], 1).column(0) is None:
            return unsure
        if rows.column(rows.width - 1) is None:  # most of which are words in a table that lies across
            return unsure
        return stated({**pattern.plan.metadata, **dict(top.told)}, "plate"), True

    def _log(self, path: str) -> Log | None:
        """The log of one file; None where it is for the exact reader."""
        file, known = self.waiting.pop(path, None) or (self._file(path), None)
        if file is None or (rows := known or _Rows.of(file.below, *file.form)) is None:
            return None
        with np.errstate(all="ignore"):
            log = file.pattern.log_of(path, file.top, rows, file.sha256)
        refuse_changed(path, file.before)
        return log

    def _file(self, path: str) -> _File | None:
        """One file; None where it is for the exact reader."""
        if not _is_small_text(path):
            return None
        before = os.stat(path)
        with open(path, "rb") as file:
            text = file.read()
        if (top := _Top.of(text)) is None or (pattern := self._pattern(path, top)) is None:
            return None
        return _File(path, before, top, pattern, text[top.start :], hashlib.sha256(text).hexdigest())

    def _pattern(self, path: str, top: _Top) -> _Pattern | None:
        """That of a file's head, learned from this very file where it is the second."""
        if top.lines in self.strange:
            return None
        known = self.known.get(top.lines, [])
        if found := next((pattern for pattern in known if pattern.holds(top)), None):
            return found
        if top.lines not in self.met or len(known) >= MOST:
            self.met.add(top.lines)
            return None
        try:
            learned = _learned(path, top)
        except (LogError, OSError):  # of this file; the next may be a good one
            return None
        if learned is None:
            self.strange.add(top.lines)
        elif learned:
            self.known[top.lines] = [*known, *learned]
        return next(iter(learned or ()), None)


def _is_small_text(path: str) -> bool:
    """Whether a file may be such a table, by its ending and its size, and is no folder, pipe or device."""
    if not path.lower().endswith(ENDINGS):
        return False
    try:
        found = os.stat(path)
    except OSError:
        return False
    return stat.S_ISREG(found.st_mode) and found.st_size <= SMALL


def _plain(text: bytes, delimiter: bytes, width: int) -> bytes | None:
    """A text of plain cells, `width` in each line; None where a line has another number of them, or something
    looks like no number."""
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
    text = text.removesuffix(b"\n")
    marks = text.translate(None, PLAIN.replace(b"\r\n", b""))
    line = delimiter * (width - 1)
    return text if text and marks == (line + b"\n") * (len(marks) // width) + line else None


def _rows(text: bytes, head: Head) -> _Rows | None:
    """The rows below a head."""
    return _Rows.of(text, str(head.dialect.delimiter).encode(), len(head.names))


def _learned(path: str, top: _Top) -> list[_Pattern] | None:
    """What the exact reader makes of a file, as a pattern for others; nothing where this file is not whole,
    and None where all such files are the exact reader's own. Raises LogError."""
    with opened({"": path}, None) as head:
        _, mapping, plan = planned(head, None)
        logs = logs_of(head)
        with open(path, "rb") as file:
            text = file.read()
    if mapping is not None or len(logs) != 1 or not _is_plain(head, plan, logs[0], top):
        return None
    rows = _rows(text[top.start :], head)
    if rows is None or logs[0].notes != plan.notes:
        return []
    keys = {source.label: quantity for quantity, source in plan.sources.items() if source.column is None}
    constants = {key: q for key, _ in top.told if (q := keys.get(f"metadata {key!r}"))}
    inputs = [s.column for name, s in plan.sources.items() if name in INPUTS]
    cells = {c: rows.cells[c :: rows.width] for c in inputs if c is not None}
    return [_Pattern(head, plan, logs[0], top.told, constants, cells)]


def _is_plain(head: Head, plan: Plan, log: Log, top: _Top) -> bool:
    """Whether a file is a table as it stands on the disk, read by its own names alone, nothing of which hangs
    on a single cell."""
    sources = plan.sources.values()
    text = head.sheet is None and head.dialect.header is True and not head.preamble and not head.repeated
    begins = (head.start, head.first_line) == (top.start, top.lines.count(b"\n") + 1)
    marks = head.dialect.decimal == "." and str(head.dialect.delimiter) in MARKS and len(head.names) > 1
    odd = [name for name in head.names if not name or name.casefold() in (*SAMPLES, "log")]
    direct = plan.sources.keys() <= {*INPUTS, "wd", "wq", "w"} and not any(
        s.dated or s.spare for s in sources
    )
    spoken = log.warnings or plan.warnings or head.notes or plan.split is not None
    return bool(text and begins and marks and direct) and not (odd or spoken)
