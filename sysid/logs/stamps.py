"""Dates (ISO 8601) and times of day, 12:00:00.5, in place of seconds: how they look, and how many seconds lie
between them."""

import math
import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np

_ISO = re.compile(r"\d{4}([-/.])\d\d?\1\d\d?([T ]\s*\d\d?:\d\d(:\d\d([.,]\d*)?)?\s*(Z|[+-]\d\d(:?\d\d)?)?)?")
_CLOCK = re.compile(r"\d\d?:\d\d:\d\d([.,]\d*)?")
_LOCAL = re.compile(r"\d\d?([-/.])\d\d?\1\d{2,4}(?!\d)")
_LONG = re.compile(r"\d{8,}[.,]\d+")
EXAMPLE = "2024-03-31T12:00:00.001"


def is_date(text: str) -> bool:
    """Whether a cell begins with a day of a calendar, the year first."""
    return re.match(r"\d{4}[-/.]\d\d?[-/.]\d\d?(?!\d)", text.strip()) is not None


def is_local(text: str) -> bool:
    """Whether a cell begins with a day of which none can tell the day from the month, as 03/04/2026."""
    return _LOCAL.match(text.strip()) is not None


def is_stamp(text: str) -> bool:
    """Whether a cell is a date, the year first, with a time of day or without, or a time of day alone."""
    text = text.strip()
    return _ISO.fullmatch(text) is not None or _CLOCK.fullmatch(text) is not None


def is_long(text: str) -> bool:
    """Whether a cell is a number of so many digits, as seconds since 1970 are, that double precision rounds
    its fraction."""
    return _LONG.fullmatch(text.strip()) is not None


def seconds_since(first: str, cells: Sequence[str]) -> np.ndarray:
    """Seconds (n,) from the stamp `first` to each cell, to the nanosecond; NaN where a cell is no stamp of
    its kind.

    Of a long number (`is_long`) the differences, in its own unit.
    """
    if is_long(first):
        return np.array([_difference(cell, first) for cell in cells])
    clock = _CLOCK.fullmatch(first.strip()) is not None
    stamps = _nanoseconds([first, *cells], clock)
    passed = (stamps[1:] - stamps[0]).astype("timedelta64[ns]")
    return np.where(np.isnat(passed), np.nan, passed.astype(np.int64) / 1e9)


def _difference(cell: str, first: str) -> float:
    try:
        return float(Decimal(cell.strip().replace(",", ".")) - Decimal(first.strip().replace(",", ".")))
    except InvalidOperation:
        return math.nan


def coarse(time: np.ndarray) -> int | None:
    """The first row whose stamp is no later than that of the row before, or is missing; None where all go
    on."""
    later = np.diff(time, prepend=-np.inf) > 0
    return None if later.all() else int(np.argmin(later))


def _nanoseconds(cells: Sequence[str], clock: bool) -> np.ndarray:
    import pandas as pd

    form = _CLOCK if clock else _ISO
    texts = [text.strip().replace(",", ".").replace("/", "-") for text in cells]
    known = pd.Series([text if form.fullmatch(text) else None for text in texts], dtype=object)
    if clock:
        return pd.to_timedelta(known, errors="coerce").to_numpy("timedelta64[ns]")
    read = pd.to_datetime(known, format="ISO8601", utc=True, errors="coerce")
    return read.dt.tz_localize(None).to_numpy("datetime64[ns]")
