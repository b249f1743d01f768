"""The schedule of the rounds in which the noise follows the fit and the fit the noise: what could circle is
held after some."""

from typing import NamedTuple

import numpy as np

HELD = 10  # rounds after which rows keep their weights, as weights that follow the fit may circle
# rounds in which a correlation time is taken as found, and mostly stays; later ones go half of the way
WHOLE = 6
SETTLED = 20  # rounds after which the noise keeps its correlation time


class Rounds(NamedTuple):
    """How far a search for a minimum goes: at most `most` rounds, before which the noise was estimated in
    `known` others, with at most `steps` in each; with 0 of them and one round, what is seen where it begins.
    `white`: of the noise only the level is asked for, as of what is to be compared in one round."""

    most: int = 30
    known: int = 0
    steps: int = 128
    white: bool = False


def halfway(time: float, before: float) -> float:
    """The geometric mean of a correlation time and the one before; the new one where either is zero."""
    return float(np.sqrt(time * before)) if time > 0 and before > 0 else time
