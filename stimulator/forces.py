"""Four force sensors under the corners of the plate: what they make of a finger's position and force.

    x = L (F2 + F4)/F,   y = B (F3 + F4)/F,   F = F1 + F2 + F3 + F4

with F1 at the origin, F2 at (L, 0), F3 at (0, B), F4 at (L, B): the centroid, which is exact on a rigid
plate. Each sensor is read at `rate`: its share of the force, an offset and noise, then its range, its
steps, and less what it showed unloaded.
"""

from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np

from stimulator.draws import stream
from stimulator.errors import positive, refuse
from stimulator.filters import Unfiltered
from sysid.scene.effects import number

FINGERTIP = 0.05  # N: below, a position is the noise of four sensors over next to nothing


class Sensed(NamedTuple):
    """What the program is told, (n, ...), from `time` (n,) s on, when it is told: `x`, `y` mm, filtered and
    held while there is no contact, and the total `force` N."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class CornerForces:
    """The sensors. `noise` is that of each reading, before any filter; `offset` the standard deviation of a
    constant that each has of its own. `null` seconds of readings of the unloaded plate are averaged
    beforehand and taken away, 0: none. `quantisation` is a step, 0: none; `range` what a sensor shows at
    most, of either sign (14.7 N: Honeywell's FSS1500). Below `contact` the position is held.

    Raises StimulatorError for numbers that are none, or below zero.
    """

    rate: float = number(1000.0, "Hz")
    noise: float = number(1.5e-3, "N")
    offset: float = number(0.0, "N")
    null: float = number(0.0, "s")
    quantisation: float = number(0.0, "N")
    range: float = number(14.7, "N")
    contact: float = number(FINGERTIP, "N")
    filter: Any = field(default_factory=Unfiltered)

    def __post_init__(self) -> None:
        for name, unit in (("rate", "Hz"), ("range", "N"), ("contact", "N")):
            positive(f"forces.{name}", getattr(self, name), unit)
        for name in ("noise", "offset", "null", "quantisation"):
            if not 0 <= getattr(self, name) < np.inf:
                refuse(f"forces.{name}", repr(getattr(self, name)), "a number of zero or more")
        for name in (f.name for f in fields(self.filter)):
            value = getattr(self.filter, name)
            if not (0 <= value < np.inf) or (value == 0 and name != "latency"):
                refuse(f"forces.filter.{name}", repr(value), "a number above zero")

    def times(self, duration: float) -> np.ndarray:
        """When the sensors are read, s."""
        return np.arange(int(duration * self.rate * (1 + 1e-12)) + 1) / self.rate

    def read(self, finger: Any, size: tuple[float, float], duration: float, seeds: Any) -> Sensed:
        """What the program is told of `finger`, a Stroke or a sequence of them, on a plate of `size` (mm).

        One of `seeds` belongs to each stroke; strokes lie along the second axis of what is returned.
        """
        several = isinstance(finger, (list, tuple))
        time = self.times(duration)
        where = [one.at(time) for one in (finger if several else [finger])]
        x, y, force = (np.stack(v, axis=1) for v in zip(*where, strict=True))
        signals = np.stack(
            [self._signals(len(time), seed) for seed in (seeds if several else [seeds])], axis=-1
        )
        read = self._recorded(shares(x, y, size) * force[:, None] + signals)
        if self.null:
            read = read - self._unloaded(seeds if several else [seeds])
        total = read.sum(axis=1)
        touched = total > self.contact
        over = np.where(touched, total, 1.0)
        most = np.array(size)[:, None]
        raw = most * np.stack([read[:, 1] + read[:, 3], read[:, 2] + read[:, 3]], axis=1) / over[:, None]
        std = self.position_std(raw, over[:, None], most)
        found = self.filter(raw, np.broadcast_to(touched[:, None], raw.shape), std, 1 / self.rate, most / 2)
        columns = [*np.moveaxis(np.clip(found, 0.0, most), 1, 0), total]
        columns = columns if several else [v[:, 0] for v in columns]
        return Sensed(time + self.filter.latency, *columns)

    def position_std(self, at: np.ndarray, force: np.ndarray, most: Any) -> np.ndarray:
        """Standard deviation (mm) of a reading at `at`, of the plate's length or width `most` (mm), by
        noise and steps: (s/F) sqrt(2 x^2 + 2 (L - x)^2) with s that of each sensor."""
        each = np.hypot(self.noise, self.quantisation / np.sqrt(12))
        return each / force * np.sqrt(2 * at**2 + 2 * (most - at) ** 2)

    def _signals(self, count: int, seed: int) -> np.ndarray:
        """(count, 4) offset and noise of each sensor."""
        noise = (
            self.noise * stream(seed, "forces").standard_normal((count, 4))
            if self.noise
            else np.zeros((count, 4))
        )
        return noise + self._offset(seed)

    def _offset(self, seed: int) -> np.ndarray:
        return self.offset * stream(seed, "forces.offset").standard_normal(4) if self.offset else np.zeros(4)

    def _unloaded(self, seeds: Any) -> np.ndarray:
        """(4, ...) mean of what the sensors showed before the finger came."""
        count = max(round(self.null * self.rate), 1)
        found = []
        for seed in seeds:
            noise = self.noise * stream(seed, "forces.null").standard_normal((count, 4))
            found.append(self._recorded(noise + self._offset(seed)).mean(axis=0))
        return np.stack(found, axis=-1)

    def _recorded(self, signal: np.ndarray) -> np.ndarray:
        """What is recorded of a signal: within the range, in steps."""
        signal = np.clip(signal, -self.range, self.range)
        return self.quantisation * np.round(signal / self.quantisation) if self.quantisation else signal


def shares(x: np.ndarray, y: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """(n, 4, ...) the share of the force on each sensor, of a finger at x, y (n, ...) mm."""
    a, b = x / size[0], y / size[1]
    return np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)
