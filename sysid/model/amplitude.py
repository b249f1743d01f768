"""The nuisances of an amplitude log: at their optimum near the values that they have, as the mean of Rice's
distribution (`model.rice`) is linear in them only nearby."""

from collections.abc import Callable
from copy import copy
from typing import NamedTuple

import jax
import numpy as np

from sysid.model import rice
from sysid.model.course import Course
from sysid.model.experiment import Experiment, Layout, Residual, off, priors, whiten
from sysid.model.nuisances import Nuisances, modelled
from sysid.model.span import Span

MOST = 30  # steps to the nuisances of an amplitude log
LEAST = 0.1  # of its floor that the steps of one look leave
GAIN = 1e-8  # of a sum of squares, less than which a step is not worth taking
DAMPED = (1e-9, 1e-3, 1e9)  # of the information of each number: least, at first, and where a step is given up
NUMBERS = 6  # of a transient: start and offset, of d and q each, lateness and floor


def amplitude(
    course: Course, x: Experiment, layout: Layout
) -> tuple[Residual, Nuisances, Callable[[np.ndarray], np.ndarray]]:
    """The residual of an amplitude log, the nuisances of a transient at their optimum near their present
    values; these; and the projection of vectors off all that they can adjust."""
    one = np.ones(course.forced.shape[:-1])
    none = np.zeros((*one.shape, 0))
    if layout.steady:
        at = Nuisances(one, *(one * v for v in (x.start, x.late, x.floor, x.offset)))
        size = modelled(course, at)
        rows = x.response - off(whiten(size[..., None, :], x), x)[..., 0, :]
        return (
            Residual(rows, size, at.start, at.floor, at.late, at.offset, one, 0 * one, none),
            at,
            lambda v: off(v, x),
        )
    log = _Transient(course, x, layout)
    values = _settled(log)
    at = log.nuisances(values)
    size, rows, columns = log.linear(values)
    columns = off(off(columns, x), x)  # twice is enough
    span = Span(columns)
    # A floor that would be below zero is held there: it has its share of the volume, and makes nothing.
    span.units[..., -1] *= x.floor_free[..., None]
    best = span.weights(rows + (log.loose(values)[..., None, :] @ columns)[..., 0, :])
    floor = log.floor(best)
    return Residual(rows, size, at.start, floor, at.late, at.offset, one, span.volume, none), at, span.off


class _Problem(NamedTuple):
    """The sum of squares (n,) at some nuisances, what their steps gain to first order (n, 6), and their
    information (n, 6, 6)."""

    cost: np.ndarray
    slope: np.ndarray
    gram: np.ndarray


class _Transient:
    """The mean amplitude of transients, or of one beside several plants, by their numbers (n, 6): start,
    lateness, offset and floor, in units of their priors over their tightness. `first` are their present
    values, `least` the least that they may have, `free` which of them are to be found."""

    def __init__(self, course: Course, x: Experiment, layout: Layout):
        self.x = x
        held = np.broadcast_to(x.offset_free[..., None], course.forced.shape)
        parts = course.start, 1j * course.start, course.late, held, 1j * held
        self.columns = np.stack(parts, axis=-2, dtype=complex)
        offset = x.offset / np.where(x.offset_free > 0, x.offset_free, 1.0)
        self.still = course.forced + np.where(x.offset_free > 0, 0.0, x.offset)[..., None]
        self.own = x.tightness[..., None, None] * priors(NUMBERS, layout)
        first = x.start.real, x.start.imag, x.late, offset.real, offset.imag, x.tightness * x.floor
        self.first = np.stack(np.broadcast_arrays(*first, np.zeros(len(course.forced)))[:-1], axis=-1)
        self.least = np.where(np.arange(NUMBERS) == NUMBERS - 1, LEAST * self.first, -np.inf)
        is_start, is_offset, is_floor = x.start_free > 0, x.offset_free > 0, x.floor_free > 0
        free = is_start, is_start, np.ones_like(is_start), is_offset, is_offset, is_floor
        self.free = np.stack(free, axis=-1) & np.ones_like(self.first, bool)

    def only(self, some: np.ndarray) -> "_Transient":
        """Some of them."""
        part = copy(self)
        for name in ("columns", "still", "first", "least", "free"):
            setattr(part, name, getattr(self, name)[some])
        if self.x.response.ndim > 1:  # else there is one log
            part.x, part.own = jax.tree.map(lambda leaf: leaf[some], self.x), self.own[some]
        return part

    def floor(self, values: np.ndarray) -> np.ndarray:
        """(...,)"""
        return np.where(self.x.floor_free > 0, values[..., -1] / self.x.tightness, self.x.floor)

    def nuisances(self, values: np.ndarray) -> Nuisances:
        start_d, start_q, late, offset_d, offset_q, _ = np.moveaxis(values, -1, 0)
        free = self.x.offset_free
        offset = np.where(free > 0, free * (offset_d + 1j * offset_q), self.x.offset)
        return Nuisances(np.ones_like(late), start_d + 1j * start_q, late, self.floor(values), offset)

    def loose(self, values: np.ndarray) -> np.ndarray:
        """(..., 6) the numbers as their prior holds them: not a floor that is not free."""
        held = values.copy()
        held[..., -1] *= self.x.floor_free
        return held

    def linear(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mean amplitude (..., N); its whitened residual (..., N), with a row for the prior of each
        number; and what a little more of each adds (..., 6, N), whitened, of the floor as if it were free."""
        w = self.still + (values[..., None, :-1] @ self.columns)[..., 0, :]
        size, towards, by_floor = rice.linear(w, self.floor(values)[..., None])
        shapes = np.empty((*size.shape[:-1], NUMBERS + 1, size.shape[-1]))
        shapes[..., 0, :] = size
        shapes[..., 1:-1, :] = (towards[..., None, :] * self.columns).real
        shapes[..., -1, :] = by_floor / self.x.tightness[..., None]
        white = whiten(shapes, self.x)
        left = off(self.x.response[..., None, :] - white[..., :1, :], self.x)
        left -= self.loose(values)[..., None, :] @ self.own
        return size, left[..., 0, :], white[..., 1:, :] + self.own

    def problem(self, values: np.ndarray) -> _Problem:
        """What steps from here may gain."""
        _, left, columns = self.linear(values)
        along = columns @ np.swapaxes(self.x.basis, -1, -2)
        gram = columns @ np.swapaxes(columns, -1, -2) - along @ np.swapaxes(along, -1, -2)
        return _Problem(np.sum(left**2, axis=-1), (columns @ left[..., None])[..., 0], gram)


def _settled(log: _Transient) -> np.ndarray:
    """(n, 6) the numbers at their optimum near the first, by Marquardt's steps: the mean of Rice's
    distribution is linear in them only nearby. Their damping follows from what a step gained of what it would
    have in a linear problem (Nielsen, IMM-REP-1999-05, Technical University of Denmark, 1999)."""
    found, values, now = log.first.copy(), log.first, log.problem(log.first)
    which, damping, growth = (
        np.arange(len(values)),
        np.full(len(values), DAMPED[1]),
        np.full(len(values), 2.0),
    )
    for _ in range(MOST):
        able = log.free & ((now.slope > 0) | (values > log.least))
        gram = np.where(able[:, :, None] & able[:, None], now.gram, 0.0)
        held = damping[:, None, None] * now.gram * np.eye(NUMBERS)
        whole = np.linalg.solve(gram + held, np.where(able, now.slope, 0.0)[..., None])[..., 0]
        new = np.maximum(values + whole, log.least)
        step, there = new - values, log.problem(new)
        foreseen = np.sum(step * (2 * now.slope - (gram @ step[..., None])[..., 0]), axis=-1)
        gained = now.cost - there.cost
        better = gained > 0
        less = 1 - (2 * gained / np.maximum(foreseen, 1e-300) - 1) ** 3
        damping = np.maximum(damping * np.where(better, np.maximum(0.1, less), growth), DAMPED[0])
        growth = np.where(better, 2.0, 2 * growth)
        going = np.where(better, gained, np.abs(foreseen)) > GAIN * now.cost
        going &= damping < DAMPED[2]
        values = np.where(better[:, None], new, values)
        pairs = zip(there, now, strict=True)
        now = _Problem(*(np.where(better.reshape(-1, *(b.ndim - 1) * [1]), a, b) for a, b in pairs))
        if not np.all(going):
            found[which] = values
            which, values, damping, growth = (v[going] for v in (which, values, damping, growth))
            log, now = log.only(going), _Problem(*(v[going] for v in now))
        if not len(which):
            break
    found[which] = values
    return found
