"""The plants that a design must serve: draws of the posterior, fingers and temperatures of a range."""

from typing import NamedTuple

import numpy as np

from controller.plate import Plate

Span = tuple[float, float]  # from and to
COUNT = 400  # plants: the 1 % that a promise leaves out are four of them


class Range(NamedTuple):
    """The range that a promise covers: the largest damping added by a finger, in units of the plate's own,
    and the `force` at which it occurs (N; None: not known); temperatures in degC above the reference, from
    and to."""

    finger: float
    force: float | None
    warming: Span


class Ensemble(NamedTuple):
    """Plants (n,): `push` = G/tau, which no finger changes; `rate` = 1/tau under the finger, 1/s; `detuning`,
    the resonance less that of the design, in Hz, with the temperature's share; `warming`, degC above the
    design's temperature, which a thermometer tells the loop (None: there is none)."""

    push: np.ndarray
    rate: np.ndarray
    detuning: np.ndarray
    warming: np.ndarray | None = None

    @classmethod
    def of(cls, plate: Plate, ranged: Range, thermometer: bool = False) -> "Ensemble":
        """From the draws of what the plate has a mean of, where there are any, else from the means.

        Finger and temperature are spread evenly over their ranges, their ends included.
        """
        means, (low, high) = plate.means, ranged.warming
        drawn_by = getattr(plate.source, "draws", {})
        # f0 is drawn, determined or not
        draws = {name: np.ravel(values) for name, values in drawn_by.items() if name in means}
        alone = not draws and ranged.finger == 0.0 and low == high
        k = np.zeros(1) if alone else np.arange(COUNT)

        def drawn(name: str) -> np.ndarray:
            """Its draws, or its mean as often."""
            if name not in draws:
                return np.full(len(k), means.get(name) or 0.0)
            return draws[name][np.linspace(0, len(draws[name]) - 1, COUNT).astype(int)]

        # Two fractions that fill the square evenly, up to its edges (Kronecker sequence, plastic number).
        plastic = (0.7548776662466927, 0.5698402909980532)
        u, v = (np.clip(1.02 * ((k * a) % 1.0) - 0.01, 0.0, 1.0) for a in plastic)
        warm, tau = low + v * (high - low), drawn("tau")
        shift = drawn("f0") - (means.get("f0") or 0.0) + drawn("k_T") * warm
        rate = (1.0 + ranged.finger * u) / tau
        return cls(drawn("G") / tau, rate, shift, warm if thermometer else None)

    def every(self, step: int) -> "Ensemble":
        """Each `step`-th of the plants."""
        return Ensemble(*(None if v is None else v[::step] for v in self))

    @property
    def resonant(self) -> "Ensemble":
        """The same plants, driven at resonance."""
        return self._replace(detuning=np.zeros_like(self.detuning), warming=None)

    def unforeseen(self, k_T: float | None) -> np.ndarray:
        """The `detuning` (n,) less what a loop with a thermometer knows of it, Hz."""
        return self.detuning if self.warming is None or k_T is None else self.detuning - k_T * self.warming
