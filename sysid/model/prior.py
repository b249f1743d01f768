"""Prior knowledge of the plant, as a normal prior on theta; flat unless stated.

For G and tau the logarithm is normal, with the standard deviation over the value; for f0 (at the reference
temperature), k_T and the finger parameters the number itself. In the fit, -log p(theta) = 1/2 (theta -
mean)^T precision (theta - mean) acts like one more log whose model is theta.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sysid.asked import given, number
from sysid.model.theta import NAMES, POSITIVE


class Prior(NamedTuple):
    """Of theta (6,), as `model.theta` has it."""

    mean: np.ndarray
    precision: np.ndarray

    @classmethod
    def of(
        cls, stated: Mapping[str, tuple[float, float]], reference: tuple[float, float], warming: float
    ) -> "Prior":
        """Of values and standard deviations by name, in the parameters' units; theta's offsets are taken from
        `reference` (Hz, degC), and f0 is stated `warming` degC above it."""
        rows, numbers = [], []
        for name, (value, std) in stated.items():
            row = np.zeros(len(NAMES))
            row[NAMES.index(name)] = 1.0
            if name == "f0":
                row[NAMES.index("k_T")] = warming
            number = math.log(value) if name in POSITIVE else value - (reference[0] if name == "f0" else 0.0)
            width = std / value if name in POSITIVE else std
            rows.append(row / width)
            numbers.append(number / width)
        a, b = np.reshape(rows, (len(rows), len(NAMES))), np.array(numbers)
        return cls(np.linalg.lstsq(a, b, rcond=None)[0] if rows else np.zeros(len(NAMES)), a.T @ a)

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """(6,) of -log p by theta."""
        return self.precision @ (theta - self.mean)

    def cost(self, theta: np.ndarray) -> np.ndarray:
        """-log p up to a constant, at theta (..., 6)."""
        off = theta - self.mean
        return 0.5 * np.einsum("...i,ij,...j->...", off, self.precision, off)


FLAT = Prior(np.zeros(len(NAMES)), np.zeros((len(NAMES), len(NAMES))))


def checked(stated: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """The priors; ValueError, with what was found and what was expected, where they are none."""
    expected = 'value and standard deviation by name, as in {"k_T": (-8.0, 1.0)}'
    given("priors", stated, Mapping, expected)
    for name, pair in stated.items():
        given(f"the prior of {name}", pair, (tuple, list, np.ndarray), expected)
        value, std = (number(f"the prior of {name}", x) for x in pair)
        if name not in NAMES:
            raise ValueError(f"found a prior of {name!r}, expected one of {', '.join(NAMES)}")
        if not (math.isfinite(value) and 0 < std < math.inf):
            raise ValueError(
                f"found a prior {value:g} +- {std:g} of {name}, expected a number and a standard deviation"
                f" above 0"
            )
        if name in POSITIVE and value <= 0:
            raise ValueError(f"found a prior {value:g} of {name}, expected a value above 0")
    return {name: (float(value), float(std)) for name, (value, std) in stated.items()}
