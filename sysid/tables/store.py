"""What a file that is no text holds, as one table: columns of equal length, constants, and how much of it may
be read.

Numbers are taken as they are, complex ones as two columns, texts as texts; whatever else stands in such a
file (objects, functions, references) is never made or run: it is named, and left out."""

import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

from sysid.tables import units
from sysid.tables.cells import Dialect, listed
from sysid.tables.csvfile import SAMPLE, Head
from sysid.tables.sheet import Sheet
from sysid.tables.textfile import LogError

SHORTEST = 4  # bytes of a number in a text, with what parts it from the next
MOST = 1 << 27  # numbers in a file: a gigabyte, which fits into a laptop's memory beside the fit


@dataclass
class Store:
    """The contents of a file: `tables[table][column]` is (n,), a table's name "" where there is one;
    constants as text."""

    path: str
    kind: str  # as "a MATLAB file"
    tables: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    constants: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    facts: dict[str, dict[str, str]] = field(
        default_factory=dict
    )  # constants of one of the tables, by its name
    default: str | None = None  # the table to take where none is asked for
    unclear: str = ""  # why it has to be asked for
    claimed: int = 0
    nameless: bool = False  # the columns of its table have no names that say anything

    def claim(self, name: str, count: int) -> None:
        """Count numbers that are about to be read. Too many: LogError."""
        self.claimed += int(count)
        if self.claimed > MOST:
            raise LogError(
                f"{self.path}, {name}: found {count} numbers claimed, expected {MOST} or fewer in a file"
            )

    def add(self, table: str, name: str, values: Any, unit: str = "") -> None:
        """Enter an array, or a single value as a constant, under its name; what is neither is left out."""
        array = np.asarray(values)
        called = f"{name} [{unit}]" if unit else name
        if array.dtype.names:  # a record array: a column a field
            for part in array.dtype.names:
                self.add(table, f"{name}.{part}" if name else part, array[part])
            return
        if array.size == 1 and array.dtype.kind in "biufUS":
            self.constants[called.replace(" [", "_").rstrip("]")] = _text(array.reshape(-1)[0])
            return
        self.claim(name, array.size)
        columns = self.tables.setdefault(table, {})
        flat = array.reshape(-1) if array.size == max(array.shape, default=0) else array
        if flat.ndim == 2 and min(flat.shape) <= 64 and flat.dtype.kind in "biufc":
            tall = flat if flat.shape[0] >= flat.shape[1] else flat.T
            for k in range(tall.shape[1]):
                columns |= _as_columns(f"{name}[{k}]", tall[:, k], unit)
        elif flat.ndim == 1 and (found := _as_columns(name, flat, unit)):
            columns |= found
        else:
            what = "objects" if array.dtype.kind == "O" else array.dtype
            self.left_out.append(f"{name} ({what} of shape {array.shape})")

    def head(self, dialect: Dialect) -> Head:
        """The head of its table: the one that the dialect names, or the only one; tables of the same columns,
        one below the other, each an experiment. Raises LogError where there is none, or where it is not clear
        which."""
        tables = {name: whole for name, of in self.tables.items() if (whole := self._of_one_length(of))}
        wanted = dialect.table if dialect.table is not None else self.default
        if wanted is not None and wanted not in tables:
            raise LogError(f"{self.path}: found no table {wanted!r}, expected one of {listed(list(tables))}")
        if wanted is None and self.unclear:
            raise LogError(f"{self.path}: {self.unclear}")
        tables = tables if wanted is None else {wanted: tables[wanted]}
        if not tables:
            held = f"; it holds {listed(self.left_out)}" if self.left_out else ""
            raise LogError(
                f"{self.path}: found {self.kind} without columns of numbers, expected two or more of one"
                f" length{held}"
            )
        names = [*next(iter(tables.values()))]
        if any([*columns] != names for columns in tables.values()):
            said = f"found {len(tables)} tables ({listed(list(tables))}), expected one"
            raise LogError(f'{self.path}: {said}; say table = "{next(iter(tables))}", say, in a mapping file')
        columns = {name: np.concatenate([of[name] for of in tables.values()]) for name in names}
        if len(tables) > 1:
            counts = [len(next(iter(of.values()))) for of in tables.values()]
            columns = {"log": np.repeat(np.array([*tables], object), counts)} | columns
        return self._head(columns, dialect, next(iter(tables)) if len(tables) == 1 else None)

    def _head(self, columns: Mapping[str, np.ndarray], dialect: Dialect, table: str | None) -> Head:
        path, names = self.path, tuple(columns)
        constants = self.constants | (self.facts.get(table, {}) if table is not None else {})
        sheet = Sheet(tuple(columns.values()), lambda row, _: f"{path}, row {row + 1}")
        notes = (*self.notes, *([f"left out: {listed(self.left_out)}"] if self.left_out else []))
        plain = Dialect(",", ("#",), ".", True, table=dialect.table)
        sample = sheet.first(SAMPLE)
        return Head(
            path,
            constants,
            frozenset(),
            ("",) * len(columns) if self.nameless or _of_one_array(names) else names,
            plain,
            0,
            1,
            sample,
            notes,
            sheet=sheet,
            above=(self.kind, *self.tables),
        )

    def _of_one_length(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The columns of the length that most of them have, the longer where as many have either."""
        lengths = [len(values) for values in columns.values()]
        best = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
        other = [name for name, values in columns.items() if len(values) != best]
        self.left_out += [f"{name} ({len(columns[name])} of {best} rows)" for name in other]
        return {name: values for name, values in columns.items() if len(values) == best and best > 0}


def _of_one_array(names: Sequence[str]) -> bool:
    """Whether columns are those of one array, whose numbers say nothing."""
    found = [re.fullmatch(r"(.*)\[\d+\]", name) for name in names]
    return all(found) and len({one[1] for one in found if one}) == 1 < len(names)


@contextmanager
def readable(store: Store, what: str) -> Iterator[None]:
    """Around a library, which answers damaged files with errors of many types, and warns of others."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except LogError:
        raise
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise LogError(
            f"{store.path}: found a damaged {what} ({said}), expected one that can be read"
        ) from None


def claim_text(store: Store) -> None:
    """Count the numbers that a file of text may hold, which its library reads whole. Too many: LogError."""
    store.claim("its text", os.path.getsize(store.path) // SHORTEST)
    store.claimed = 0


def library(name: str, path: str, kind: str, extra: str) -> Any:
    """A library that reads files of a kind, or LogError that says how to have it."""
    try:
        return import_module(name)
    except ImportError:
        said = f"found {kind}, which is read with {name.partition('.')[0]}; expected that it is installed"
        raise LogError(f"{path}: {said}: pip install 'sysid[{extra}]', or save the log as CSV") from None


def _as_columns(name: str, values: np.ndarray, unit: str) -> dict[str, np.ndarray]:
    """A one-dimensional array as a column, or as two; empty where it holds neither numbers nor texts."""
    if values.dtype.kind == "c" and not unit and (said := units.parse_name(name)):  # w_um: both of its parts
        name, unit = said.quantity, said.unit
    ending = f" [{unit}]" if unit else ""
    if values.dtype.kind == "c":
        parts = {"re": values.real, "im": values.imag}
        return {f"{name} {part}{ending}": of.astype(np.float64) for part, of in parts.items()}
    if values.dtype.kind in "biuf":
        return {f"{name}{ending}": values.astype(np.float64)}
    if values.dtype.kind == "M":
        return {name: np.array([str(stamp) for stamp in np.datetime_as_string(values, "ns")], object)}
    if values.dtype.kind in "US" or (
        values.dtype.kind == "O" and all(isinstance(x, str | bytes) for x in values)
    ):
        return {name: np.array([_text(text) for text in values], object)}
    return {}


def _text(value: Any) -> str:
    """A value in one line; a number as it is written by Python."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    text = value if isinstance(value, str) else repr(value.item())
    return " ".join(text.split())
