"""A `Bench`: what a log's bench added to its plate, as it is known at present."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


class Extra(NamedTuple):
    """An effect of `trials.extra`: its `shape` (n,) per unit of its number, not turned by the demodulator,
    and the number's prior std."""

    shape: np.ndarray
    prior: float


@dataclass(frozen=True, eq=False)
class Bench:
    """What the bench added to one log."""

    start: complex = 0.0  # in the plate's frame
    offset: complex = 0.0  # of d and q, under an amplitude, in the plate's frame
    standing: bool = False  # there is one
    # (n,) of a sweep: what else moves, in the plate's frame
    alongside: np.ndarray | None = field(default=None, repr=False)
    # (n,) of d and q: what was recorded beside the plate, as fed through or offset
    fed: np.ndarray | float = field(default=0.0, repr=False)
    floor: float = 0.0  # of an amplitude log, response squared
    floor_free: bool = True  # until the data want it below zero
    late: float = 0.0  # s, by which the response is late
    resonance: float | None = None  # Hz above the reference, its own where the thermometer's error is fitted
    k_T: float = 0.0  # Hz/degC, at which the shape of that error is
    under: np.ndarray | None = field(default=None, repr=False)  # (n,) what one unit of floor adds to a sweep
    narrow: dict[str, float] = field(default_factory=dict)  # std of priors that are narrower than usual
    # what else may have been done to the log, at the present plate
    extra: dict[str, Extra] = field(default_factory=dict, repr=False)
    filter: tuple[complex, int] | None = None  # time constant (s) and poles of a lock-in's, or `SECOND`
    turn: complex = 1.0  # by what the plate's response is turned; times its gain, where that is the log's own

    @property
    def moves(self) -> np.ndarray | float:
        """(n,) `alongside`, or nothing."""
        return 0.0 if self.alongside is None else self.alongside
