"""Dates, of ISO 8601 or as they are written locally, and times of day, 12:00:00.5, in place of seconds: how
they look, and how many seconds lie between them.

A local date does not say which of its numbers is the day: 03/04/2024 is in March or in April. It is read in
each order, and the column tells which is meant: by a day above 12, or by a span in which all orders agree.
"""

import math
import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np

_ISO = re.compile(
    r"\d{4}([-/.])\d\d?\1\d\d?([T ]\s*\d\d?:\d\d(:\d\d([.,:]\d*)?)?\s*(Z|UTC|GMT|[+-]\d\d(:?\d\d)?)?)?"
)
_HALF = r"(?:\s*([AP])\.?M\.?)?"  # of the day
# 12:00:00.5, 12:00:00:500, and 00:00.5 of minutes and seconds, as spreadsheets show it
_CLOCK = re.compile(
    rf"(?:(\d\d?):(?=\d\d:)|(?=\d\d:\d\d[.,]\d))(\d\d):(\d\d(?:[.,]\d*|:\d{{3}})?){_HALF}", re.IGNORECASE
)
_LOCAL = re.compile(r"\d\d?([-/.])\d\d?\1\d{2,4}(?!\d)")
_LOCALLY = re.compile(
    rf"(\d\d?)([-/.])(\d\d?)\2(\d{{4}}|\d\d)(?:(?:,?\s+|T)(\d\d?):(\d\d)(?::(\d\d(?:[.,]\d*|:\d{{3}})?))?{_HALF})?",
    re.IGNORECASE,
)
_SECONDS = r"(?P<second>\d\d(?:[.,]\d*|:\d{3})?)"
_TIME = rf"(?P<hour>\d\d?):(?P<minute>\d\d)(?::{_SECONDS})?{_HALF.replace('([', '(?P<half>[')}"
_MONTHS = (
    "jan",
    "feb",
    "mar mär mrz",
    "apr",
    "may mai",
    "jun",
    "jul",
    "aug",
    "sep",
    "oct okt",
    "nov",
    "dec dez",
)
_MONTH = rf"(?P<month>{'|'.join(_MONTHS).replace(' ', '|')})[a-z]*\.?"
# Dates whose month is a word, 31-Mar-2024 12:00:00, Mar 31, 2024 12:00 PM, Sun Mar 31 12:00:00 2024, and some
# without marks, 20240331T120000.5.
_WRITTEN = [
    re.compile(form, re.IGNORECASE)
    for form in (
        rf"(?P<day>\d\d?)[-\s/.]+{_MONTH}[-\s/.,]+(?P<year>\d{{4}}|\d\d)(?:[\s,T:]+{_TIME})?",
        rf"{_MONTH}\s+(?P<day>\d\d?),?\s+(?P<year>\d{{4}})(?:[\s,]+{_TIME})?",
        rf"(?:[a-z]{{3}},?\s+)?{_MONTH}\s+(?P<day>\d\d?)\s+{_TIME}\s+(?P<year>\d{{4}})",
        r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)[T_ ]"
        r"(?P<hour>\d\d)(?P<minute>\d\d)(?P<second>\d\d(?:[.,]\d*)?)(?P<half>)Z?",
    )
]
_SIGNS = str.maketrans({"年": "-", "月": "-", "日": " ", "時": ":", "时": ":", "分": ":", "秒": ""})
ORDERS = ((2, 1, 0), (2, 0, 1))  # at which place of a local date year, month and day may stand
SHORT = (*ORDERS, (0, 1, 2))  # where the year has two digits
DAY = 86400.0  # s
_LONG = re.compile(r"\d{8,}[.,]\d+")
EXAMPLE = "2024-03-31T12:00:00.001"


def is_date(text: str) -> bool:
    """Whether a cell begins with a day of a calendar, the year first."""
    return re.match(r"\d{4}[-/.]\d\d?[-/.]\d\d?(?!\d)", text.strip()) is not None


def is_local(text: str) -> bool:
    """Whether a cell begins with a day of a calendar, the year last, which does not tell day from month."""
    return _LOCAL.match(text.strip()) is not None


def is_stamp(text: str) -> bool:
    """Whether a cell is a date, with a time of day or without, or a time of day alone."""
    return _is_usual(text) or _is_usual(_usual(text))


def _is_usual(text: str) -> bool:
    return any(form.fullmatch(text.strip()) for form in (_ISO, _CLOCK, _LOCALLY))


def _usual(text: str) -> str:
    """A date that is written with words, with signs or without marks as one of ISO 8601; any other text as it
    is."""
    text = re.sub(r"\s+", " ", text.translate(_SIGNS)).strip()
    found = next((found for form in _WRITTEN if (found := form.fullmatch(text))), None)
    if found is None:
        return text
    word = found["month"].casefold()
    month = word if word.isdigit() else 1 + next(k for k, names in enumerate(_MONTHS) if word in names)
    century = "" if len(found["year"]) == 4 else "20"
    day = f"{century}{found['year']}-{int(month):02d}-{int(found['day']):02d}"
    if found["hour"] is None:
        return day
    return f"{day}T{_hour(found['hour'], found['half'])}:{found['minute']}:{_second(found['second'])}"


def is_clock(text: str) -> bool:
    """Whether a cell is a time of day alone."""
    return _CLOCK.fullmatch(text.strip()) is not None


def is_long(text: str) -> bool:
    """Whether a cell is a number of so many digits, as seconds since 1970 are, that double precision rounds
    its fraction."""
    return _LONG.fullmatch(text.strip()) is not None


def seconds_since(first: str, cells: Sequence[str]) -> np.ndarray:
    """Seconds (n,) from the stamp `first` to each cell, to the nanosecond; NaN where a cell is no stamp of
    its kind. Of local dates (n, orders), in each order of day and month, of which `told` takes one.

    Of a long number (`is_long`) the differences, in its own unit.
    """
    if is_long(first):
        return np.array([_difference(cell, first) for cell in cells])
    read = str.strip if _is_usual(first) else _usual
    texts, first = [read(text) for text in cells], read(first)
    if found := _LOCALLY.fullmatch(first):
        orders = SHORT if len(found[4]) == 2 else ORDERS
        dates = [_LOCALLY.fullmatch(text) for text in (first, *texts)]
        known = [[_as_iso(date, order) if date else None for date in dates] for order in orders]
        return np.stack([_passed(_dates(stamps)) for stamps in known], axis=1)
    if _CLOCK.fullmatch(first):
        return _passed(_clocks([first, *texts]))
    return _passed(_dates([text if _ISO.fullmatch(text) else None for text in (first, *texts)]))


def told(seconds: np.ndarray) -> np.ndarray:
    """Seconds (n,) of a whole column. Of local dates, (n, orders), those in the order that reads most of
    them; NaN where several do and differ, so that none can tell the day from the month."""
    if seconds.ndim == 1:
        return seconds
    lost = np.isnan(seconds).sum(axis=0)
    likely = seconds[:, lost == lost.min()]
    return np.where(np.ptp(likely, axis=1) == 0, likely[:, 0], np.nan)


def past_midnight(time: np.ndarray) -> int | None:
    """The row at which times of day (s) begin anew, where they do so once; else None. A clock of twelve hours
    goes back by less than half a day, one of 24 by more, if its rows follow one another within the other
    half."""
    (back,) = np.nonzero(np.diff(time) < 0)
    once = len(back) == 1 and time[back[0]] - time[back[0] + 1] > DAY / 2
    return int(back[0]) + 1 if once else None


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


def _passed(stamps: np.ndarray) -> np.ndarray:
    """Seconds from the first of some stamps to each of the others, NaN where one is missing."""
    passed = (stamps[1:] - stamps[0]).astype("timedelta64[ns]")
    return np.where(np.isnat(passed), np.nan, passed.astype(np.int64) / 1e9)


def _as_iso(date: re.Match[str], order: tuple[int, int, int]) -> str:
    """A local date as one of ISO 8601, its year, month and day at the places of the `order`."""
    numbers = (date[1], date[3], date[4])
    year, month, day = (numbers[place].zfill(2) for place in order)
    day = f"{year if len(year) == 4 else f'20{year}'}-{month}-{day}"
    if date[5] is None:
        return day
    return f"{day}T{_hour(date[5], date[8])}:{date[6]}:{_second(date[7])}"


def _second(second: str | None) -> str:
    """Of a minute, whatever stands before its fraction: 05.250 of 05:250."""
    return re.sub("[,:]", ".", second or "00")


def _hour(hour: str, half: str | None) -> str:
    """The hour of the day, of one that is counted in halves of it, AM and PM, too: 12 AM is 00."""
    if not half:
        return hour.zfill(2)
    within = int(hour) % 12 if 1 <= int(hour) <= 12 else 99  # no hour at all, which nothing reads
    return f"{within + 12 * (half.upper() == 'P'):02d}"


def _clocks(texts: Sequence[str]) -> np.ndarray:
    import pandas as pd

    found = [_CLOCK.fullmatch(text) for text in texts]
    known = [of and f"{_hour(of[1] or '0', of[4])}:{of[2]}:{_second(of[3])}" for of in found]
    read = pd.to_timedelta(pd.Series(known, dtype=object), errors="coerce")
    return read.to_numpy("timedelta64[ns]")


def _plain(text: str) -> str:
    """A date of ISO 8601 as the library reads it: a point before the fraction of a second, Z for UTC."""
    text = re.sub(r"(:\d\d:\d\d):", r"\1.", text.replace(",", ".").replace("/", "-"))
    return re.sub(r"\s*(UTC|GMT)$", "Z", text)


def _dates(texts: Sequence[str | None]) -> np.ndarray:
    import pandas as pd

    known = [text and _plain(text) for text in texts]
    read = pd.to_datetime(pd.Series(known, dtype=object), format="ISO8601", utc=True, errors="coerce")
    return read.dt.tz_localize(None).to_numpy("datetime64[ns]")
