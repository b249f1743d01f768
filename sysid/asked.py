"""What a function was given: refused, where it is of another kind than was asked for, in the words of other
refusals."""

import math
from collections.abc import Iterable
from numbers import Integral
from pathlib import Path
from typing import Any, NoReturn

ABSOLUTE_ZERO = -273.15  # degC
FIT = "a Fit, which sysid.fit(logs) returns"
LOG = "a Log, of those that sysid.read_logs(paths) returns"
LOOP = "a Loop, which controller.design(posterior) returns"
PROFILE = "a number, or a sysid.Profile of it over time"


def refuse(name: str, value: Any, expected: str) -> NoReturn:
    """Raise TypeError for what is `value` and should be something else."""
    short = isinstance(value, str | bytes | int | float | complex | Path | None)
    raise TypeError(f"found {name} = {value!r}, expected {expected}" if short else _of(name, value, expected))


def _of(name: str, value: Any, expected: str) -> str:
    return f"found {name} of the type {type(value).__name__}, expected {expected}"


def given(name: str, value: Any, kind: Any, expected: str) -> None:
    """Raise TypeError where `value` is not of a `kind`."""
    if not isinstance(value, kind):
        refuse(name, value, expected)


def every(name: str, values: Any, kind: Any, expected: str) -> list:
    """Several values of a `kind`, or one of it, as a list. Raises TypeError for others."""
    if isinstance(values, kind):
        return [values]
    if isinstance(values, str) or not isinstance(values, Iterable):
        refuse(name, values, expected)
    found = list(values)
    for value in found:
        given(f"one of {name}", value, kind, expected)
    return found


def whole_number(name: str, value: Any) -> int:
    """A whole number from 0 on. Raises TypeError for what is no whole number, ValueError for one below."""
    if not isinstance(value, Integral):
        refuse(name, value, "a whole number")
    if value < 0:
        raise ValueError(f"found {name} = {value}, expected a whole number from 0 on")
    return int(value)


def temperature(name: str, value: Any) -> float:
    """A temperature in degC. Raises TypeError for what is no number, ValueError for none above absolute
    zero."""
    found = number(name, value)
    if not ABSOLUTE_ZERO <= found < math.inf:
        raise ValueError(f"found {name} = {found:g}, expected degC, above absolute zero")
    return found


def number(name: str, value: Any, expected: str = "a number") -> float:
    """A number, of whatever library. Raises TypeError for what is none, a text of one included."""
    try:
        math.isfinite(value)
    except (TypeError, ValueError):
        refuse(name, value, expected)
    return float(value)
