"""Arrays that have an axis of plates and one of rows: numpy's on a processor; on an accelerator, where JAX
has one, JAX's in double precision.

What is done to them is written once, as a function of the module `xp` whose arrays it takes, and of these; an
accelerator runs it as one program. What has an axis of plates alone is numpy's everywhere.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial, wraps
from typing import Any, NamedTuple

import jax
import numpy as np

from sysid.precision import float64

Rows = Any  # an array of numpy, or of JAX
FEWEST = 64  # plates for which an accelerator has a program of its own


class Place(NamedTuple):
    """Where such arrays are: the module of their functions; how many plates are fitted at once at most, and
    how many rows of a log of all of them."""

    xp: Any
    plates: int
    rows: int


PROCESSOR = Place(np, 512, 1 << 18)  # of fewer each cell is gone through often, for few plates each
ACCELERATOR = Place(jax.numpy, 1 << 12, 1 << 22)  # half a gigabyte of columns


@cache
def here() -> Place:
    """The place that this process uses."""
    return PROCESSOR if jax.default_backend() == "cpu" else ACCELERATOR


def on_rows(*static: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Of a function `f(xp, *arrays, **static)`, f without `xp`, that of the place."""

    def placed(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def run(*arrays: Any, **given: Any) -> Any:
            xp = here().xp
            return function(np, *arrays, **given) if xp is np else program(xp)(*arrays, **given)

        @cache
        def program(xp: Any) -> Callable[..., Any]:
            return float64(jax.jit(partial(function, xp), static_argnames=static))

        return run

    return placed


@on_rows()
def there(xp: Any, array: Rows) -> Rows:
    """An array at the place."""
    return array


@on_rows()
def one(xp: Any, array: Rows, index: int) -> Rows:
    """Of an array (P, ...) that of one plate."""
    return array[index]


def put(array: Rows, where: Any, values: Rows) -> Rows:
    """The array with these values at an index; numpy's is changed itself."""
    if not isinstance(array, np.ndarray):
        return array.at[where].set(values)
    array[where] = values
    return array


def padding(count: int) -> int:
    """How many plates to add to so many, so that an accelerator needs programs for few counts."""
    return 0 if here().xp is np or not count else max(FEWEST, 1 << (count - 1).bit_length()) - count


def padded(items: Sequence[Any]) -> list[Any]:
    """The plates and, for such a program, the last of them again."""
    return [*items, *([items[-1]] * padding(len(items)) if items else ())]
