"""A flexural mode as a resonator: modal mass, stiffness, force per volt, and the `sysid.Plant` that it makes.

A mode's shape phi is scaled so that its amplitude in the middle of the plate is 1: "W" is the peak amplitude
at the antinodes of the middle, 2 <phi^2> = 1 over the inner 60 % of length and width. With that,

    m w'' + (2 m/tau) w' + c w = N v,    b = N/(2 m omega0),    G = b tau

The loss is not predicted: tau is an input, bounded by what the plate radiates into the air.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stimulator.errors import beyond, positive, refuse
from stimulator.plate import PlateGeometry
from stimulator.shape import Shape, contact_map
from stimulator.theory import radiation_tau, wavelength

if TYPE_CHECKING:
    from sysid import Plant

STRAIGHT = 0.6  # uniformity of straight nodal lines: .8 to .98 is usual, and below .25 of most other modes
NOTHING = 1e-9  # of the sum of what each patch does: below, they cancel but for rounding
UM = 1e6  # a plant's response is in um


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
        """At unit modal mass."""
        return Shape(self.x, self.y, self.values)

    @cached_property
    def scaled(self) -> Shape:
        """1 at the antinodes of the middle."""
        return self.shape.scaled(1 / self.amplitude)

    @cached_property
    def amplitude(self) -> float:
        """At the antinodes of the middle, 1/sqrt(kg)."""
        return math.sqrt(2 * self.shape.mean(np.square, self.shape.middle))

    def force(self, poling: np.ndarray) -> float:
        """N (N/V) of all patches in parallel; `poling` (patches,) is 0 for those that do not belong."""
        parts = poling * self.moments
        whole = float(np.sum(parts))
        return whole / self.amplitude if abs(whole) > NOTHING * float(np.sum(np.abs(parts))) else 0.0

    def slope(self, poling: np.ndarray) -> float:
        """b = N/(2 m omega0), m/(s V)."""
        return self.force(poling) * self.amplitude**2 / (4 * math.pi * self.f0)

    def turned(self, to: float) -> "Eigenmode":
        """The same mode, its shape times the sign of `to`."""
        sign = -1.0 if to < 0 else 1.0
        return replace(self, values=sign * self.values, moments=sign * self.moments)

    def upright(self) -> "Eigenmode":
        """The same mode, positive in the corner (0, 0), where every mode of a free plate moves."""
        return self.turned(self.values[0, 0])


def straight(found: Sequence[Eigenmode], near: float, reach: float) -> list[Eigenmode]:
    """The modes with straight nodal lines within `reach` of `near` (Hz), the nearest first.

    By their shape, never by their place in the list: a coarse mesh changes the order of so dense a spectrum.
    Raises StimulatorError where there is none.
    """
    within = [one for one in found if abs(one.f0 - near) <= reach]
    chosen = [one for one in within if one.shape.uniformity > STRAIGHT]
    if not chosen:
        best = max((one.shape.uniformity for one in within), default=0.0)
        expected = f"one above {STRAIGHT:g} between {near - reach:.0f} and {near + reach:.0f} Hz"
        refuse("near", f"no mode with straight nodal lines (uniformity at most {best:.2f})", expected)
    return sorted(chosen, key=lambda one: abs(one.f0 - near))


def resonator(plate: PlateGeometry, chosen: Eigenmode, beside: Sequence[Eigenmode]) -> "Mode":
    """The chosen mode with its neighbours; patches that leave their poling open are poled to serve it."""
    chosen = chosen.upright()
    stated = np.array([patch.poling for patch in plate.patches], int)
    poling = np.where(stated == 0, np.where(chosen.moments < 0, -1, 1), stated)
    drive, sense = (poling * [patch.role == role for patch in plate.patches] for role in ("drive", "sense"))
    chosen = chosen.turned(chosen.force(drive))
    length = wavelength(plate.material, plate.thickness, chosen.f0)
    return Mode(
        f0=chosen.f0,
        m=chosen.amplitude**-2,
        N=chosen.force(drive),
        shape=chosen.scaled,
        uniformity=chosen.shape.uniformity,
        radiation_tau=radiation_tau(plate.mass / plate.area, length, chosen.f0),
        sense=chosen.force(sense),
        poling=tuple(int(p) for p in poling),
        neighbours=tuple(_neighbour(mode, chosen, drive, sense) for mode in beside),
    )


def _neighbour(mode: Eigenmode, chosen: Eigenmode, drive: np.ndarray, sense: np.ndarray) -> "Neighbour":
    mode = mode.upright()
    return Neighbour(
        f0=mode.f0,
        drive=_over(mode.slope(drive), chosen.slope(drive)),
        sense=_over(mode.force(sense), chosen.force(sense)),
        shape=mode.scaled,
        uniformity=mode.shape.uniformity,
    )


def _over(one: float, other: float) -> float:
    return one / other if other else math.nan


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another flexural mode near the chosen one.

    f0, Hz. `drive`: its b = N/(2 m omega0) over that of the chosen mode, at the same voltage; `sense`: what
    the sensing ceramics read of 1 um of it in the middle, over what they read of 1 um of the chosen one. With
    Z of each mode in the middle, Z' = (b drive) V + ..., the ceramics read Z_chosen + sense Z. Its shape is
    positive in the corner (0, 0); turning it would change the signs of `drive`, `sense` and `weight`, and no
    product of two of them. nan where nothing drives or senses the chosen mode.
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
    """The chosen mode: f0 (Hz), modal mass m (kg), N (N/V) of all driving patches in parallel, its
    neighbours.

    `shape`: 1 at the antinodes of the middle, its sign such that N is not negative. `uniformity`: from 0 to
    1, how straight its nodal lines run along the width. `radiation_tau` (s): the time constant if nothing but
    the air took energy. `sense` (C/m): charge of the sensing ceramics for 1 m in the middle. `poling`: the
    direction of each patch, as the layout states it or as it serves the mode.
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
        if self.N == 0:
            refuse("mode.N", "0 N/V", "patches that drive the mode, poled along its curvature")
        if positive("tau", tau, "s") > self.radiation_tau:
            bound = 1e3 * self.radiation_tau
            beyond(f"tau: {1e3 * tau:g} ms; radiation into the air alone gives {bound:.3g} ms")
        return _plant(self.b * (1.0 if at is None else abs(float(self.weight(*at)))), tau, self.f0)

    def weight(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        """The amplitude at points (m, from the corner) over W, signed. Raises StimulatorError."""
        return self.shape(x_m, y_m)

    def contact(self, x_m: ArrayLike, y_m: ArrayLike, diameter_m: float = 8e-3) -> np.ndarray:
        """Weight of a finger's damping: 2 <phi^2> over a disc of contact, 1 on average in the middle."""
        return contact_map(self.shape, positive("diameter_m", diameter_m, "m"))(x_m, y_m)

    def ceramic(self, x_m: float, y_m: float, side_m: float) -> float:
        """Amplitude over a square ceramic, root mean square, over that of the middle: 1.0 to 3.5 in a
        corner."""
        half = side_m / 2
        return math.sqrt(2 * self.shape.mean(np.square, (x_m - half, x_m + half, y_m - half, y_m + half)))


def _plant(b: float, tau: float, f0: float) -> "Plant":
    from sysid import Plant

    return Plant(G=UM * b * tau, tau=float(tau), f0=f0)
