"""Logs that are there twice: the same rows in whatever order, exported once more into another file, perhaps
with fewer digits.

A copy tells nothing new, and counted as a log of its own it makes all errors smaller by sqrt 2. Two logs are
taken for copies where every reading of one is that of the other to the digits that either is written with.
Two recordings of one thing agree so where noise is far below the digits of the coarser alone; that one then
tells next to nothing beside the other."""

import dataclasses
from collections.abc import Iterable
from typing import TYPE_CHECKING

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
    kept: list[Log] = []
    for log in logs:
        place = next((k for k, other in enumerate(kept) if _are_copies(other, log)), None)
        if place is None:
            kept.append(log)
            continue
        best, other = sorted((kept[place], log), key=_coarseness)
        fewer = ", with fewer digits" if _coarseness(other) > _coarseness(best) else ""
        note = f"{other.path or other.name} holds the same rows{fewer}: counted once"
        kept[place] = dataclasses.replace(best, notes=(*best.notes, note))
    return kept


def _are_copies(first: "Log", second: "Log") -> bool:
    """Whether all readings of both are the same to their digits, in some order of the rows."""
    alike = all(
        getattr(first, name) == getattr(second, name)
        for name in ("kind", "amplitude_only", "bench", "drive_unit", "response_unit")
    )
    columns, others = _columns(first), _columns(second)
    if first.path == second.path or len(first) != len(second) or not alike or columns.keys() != others.keys():
        return False
    if len(_channels(first)) * len(first) < LEAST or not _are_near(first, second):
        return False
    a = {name: values[_order(first)] for name, values in columns.items()}
    rows = np.arange(len(second))
    held = ~np.any([np.diff(a[name]) != 0 for name in INPUTS if name in a], axis=0)
    ways = (rows, rows[::-1]) if np.any(held) else (rows,)  # of rows of the same inputs
    return any(
        _agree(a, {name: values[order] for name, values in others.items()})
        for order in (way[_order(second, way)] for way in ways)
    )


def _are_near(first: "Log", second: "Log") -> bool:
    """Whether the largest and the mean reading are alike, as they are of copies, and not of most logs."""
    a, b = np.abs(first.response), np.abs(second.response)
    largest = float(np.max(a))
    return all(abs(float(of(a)) - float(of(b))) <= NEAR * largest for of in (np.max, np.mean))


def _agree(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    """Whether all numbers agree to their digits. Of a few rows that is asked first: with their own digits,
    which are no more than those of all, they agree where all do."""
    few = slice(None, None, len(next(iter(a.values()))) // FEW + 1)
    return all(_are_one(a[name][rows], b[name][rows]) for rows in (few, slice(None)) for name in a)


def _are_one(a: np.ndarray, b: np.ndarray) -> bool:
    most = (0.5 + EXACT) * np.maximum(digit(a), digit(b)) + EXACT * np.max(np.abs(a))
    return bool(np.all(np.abs(a - b) <= most))


def _columns(log: "Log") -> dict[str, np.ndarray]:
    inputs = {name: values for name in INPUTS if (values := getattr(log, name)) is not None}
    return _channels(log) | inputs  # readings first: most logs are told apart by them


def _channels(log: "Log") -> dict[str, np.ndarray]:
    return {"w": log.response} if log.amplitude_only else {"wd": log.response.real, "wq": log.response.imag}


def _order(log: "Log", rows: np.ndarray | None = None) -> np.ndarray:
    """Places in `rows` (all of them as they are, if None) in the order of the inputs; rows of the same stay
    as they come."""
    keys = [values for name in reversed(INPUTS) if (values := getattr(log, name)) is not None]
    if not keys:
        return np.arange(len(log))
    return np.lexsort(keys if rows is None else [values[rows] for values in keys])


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
