"""From voltage and frequency to what the rig takes: duty ratio or code, timer ticks or a phase increment."""

import math
from typing import NamedTuple

import numpy as np

STEEPEST = 0.95  # of the most that an inverter can make, up to which its duty ratio is computed
ACCURATE = 1e-4  # of a duty ratio of one, to which it is


class Adc(NamedTuple):
    """The sensor's converter: signed `bits`; +-`full_scale` in what the sensor shows; `rate` in Hz."""

    bits: float
    full_scale: float
    rate: float

    @property
    def unit(self) -> float:
        """What one count stands for."""
        return self.full_scale / 2 ** (self.bits - 1)


class Dac(NamedTuple):
    """A converter for the peak voltage: signed `bits`; +-`full_scale` in the drive unit."""

    bits: float
    full_scale: float

    @property
    def most(self) -> float:
        """The largest voltage that it can make."""
        return self.full_scale


class Inverter(NamedTuple):
    """V = supply * duty, or (4/pi) supply sin(pi duty/2), the fundamental of three levels, of either sign."""

    supply: float
    sine: bool

    @property
    def most(self) -> float:
        """The largest voltage that it can make."""
        return self.supply * (STEEPEST * 4 / math.pi if self.sine else 1.0)

    def check(self, limit: float | None) -> None:
        """Raise ValueError for a voltage limit that it cannot make."""
        if limit is None or limit > self.most * (1 + 1e-9):
            said = "no limit" if limit is None else f"{limit:g}"
            most = f"{self.most:.4g} at most, which the inverter can make"
            raise ValueError(f"found a voltage limit of {said}, expected {most}")

    def series(self, limit: float) -> np.ndarray:
        """Coefficients a of  duty = x (a0 + a1 x^2 + ...), x = V / limit, for |V| <= limit: as few as
        ACCURATE needs."""
        ratio = limit / self.supply * (math.pi / 4 if self.sine else 1.0)
        if not self.sine:
            return np.array([ratio])
        x = np.cos(np.linspace(0, np.pi / 2, 400)[:-1])
        wanted = 2 / math.pi * np.arcsin(ratio * x)
        for count in range(1, 12):
            powers = x[:, None] ** (2 * np.arange(count) + 1)
            a = np.linalg.lstsq(powers, wanted, rcond=None)[0]
            if np.max(np.abs(powers @ a - wanted)) < ACCURATE:
                break
        return a


class Dds(NamedTuple):
    """An accumulator of 32 bits that is advanced `clock` times a second; `start` in Hz."""

    clock: float
    start: float

    @property
    def base(self) -> int:
        """The increment at the start."""
        return round(self.start / self.clock * 2**32)

    @property
    def fraction(self) -> float:
        """Of the increment at the start, what `base` leaves."""
        return self.start / self.clock * 2**32 - self.base
