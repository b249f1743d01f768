"""Sweeps that stand side by side in one table, as f1, X1, Y1, f2, X2, Y2 or f, A_20C, A_30C: what tells their
columns apart is a number in each head. They are read one below the other, an experiment each."""

import dataclasses
import re
from collections import Counter
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from sysid.columns.labels import INPUTS, folded
from sysid.columns.plan import SPLITS
from sysid.tables import units
from sysid.tables.cells import split_line
from sysid.tables.compound import rows_of
from sysid.tables.csvfile import SAMPLE, Head
from sysid.tables.sheet import Sheet

# 20C, (20 °C), @5V: of a temperature or a drive, behind a mark; or a number alone, as of f1_Hz and wd_um.1
_AMOUNT = re.compile(
    r"(?:^|[\s_@,;:=-]+|\s*[(\[]\s*)(-?\d+(?:[.,]\d+)?(?: ?(?:°|deg ?)?[CFK]|[mk]?V\w*))\b[)\]]?"
)
# R_up beside R_down: of a sweep's direction
_DIRECTION = re.compile(
    r"(?:^|[\s_.(\[-]+)(up|down|fwd|bwd|rev|forward|backward|reverse|auf|ab|hin|rück)(?![^\W_])[)\]]?",
    re.IGNORECASE,
)
_NUMBER = re.compile(r"[\s_.#]*(?<![\d^.])(\d+)(?![\d.]*\d)")


class _Groups(NamedTuple):
    """The columns of each sweep by what is left of their heads, and the columns that all sweeps share."""

    sweeps: Mapping[str, Mapping[str, int]]
    shared: Mapping[str, int]


def stacked(head: Head, kept: Collection[str | int]) -> Head:
    """The head of such a table as of one sweep below the other; of any other, or where some of its columns
    are `kept`, as it is."""
    known = {*head.names, *range(len(head.names))} & {*kept}
    if known or head.sheet is not None or {*map(str.casefold, head.names)} & {*SPLITS}:
        return head
    for parted in (_by_amount, _by_place, _by_number):
        if (found := parted(head)) is not None:
            return _one_below_the_other(head, found)
    return head


def _by_amount(head: Head) -> _Groups | None:
    """Sweeps at temperatures or drives that the heads state, or up and down; their frequency, or time, may be
    one for all."""
    for form in (_AMOUNT, _DIRECTION):
        found = _grouped([_cut(name, form, 0) for name in head.names])
        axis = found and {*next(iter(found.sweeps.values())), *found.shared}
        if axis and (_are(axis, "frequency") or _are(axis, "time")):
            return found
    return None


def _by_number(head: Head) -> _Groups | None:
    """Sweeps that are counted, each with its frequency and without a time: over one they may be channels."""
    for place in (0, -1):
        if (found := _grouped([_cut(name, _NUMBER, place) for name in head.names])) and _own(found):
            return found
    return None


def _by_place(head: Head) -> _Groups | None:
    """Sweeps whose heads are the same, or get a number behind a point as pandas writes it; what stands above
    each group of columns tells it."""
    names = [re.sub(r"\.\d+$", "", name) for name in head.names]
    seen: Counter[str] = Counter()
    alike = Counter(names)
    pairs = []
    for name in names:
        seen[name] += 1
        pairs.append((name, str(seen[name]) if alike[name] > 1 else ""))
    found = _grouped(pairs)
    if not found or not _own(found):
        return None
    above = split_line(head.above[-1], str(head.dialect.delimiter)) if head.above else []
    titles = [cell.strip() for cell in above if cell.strip()]
    same = len({*titles}) == len(titles) == len(found.sweeps)
    return _Groups(dict(zip(titles, found.sweeps.values(), strict=True)), found.shared) if same else found


def _own(found: _Groups) -> bool:
    sweep = next(iter(found.sweeps.values()))
    return _are(sweep, "frequency") and not _are([*sweep, *found.shared], "time")


def _cut(name: str, form: re.Pattern[str], place: int) -> tuple[str, str]:
    """A head without the number that tells its sweep, the first or the last in it, and the number."""
    every = list(form.finditer(name))
    if not every:
        return name, ""
    found = every[place]
    return f"{name[: found.start()]}{name[found.end() :]}".strip(" _"), found[1]


def _grouped(pairs: list[tuple[str, str]]) -> _Groups | None:
    """The groups of columns by heads without their marks, and the marks; None where they are not alike."""
    sweeps: dict[str, dict[str, int]] = {}
    shared: dict[str, int] = {}
    for column, (stem, mark) in enumerate(pairs):
        group = sweeps.setdefault(mark, {}) if mark else shared
        if stem in group or not stem:
            return None
        group[stem] = column
    alike = len({frozenset(group) for group in sweeps.values()}) == 1 < len(sweeps)
    own = next(iter(sweeps.values())) if alike else {}
    return _Groups(sweeps, shared) if own and not own.keys() & shared and len(own) + len(shared) > 1 else None


def _are(names: Collection[str], quantity: str) -> bool:
    """Whether one of some heads is that of a frequency, or of a time."""
    words = [re.split(r"[\W_]+", folded(units.split_unit(name)[0])) for name in names]
    return sum(bool({*of} & {*INPUTS[quantity]}) for of in words) == 1


def _one_below_the_other(head: Head, found: _Groups) -> Head:
    rows, lines, _ = rows_of(head)
    stems = [*next(iter(found.sweeps.values()))]
    degrees = _degrees([*found.sweeps]) if not _are([*stems, *found.shared], "temperature") else {}
    names = ["log", *(["temperature_degC"] if degrees else []), *found.shared, *stems]
    told: list[list[str]] = []
    places: list[tuple[int, int]] = []  # the line of each row, and its sweep
    for sweep, (mark, columns) in enumerate(found.sweeps.items()):
        for row, line in zip(rows, lines, strict=True):
            own = [row[columns[stem]] for stem in stems]
            if any(own):
                stated = [degrees[mark]] if degrees else []
                told.append([mark, *stated, *(row[k] for k in found.shared.values()), *own])
                places.append((line, sweep))
    sheet = Sheet(
        tuple(np.array(cells, object) for cells in zip(*told, strict=True)),
        lambda row, _: f"{head.path}, line {places[row][0]}, sweep {[*found.sweeps][places[row][1]]}",
    )
    beside = "; their temperatures are those of the heads" if degrees else ""
    note = (
        f"{len(found.sweeps)} sweeps side by side ({', '.join(found.sweeps)}) are read as a log each{beside}"
    )
    return dataclasses.replace(
        head,
        names=tuple(names),
        sheet=sheet,
        sample=sheet.first(SAMPLE),
        notes=(*head.notes, note),
        header=(),
        told={},
    )


def _degrees(marks: list[str]) -> dict[str, str]:
    """The temperature (degC) of each mark; none where they are not all of one."""
    found = {mark: re.fullmatch(r"(-?[\d.,]+) ?(?:°|deg ?)?([CFK])", mark) for mark in marks}
    if not all(found.values()):
        return {}
    pairs = {mark: (of[1].replace(",", "."), of[2]) for mark, of in found.items() if of}
    unit = {"F": "degF", "K": "K"}
    return {
        mark: text if of == "C" else f"{units.convert(float(text), unit[of], 'degC'):.10g}"
        for mark, (text, of) in pairs.items()
    }
