"""Plain floats under the names that numpy and JAX have for arrays.

A step is written once, in `+ - * /`, comparisons and the functions below, and takes what it computes with as `xp`: this module,
`numpy`, `jax.numpy`, or the symbols that the C export records. All of them run the same operations in the same order.
"""

import math
from typing import Any, NamedTuple

NO_LIMIT = 1e30  # in any unit; a number also in single precision
nan = math.nan


class Span(NamedTuple):
    """Where a number lies; fixed point takes its scale from it."""

    low: float
    high: float


class Full(NamedTuple):
    """Full scale: the largest `response` (each of Wd, Wq) and `voltage`, and the plate's `temperature` in degC."""

    response: float
    voltage: float
    temperature: Span = Span(-60.0, 200.0)


def where(condition: bool, yes: float, no: float) -> float:
    """As numpy's, of one number."""
    return yes if condition else no


def isfinite(x: float) -> bool:
    """As numpy's, of one number."""
    return math.isfinite(x)


def logical_not(x: bool) -> bool:
    """As numpy's, of one number."""
    return not x


def floor(x: float) -> float:
    """As numpy's, of one number: infinite stays infinite."""
    return float(math.floor(x)) if math.isfinite(x) else x


def clip(x: Any, low: Any, high: Any, xp: Any) -> Any:
    """x within low to high; low where they cross."""
    x = xp.where(x > high, high, x)
    return xp.where(x < low, low, x)


def seen(reference: Any, W: Any, xp: Any) -> Any:
    """Whether a measurement is there at all: one that is missing is not finite, and is not zero. One whose fourth power
    overflows is none either: nothing that is computed from it would be finite."""
    size = W.real * W.real + W.imag * W.imag
    return xp.isfinite(reference) & xp.isfinite(size * size)
