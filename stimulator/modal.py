"""A flexural mode as a resonator: its shape, its modal mass, stiffness and force per volt, and the
`sysid.Plant` that it makes.

A mode's shape phi is scaled so that its amplitude in the middle of the plate is 1: "W" is the peak amplitude
at the antinodes of the middle, 2 <phi^2> = 1 over the inner 60 % of length and width. With that,

    m w'' + (2 m/tau) w' + c w = N v,    b = N/(2 m omega0),    G = b tau

The loss is not predicted: tau is an input, bounded by what the plate radiates into the air.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from stimulator.errors import beyond, positive, refuse

if TYPE_CHECKING:
    from sysid import Plant

MIDDLE = 0.6  # of length and width: where "W" is taken; its edge effects are three wavelengths away
UM = 1e6  # a plant's response is in um
RINGS, SPOKES = 4, 12  # of a disc's points: a disc of half a wavelength is averaged to 1 %


class Shape:
    """Values (nx, ny) at `x` (nx,) and `y` (ny,) m from a corner of the plate, and cubic splines between
    them.

    `shape(x, y)` gives them at any points of the plate, of the common shape of x and y. Raises
    StimulatorError off the plate.
    """

    def __init__(self, x: ArrayLike, y: ArrayLike, values: ArrayLike):
        self.x, self.y, self.values = np.asarray(x, float), np.asarray(y, float), np.asarray(values, float)
        self._spline = RectBivariateSpline(self.x, self.y, self.values)

    def __call__(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        for axis, at, grid in (("x", x, self.x), ("y", y, self.y)):
            slack = 1e-9 * grid[-1]
            if at.size and not (np.min(at) >= -slack and np.max(at) <= grid[-1] + slack):
                refuse(
                    f"{axis}_m",
                    f"{np.min(at):g} to {np.max(at):g} m",
                    f"points on the plate, from 0 to {grid[-1]:g} m",
                )
        return self._spline.ev(x, y)

    def scaled(self, factor: float) -> "Shape":
        """The shape times a number."""
        return Shape(self.x, self.y, factor * self.values)


def rectangle_mean(
    of: Callable[[np.ndarray, np.ndarray], np.ndarray], box: tuple[float, float, float, float]
) -> float:
    """Mean over a rectangle (x0, x1, y0, y1) of a function of x and y, by Gauss' rule."""
    (x, wx), (y, wy) = _gauss(*box[:2]), _gauss(*box[2:])
    return float(wx @ of(x[:, None], y[None, :]) @ wy)


def _gauss(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights, which add up to 1; 96 points resolve 30 wavelengths."""
    x, w = np.polynomial.legendre.leggauss(96)
    return (low + high) / 2 + (high - low) / 2 * x, w / 2


def middle(length: float, width: float) -> tuple[float, float, float, float]:
    """The rectangle (x0, x1, y0, y1), m, over which "W" is taken."""
    inner = (1 - MIDDLE) / 2
    return inner * length, (1 - inner) * length, inner * width, (1 - inner) * width


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another flexural mode near the chosen one.

    f0, Hz. `drive`: its b = N/(2 m omega0) over that of the chosen mode, at the same voltage; `sense`: what
    the sensing ceramics read of 1 um of it in the middle, over what they read of 1 um of the chosen one. With
    Z of each mode in the middle, Z' = (b drive) V + ..., the ceramics read Z_chosen + sense Z. Shapes are
    positive in the corner (0, 0), which only the product drive * sense does not depend on. nan where nothing
    drives or senses the chosen mode.
    """

    f0: float
    drive: float
    sense: float
    shape: Shape
    uniformity: float

    def weight(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        """Its amplitude at points of the plate over that in the middle."""
        return self.shape(x_m, y_m)


@dataclass(frozen=True, eq=False)
class Mode:
    """The chosen mode: f0 (Hz), modal mass m (kg), N (N/V) of all driving patches in parallel, and its
    `neighbours`.

    `shape` is 1 at the antinodes of the middle; `uniformity` from 0 to 1 says how straight its nodal lines
    run along the width (`stimulator.modes.uniformity`); `radiation_tau` (s): the time constant if nothing but
    the air took energy. `sense`: charge of the sensing ceramics for 1 m in the middle, C/m. `poling`: the
    direction of each patch, that of the layout or the one chosen.
    """

    f0: float
    m: float
    N: float
    shape: Shape
    uniformity: float
    radiation_tau: float
    sense: float
    poling: tuple[int, ...]
    neighbours: tuple[Neighbour, ...] = ()

    @property
    def c(self) -> float:
        """Modal stiffness m omega0^2, N/m."""
        return self.m * (2 * math.pi * self.f0) ** 2

    @property
    def b(self) -> float:
        """N/(2 m omega0), m/(s V): the initial slope of a step, which no loss changes."""
        return self.N / (4 * math.pi * self.f0 * self.m)

    def plant(self, tau: float, at: tuple[float, float] | None = None) -> "Plant":
        """The plant G = N tau/(2 m omega0) in um/V, tau in s, f0 in Hz, to lay beside a fit.

        W is the amplitude in the middle, or, with `at` = (x, y) m from the corner, that at a point: what a
        vibrometer reads there. Warns with RangeWarning for a tau that the air alone would not allow. Raises
        StimulatorError for a mode that nothing drives.
        """
        if not self.N > 0:
            refuse("mode.N", f"{self.N:g} N/V", "patches that drive the mode, poled along its curvature")
        if positive("tau", tau, "s") > self.radiation_tau:
            bound = 1e3 * self.radiation_tau
            beyond(f"tau: {1e3 * tau:g} ms; radiation into the air alone gives {bound:.3g} ms")
        return _plant(self.b * (1.0 if at is None else abs(float(self.weight(*at)))), tau, self.f0)

    def weight(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        """The amplitude at points (m, from the corner) over W: what a vibrometer reads there, signed. Raises
        StimulatorError."""
        return self.shape(x_m, y_m)

    def contact(self, x_m: ArrayLike, y_m: ArrayLike, diameter_m: float = 8e-3) -> np.ndarray:
        """Weight of a finger's damping: 2 <phi^2> over a disc of contact, 1 on average in the middle. Raises
        StimulatorError."""
        return contact_map(self.shape, positive("diameter_m", diameter_m, "m"))(x_m, y_m)

    def ceramic(self, x_m: float, y_m: float, side_m: float) -> float:
        """Root mean square amplitude over a square ceramic, over that of the middle."""
        half = side_m / 2
        box = (x_m - half, x_m + half, y_m - half, y_m + half)
        return math.sqrt(2 * rectangle_mean(lambda x, y: self.shape(x, y) ** 2, box))


def _plant(b: float, tau: float, f0: float) -> "Plant":
    from sysid import Plant

    return Plant(G=UM * b * tau, tau=float(tau), f0=f0)


@lru_cache(maxsize=64)
def contact_map(shape: Shape, diameter_m: float) -> Shape:
    """2 <phi^2> over a disc around each point of the plate; of a disc that hangs over the edge, over the part
    on the plate."""
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
