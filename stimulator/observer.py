"""An observer who says which of two gratings is the stronger one.

The inner response to a grating of intensity S, the contrast of its friction, is ln(S + floor) with Gaussian
noise. The stronger of two is then chosen with

    P = lapse/2 + (1 - lapse) Phi(z(3/4) ln((S1 + floor)/(S2 + floor))/ln(1 + k)),       z(3/4) = 0.6745

where k is the Weber fraction: a ratio of 1 + k is told three times out of four.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stimulator.errors import number as checked
from stimulator.errors import positive, refuse
from sysid.scene.effects import number, word

LIGHT = 0.5  # N: below, Weber fractions of force have been found larger


class Published(NamedTuple):
    """A Weber fraction, from `low` to `high`, as it was published."""

    what: str
    low: float
    high: float
    source: str


PUBLISHED = (
    Published("a drop of friction", 0.11, 0.11, "Gueorguiev et al., J. R. Soc. Interface 2017 (abstract)"),
    Published("force above 0.5 N", 0.07, 0.10, "Sci. Rep. 2022, s41598-022-12010-0 (excerpt)"),
    Published("force below 0.5 N", 0.15, 0.27, "Sci. Rep. 2022, s41598-022-12010-0 (excerpt)"),
    Published(
        "friction on a vibrating plate", 0.18, 0.18, "Samur et al., SPIE 7240, 2009 (value not verified)"
    ),
)


@dataclass(frozen=True)
class Observer:
    """`weber`: k; `light_weber`: that below 0.5 N, None: the same. `lapse`: share of answers that are
    guessed. `floor`: contrast that cannot be told from none (assumed: no source). `intensity`: which
    contrast is felt.

    Raises StimulatorError for numbers that are none.
    """

    weber: float = number(0.18)
    light_weber: float | None = number(None)  # type: ignore[arg-type]
    lapse: float = number(0.03)
    floor: float = number(0.02)
    intensity: str = word("plateau", "plateau", "spectral")

    def __post_init__(self) -> None:
        positive("observer.weber", self.weber, "1")
        if self.light_weber is not None:
            positive("observer.light_weber", self.light_weber, "1")
        checked("observer.lapse", self.lapse, -1e-300, 1.0, "a share of the answers, from 0 to 1")
        checked("observer.floor", self.floor, -1e-300, 1.0, "a contrast, from 0 to 1")
        if self.intensity not in ("plateau", "spectral"):
            refuse("observer.intensity", repr(self.intensity), "'plateau' or 'spectral'")

    def felt(self, touch: Any) -> float:
        """Intensity of a Touch."""
        from stimulator.contrast import CONTRASTS

        return CONTRASTS[self.intensity](touch)

    def prefers(self, stronger: Any, weaker: Any, force: Any = np.inf) -> Any:
        """P that the first of two intensities is said to be the stronger, at normal `force` (N); of their
        common shape."""
        k = (
            self.weber
            if self.light_weber is None
            else np.where(np.less(force, LIGHT), self.light_weber, self.weber)
        )
        return preference(stronger, weaker, k, self.lapse, self.floor)


def preference(stronger: Any, weaker: Any, weber: Any, lapse: Any = 0.0, floor: Any = 0.0) -> Any:
    """The equation at the head of this module, of the common shape of its arguments; 1/2 for two
    intensities of nothing."""
    from scipy.special import ndtr, ndtri

    first, second = np.add(stronger, floor), np.add(weaker, floor)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(first == second, 0.0, np.log(first) - np.log(second))
    found = lapse / 2 + (1 - lapse) * ndtr(ndtri(0.75) * ratio / np.log1p(weber))
    return found if np.ndim(found) else float(found)
