"""The air film under a fingertip: Reynolds' equation, periodic, as the reference, and a fast law from it.

The film is a strip of full width L whose lower face moves by W cos(omega t) under a rigid upper one at the
mean gap h0:

    d/dx (H^3 P dP/dx) = sigma d(PH)/dt,    H = h(x)/h0 + e cos t,    P = p/p0, 1 at both edges
    e = W/h0,    sigma = 12 eta omega L^2/(p0 h0^2)

with x from edge to edge over L and t in radians. The squeeze number is on the FULL width: on the half width
it is a quarter.

What lifts the finger is the mean overpressure <P> - 1. Isothermal, continuum, without inertia: gaps of 1 to 5
um at 32 kHz (at 1 um the mean free path is 7 % of the gap, at 10 um the Stokes number is 1.4). Langlois,
Quart. Appl. Math. 20, 131 (1962).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from stimulator.errors import beyond, not_negative, number, positive, refuse

VISCOSITY = 1.85e-5  # Pa s, of air at 20 degC
PRESSURE = 1.013e5  # Pa
GAPS_UM = (1.0, 5.0)  # below, the air slips; above, its inertia counts
LEAST_FREQUENCY = 25e3  # Hz, and
LEAST_AMPLITUDE_UM = 1.0  # the conditions that the paper states for a squeeze film that is felt
FAST_SIGMA, FAST_E = 30.0, 0.5  # from and to where the fast law is within 2.5 % of Reynolds' equation

MOST_STEPS = 40  # of Newton's method; six are usual
RESOLVED = 0.01  # the highest harmonic over the mean overpressure: above, that errs by 0.2 % or more
CONVERGED = 1e-10  # the largest change of a pressure, over the largest pressure
CELLS_PER_PITCH = 40  # of a grooved pad: the overpressure changes by less than 1 % from 20 on
GROOVE_PHASES = 17


def squeeze_number(full_width_m: float, gap_m: float, frequency_Hz: float) -> float:
    """sigma = 12 eta omega L^2/(p0 h0^2), L the FULL width from edge to edge (not the half, not the radius).
    Raises StimulatorError."""
    L, h0 = positive("film.full_width_m", full_width_m, "m"), positive("film.gap_m", gap_m, "m")
    omega = 2 * math.pi * positive("film.frequency_Hz", frequency_Hz, "Hz")
    return 12 * VISCOSITY * omega * L**2 / (PRESSURE * h0**2)


def infinite_overpressure(e: ArrayLike) -> np.ndarray:
    """<P> - 1 of a flat film that cannot leak, sigma to infinity: sqrt((1 + 3/2 e^2)/(1 - e^2)) - 1, e = W/h0
    below 1."""
    e = _excursion(e)
    return np.sqrt((1 + 1.5 * e**2) / (1 - e**2)) - 1


def second_order(sigma: ArrayLike) -> np.ndarray:
    """(<P> - 1)/e^2 as e goes to 0, exact for a flat strip: 3/2 S - A/4, S = -Re<p>, A = <|p|^2>, p the
    linear response.

    With z = sqrt(i sigma)/2: p = -(1 - cosh(2 z x)/cosh z), x from -1/2 to 1/2. To 5/4 as sigma goes to
    infinity.
    """
    z = np.sqrt(1j * np.asarray(sigma, float)) / 2
    tanh, a = np.tanh(z), z.real  # Re z = Im z = a
    S = (1 - tanh / z).real
    # <|cosh(2 z x)|^2>/|cosh z|^2 = (sinh 2a/(2a) + sin 2a/(2a)) / (cosh 2a + cos 2a), written so that
    # nothing overflows
    decay = np.exp(-2 * a)
    squares = (
        ((1 - decay**2) + 2 * decay * np.sin(2 * a)) / (2 * a) / (1 + decay**2 + 2 * decay * np.cos(2 * a))
    )
    return 1.5 * S - (1 - 2 * (tanh / z).real + squares) / 4


def overpressure(e: ArrayLike, sigma: ArrayLike) -> np.ndarray:
    """The fast law: <P> - 1 of a flat strip, (P_inf(e) - 1) (3/2 S - A/4)/(5/4), `sigma` on the FULL width.

    Within 2.5 % of Reynolds' equation for sigma >= 30 and e <= 0.5. Beyond, where it warns with RangeWarning,
    it is too low: at e = 0.5 by 9 % at sigma 10 and by 48 % at 3. Raises StimulatorError for e outside [0, 1)
    and sigma not above zero.
    """
    e, sigma = _excursion(e), np.asarray(sigma, float)
    if not np.all(np.isfinite(sigma)) or np.any(sigma <= 0):
        refuse("film.sigma", f"{sigma}", "squeeze numbers above zero")
    if np.any(sigma < FAST_SIGMA) or np.any(e > FAST_E):
        beyond(
            f"film: e up to {np.max(e):.3g} and a squeeze number down to {np.min(sigma):.3g}; the fast law is"
            f" within 2.5 % for e up to {FAST_E:g} and from {FAST_SIGMA:g} on; use Reynolds"
        )
    return infinite_overpressure(e) * second_order(sigma) / 1.25


def _excursion(e: ArrayLike) -> np.ndarray:
    e = np.asarray(e, float)
    if not np.all(np.isfinite(e)) or np.any(e < 0) or np.any(e >= 1):
        refuse("film.e", f"{e}", "W/h0 from 0 to below 1: at 1 the plate hits the finger")
    return e


@dataclass(frozen=True, eq=False)
class Film:
    """A periodic solution: pressure P = p/p0 (n, m) at `x` (n,), from 0 in the middle of the strip to 1 at
    its edge, and at `t` (m,), the phase of the plate's motion in radians. `share` (n,): the part of the strip
    that each x stands for."""

    x: np.ndarray
    share: np.ndarray
    t: np.ndarray
    P: np.ndarray

    @property
    def lift(self) -> np.ndarray:
        """(m,) P - 1, averaged over the strip, over the period."""
        return self.share @ self.P - 1

    @property
    def overpressure(self) -> float:
        """<P> - 1, over strip and period: what carries the finger, in units of the atmosphere's pressure."""
        return float(self.lift.mean())

    @property
    def last_harmonic(self) -> float:
        """The largest amplitude anywhere of the highest harmonic that the phases can hold."""
        return float(2 * np.max(np.abs(np.fft.rfft(self.P, axis=1)[:, -1])) / self.P.shape[1])

    @property
    def first_harmonic(self) -> complex:
        """F with lift = Re[F e^{jt}] + ...: of a thin film -F/e is its stiffness, j its damping."""
        return complex(2 * np.mean(self.lift * np.exp(-1j * self.t)))


def _flat(x: np.ndarray) -> np.ndarray:
    return np.ones_like(x)


@dataclass(frozen=True)
class Reynolds:
    """Reynolds' equation of a strip of squeeze number `sigma` on the FULL width and excursion e = W/h0.

    `profile`: gap over h0 at x (n,), x from 0 in the middle to 1 at the edge, without the motion; the strip
    is symmetric. Finite volumes in x, `cells` of them, which crowd towards the edge unless `even`; `phases`
    (odd) points of a period, on which the time derivative is exact for the harmonics that they can hold. The
    defaults are within 2e-4 of finer ones for a flat strip and e up to 0.95; beyond, it warns with
    RangeWarning.
    """

    e: float
    sigma: float
    profile: Callable[[np.ndarray], np.ndarray] = _flat
    cells: int = 80
    phases: int = 33
    even: bool = False

    def __post_init__(self) -> None:
        not_negative("film.e", self.e, "gaps h0: at 1 the plate hits the finger", below=1.0)
        positive("film.sigma", self.sigma, "1")
        if self.cells < 2 or self.phases < 3 or self.phases % 2 == 0:
            refuse(
                "film.cells, film.phases",
                f"{self.cells}, {self.phases}",
                "two cells or more, an odd number of phases from 3 on",
            )

    def periodic(self) -> Film:
        """The periodic solution, by Newton's method on all pressures at once.

        Raises StimulatorError for a gap that closes, and if it does not converge.
        """
        faces = np.linspace(0, 1, self.cells + 1)
        faces = faces if self.even else np.sin(np.pi / 2 * faces)
        x, share = (faces[1:] + faces[:-1]) / 2, np.diff(faces)
        t = 2 * np.pi * np.arange(self.phases) / self.phases
        H = np.asarray(self.profile(x), float)[:, None] + self.e * np.cos(t)
        if not np.min(H) > 0:
            refuse("film.profile", f"a gap of {np.min(H):g} h0", "a gap that stays open")
        balance = _Balance(H, share, self.sigma / 4)  # x runs over the half width
        film = Film(x, share, t, balance.solved())
        if film.last_harmonic > RESOLVED * film.overpressure:
            beyond(f"film: {self.phases} phases err by 0.2 % or more at e = {self.e:.3g}; take more")
        return film


class _Balance:
    """Air that each cell gains and loses over the period; unknowns P (n, m)."""

    def __init__(self, H: np.ndarray, share: np.ndarray, sigma: float):
        self.H, self.share, self.sigma = H, share, sigma
        self.rate = sigma * _derivative(H.shape[1])
        # Half of each cell resists the flow across a face, in series; the outermost face has one half cell.
        half = share[:, None] / (2 * H**3)
        self.conductance = 1 / (half + np.vstack([half[1:], np.zeros((1, H.shape[1]))])) / 2

    def solved(self) -> np.ndarray:
        # Air that cannot leak keeps P H, at the mean square that the edge imposes; a slow film stays at the
        # atmosphere's pressure.
        H = self.H
        trapped = np.sqrt((H**3).mean(axis=1) / H.mean(axis=1))[:, None] / H
        P = trapped if self.sigma > 10 else np.ones_like(H)
        for _ in range(MOST_STEPS):
            step = self._step(P)
            while np.min(P + step) <= 0:
                step = step / 2
            P = P + step
            if np.max(np.abs(step)) < CONVERGED * np.max(P):
                return P
        refuse(
            "film", f"no convergence in {MOST_STEPS} steps of Newton's method", "a smaller e, or more cells"
        )

    def _step(self, P: np.ndarray) -> np.ndarray:
        """Newton's step: a banded system, whose unknowns run over the period first."""
        n, m = P.shape
        outside = np.vstack([P[1:], np.ones((1, m))])
        outflow = self.conductance * (P**2 - outside**2)
        inner = np.vstack([np.zeros((1, m)), self.conductance[:-1]])
        gain = (self.share[:, None] * (P * self.H)) @ self.rate.T
        residual = gain + outflow - np.vstack([np.zeros((1, m)), outflow[:-1]])
        band = np.zeros((2 * m + 1, n * m))
        own = self.share[:, None, None] * self.rate * self.H[:, None, :]
        own[:, np.arange(m), np.arange(m)] += 2 * P * (self.conductance + inner)
        row, column = np.indices((m, m))
        cells = np.arange(n)[:, None, None]
        band[m + row - column, cells * m + column] = own
        band[0, m:] = (-2 * outside * self.conductance)[:-1].ravel()
        band[2 * m, : (n - 1) * m] = (-2 * P * self.conductance)[:-1].ravel()
        return -solve_banded((m, m), band, residual.ravel()).reshape(n, m)


def _derivative(m: int) -> np.ndarray:
    """(m, m) d/dt of a period at an odd number of equidistant points, exact up to harmonic (m - 1)/2."""
    k = np.arange(m)[:, None] - np.arange(m)
    with np.errstate(divide="ignore"):
        D = (-1.0) ** k / (2 * np.sin(np.pi * k / m))
    np.fill_diagonal(D, 0.0)
    return D


@dataclass(frozen=True)
class Pad:
    """What touches the plate: a flat strip of `width_m`, or one with grooves, as of a fingerprint.

    `groove_m`: depth; `pitch_m`: from groove to groove; `ridges`: the share of the width that is not groove.
    """

    width_m: float = 10e-3
    groove_m: float = 0.0
    pitch_m: float = 0.4e-3
    ridges: float = 0.6

    def __post_init__(self) -> None:
        for name in ("width_m", "pitch_m"):
            positive(f"pad.{name}", getattr(self, name), "m")
        not_negative("pad.groove_m", self.groove_m, "m")
        number("pad.ridges", self.ridges, 0.0, 1.0, "a share between 0 and 1")

    def reynolds(self, W_um: float, gap_um: float, frequency_Hz: float) -> Reynolds:
        """Its film at peak amplitude `W_um` and mean gap `gap_um` under the ridges."""
        sigma = squeeze_number(self.width_m, 1e-6 * positive("film.gap_um", gap_um, "um"), frequency_Hz)
        e = not_negative("film.W_um", W_um, "um: below the gap", below=gap_um) / gap_um
        if not self.groove_m:
            return Reynolds(e, sigma)
        cells = math.ceil(self.width_m / 2 / self.pitch_m * CELLS_PER_PITCH)
        return Reynolds(e, sigma, lambda x: self._profile(x, gap_um), cells, GROOVE_PHASES, even=True)

    def _profile(self, x: np.ndarray, gap_um: float) -> np.ndarray:
        within = (x * self.width_m / 2 / self.pitch_m) % 1  # of a pitch, the groove in its middle
        return 1 + 1e6 * self.groove_m / gap_um * (np.abs(within - 0.5) < (1 - self.ridges) / 2)


FLAT_PAD = Pad(10e-3)
RIDGE = Pad(0.4e-3)
GROOVED_PAD = Pad(10e-3, groove_m=60e-6)


def film_pressure(W_um: float, gap_um: float, pad: Pad = FLAT_PAD, frequency_Hz: float = 32300.0) -> float:
    """Mean overpressure under the pad, Pa, from Reynolds' equation, per area of the whole pad.

    Warns with RangeWarning for a gap outside 1 to 5 um, a frequency below 25 kHz and an amplitude below 1 um.
    Raises StimulatorError.
    """
    reynolds = pad.reynolds(W_um, gap_um, frequency_Hz)
    if not GAPS_UM[0] <= gap_um <= GAPS_UM[1]:
        beyond(
            f"film: a gap of {gap_um:g} um; Reynolds' equation holds from {GAPS_UM[0]:g} um (slip)"
            f" to {GAPS_UM[1]:g} um (inertia)"
        )
    if frequency_Hz < LEAST_FREQUENCY:
        beyond(f"film: {frequency_Hz:g} Hz; a film that is felt needs {LEAST_FREQUENCY:g} Hz or more")
    if W_um < LEAST_AMPLITUDE_UM:
        beyond(
            f"film: an amplitude of {W_um:g} um; a film that is felt needs {LEAST_AMPLITUDE_UM:g} um or more"
        )
    return PRESSURE * reynolds.periodic().overpressure
