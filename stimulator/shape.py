"""The shape of a mode over the plate: values at any point, means over rectangles and over a contact."""

from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from stimulator.errors import refuse
from stimulator.plate import Box

MIDDLE = 0.6  # of length and width: where "W" is taken; its edge effects are three wavelengths away
RINGS, SPOKES = 4, 12  # of a disc's points: a disc of half a wavelength is averaged to 1 %


class Shape:
    """Values (nx, ny) at `x` (nx,) and `y` (ny,) m from a corner of the plate; cubic splines between them.

    `shape(x, y)`: at any points, of the common shape of x and y. Raises StimulatorError off the plate.
    """

    def __init__(self, x: ArrayLike, y: ArrayLike, values: ArrayLike):
        self.x, self.y, self.values = np.asarray(x, float), np.asarray(y, float), np.asarray(values, float)
        self._spline = RectBivariateSpline(self.x, self.y, self.values)

    def __call__(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        for axis, at, grid in (("x", x, self.x), ("y", y, self.y)):
            slack = 1e-9 * grid[-1]
            if at.size and not (np.min(at) >= -slack and np.max(at) <= grid[-1] + slack):
                on_plate = f"points on the plate, from 0 to {grid[-1]:g} m"
                refuse(f"{axis}_m", f"{np.min(at):g} to {np.max(at):g} m", on_plate)
        return self._spline.ev(x, y)

    def scaled(self, factor: float) -> "Shape":
        """The shape times a number."""
        return Shape(self.x, self.y, factor * self.values)

    def mean(self, of: Callable[[np.ndarray], np.ndarray], box: Box) -> float:
        """Mean over a rectangle of a function of the values, by Gauss' rule."""
        (x, wx), (y, wy) = _gauss(*box[:2]), _gauss(*box[2:])
        return float(wx @ of(self._spline(x, y)) @ wy)

    @property
    def whole(self) -> Box:
        """The plate's edges."""
        return 0.0, float(self.x[-1]), 0.0, float(self.y[-1])

    @property
    def middle(self) -> Box:
        """The rectangle over which "W" is taken."""
        inner = (1 - MIDDLE) / 2
        _, length, _, width = self.whole
        return inner * length, (1 - inner) * length, inner * width, (1 - inner) * width

    @property
    def uniformity(self) -> float:
        """<(<phi>_y)^2>_x/<phi^2>: 1 for straight nodal lines along the width, 0 where it averages out."""
        (x, wx), (y, wy) = _gauss(*self.whole[:2]), _gauss(*self.whole[2:])
        return float(wx @ (self._spline(x, y) @ wy) ** 2) / self.mean(np.square, self.whole)


@cache
def _rule() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(96)


def _gauss(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights, which add up to 1; 96 points resolve 30 wavelengths."""
    x, w = _rule()
    return (low + high) / 2 + (high - low) / 2 * x, w / 2


@lru_cache(maxsize=64)
def contact_map(shape: Shape, diameter_m: float) -> Shape:
    """2 <phi^2> over a disc around each point of the plate, over the part of it that lies on the plate."""
    radius = diameter_m / 2 * np.sqrt((np.arange(RINGS) + 0.5) / RINGS)  # rings of equal area
    angle = 2 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    dx, dy = (f.ravel() for f in (np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))))
    total, touched = np.zeros(shape.values.shape), np.zeros(shape.values.shape)
    X, Y = np.meshgrid(shape.x, shape.y, indexing="ij")
    for step_x, step_y in zip(dx, dy, strict=True):
        x, y = X + step_x, Y + step_y
        on = (x >= 0) & (x <= shape.x[-1]) & (y >= 0) & (y <= shape.y[-1])
        total[on] += shape(x[on], y[on]) ** 2
        touched += on
    return Shape(shape.x, shape.y, 2 * total / touched)
