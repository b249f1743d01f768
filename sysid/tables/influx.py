"""The line protocol of InfluxDB, `plate,run=1 wd_um=0.25,wq_um=0.1 1711886400000000000`: each series, a
measurement with its tags, is a table, whose fields are columns at their times."""

import re
from collections.abc import Iterator

import numpy as np

from sysid.tables.store import Store
from sysid.tables.textfile import LogError, open_text, read_line

_NAME = r"(?:[^,= \\]|\\.)+"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?[iu]?"
_VALUE = rf'(?:"(?:[^"\\]|\\.)*"|{_NUMBER}|[tT](?:rue)?|[fF](?:alse)?|TRUE|FALSE)'
_LINE = re.compile(
    rf"((?:[^, \\]|\\.)+(?:,{_NAME}={_NAME})*) +({_NAME}={_VALUE}(?:,{_NAME}={_VALUE})*)(?: +(-?\d+))?"
)
_FIELD = re.compile(rf"({_NAME})=({_VALUE})")
_DIGITS = {10: "s", 13: "ms", 16: "us", 19: "ns"}  # of a time since 1970, from 2001 until 2286


def is_influx(first: bytes) -> bool:
    """Whether a text begins with a line of this protocol, with a time."""
    lines = (line.strip() for line in first.decode("utf-8", errors="replace").splitlines())
    found = _LINE.fullmatch(next((line for line in lines if line and not line.startswith("#")), ""))
    return found is not None and found[3] is not None and len(found[3]) in _DIGITS


def read_influx(path: str, kind: str) -> Store:
    """The contents of a file of lines. Raises LogError where one is none."""
    store = Store(path, kind)
    series: dict[str, dict[str, dict[str, float]]] = {}  # the fields at each time
    names: dict[str, dict[str, None]] = {}
    for number, text in _lines(path):
        found = _LINE.fullmatch(text)
        if found is None or len(found[3] or "") not in _DIGITS:
            expected = "a measurement, its fields and a time since 1970 in s, ms, us or ns"
            raise LogError(f"{path}, line {number}: found {text!r}, expected {expected}")
        fields = {name: _number(value) for name, value in _FIELD.findall(found[2])}
        row = series.setdefault(found[1], {}).setdefault(found[3], {})
        if again := row.keys() & fields.keys():
            said = f"found {min(again)!r} of {found[1]} at {found[3]} again"
            raise LogError(f"{path}, line {number}: {said}, expected one value at each time")
        row |= fields
        names.setdefault(found[1], {}).update(dict.fromkeys(fields))
        store.claim(f"line {number}", len(fields))
    for table, at in series.items():
        units = {_DIGITS[len(stamp)] for stamp in at}
        if len(units) > 1:
            raise LogError(
                f"{path}: found times of {table} in {' and '.join(sorted(units))}, expected one unit"
            )
        stamps = sorted(at, key=int)
        store.add(table, "time", np.array([*map(int, stamps)]).astype(f"datetime64[{units.pop()}]"))
        for name in names[table]:
            store.add(table, re.sub(r"\\(.)", r"\1", name), [at[stamp].get(name, np.nan) for stamp in stamps])
    return store


def _lines(path: str) -> Iterator[tuple[int, str]]:
    """The lines that hold something, by their numbers, comments aside."""
    with open_text(path) as file:
        number = 0
        while raw := read_line(path, file, number + 1):
            number += 1
            text = raw.decode("utf-8-sig", errors="replace").strip()
            if text and not text.startswith("#"):
                yield number, text


def _number(value: str) -> float:
    """A value as a number, of integers without their mark; NaN of texts and truths."""
    return np.nan if value[0] in '"tTfF' else float(value.rstrip("iu"))
