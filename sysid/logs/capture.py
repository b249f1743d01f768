"""One capture in several files, as oscilloscopes write a channel each: found by their names, read side by
side.

A mapping file names them by `file` of its columns: a pattern such as `*CH1.csv`. What its `*` and `?` stand
for is the name of the capture, so that F0001CH1.csv belongs to F0001CH2.csv, and F0002CH1.csv to
F0002CH2.csv."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from sysid.columns.mapping import MappingFile
from sysid.tables.cells import listed
from sysid.tables.csvbody import Body, read_body
from sysid.tables.csvfile import Head, LogError
from sysid.tables.head import open_head
from sysid.tables.sheet import Sheet

STEP = 1e-3  # of a step, by which the rows of two files may stand apart: their stamps are rounded


def captures(paths: Sequence[str], mapping: MappingFile) -> list[dict[str, str]]:
    """The files of each capture, {pattern: path}, in the order of their first file. Raises LogError where a
    file fits no pattern or several, or a capture lacks one."""
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for path in paths:
        name, folder = Path(path).name, str(Path(path).parent)
        fitting = {pattern: part for pattern in mapping.files if (part := _wild(pattern, name)) is not None}
        if len(fitting) != 1:
            said = "none of them" if not fitting else f"{len(fitting)} of them"
            raise mapping.fail(
                "[columns]",
                f"found {name}, which fits {said}, expected one of file = {listed(mapping.files)}",
            )
        pattern, part = next(iter(fitting.items()))
        group = found.setdefault((folder, *part), {})
        if pattern in group:
            raise mapping.fail(
                "[columns]",
                f"found {name} beside {Path(group[pattern]).name}, expected one file of {pattern}",
            )
        group[pattern] = path
    for group in found.values():
        if lost := [pattern for pattern in mapping.files if pattern not in group]:
            here = Path(next(iter(group.values())))
            raise LogError(
                f"{here}: found no file {listed(lost)} of the same capture, expected it among the logs"
            )
    return [{pattern: group[pattern] for pattern in mapping.files} for group in found.values()]


def side_by_side(group: dict[str, str], mapping: MappingFile) -> Head:
    """The head of a capture's files as one table. Raises LogError where their rows differ."""
    heads = {pattern: open_head(path, mapping.dialect) for pattern, path in group.items()}
    bodies = [_whole(head) for head in heads.values()]
    counts, names = [len(body) for body in bodies], [Path(path).name for path in group.values()]
    if len(set(counts)) > 1:
        said = " and ".join(f"{count} rows in {name}" for count, name in zip(counts, names, strict=True))
        raise LogError(
            f"{next(iter(group.values()))}: found {said}, expected as many in each file of one capture"
        )
    ends = np.cumsum([len(head.names) for head in heads.values()]).tolist()
    parts = dict(zip(heads, pairwise([0, *ends]), strict=True))
    owners = [(head, body) for head, body in zip(heads.values(), bodies, strict=True) for _ in head.names]

    def where(row: int, column: int) -> str:
        """The file and line of a cell; rows, and columns of all files together, are counted from 0."""
        head, body = owners[column]
        return f"{head.path}, line {body.line(head, row)}"

    columns = tuple(body.numbers[column] for body in bodies for column in sorted(body.numbers))
    digest = hashlib.sha256("".join(body.sha256 for body in bodies).encode()).hexdigest()
    samples = zip(
        *(head.sample for head in heads.values()), strict=False
    )  # of equally many rows, blank lines aside
    head = replace(
        next(iter(heads.values())),
        names=tuple(name for head in heads.values() for name in head.names),
        sheet=Sheet(columns, where, digest),
        sample=tuple(tuple(cell for row in rows for cell in row) for rows in samples),
        metadata={key: value for head in reversed(heads.values()) for key, value in head.metadata.items()},
        notes=(
            *dict.fromkeys(note for head in heads.values() for note in head.notes),
            f"read side by side: {listed(names)}",
        ),
        header=(),
        parts=parts,
    )
    _check_shared(head, mapping)
    return head


def _whole(head: Head) -> Body:
    """All columns of a file, which holds one table."""
    dated = [column for column in range(len(head.names)) if head.dated(column)]
    body = read_body(head, list(range(len(head.names))), dated=dated)
    if body.tables is not None:
        raise LogError(
            f"{head.path}: found the header {len(body.tables)} times, expected one table in each file of a"
            f" capture"
        )
    return body


def _check_shared(head: Head, mapping: MappingFile) -> None:
    """Raise LogError where the files differ in a column that the mapping file names without a `file`: their
    common time."""
    for name, entry in mapping.options.get("columns", {}).items():
        if "file" in entry:
            continue
        own = mapping.position(f"[columns] {name}", entry, head)
        for begin, end in list(head.parts.values())[1:]:
            called = [k for k in range(begin, end) if entry["column"] in (head.names[k], k - begin)]
            if len(called) == 1:
                _check_same(head, own, called[0])


def _check_same(head: Head, own: int, other: int) -> None:
    """Raise LogError where two columns differ by more than a thousandth of a step."""
    first, second = head.sheet.columns[own], head.sheet.columns[other]
    step = float(np.median(np.abs(np.diff(first)))) if len(first) > 1 else 0.0
    apart = ~((np.abs(first - second) <= STEP * step) | (np.isnan(first) & np.isnan(second)))
    if apart.any():
        row = int(np.argmax(apart))
        said = (
            f"found {head.sheet.text(row, other)}, expected {head.sheet.text(row, own)} as in"
            f" {head.sheet.where(row, own)}"
        )
        raise LogError(f"{head.sheet.where(row, other)}, column {head.names[other] or other!r}: {said}")


def _wild(pattern: str, name: str) -> tuple[str, ...] | None:
    """What the marks * and ? of a pattern stand for in a file's name, capitals aside; None where it does not
    fit."""
    parts = "".join("(.*)" if mark == "*" else "(.)" if mark == "?" else re.escape(mark) for mark in pattern)
    found = re.fullmatch(parts, name, re.IGNORECASE | re.DOTALL)
    return found.groups() if found else None
