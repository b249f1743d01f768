"""One line of a text table as cells: how it is parted, which cells are numbers, and how names are listed in
messages."""

import csv
import io
import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

WHITESPACE = " "  # the delimiter that means any run of blanks and tabs
MARKS = ",;\t| "  # that may part cells
_MAGNITUDE = re.compile(r"(?<![^\s,;])\|[^|\s]+\|")
GROUPED = re.compile(
    r"[+-]?[1-9]\d{0,2}([.,]\d{3})+"
)  # 32,300: a fraction where the comma is the decimal mark, else thousands
_MARKS = str.maketrans({"−": "-", "\u00a0": "'", "\u202f": "'", "’": "'"})
# Thousands beside a fraction, in two groups or more, or behind a mark that is never a decimal one.
_THOUSANDS = {
    decimal: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}(({group}\d{{3}})+{point}\d*|({group}\d{{3}}){{2,}}|('\d{{3}})+({point}\d*)?)"
        r"([eE][+-]?\d+)?"
    )
    for decimal, point, group in ((".", r"\.", ","), (",", ",", r"\."))
}
_AMOUNT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)(?![\d:])\s*(.*)")  # not of 12:31
_PART = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_SIGNED = _PART.replace("[+-]?", r"[+-]\s*", 1)
RECTANGULAR = re.compile(rf"\(?\s*{_PART}\s*{_SIGNED}\s*\*?\s*[ij]\s*\)?")  # (0.1+0.2j), 0.1 + 0.2i
# Of SCPI, and so of many instruments: 9.91e37 is "not a number", ±9.9e37 infinity (SCPI-99, volume 1, 7.2.1).
NO_NUMBER = 9.9e37
SHOWN = 20  # names in a message, of files that have thousands


@dataclass(frozen=True)
class Dialect:
    """How a table is written; None means: see from the file."""

    delimiter: str | None = None
    comment: tuple[str, ...] | None = None  # what lines of metadata begin with
    decimal: str | None = None
    header: bool | None = None
    # lines at the top to leave out; None: a preamble without a comment mark is seen from the file
    skip: int | None = None
    table: str | None = None  # of a file of several tables, as of HDF5 groups: which of them
    join: str | int | None = None  # the column that tables one below the other share, side by side


def split_line(text: str, delimiter: str) -> list[str]:
    """The cells of one line; quotes are understood."""
    if delimiter == WHITESPACE:
        text = " ".join(text.split())
    text = text.rstrip("\r\n").replace("\r", " ")
    if '"' not in text:  # the library takes no cell of more than 131072 characters
        cells = text.split(delimiter) if text else []
        return [cell.lstrip(" ") for cell in cells] if " " in text else cells
    return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])


def to_number(text: str, decimal: str = ".") -> float:
    """A cell as a number, NaN when it is none, or what instruments write for none. Where the decimal mark is
    a comma, 32.300 is none: it may be thousands.

    Thousands that can be nothing else are understood (32,300.5 with a decimal point; 32'300, or a hard
    space), and so are a printed minus, Fortran's 1.5D-3 and Mathematica's 1.5*^-3.
    """
    text = text.strip()
    if "_" in text or (decimal == "," and "." in text and GROUPED.fullmatch(text)):
        return math.nan
    try:
        number = float(text.replace(decimal, "."))
    except ValueError:
        number = _odd_number(text, decimal)
    return math.nan if abs(number) >= NO_NUMBER else number


def decimals(text: str, decimal: str = ".") -> int:
    """How many decimals a number is written with: 1 of 24.0, 0 of 24."""
    mantissa, _, power = text.strip().casefold().replace("d", "e").partition("e")
    shift = int(power) if power.lstrip("+-").isdigit() else 0
    return len(mantissa.partition(decimal)[2]) - shift


def _odd_number(text: str, decimal: str) -> float:
    text = text.translate(_MARKS)
    if _THOUSANDS[decimal].fullmatch(text):
        text = re.sub(rf"['{'.' if decimal == ',' else ','}]", "", text)
    try:
        return float(re.sub(r"(?:[dD]|\*\^)(?=[+-]?\d+$)", "e", text.replace(decimal, ".")))
    except ValueError:
        return math.nan


def is_number(text: str) -> bool:
    """Whether a cell is a number (nan and inf included), whichever its decimal mark."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return not (math.isnan(to_number(text)) and math.isnan(to_number(text, ",")))
    return "_" not in text


def means_none(text: str) -> bool:
    """Whether a cell is the number that an instrument writes where it has none."""
    try:
        return NO_NUMBER <= abs(float(text.replace(",", "."))) < math.inf
    except ValueError:
        return False


def amount(text: str) -> tuple[str, str] | None:
    """A number and what stands behind it, a unit perhaps, of a text that begins so; else None."""
    found = _AMOUNT.fullmatch(text.strip())
    return (found[1], found[2]) if found and is_number(found[1]) else None


def listed(names: Sequence[str]) -> str:
    """Names in a message: the first of them, where a file has thousands."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def find_delimiter(line: str) -> str:
    """The mark that parts a row into numbers; of a header a comma, or where it has none a semicolon, a tab or
    a bar that does not stand for a magnitude, |Z|, else blanks."""
    for mark in MARKS:
        if mark in line and all(is_number(cell) for cell in split_line(line, mark) if cell.strip()):
            return mark
    bare = _MAGNITUDE.sub("", line)
    return next((mark for mark in MARKS[:-1] if mark in bare), WHITESPACE if " " in line else ",")


def uncounted(names: Sequence[str]) -> tuple[str, ...]:
    """The names of a header without the numbers at its end that count the columns, from 0 or 1 on."""
    texts = tuple(itertools.takewhile(lambda name: not is_number(name), names))
    counted = [name.strip() for name in names[len(texts) :]]
    counts = any(counted == [str(k + first) for k in range(len(counted))] for first in (0, 1))
    return texts if counts and any(text.strip() for text in texts) else tuple(names)


def with_unit_cells(names: list[str], units: list[str], delimiter: str) -> str:
    """The header line of two: each name with the unit that stands below it at its end, once."""
    pairs = [(name.strip(), unit.strip()) for name, unit in zip(names, units, strict=True)]
    named = io.StringIO()
    csv.writer(named, delimiter=delimiter).writerow(
        [name if not unit or name.endswith(_below(unit)) else f"{name}{_below(unit)}" for name, unit in pairs]
    )
    return named.getvalue().rstrip("\r\n")


def unbracketed(text: str) -> str:
    """A text without the brackets that it stands in, as (ms) and [ Hz ] do; not those at its end alone."""
    text = text.strip()
    return text[1:-1].strip() if text[:1] in ("[", "(") and text[-1:] in ("]", ")") else text


def _below(unit: str) -> str:
    """A unit as the end of a name; of words with a unit in brackets, as `Time (s)`, all of them."""
    return f"_{unbracketed(unit)}" if re.fullmatch(r"[\[(]?[^\[\]()]*[\])]?", unit) else f" {unit}"
