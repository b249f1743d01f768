"""Textures: the amplitude that is asked for at each position along x, from zero to `amplitude`, a peak
amplitude in um.

A scene file says whether its number is a peak amplitude (`amplitude_um_peak`) or peak to peak
(`amplitude_um_pp`, twice that).
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from stimulator.draws import stream
from stimulator.errors import number as checked
from stimulator.errors import positive, refuse


@dataclass(frozen=True)
class Square:
    """`amplitude` over the share `duty` of each `period` (mm) from x = 0 on, else nothing: the paper's
    grating."""

    kind: ClassVar[str] = "square"
    period: float = 5.0
    amplitude: float = 1.0
    duty: float = 0.5

    def __post_init__(self) -> None:
        _checked(self)
        checked("texture.duty", self.duty, 0.0, 1.0, "a share of the period, between 0 and 1")

    @property
    def finest(self) -> float:
        """The shortest stretch (mm) without a change."""
        return self.period * min(self.duty, 1 - self.duty)

    def at(self, x: np.ndarray) -> np.ndarray:
        return np.where(np.mod(x / self.period, 1.0) < self.duty, self.amplitude, 0.0)


@dataclass(frozen=True)
class Sine:
    """amplitude (1 - cos(2 pi x/period))/2."""

    kind: ClassVar[str] = "sine"
    period: float = 5.0
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        _checked(self)

    @property
    def finest(self) -> float:
        return self.period / 2

    def at(self, x: np.ndarray) -> np.ndarray:
        return self.amplitude * np.sin(np.pi * x / self.period) ** 2


@dataclass(frozen=True)
class Noise:
    """Rough: a sum of waves whose wavelengths lie from `period` (mm) to eight times that, one for each of
    `WAVES` random numbers, mapped so that every amplitude from 0 to `amplitude` is as frequent as any
    other."""

    kind: ClassVar[str] = "noise"
    period: float = 2.0
    amplitude: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        _checked(self)

    @property
    def finest(self) -> float:
        return self.period / 2

    def at(self, x: np.ndarray) -> np.ndarray:
        from scipy.special import ndtr

        draws = stream(self.seed, "texture")
        cycles = draws.uniform(1 / 8, 1.0, WAVES) / self.period
        phase = draws.uniform(0, 2 * np.pi, WAVES)
        waves = np.cos(2 * np.pi * np.multiply.outer(np.asarray(x, float), cycles) + phase).sum(axis=-1)
        return self.amplitude * ndtr(waves / np.sqrt(WAVES / 2))


WAVES = 64  # their sum is Gaussian to a kurtosis of 1.5/64 below its own


@dataclass(frozen=True, eq=False)
class ImageRow:
    """The grey values (n,) of a row of an image, 0 to 1, each `pixel` (mm) wide from `start` (mm) on;
    nothing beyond them."""

    kind: ClassVar[str] = "image"
    grey: np.ndarray = field(repr=False)
    pixel: float = 0.25
    start: float = 0.0
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        _checked(self, "pixel", "amplitude")
        object.__setattr__(self, "grey", np.asarray(self.grey, float))
        if self.grey.ndim != 1 or not self.grey.size or not np.all((self.grey >= 0) & (self.grey <= 1)):
            refuse("texture.grey", f"values of shape {self.grey.shape}", "one row of numbers from 0 to 1")

    @classmethod
    def of_file(cls, path: Any, row: int, **given: float) -> "ImageRow":
        """Row `row` of an image file that matplotlib reads; colours count alike."""
        from matplotlib.image import imread

        try:
            image = np.asarray(imread(path), float)
        except (OSError, ValueError, SyntaxError) as error:
            refuse("texture.image", f"{path}, which cannot be read: {error}", "an image file")
        if not 0 <= row < len(image):
            refuse("texture.row", repr(row), f"0 to {len(image) - 1}, a row of the image")
        line = image[row] if image.ndim == 2 else image[row, :, :3].mean(axis=-1)
        return cls(line / (255.0 if image.max() > 1 else 1.0), **given)

    @property
    def finest(self) -> float:
        return self.pixel

    def at(self, x: np.ndarray) -> np.ndarray:
        k = np.floor((np.asarray(x) - self.start) / self.pixel).astype(int)
        inside = (k >= 0) & (k < len(self.grey))
        return np.where(inside, self.amplitude * self.grey[np.clip(k, 0, len(self.grey) - 1)], 0.0)


TEXTURES: dict[str, Any] = {cls.kind: cls for cls in (Square, Sine, Noise, ImageRow)}


def _checked(texture: Any, *names: str) -> None:
    for name in names or ("period", "amplitude"):
        positive(f"texture.{name}", getattr(texture, name), "um" if name == "amplitude" else "mm")
