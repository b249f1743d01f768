"""Errors of effects' numbers whose likelihood is no normal's: as of what lies in phase under an amplitude,

    |h + c|^2 = |h|^2 + 2 Re(h* c) + |c|^2,

whose second term looks like a gain, so that the third tells Re c, and near zero not even its sign. Along such
a number all else is fitted anew at several places, and the errors are the moments of these about the best.
"""

from collections.abc import Collection
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.adoption.point import NEAR, SETTLED, Looked, Point, Points
from sysid.minimum.ridge import DEEP, MOST, RISE, STEP, risen
from sysid.trials.rounds import Rounds
from sysid.trials.whitening import Noise

JUMP = 0.01  # standard deviations: a cost that has risen nearer than that has jumped
NORMAL = 1.5  # of a rise, a factor by which that of a normal may be missed: its error is then 22 % off
FURTHEST = 5.0  # prior standard deviations
AWAY = float(np.sqrt(2 * RISE))  # standard deviations, at which a normal rises by RISE


class _Place(NamedTuple):
    """A point with one number held, how far that is off, and what is seen from there."""

    off: float
    point: Point
    look: Looked

    @property
    def evidence(self) -> float:
        """Log of the posterior mass about it."""
        return self.point.state.evidence + self.point.state.cost - self.point.cost


def profiled(points: Points, point: Point, look: Looked, mirrored: Collection[int]) -> Looked:
    """What is seen from an optimum, with the errors of its numbers, and of the plant by these, as wide as the
    likelihood is along the one that is least a normal's, if any is none. Of those that are `mirrored` there
    is an optimum of the other sign, as far as which nothing is followed."""
    near = _Near(points, tuple(t.noise for t in point.state.trials))
    middle = _Place(0.0, near.at(point, look, np.zeros(len(point.numbers))), look)
    lines = [
        _Line(near, middle, j, j in mirrored)
        for j in range(len(look.covariance))
        if look.covariance[j, j] > 0
    ]
    worst = max(lines, key=lambda line: line.missed, default=None)
    return look if worst is None or worst.missed < NORMAL else worst.widened()


class _Near(NamedTuple):
    """Points near others, in one noise of each log: so costs compare."""

    points: Points
    noise: tuple[Noise, ...]

    def at(self, point: Point, look: Looked, step: np.ndarray) -> Point:
        """The point a step of the numbers away from another."""
        numbers, state = point.numbers + step, point.state
        theta = self.points.minimiser.onward(state.theta, look.along @ step)
        for _ in range(SETTLED if any(x.effect.settles for x in point.instances) else 1):
            read = self.points.applied(point.instances, numbers, state)
            trials = tuple(t.in_noise(noise) for t, noise in zip(read, self.noise, strict=True))
            near, state = state, self.points.minimiser.refine(trials, theta, Rounds(1))
            if abs(state.likelihood - near.likelihood) < NEAR**2:
                break
            theta = state.theta
        return Point(point.instances, numbers, state, self.points.cost(point.instances, numbers, state))


class _Line:
    """Places along one number of an optimum, `j`, whose standard deviation is `std` to first order; to where
    it changes its sign if it is `mirrored`."""

    def __init__(self, near: _Near, middle: _Place, j: int, mirrored: bool):
        self.near, self.middle, self.j, self.mirrored = near, middle, j, mirrored
        self.std = float(np.sqrt(middle.look.covariance[j, j]))
        self.far = FURTHEST * float(near.points.stds(middle.point.instances)[j])

    def rise(self, place: _Place) -> float:
        """Of the cost, from the optimum."""
        return place.point.cost - self.middle.point.cost

    @cached_property
    def missed(self) -> float:
        """The factor by which the cost rises more, or less, than a normal's to either side, the other numbers
        as they are foreseen."""
        away = AWAY * self.middle.look.covariance[:, self.j] / self.std
        costs = [self.near.at(self.middle.point, self.middle.look, sign * away).cost for sign in (1, -1)]
        rises = [(cost - self.middle.point.cost) / RISE for cost in costs]
        return max(np.inf if not rise > 0 else max(rise, 1 / rise) for rise in rises)

    def widened(self) -> Looked:
        """What is seen, with this number's part of both covariances by its moments over places along it."""

        def both(off: float) -> tuple[float, list[np.ndarray]]:
            """The mean rise on both sides."""
            return float(np.mean([self.rise(self.at(sign * off, self.middle)) for sign in (1, -1)])), []

        high = risen(both, AWAY * self.std, self.far)[0]
        if high < JUMP * self.std:
            return self.middle.look
        step = 0.5 * STEP * high
        places = [self.middle, *self.side(step), *self.side(-step)]
        evidence = np.array([p.evidence for p in places])
        weights = np.exp(evidence - evidence.max())
        weights /= weights.sum()
        numbers = np.array([p.point.numbers for p in places]) - self.middle.point.numbers
        thetas = np.array([p.point.state.theta for p in places]) - self.middle.point.state.theta
        look = self.middle.look
        own = look.covariance[:, self.j] / self.std
        move = look.along @ own
        return look._replace(
            covariance=look.covariance - np.outer(own, own) + (weights * numbers.T) @ numbers,
            dispersion=look.dispersion - np.outer(move, move) + (weights * thetas.T) @ thetas,
        )

    def side(self, step: float) -> list[_Place]:
        """The places to one side, as far as they hold any of the posterior."""
        places = [self.middle]
        while len(places) <= MOST and self.rise(places[-1]) < DEEP and abs(places[-1].off) < self.far:
            places.append(self.at(places[-1].off + step, places[-1]))
            if self.mirrored and places[-1].point.numbers[self.j] * self.middle.point.numbers[self.j] < 0:
                break
        return places[1:]

    def at(self, off: float, begin: _Place) -> _Place:
        """The place so far off, found from another: the other numbers are first where that one foresees
        them, and then a step further on."""
        covariance = begin.look.covariance
        way = covariance[:, self.j] / covariance[self.j, self.j]
        place = self.seen(off, self.near.at(begin.point, begin.look, (off - begin.off) * way))
        others = np.delete(np.arange(len(covariance)), self.j)
        if not len(others):
            return place
        information = np.linalg.inv(place.look.covariance)
        step = np.zeros(len(covariance))
        score = (information @ place.look.step)[others]
        step[others] = np.linalg.solve(information[np.ix_(others, others)], score)
        further = self.seen(off, self.near.at(place.point, place.look, step))
        return further if further.point.cost < place.point.cost else place

    def seen(self, off: float, point: Point) -> _Place:
        """A place, by its point."""
        return _Place(off, point, self.near.points.looked(point, True))
