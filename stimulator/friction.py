"""Friction of a fingertip on the vibrating plate: two laws, from the peak amplitude W and the normal force to
mu.

Neither is validated quantitatively: no digitised data of friction against amplitude were at hand. Both fall
from mu0 at rest to little at several um, as all published measurements do.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stimulator.errors import beyond, positive, refuse

PRESSURE = 1.013e5  # Pa, of the atmosphere
LEAST_LOAD = 1e-6  # Pa: no finger rests so lightly
LARGEST_FORCE = 10.0  # N: fingertips stroke with 0.1 to 5 N
TOLERANCE = 1e-12  # of the gap, at which Newton's steps end
STEPS = 60  # of Newton at most; from the left of the root they increase towards it, ten are usual


@dataclass(frozen=True)
class Exponential:
    """F1: mu = mu0 (least + (1 - least) exp(-(W/scale)^power)), W the peak amplitude in um; no dependence on
    the force.

    `least` is the share of mu0 that is left at large W. A smooth curve through what is known, not a
    derivation.
    """

    mu0: float = 0.8
    least: float = 0.2
    scale_um: float = 0.9
    power: float = 1.5

    def __post_init__(self) -> None:
        for name in ("mu0", "scale_um", "power"):
            positive(f"friction.{name}", getattr(self, name), "um" if name == "scale_um" else "1")
        if not 0 <= self.least <= 1:
            refuse("friction.least", repr(self.least), "a share of mu0, from 0 to 1")

    def friction(self, W_um: ArrayLike, force_N: ArrayLike) -> np.ndarray:
        """mu of the common shape of peak amplitude `W_um` and normal `force_N`. Raises StimulatorError."""
        W, force = _inputs(W_um, force_N)
        fallen = np.exp(-((W / self.scale_um) ** self.power))
        return np.broadcast_to(
            self.mu0 * (self.least + (1 - self.least) * fallen), np.broadcast(W, force).shape
        ).copy()


@dataclass(frozen=True)
class PartialLevitation:
    """F2: the load p_f = F/A is shared by the skin's contacts, p_c, and the film, 5/4 p0 (W/u)^2, at a common
    gap u:

        p_f = p_c0 exp(-u/u_rms) + 5/4 p0 (W/u)^2,    mu = mu0 p_c/p_f,    A = area (F/1 N)^(1/3)

    The structure is that of Wiertlewski, Fenton Friesen and Colgate (PNAS 113, 9210, 2016); u_rms and p_c0
    are effective numbers: a film of this load over fingerprints and a flat pad differ by more than a factor
    of four. p_c0 follows from `rest_gap_um`, the gap at `rest_pressure_kPa` without vibration.
    """

    mu0: float = 0.8
    u_rms_um: float = 1.5
    rest_gap_um: float = 5.0
    rest_pressure_kPa: float = 10.0
    area_cm2: float = 1.0

    def __post_init__(self) -> None:
        units = {
            "mu0": "1",
            "u_rms_um": "um",
            "rest_gap_um": "um",
            "rest_pressure_kPa": "kPa",
            "area_cm2": "cm^2",
        }
        for name, unit in units.items():
            positive(f"friction.{name}", getattr(self, name), unit)

    def load(self, force_N: ArrayLike) -> np.ndarray:
        """Pressure p_f = F/A of a fingertip, Pa; never quite zero, so that the gap stays finite."""
        return np.maximum(np.asarray(force_N, float) ** (2 / 3) / (1e-4 * self.area_cm2), LEAST_LOAD)

    def gap(self, W_um: ArrayLike, force_N: ArrayLike) -> np.ndarray:
        """The gap u at which contacts and film carry the load, um, of the common shape. Raises
        StimulatorError."""
        W, load = np.broadcast_arrays(*self._checked(W_um, force_N))
        gap = np.maximum(self.u_rms_um * np.log(self._stiffest() / load), W * np.sqrt(1.25 * PRESSURE / load))
        for _ in range(STEPS):
            # Left of the root of a falling, convex function Newton's steps grow towards it and never pass it.
            contact, film = self._contact(gap), 1.25 * PRESSURE * (W / gap) ** 2
            step = (contact + film - load) / (contact / self.u_rms_um + 2 * film / gap)
            gap = gap + step
            if np.all(np.abs(step) <= TOLERANCE * gap):
                break
        return gap

    def friction(self, W_um: ArrayLike, force_N: ArrayLike) -> np.ndarray:
        """mu of the common shape of peak amplitude `W_um` and normal `force_N`; mu0 without vibration. Raises
        StimulatorError."""
        return self.mu0 * self._contact(self.gap(W_um, force_N)) / self.load(force_N)

    def _checked(self, W_um: ArrayLike, force_N: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        W, force = _inputs(W_um, force_N)
        load = self.load(force)
        if np.any(load >= self._stiffest()):
            refuse(
                "friction.force_N", f"{np.max(force):g} N", "a load below p_c0, at which the gap would close"
            )
        return W, load

    def _contact(self, gap: np.ndarray) -> np.ndarray:
        return self._stiffest() * np.exp(-gap / self.u_rms_um)

    def _stiffest(self) -> float:
        """p_c0, Pa."""
        return 1e3 * self.rest_pressure_kPa * float(np.exp(self.rest_gap_um / self.u_rms_um))


def _inputs(W_um: ArrayLike, force_N: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    W, force = np.asarray(W_um, float), np.asarray(force_N, float)
    for key, value, unit in (("friction.W_um", W, "um"), ("friction.force_N", force, "N")):
        if not np.all(value >= 0) or np.any(np.isinf(value)):
            refuse(key, f"{np.min(value):g}", f"numbers of zero or more, in {unit}")
    if force.size and np.max(force) > LARGEST_FORCE:
        beyond(f"friction: a force of {np.max(force):g} N; the area's law is known up to {LARGEST_FORCE:g} N")
    return W, force
