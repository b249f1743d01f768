"""Plain floats under the names that numpy and JAX have for arrays.

A step is written once in Python, in `+ - * /`, comparisons and the functions below, and takes what it
computes with as `xp`: this module, `numpy` or `jax.numpy`. All run the same operations in the same order, and
so does the C (`controller/c/dq.c`).
"""

import math
from typing import Any

import numpy as np

KNOWN = (np.bool_, np.ndarray)  # and no array of JAX, which may stand for what is not there yet
NO_LIMIT = 1e30  # in any unit; a number also in single precision
nan = math.nan


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


def beyond(x: Any, most: Any) -> Any:
    """Whether x is above `most` or below -`most`."""
    return (x > most) | (x < -most)


def counted(condition: Any, count: Any, xp: Any) -> Any:
    """Samples for which a condition has held, this one included."""
    return xp.where(condition, count + 1.0, 0.0)


def magnitude(x: Any, xp: Any) -> Any:
    """|x|."""
    return xp.where(x < 0.0, -x, x)


def seen(reference: Any, W: Any, xp: Any) -> Any:
    """Whether a measurement is there at all: one that is missing is not finite, and is not zero. One whose
    fourth power overflows is none either: nothing that is computed from it would be finite."""
    size = W.real * W.real + W.imag * W.imag
    return xp.isfinite(reference) & xp.isfinite(size * size)


def mapped(function: Any, value: Any, *others: Any) -> Any:
    """A function of the numbers of states of one form, number by number; None is no number."""
    if value is None:
        return None
    if not isinstance(value, tuple):
        return function(value, *others)
    items = (mapped(function, *parts) for parts in zip(value, *others, strict=True))
    return type(value)(*items) if hasattr(value, "_fields") else tuple(items)


def either(condition: Any, yes: Any, no: Any, xp: Any) -> Any:
    """Of two states of one form, number by number; at once where the condition is a plain one, or an array
    that is the same throughout: a model's line may be of tens of thousands of numbers."""
    if isinstance(condition, bool):
        return yes if condition else no
    if isinstance(condition, KNOWN) and (all_ := bool(np.all(condition))) == bool(np.any(condition)):
        return yes if all_ else no
    return mapped(lambda a, b: xp.where(condition, a, b), yes, no)


def typed(control: Any, kind: Any) -> Any:
    """A controller, or a state, with every float in another type, in which its steps then compute."""
    return mapped(lambda v: kind(v) if isinstance(v, float) else v, control)
