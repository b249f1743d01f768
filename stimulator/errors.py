"""What the package says when something cannot be, and when a law is used beyond its range."""

import math
import numbers
import warnings
from typing import Any, NoReturn


class StimulatorError(ValueError):
    """Something that cannot be: says which key, what was found and what was expected."""


class RangeWarning(UserWarning):
    """A law is used beyond the range in which it is known to hold; the message names the quantity, its value
    and the range."""


def refuse(key: str, found: Any, expected: str) -> NoReturn:
    """Raise StimulatorError for `key`."""
    raise StimulatorError(f"{key}: found {found}, expected {expected}")


def number(
    key: str, value: Any, low: float = -math.inf, high: float = math.inf, expected: str = "a number"
) -> float:
    """`value` if it is a finite number strictly between `low` and `high`. Raises StimulatorError."""
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not (real and math.isfinite(value) and low < value < high):
        refuse(key, repr(value), expected)
    return float(value)


def not_negative(key: str, value: Any, unit: str, below: float = math.inf) -> float:
    """`value` if it is a number from zero to less than `below`. Raises StimulatorError."""
    limit = "" if below == math.inf else f" and below {below:g}"
    return number(key, value, -math.ulp(0.0), below, f"a number of zero or more{limit}, in {unit}")


def positive(key: str, value: Any, unit: str) -> float:
    """`value` if it is a finite number above zero. Raises StimulatorError."""
    return number(key, value, low=0.0, expected=f"a number above zero, in {unit}")


def beyond(message: str) -> None:
    """Warn that a law is used beyond its range, at the line of whoever called the law."""
    warnings.warn(message, RangeWarning, stacklevel=3)
