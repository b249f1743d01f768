"""Many plates in one Parquet file: a column `plate`, perhaps one that tells the `log`s of each, and else the
columns that each one's file would have; what is one text or one number of its metadata stands in every row of
a log.

A log is read as a file of its columns would be, but one that has no more of its own than d and q, and what it
states of its plate, takes the inputs of the one that it is like.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.logs.alike import MOST, OWN
from sysid.logs.log import Log
from sysid.tables import units
from sysid.tables.cells import NO_NUMBER
from sysid.tables.textfile import LogError

PLATE, LOG = "plate", "log"
MARK = b"PAR1"  # by which a Parquet file begins
Columns = Mapping[str, np.ndarray]
Told = tuple[str | None, Sequence[Log], str]


def plates(path: str | Path) -> Iterator[Told] | None:
    """Of each plate its name, its logs, and why these cannot be read, else ""; None of a file that is no
    such table. Raises LogError for one that is damaged."""
    with suppress(OSError), open(path, "rb") as file:
        if file.read(len(MARK)) == MARK:
            from sysid.tables.arrow import read_parquet

            columns = read_parquet(str(path), "a Parquet file").tables.get("", {})
            return _Table(str(path)).plates(columns) if PLATE in columns else None
    return None


@dataclass
class _Table:
    """The file at `path`, and logs of it that others may be like."""

    path: str
    known: list["_Known"] = field(default_factory=list)

    def plates(self, columns: Columns) -> Iterator[Told]:
        """Those in it, in the order of their first rows."""
        for key, rows in _parted(columns, PLATE):
            if not (plate := _text(key)):
                count = len(next(iter(rows.values())))
                said = f"found {count} rows without a plate, expected its name in each"
                yield None, [], f"{self.path}: {said}"
                continue
            try:
                logs = _parted(rows, LOG) if LOG in rows else [("", rows)]
                yield plate, [self._log(part, plate, _text(log)) for log, part in logs], ""
            except LogError as error:
                yield plate, [], f"{self.path}: {error}"

    def _log(self, rows: Columns, plate: str, log: str) -> Log:
        """That of these rows."""
        name = f"{plate} {log}".strip()
        series, said = _told(rows, name)
        said = {PLATE: plate} | said
        for known in self.known:
            if (found := known.again(series, said, name)) is not None:
                return found
        from sysid.logs.made import of_table

        made = of_table(series, name, said)
        if len(self.known) < MOST and _is_plain(made, series):
            self.known.append(_Known(made, series, said))
        return made


@dataclass(frozen=True, eq=False)
class _Known:
    """A log, its columns and what its rows say beside."""

    log: Log
    series: Columns
    said: Mapping[str, str]

    def again(self, series: Columns, said: Mapping[str, str], name: str) -> Log | None:
        """The log of other columns; None where it is not like this one."""
        if series.keys() != self.series.keys() or said.keys() != self.said.keys():
            return None
        own = {key: text for key, text in said.items() if key.casefold() in OWN}
        inputs = (key for key in series if key not in _response(series))
        if {**self.said, **own} != said:
            return None
        if not all(np.array_equal(series[key], self.series[key]) for key in inputs):
            return None
        d, q = (series[key] for key in _response(series))
        if not (np.all(np.abs(d) < NO_NUMBER) and np.all(np.abs(q) < NO_NUMBER)):
            return None
        return self.log.again(d + 1j * q, name=name, metadata={**self.log.metadata, **own})


def _is_plain(log: Log, series: Columns) -> bool:
    """Whether a log is d and q of the table as they stand there, and nothing is said of it."""
    both = _response(series)
    if len(both) != 2 or log.warnings or log.notes or len(log) != len(series[both[0]]):
        return False
    return np.array_equal(log.response, series[both[0]] + 1j * series[both[1]])


def _response(series: Columns) -> list[str]:
    """The columns of d and q."""
    return sorted(name for name in series if name.startswith(("wd_", "wq_")))


def _told(rows: Columns, name: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The columns of these rows that hold numbers, and what else they say, of the log of that name."""
    series, said = dict[str, np.ndarray](), dict[str, str]()
    for column, values in rows.items():
        texts = values.dtype.kind in "OUS"
        some = {_text(value) for value in (set(values) if texts else values[:1])} - {""}
        if texts and len(some) > 1:
            raise LogError(f"{name}, column {column!r}: found {len(some)} texts, expected one in a log")
        if texts or (units.parse_name(column) is None and np.all(values == values[0])):
            said[column] = "".join(some)
        elif np.any(np.isfinite(values)):
            series[column] = values
    return series, {key: text for key, text in said.items() if text}


def _parted(columns: Columns, by: str) -> Iterator[tuple[Any, dict[str, np.ndarray]]]:
    """The other columns by the values of one, in the order of their first rows."""
    import pandas as pd

    codes, values = pd.factorize(columns[by], use_na_sentinel=False)
    order = np.argsort(codes, kind="stable")
    ends = np.searchsorted(codes[order], np.arange(len(values) + 1))
    others = {name: column for name, column in columns.items() if name != by}
    if np.any(order[1:] < order[:-1]):
        others = {name: column[order] for name, column in others.items()}
    for value, a, b in zip(values, ends[:-1], ends[1:], strict=True):
        yield value, {name: column[a:b] for name, column in others.items()}


def _text(value: Any) -> str:
    """A name or a number as text, a whole one without decimals; "" of nothing."""
    if isinstance(value, str):
        return value
    return "" if value != value else str(int(value)) if value == round(value) else repr(float(value))
