"""One term that a log may hold beside what the model has: a shape to first order and a sentence."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sysid.view import View


@dataclass(frozen=True)
class Term:
    """Something left out: `shapes`, of some logs (by position), (n, m) in the unit of the response, complex or real."""

    name: str
    shapes: dict[int, np.ndarray] = field(repr=False)
    say: Callable[[np.ndarray, View], str | None]  # of the m coefficients; None: that sign or size makes no sense
    log: int | None = None  # the one log that it is about
    freedom: int = 1  # numbers that it has, its place on a grid among them
    beside: tuple[str, float] | None = None  # a parameter that it moves besides, by so much for a coefficient of one
    unseen: str = ""  # what to say, of its size and of what that moves, where it is to be expected and may hide


def of_one(i: int, name: str, shape: np.ndarray, sentence: str, sign: int = 0) -> Term:
    """A term of one real number in one log, of the given sign (0: either)."""
    return Term(name, {i: shape[:, None]}, lambda value, _: sentence if value[0] * sign >= 0 else None, i)
