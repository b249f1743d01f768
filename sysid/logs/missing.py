"""Rows that a log cannot hold: refused by name, or left out where a cell is empty and the log tells little
there.

What a row tells is taken from the response W itself, without a model: a row's information about a gain is as
|W|^2, about a frequency or a time constant as |dW|^2 (for settled points dW/df0 = -dW/df, for a decay dW/dtau
= -(t/tau) dW/dt), about a constant background as 1. Rows may be left out that hold no more than `LOST` of any
of these sums."""

import itertools
from collections.abc import Mapping
from typing import NoReturn

import numpy as np

from sysid.columns.plan import Plan, Source
from sysid.tables.cells import listed, means_none, split_line
from sysid.tables.csvbody import Body, refuse_cell
from sysid.tables.csvfile import Head, LogError
from sysid.tables.textfile import open_text
from sysid.tables.units import DRIVES

# of the information, at most: each standard error then grows by 1/sqrt(1 - LOST) - 1 = 2.6 % at most
LOST = 0.05
DWELL = 4.0  # times tau, from which on points are settled
STEEP = 2.6  # by which the steepest slope of |W| shows a tau that is too short: 3 sqrt(3)/2
EMPTY = {
    "", "-", "--", "---", "nan", "na", "n/a", "null", "none", "<na>", "nat",
    "-nan", "-nan(ind)", "nan(ind)", "1.#qnan", "-1.#ind",
    "#n/a", "#nv", "#div/0!", "#num!", "#value!", "#ref!",  # of a spreadsheet that cannot work a number out
}  # fmt: skip

Arrays = Mapping[str, tuple[np.ndarray, str]]


def rows_to_keep(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays, kind: str | None
) -> tuple[np.ndarray | None, str]:
    """Which of the rows of `arrays`, NaN where a cell holds no number, are kept, and a note that names the
    others; None where all are. `rows`: their numbers in the file, None for all. Raises LogError where a cell
    is no number and not empty, or where the rows to leave out would be missed."""
    finite = {
        name: np.isfinite(values) for name, (values, _) in arrays.items() if not plan.sources[name].spare
    }
    bad = {name: ~of for name, of in finite.items() if not of.all()}
    if not bad:
        return None, ""
    missing = np.any([*bad.values()], axis=0)
    name = next(iter(bad))
    source, row = plan.sources[name], int(np.argmax(bad[name]))
    share, why = _lost(arrays, missing, kind)
    if why or share > LOST or not all_empty(head, body, plan, rows, bad):
        expected = (
            f"a date as in the first row, {head.first(source.column)!r}"
            if source.dated
            else "a finite number"
        )
        told = f"to do without loses {100 * share:.2g} % of what the log tells, more than {100 * LOST:g} %"
        more = why or (told if LOST < share < 1 else "")
        rests = name in DRIVES and "time" in arrays and kind != "steady"
        if rests and all_empty(head, body, plan, rows, {name: bad[name]}, blank=True):
            more = f"write 0 where the drive is off{f'; {more}' if more else ''}"
        refuse_row(head, body, source, rows, row, expected, more)
    labels = [plan.sources[name].label for name in bad]
    numbers = np.flatnonzero(missing) if rows is None else rows[missing]
    where = listed([placed(head, body, int(number)) for number in numbers])
    said = (
        f"{int(missing.sum())} of {len(missing)} rows left out, without a number in {listed(labels)}: {where}"
    )
    return ~missing, f"{said}; {100 * share:.2g} % of what the log tells is lost"


def refuse_row(
    head: Head, body: Body, source: Source, rows: np.ndarray | None, row: int, expected: str, more: str = ""
) -> NoReturn:
    """Raise the LogError of a value that cannot be, in the `row` among `rows`, or in the metadata."""
    if source.column is None:
        raise LogError(f"{head.path}, {source.label}: found {source.constant:g}, expected {expected}")
    refuse_cell(head, body, row if rows is None else int(rows[row]), source.column, expected, more)


def _lost(arrays: Arrays, missing: np.ndarray, kind: str | None) -> tuple[float, str]:
    """The share of what the log tells that its missing rows hold, and why they cannot be done without, if
    so."""
    if kind == "waveform":
        there = np.flatnonzero(~missing)
        inner = len(there) == 0 or there[-1] - there[0] + 1 != len(there)
        return float(np.mean(missing)), "the samples of a waveform follow one another evenly" if inner else ""
    response = response_of(arrays)
    if (share := _share(response, missing)) > LOST:
        return share, ""
    changes = (
        kind != "steady"
        and "time" in arrays
        and _change(arrays, missing)
        and not _settles(arrays, response, missing)
    )
    return share, "drive or frequency change there, from which the plate goes on" if changes else ""


def _share(response: np.ndarray, missing: np.ndarray) -> float:
    """The largest share of the missing rows: of the rows, of sum |W|^2, of sum |dW|^2."""
    index, there = np.arange(len(missing)), ~missing
    if np.count_nonzero(there) < 3:
        return 1.0
    filled = np.interp(index, index[there], response[there])
    step = np.abs(np.diff(filled))
    before, after = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    moved = 0.5 * (before**2 + after**2)
    for begin, end in _runs(missing):
        moved[begin:end] = np.max(step[max(begin - 2, 0) : end + 1], initial=0.0) ** 2
    return max(_part(weight, missing) for weight in (np.ones(len(missing)), np.abs(filled) ** 2, moved))


def _part(weight: np.ndarray, chosen: np.ndarray) -> float:
    total = float(np.sum(weight))
    return float(np.sum(weight[chosen])) / total if total > 0 else 0.0


def response_of(arrays: Arrays) -> np.ndarray:
    """The response as far as rows tell how much there is of it: (n,), complex where it has two parts."""
    for first, second in (("wd", "wq"), ("x", "y")):
        if first in arrays and second in arrays:
            return arrays[first][0] + 1j * arrays[second][0]
    if "magnitude" in arrays:
        return arrays["magnitude"][0] * np.exp(1j * arrays["phase"][0] if "phase" in arrays else 0j)
    return next(arrays[name][0] for name in ("w", "wd", "x", "response", *arrays) if name in arrays)


def _change(arrays: Arrays, missing: np.ndarray) -> bool:
    """Whether an input is another after a run of missing rows than before, or within."""
    inputs = [arrays[name][0] for name in ("drive", "voltage", "duty", "frequency") if name in arrays]
    spans = [values[max(begin - 1, 0) : end + 1] for begin, end in _runs(missing) for values in inputs]
    return any(np.ptp(known) > 0 for span in spans if len(known := span[np.isfinite(span)]))


def _settles(arrays: Arrays, response: np.ndarray, missing: np.ndarray) -> bool:
    """Whether each row of a sweep is held for so long that the plate settles: its tau is that of the steepest
    step."""
    if "frequency" not in arrays:
        return False
    time, frequency, known = arrays["time"][0][~missing], arrays["frequency"][0][~missing], response[~missing]
    move = np.abs(np.diff(frequency))
    if len(known) < 3 or not move.all():
        return False
    size = float(np.max(np.abs(known - np.mean(known))))
    tau = float(np.max(np.abs(np.diff(known)) / (2 * np.pi * move))) / size if size > 0 else np.inf
    tau *= 1 if np.iscomplexobj(response) else STEEP
    return float(np.median(np.diff(time))) >= DWELL * tau


def _runs(chosen: np.ndarray) -> list[tuple[int, int]]:
    """(begin, end) of each stretch of chosen rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def all_empty(
    head: Head,
    body: Body,
    plan: Plan,
    rows: np.ndarray | None,
    bad: Mapping[str, np.ndarray],
    blank: bool = False,
) -> bool:
    """Whether the cells that hold no number are empty, or (not for `blank`) hold a number that is written for
    none: no text, and no overload."""
    cells: dict[int, list[int]] = {}
    for name, of in bad.items():
        column = plan.sources[name].column
        for row in np.flatnonzero(of) if column is not None else ():
            cells.setdefault(int(row) if rows is None else int(rows[row]), []).append(column)
    if head.sheet is not None:
        texts = [head.sheet.text(row, column) for row, columns in cells.items() for column in columns]
    else:
        lines = _lines(head.path, {body.line(head, row): columns for row, columns in cells.items()})
        parted = ((split_line(text, str(head.dialect.delimiter)), columns) for text, columns in lines)
        texts = ["".join(row[column : column + 1]).strip() for row, columns in parted for column in columns]
    return all(text.casefold() in EMPTY or (means_none(text) and not blank) for text in texts)


def _lines(path: str, wanted: Mapping[int, list[int]]) -> list[tuple[str, list[int]]]:
    """The lines of the wanted numbers, counted from 1, with what is wanted of each."""
    found, last = [], 0
    with open_text(path) as file:
        for number in sorted(wanted):
            raw = next(itertools.islice(file, number - last - 1, None), b"")
            found.append((raw.decode("utf-8", errors="replace"), wanted[number]))
            last = number
    return found


def placed(head: Head, body: Body, row: int) -> str:
    """Where a row of a file, counted from 0, stands in it."""
    return f"row {row + 1}" if head.sheet is not None else f"line {body.line(head, row)}"
