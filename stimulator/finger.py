"""What a finger's place and size make of its hold on the plate, the input `contact` of a scene; and the
modes beside."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from stimulator.errors import positive
from sysid.scene.effects import EFFECTS, number


@dataclass(frozen=True)
class Finger:
    """A fingertip on the mode phi = cos(2 pi (x - antinode)/wavelength), which has straight nodal lines
    across the plate.

    It takes from the plate by the mean of phi^2 over its contact, over 1/2, the mean on the plate:

        contact = 1 + sin(k d)/(k d) cos(2 k (x - antinode)),    k = 2 pi/wavelength

    of a uniform contact of `width` d at 1 N, which grows with the root of the contact's area: d (F/1
    N)^(1/6), as the area with F^(1/3). The default wavelength is that of the paper's plate at 32.3 kHz, of
    aluminium; the default antinode its middle.

    Raises StimulatorError for numbers that are none.
    """

    wavelength: float = number(18.7, "mm")
    antinode: float = number(99.0, "mm")
    width: float = number(10.0, "mm")

    def __post_init__(self) -> None:
        for name in ("wavelength", "width"):
            positive(f"finger.{name}", getattr(self, name), "mm")

    def contact(self, x: np.ndarray, y: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Mean square of the mode under the finger over its mean on the plate, of the shape of `x` (mm) and
        `force` (N)."""
        k = 2 * np.pi / self.wavelength
        return 1 + np.sinc(k * self.extent(force) / np.pi) * np.cos(2 * k * (x - self.antinode))

    def extent(self, force: np.ndarray) -> np.ndarray:
        """Width of the contact at `force` (N), mm."""
        return self.width * np.maximum(force, 0.0) ** (1 / 6)


@dataclass(frozen=True, eq=False)
class OnMode:
    """As `Finger`, on a `mode` of the finite elements (`stimulator.modal.Mode`): a disc of diameter `width`
    (mm) at 1 N.

    Between `SIZES` discs, from the lightest touch to the hardest, the weight is interpolated.
    """

    mode: Any
    width: float = 10.0

    def contact(self, x: np.ndarray, y: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Mean square of the mode under the finger over its mean in the middle of the plate, of the shape
        of `x`."""
        extent = np.maximum(self.width * np.maximum(force, 0.0) ** (1 / 6), SMALLEST)
        sizes = np.unique(np.linspace(extent.min(), extent.max(), SIZES))
        weights = np.stack([self.mode.contact(1e-3 * x, 1e-3 * y, 1e-3 * size) for size in sizes])
        if len(sizes) == 1:
            return weights[0]
        above = np.clip(np.searchsorted(sizes, extent), 1, len(sizes) - 1)
        share = (extent - sizes[above - 1]) / (sizes[above] - sizes[above - 1])
        rows = np.arange(len(x))
        return np.maximum((1 - share) * weights[above - 1, rows] + share * weights[above, rows], 0.0)


SIZES = 5
SMALLEST = 0.1  # mm: no contact is smaller than what the mode's own mesh tells apart


UNDRIVEN = 1e-6  # of the chosen mode's b: what a symmetric layout cancels is zero but for rounding


def neighbours(mode: Any, plant: Any, within: float = 500.0) -> tuple:
    """The neighbours of a `stimulator.modal.Mode` that are driven, within `within` Hz, as further
    resonances of a scene whose plate is `plant`: as far from its f0 as they are from the mode's, driven by
    their share of its b = G/tau, with its tau.

    A mode's motion is that in the middle of the plate, and the ceramics see `seen` of it.
    """
    near = [n for n in mode.neighbours if abs(n.f0 - mode.f0) <= within and abs(n.drive) > UNDRIVEN]
    return tuple(
        EFFECTS["second_mode"](
            G=float(plant.G * n.drive), tau=float(plant.tau), f0=float(plant.f0 + n.f0 - mode.f0),
            k_T=float(plant.k_T or 0.0), seen=float(n.sense), parity="even",
        )
        for n in near
    )  # fmt: skip
