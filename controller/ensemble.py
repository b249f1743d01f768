"""The plants that a design must serve: draws of the posterior, each with a finger and a temperature from the
stated range."""

from typing import Any, NamedTuple

import numpy as np

COUNT = 400  # plants: the 1 % that a promise leaves out are four of them


class Ensemble(NamedTuple):
    """Plants (n,): `push` = G/tau, which no finger changes; `rate` = 1/tau under the finger, 1/s; `detuning`,
    the resonance less that of the design, in Hz, with the temperature's share; `warming`, degC above the
    design's temperature, which a thermometer tells the loop (None: there is none)."""

    push: np.ndarray
    rate: np.ndarray
    detuning: np.ndarray
    warming: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        source: Any,
        means: dict[str, float],
        finger: float,
        warming: tuple[float, float],
        thermometer: bool = False,
    ) -> "Ensemble":
        """From `source.draws` of what has a mean, where there are any, else from the `means`. `finger`: the
        largest added damping in units of the plate's own; `warming`: degC above the reference temperature,
        from and to.

        Finger and temperature are spread evenly over their ranges, their ends included.
        """
        drawn_by = getattr(source, "draws", {})
        draws = {
            name: np.ravel(values) for name, values in drawn_by.items() if name in means
        }  # f0 is drawn, determined or not
        draws = {
            name: values[np.linspace(0, len(values) - 1, COUNT).astype(int)] for name, values in draws.items()
        }

        alone = not draws and finger == 0.0 and warming[0] == warming[1]
        k = np.zeros(1) if alone else np.arange(COUNT)

        def drawn(name: str) -> np.ndarray:
            """Its draws, or its mean as often."""
            return draws.get(name, np.full(len(k), means.get(name) or 0.0))

        # Two fractions that fill the square evenly (Kronecker sequence of the plastic number), stretched to
        # reach its edges.
        u, v = (
            np.clip(1.02 * ((k * a) % 1.0) - 0.01, 0.0, 1.0) for a in (0.7548776662466927, 0.5698402909980532)
        )
        warm = warming[0] + v * (warming[1] - warming[0])
        shift = drawn("f0") - (means.get("f0") or 0.0) + drawn("k_T") * warm
        return cls(
            drawn("G") / drawn("tau"), (1.0 + finger * u) / drawn("tau"), shift, warm if thermometer else None
        )

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
