"""theta, what is fitted of a plate: its parameters by name, in one vector of six."""

from typing import Any, NamedTuple

import numpy as np

from sysid.rows.hold import Hold

PLANT = ("G", "tau", "f0", "k_T")
FINGER = (
    "finger_damping",
    "finger_detuning",
)  # of a full contact: in units of the plate's own damping; shift of f0 in Hz
NAMES = (*PLANT, *FINGER)
POSITIVE = ("G", "tau")  # their logarithms are in theta
TWO_PI = 2 * np.pi


class Theta(NamedTuple):
    """The numbers of a vector (6,), or of several (P, 6), numpy's or JAX's: `f0` is counted from a reference
    (Hz), and holds at a reference temperature."""

    log_G: Any
    log_tau: Any
    f0: Any
    k_T: Any = 0.0
    finger_damping: Any = 0.0
    finger_detuning: Any = 0.0

    @classmethod
    def of(cls, vector: Any) -> "Theta":
        """Of one vector (6,), of the first few of its numbers, or of several (P, 6)."""
        return cls(*vector.T)

    def damped(self, hold: Hold) -> Any:
        """(M,) factor by which a finger, and what else damps, multiplies the damping over each interval."""
        return hold.damped * (1.0 + self.finger_damping * hold.contact)

    def detuning(self, hold: Hold) -> Any:
        """(M,) omega0 - omega of each interval, rad/s."""
        resonance = self.f0 + self.k_T * hold.warming + self.finger_detuning * hold.contact
        return TWO_PI * (hold.offset + resonance)


def carried(warming: float) -> np.ndarray:
    """(6, 6) by which theta is taken to a temperature `warming` degC above that of its f0."""
    found = np.eye(len(NAMES))
    found[NAMES.index("f0"), NAMES.index("k_T")] = warming
    return found


def in_units(theta: np.ndarray, frequency: float) -> np.ndarray:
    """(..., 6) the parameters in their units; theta's f0 is counted from `frequency` (Hz)."""
    return np.concatenate([np.exp(theta[..., :2]), theta[..., 2:3] + frequency, theta[..., 3:]], axis=-1)


def std_of(covariance: np.ndarray, name: str) -> float:
    """Standard deviation of one number of theta, by its covariance (6, 6)."""
    k = NAMES.index(name)
    return float(np.sqrt(covariance[k, k]))
