"""Strokes: where a finger is and how hard it presses, over time; ramps, tables and recorded ones are one
type."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stimulator.errors import StimulatorError, refuse
from sysid.scene.profile import Profile


@dataclass(frozen=True, eq=False)
class Stroke:
    """The finger's centre `x`, `y` (mm, from the plate's corner) and its normal `force` (N), each a Profile
    over time.

    Raises StimulatorError for a force below zero.
    """

    x: Profile
    y: Profile
    force: Profile

    def __post_init__(self) -> None:
        least = int(np.argmin(self.force.values))
        if (force := self.force.values[least]) < 0:
            at = self.force.times[least]
            refuse("stroke.force", f"{force:g} N at {at:g} s", "0 or more")

    @classmethod
    def line(cls, start: float, speed: float, duration: float, y: float, force: float) -> "Stroke":
        """Along x from `start` (mm) at `speed` (mm/s), with one force (N)."""
        x = Profile(np.array([0.0, duration]), np.array([start, start + speed * duration]), held=False)
        return cls(x, Profile.constant(y), Profile.constant(force))

    @classmethod
    def to_and_fro(
        cls, middle: float, reach: float, period: float, y: float, force: float, duration: float
    ) -> "Stroke":
        """x = middle - reach cos(2 pi t/period) (mm), at its turning point at the beginning; its knots are
        1 ms apart."""
        time = np.linspace(0.0, duration, round(duration * 1e3) + 1)
        x = Profile(time, middle - reach * np.cos(2 * np.pi * time / period), held=False)
        return cls(x, Profile.constant(y), Profile.constant(force))

    @classmethod
    def from_csv(cls, path: str | Path) -> "Stroke":
        """A recorded stroke: columns time_s, x_mm, y_mm and force_N, or in other units of the same kind.

        Between two rows the finger moves on a straight line. Raises StimulatorError that names file and
        column.
        """
        import pandas as pd

        from sysid.tables import units

        try:
            frame = pd.read_csv(path, comment="#", skipinitialspace=True)
        except (OSError, ValueError) as error:
            raise StimulatorError(f"{path}: cannot be read: {error}") from None
        columns = {}
        for name, unit in (("time", "s"), ("x", "mm"), ("y", "mm"), ("force", "N")):
            key = next((k for k in frame.columns if k.partition("_")[0] == name), None)
            if key is None:
                raise StimulatorError(
                    f"{path}: found no column {name}_{unit}, expected it among {', '.join(frame.columns)}"
                )
            given = str(key).partition("_")[2]
            if not units.same_kind(given, unit):
                raise StimulatorError(
                    f"{path}: {key}: found the unit {given!r}, expected {unit} or another of its kind"
                )
            values = pd.to_numeric(frame[key], errors="coerce").to_numpy(float)
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values)))
                raise StimulatorError(
                    f"{path}: {key}: found {frame[key][row]} in row {row + 1}, expected a number"
                )
            columns[name] = units.convert(values, given, unit)
        time = columns.pop("time")
        try:
            return cls(**{name: Profile(time, v, held=False) for name, v in columns.items()})
        except ValueError as error:
            raise StimulatorError(f"{path}: {error}") from None

    @property
    def duration(self) -> float:
        """Time of the last knot, s."""
        return float(max(p.times[-1] for p in (self.x, self.y, self.force)))

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x and y (mm) and force (N) at `time` (n,) s."""
        return self.x.at(time), self.y.at(time), self.force.at(time)

    def speed(self) -> float:
        """The largest speed between two knots (mm/s); a jump has none."""
        most = [
            np.abs(np.diff(p.values) / np.diff(p.times)).max()
            for p in (self.x, self.y)
            if len(p.times) > 1 and not p.held
        ]
        return float(np.hypot.reduce(most)) if most else 0.0

    def stay(self, size: tuple[float, float]) -> None:
        """Raises StimulatorError where the finger leaves a plate of `size` (mm)."""
        for name, profile, most in (("x", self.x, size[0]), ("y", self.y, size[1])):
            outside = (profile.values < 0) | (profile.values > most)
            if outside.any():
                k = int(np.argmax(outside))
                found = f"{profile.values[k]:g} mm at {profile.times[k]:g} s"
                refuse(f"stroke.{name}", found, f"0 to {most:g} mm, on the plate")
