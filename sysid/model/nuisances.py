"""What the bench adds to what the plant does, by numbers that are eliminated at each plant."""

from typing import NamedTuple

import numpy as np

from sysid.model import rice
from sysid.model.course import Course


class Nuisances(NamedTuple):
    """(...,) of each log or plant: rotation; start and lateness, of which settled points have none; and the
    floor and the offset of d and q of an amplitude."""

    turn: np.ndarray
    start: np.ndarray | None = None
    late: np.ndarray | None = None
    floor: np.ndarray | None = None
    offset: np.ndarray | None = None


def plate(course: Course, at: Nuisances) -> np.ndarray:
    """(..., N) W = turn h + start e + late h' + offset."""
    w = at.turn[..., None] * course.forced
    for number, shape in (at.start, course.start), (at.late, course.late), (at.offset, 1.0):
        if number is not None and shape is not None:
            w = w + number[..., None] * shape
    return w


def modelled(course: Course, at: Nuisances) -> np.ndarray:
    """(..., N) rows that the plant drives: W or, for an amplitude, the mean of Rice's distribution about its
    size, whose level is the root of the floor."""
    w = plate(course, at)
    return w if at.floor is None else rice.mean(w, at.floor[..., None])


def changed(course: Course, change: Course, at: Nuisances) -> np.ndarray:
    """(..., p, N) how these change where the course does so by `change`, of axes (..., p, N)."""
    moved = plate(change, Nuisances(*(None if v is None else v[..., None] for v in at[:3])))
    if at.floor is None:
        return moved
    return (rice.towards(plate(course, at), at.floor[..., None])[..., None, :] * moved).real
