"""A flexural mode as a resonator: its shape, its modal mass, stiffness and force per volt, and the
`sysid.Plant` that it makes.

A mode's shape phi is scaled so that its amplitude in the middle of the plate is 1: "W" is the peak amplitude
at the antinodes of the middle, 2 <phi^2> = 1 over the inner 60 % of length and width. With that,

    m w'' + (2 m/tau) w' + c w = N v,    b = N/(2 m omega0),    G = b tau

The loss is not predicted: tau is an input, bounded by what the plate radiates into the air.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from stimulator.errors import beyond, positive, refuse
from stimulator.plate import ROLES, Box, PlateGeometry
from stimulator.theory import radiation_tau, wavelength

if TYPE_CHECKING:
    from sysid import Plant

STRAIGHT = 0.6  # uniformity of straight nodal lines: .8 to .98 is usual, and below .25 of most other modes
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

    def mean(self, of: Callable[[np.ndarray], np.ndarray], box: Box, along: str = "xy") -> np.ndarray:
        """Mean over a rectangle of a function of the values, by Gauss' rule; `along` "y": for each x,
        (96,)."""
        (x, wx), (y, wy) = _gauss(*box[:2]), _gauss(*box[2:])
        return of(self._spline(x, y)) @ wy if along == "y" else wx @ of(self._spline(x, y)) @ wy

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
        """<(<phi>_y)^2>_x/<phi^2>: 1 for nodal lines straight along the width, 0 for a shape that averages
        out over it."""
        across = self.mean(lambda values: values, self.whole, along="y")
        return float(_gauss(*self.whole[:2])[1] @ across**2 / self.mean(np.square, self.whole))


@cache
def _rule() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(96)


def _gauss(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights, which add up to 1; 96 points resolve 30 wavelengths."""
    x, w = _rule()
    return (low + high) / 2 + (high - low) / 2 * x, w / 2


@dataclass(frozen=True, eq=False)
class Eigenmode:
    """A mode as it is found: f0 (Hz), its shape at unit modal mass (1/sqrt(kg)) on a grid `x`, `y` (m), and
    `moments` (patches,), the work that 1 V on each patch, poled up, does on it (N/(V sqrt(kg)))."""

    f0: float
    x: np.ndarray
    y: np.ndarray
    values: np.ndarray
    moments: np.ndarray

    @cached_property
    def shape(self) -> Shape:
        """Positive in the corner (0, 0), where every mode of a free plate moves."""
        return Shape(self.x, self.y, self.values * self.sign)

    @property
    def sign(self) -> float:
        return -1.0 if self.values[0, 0] < 0 else 1.0

    @cached_property
    def amplitude(self) -> float:
        """At the antinodes of the middle, 1/sqrt(kg)."""
        return math.sqrt(2 * self.shape.mean(np.square, self.shape.middle))


def choose(
    found: Sequence[Eigenmode], near: float, reach: float
) -> tuple[Eigenmode, tuple[tuple[float, float], ...]]:
    """The mode with straight nodal lines nearest to `near` (Hz), and (Hz, uniformity) of all such ones within
    `reach` of it.

    By its shape, never by its place in the list: a coarse mesh changes the order of so dense a spectrum.
    Raises StimulatorError.
    """
    within = [one for one in found if abs(one.f0 - near) <= reach]
    straight = [one for one in within if one.shape.uniformity > STRAIGHT]
    if not straight:
        best = max((one.shape.uniformity for one in within), default=0.0)
        expected = f"one above {STRAIGHT:g} between {near - reach:.0f} and {near + reach:.0f} Hz"
        refuse("near", f"no mode with straight nodal lines (uniformity at most {best:.2f})", expected)
    straight.sort(key=lambda one: one.f0)
    return min(straight, key=lambda one: abs(one.f0 - near)), tuple(
        (one.f0, one.shape.uniformity) for one in straight
    )


def resonator(plate: PlateGeometry, chosen: Eigenmode, beside: Sequence[Eigenmode]) -> "Mode":
    """The chosen mode with its neighbours; patches that leave their poling open are poled to serve it."""
    sign = np.array([patch.poling for patch in plate.patches])
    poling = np.where(sign == 0, np.where(chosen.sign * chosen.moments < 0, -1, 1), sign)
    drive, sense = (
        np.array([patch.role == role for patch in plate.patches], bool) * poling for role in ROLES
    )

    def per_volt(mode: Eigenmode, patches: np.ndarray) -> float:
        return float(mode.sign * (patches @ mode.moments)) / mode.amplitude

    def slope(mode: Eigenmode) -> float:
        return per_volt(mode, drive) * mode.amplitude**2 / (4 * math.pi * mode.f0)

    def neighbour(mode: Eigenmode) -> Neighbour:
        driven, sensed = (
            _over(slope(mode), slope(chosen)),
            _over(per_volt(mode, sense), per_volt(chosen, sense)),
        )
        return Neighbour(
            mode.f0, driven, sensed, mode.shape.scaled(1 / mode.amplitude), mode.shape.uniformity
        )

    length = wavelength(plate.material, plate.thickness, chosen.f0)
    return Mode(
        f0=chosen.f0,
        m=chosen.amplitude**-2,
        N=per_volt(chosen, drive),
        shape=chosen.shape.scaled(1 / chosen.amplitude),
        uniformity=chosen.shape.uniformity,
        radiation_tau=radiation_tau(plate.mass / plate.area, length, chosen.f0),
        sense=per_volt(chosen, sense),
        poling=tuple(int(p) for p in poling),
        neighbours=tuple(neighbour(mode) for mode in beside),
    )


def _over(one: float, other: float) -> float:
    return one / other if other else math.nan


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
        """Amplitude over a square ceramic, root mean square, over that of the middle: 1.0 to 3.5 in a
        corner."""
        half = side_m / 2
        return math.sqrt(2 * self.shape.mean(np.square, (x_m - half, x_m + half, y_m - half, y_m + half)))


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
