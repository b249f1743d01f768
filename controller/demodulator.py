"""The demodulator: samples of the sensor and the phase accumulator of the drive in, Wd and Wq out.

With a drive v = V sin p, p = 2 pi phase / 2^32 the accumulator's angle, a response w = Re[(Wd + j Wq) e^{j
theta}] is

    w = -Wd cos p + Wq sin p,     Wd + j Wq = mean of -2 w e^{-jp}.

The mean is that of `order` one-pole filters  y <- y + share (x - y), as those of
`sysid.demodulation.lockin.low_pass`: without a block or a division, it may be read at any time. Of the image
at twice the carrier (|H(2 omega)|)^order is left. W is late by `delay`: by the filters', and by the age of
the last sample when it is read.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from controller import scalar
from controller.scalar import NO_LIMIT, either

IMAGE = 1e-3  # of |W|, that is left of the image at twice the carrier
ORDER = 4  # poles: for this image within a fifth of the delay that the best number, seven, would have
SAMPLES = 16  # of the sensor in a period of the carrier, where no rig says otherwise
LEAST = 0.05  # 1 - cos(2 omega): nearer to its alias the image cannot be told from W
# sin and cos of u pi/4, |u| <= 1, by their series: right to 3.2e-7 and 2.5e-8.
SINE = tuple((-1.0) ** k * (math.pi / 4) ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(4))
COSINE = tuple((-1.0) ** k * (math.pi / 4) ** (2 * k) / math.factorial(2 * k) for k in range(5))


class Turn(NamedTuple):
    """An angle: `u` eighths of a turn beside a multiple of a quarter, which is `odd` or not, and in the
    second `half` or not."""

    u: Any
    odd: Any
    half: Any

    @classmethod
    def of(cls, phase: Any) -> "Turn":
        """Of an accumulator of 32 bits, one or an array; what C makes of it."""
        p = (np.asarray(phase, np.int64) + (1 << 29)) & 0xFFFFFFFF
        return cls(((p & 0x3FFFFFFF) * 2 - (1 << 30)) * 2.0**-30, (p >> 30) & 1 == 1, p >> 31 == 1)


def cosine_and_sine(turn: Turn, xp: Any) -> tuple[Any, Any]:
    """cos and sin of the angle, to 3.2e-7."""
    u, square = turn.u, turn.u * turn.u
    s = u * (SINE[0] + square * (SINE[1] + square * (SINE[2] + square * SINE[3])))
    c = COSINE[0] + square * (COSINE[1] + square * (COSINE[2] + square * (COSINE[3] + square * COSINE[4])))
    c, s = xp.where(turn.odd, -s, c), xp.where(turn.odd, c, s)
    return xp.where(turn.half, -c, c), xp.where(turn.half, -s, s)


class DemodulatorState(NamedTuple):
    """Outputs d and q of the filters, the first in front; how many samples have been missing in a row; and
    for how many more it is remembered that one was `clipped`."""

    poles: tuple[tuple[Any, Any], ...]
    missed: Any
    clipped: Any


class Demodulator(NamedTuple):
    """`scale`: response per unit of a sample. A missing (not finite) sample leaves the filters as they are;
    after `patience` of them in a row Wd and Wq are missing, until the next valid sample. One of `most` or
    more is clipped, which is remembered as long. `rate` in Hz."""

    share: float
    scale: float
    patience: float
    rate: float
    most: float = NO_LIMIT
    order: int = ORDER

    @classmethod
    def of(
        cls, rate: float, carrier: float, patience: float, scale: float = 1.0, most: float = NO_LIMIT
    ) -> "Demodulator":
        """For a sampling rate and a carrier, Hz: the fastest filters that leave IMAGE. Raises ValueError."""
        apart = 1.0 - math.cos(4 * math.pi * carrier / rate)
        if apart < LEAST:
            raise ValueError(
                f"found a sensor sampled at {rate:g} Hz, at which the image of the carrier of {carrier:.8g}"
                " Hz falls on the response itself; expected a rate away from 2 f0, f0, 2 f0/3, ...: four"
                " times the carrier is best"
            )
        # |H|^2 = s^2 / (s^2 + 2 (1 - s) apart) = g^2, solved for the share s.
        g = IMAGE ** (2 / ORDER)
        half = g * apart / (1 - g)
        return cls(math.sqrt(half * half + 2 * half) - half, scale, patience, rate, most)

    @property
    def delay(self) -> float:
        """s: group delay of the filters, and the `age`."""
        return self.order * (1 - self.share) / self.share / self.rate + self.age

    @property
    def age(self) -> float:
        """s since the last sample when a controller reads W, on average: the two clocks are independent."""
        return 0.5 / self.rate

    def init(self) -> DemodulatorState:
        """At rest."""
        return DemodulatorState(((0.0, 0.0),) * self.order, 0.0, 0.0)

    def step(
        self, state: DemodulatorState, sample: Any, turn: Turn, xp: Any = scalar
    ) -> tuple[DemodulatorState, Any, Any]:
        """One sample, taken at `turn` of the drive: the next state, Wd and Wq."""
        c, s = cosine_and_sine(turn, xp)
        there = xp.isfinite(sample)
        w = (2.0 * self.scale) * sample
        d, q, poles = -w * c, w * s, []
        for was_d, was_q in state.poles:
            d, q = was_d + self.share * (d - was_d), was_q + self.share * (q - was_q)
            poles.append((d, q))
        missed = xp.where(state.missed < self.patience, state.missed + 1.0, state.missed)
        less = xp.where(state.clipped > 0.0, state.clipped - 1.0, 0.0)
        clipped = xp.where((sample >= self.most) | (sample <= -self.most), self.patience, less)
        heard = DemodulatorState(tuple(poles), 0.0, clipped)
        after = either(there, heard, state._replace(missed=missed), xp)
        gone, (d, q) = after.missed >= self.patience, after.poles[-1]
        return after, xp.where(gone, xp.nan, d), xp.where(gone, xp.nan, q)
