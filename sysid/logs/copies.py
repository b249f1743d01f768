"""Logs that are there twice: the same rows in whatever order, exported once more into another file, perhaps
with fewer digits.

A copy tells nothing new, and counted as a log of its own it makes all errors smaller by sqrt 2. Two logs are
taken for copies where every reading of one is that of the other to the digits that either is written with.
Two recordings of one thing agree so where noise is far below the digits of the coarser alone; that one then
tells next to nothing beside the other."""

import dataclasses
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from sysid.logs.log import Log

INPUTS = ("time", "frequency", "drive", "temperature", "force")
# readings: with noise of a third of a digit so many are equal by chance in one pair of recordings of 1e4
LEAST = 20
NEAR = 0.05  # of the largest reading, to which whoever writes a log rounds at the worst
FEW = 16  # rows, of which most pairs of recordings show that they are two
PLACES = 10  # digits that are looked at; with more no two recordings agree by chance
ROUNDED = 1e-12  # of a number, to which it is a decimal one after it changed its unit
EXACT = 1e-9  # of the largest, to which numbers are one after they changed their unit


def once(logs: Iterable["Log"]) -> list["Log"]:
    """The logs, of copies the one with the most digits in the place of the first, with a note."""
    kept: list[_Rows] = []
    for rows in map(_Rows, logs):
        place = next((k for k, other in enumerate(kept) if _are_copies(other, rows)), None)
        if place is None:
            kept.append(rows)
            continue
        best, other = sorted((kept[place].log, rows.log), key=_coarseness)
        fewer = ", with fewer digits" if _coarseness(other) > _coarseness(best) else ""
        note = f"{other.path or other.name} holds the same rows{fewer}: counted once"
        kept[place] = _Rows(dataclasses.replace(best, notes=(*best.notes, note)))
    return [rows.log for rows in kept]


class _Numbers(NamedTuple):
    """Numbers (n,) of a column, and one of the last digit of each."""

    values: np.ndarray
    digits: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "_Numbers":
        return cls(values, digit(values))

    def are(self, other: "_Numbers") -> bool:
        """Whether they agree to their digits."""
        exact = EXACT * np.max(np.abs(self.values))
        most = (0.5 + EXACT) * np.maximum(self.digits, other.digits) + exact
        return bool(np.all(np.abs(self.values - other.values) <= most))


@dataclasses.dataclass(eq=False)
class _Rows:
    """A log with what is asked of it beside every other one, each worked out once."""

    log: "Log"

    @cached_property
    def alike(self) -> tuple[Any, ...]:
        """What is the same in copies."""
        log = self.log
        said = (log.kind, log.amplitude_only, log.bench, log.drive_unit, log.response_unit)
        return (*said, len(log), self.columns.keys())

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Readings first: most logs are told apart by them."""
        inputs = {name: values for name in INPUTS if (values := getattr(self.log, name)) is not None}
        return _channels(self.log) | inputs

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """The largest and the mean reading."""
        size = np.abs(self.log.response)
        return float(np.max(size)), float(np.mean(size))

    @cached_property
    def ways(self) -> tuple[np.ndarray, ...]:
        """(n,) places in the order of the inputs: of rows of the same inputs as they come, and backwards."""
        rows = np.arange(len(self.log))
        order = self._order(rows)
        held = [np.diff(values[order]) == 0 for name, values in self.columns.items() if name in INPUTS]
        backwards = (self._order(rows[::-1]),) if np.any(np.all(held, axis=0)) else ()
        return (order, *backwards)

    def _order(self, rows: np.ndarray) -> np.ndarray:
        keys = [self.columns[name][rows] for name in reversed(INPUTS) if name in self.columns]
        return rows[np.lexsort(keys)] if keys else rows

    def numbers(self, way: int) -> Iterator[_Numbers]:
        """The columns, a few of their rows first: with their own digits, which are no more than those of all,
        they agree where all do."""
        yield from self._few[way]
        yield from self._all[way]

    @cached_property
    def _few(self) -> list[list[_Numbers]]:
        step = len(self.log) // FEW + 1
        return [[_Numbers.of(v[order[::step]]) for v in self.columns.values()] for order in self.ways]

    @cached_property
    def _all(self) -> list[list[_Numbers]]:
        return [[_Numbers.of(v[order]) for v in self.columns.values()] for order in self.ways]


def _are_copies(first: _Rows, second: _Rows) -> bool:
    """Whether all readings of both are the same to their digits, in some order of the rows."""
    if first.log.path == second.log.path or first.alike != second.alike:
        return False
    if len(_channels(first.log)) * len(first.log) < LEAST or not _are_near(first, second):
        return False
    ways = range(len(second.ways))
    return any(all(map(_Numbers.are, first.numbers(0), second.numbers(way))) for way in ways)


def _are_near(first: _Rows, second: _Rows) -> bool:
    """Whether the largest and the mean reading are alike, as they are of copies, and not of most logs."""
    near = NEAR * first.sizes[0]
    return all(abs(a - b) <= near for a, b in zip(first.sizes, second.sizes, strict=True))


def _channels(log: "Log") -> dict[str, np.ndarray]:
    return {"w": log.response} if log.amplitude_only else {"wd": log.response.real, "wq": log.response.imag}


def _coarseness(log: "Log") -> float:
    """The mean of one of the last digit of a reading."""
    return float(np.mean([np.mean(digit(values)) for values in _channels(log).values()]))


def digit(values: np.ndarray) -> np.ndarray:
    """One of the last digit of each number (n,), where all are written with as many decimals, or with as many
    digits; the larger of both. Of more than PLACES digits none is the last.

    >>> digit(np.array([0.057, 12.25])), digit(np.array([0.0571, 12.3]))
    (array([0.001, 0.01 ]), array([0.0001, 0.1   ]))
    """
    size = np.abs(values)
    power = np.floor(np.log10(size, out=np.full(len(size), -np.inf), where=size > 0))
    if not np.any(size):
        return np.zeros(len(size))
    power = np.maximum(power, np.min(power[size > 0]))
    digits = [_last(size, np.full(len(size), np.max(power))), _last(size, power)]
    return np.maximum(*digits)


def _last(size: np.ndarray, power: np.ndarray) -> np.ndarray:
    """One of the last digit of numbers whose first is at a `power` (n,) of ten, with as many behind it."""
    for places in range(PLACES):
        scaled = size * 10.0 ** (places - power)
        if np.all(np.abs(scaled - np.rint(scaled)) <= ROUNDED * scaled):
            return 10.0 ** (power - places)
    return np.zeros(len(size))
