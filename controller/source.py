"""The frequencies that a source can make, as offsets in Hz from that at which the tracker starts."""

import math
from typing import Any, NamedTuple


def begun(source: "Source | None", offset: Any, xp: Any) -> Any:
    """What a source makes of an `offset` to begin with."""
    if source is None:
        return offset
    return source.first if isinstance(offset, float) and offset == 0.0 else source.made(offset, xp)


class Multiples(NamedTuple):
    """Multiples of `step`; `first` is one of them."""

    step: float
    first: float

    @classmethod
    def of(cls, step: float, start: float) -> "Multiples":
        """Those of a source that starts near `start`."""
        return cls(step, step * math.floor(start / step + 0.5) - start)

    def made(self, offset: Any, xp: Any) -> Any:
        """The nearest to `offset`."""
        return self.first + self.step * xp.floor((offset - self.first) * (1.0 / self.step) + 0.5)


class Timer(NamedTuple):
    """A timer that counts `periods` + n ticks for one period of the carrier:  f = centre / (1 + n / periods).

    With y = n / periods, f = centre (1 - y + y^2 - y^3), and likewise for n: without a division, right to
    y^4. `first` is centre less the start; `step` the distance between two frequencies there.
    """

    periods: float
    centre: float
    first: float
    step: float

    @classmethod
    def of(cls, clock: float, start: float) -> "Timer":
        """Of a timer of `clock` Hz that starts near `start` Hz."""
        periods = float(round(clock / start))
        centre = clock / periods
        return cls(periods, centre, centre - start, centre * centre / clock)

    def ticks(self, offset: Any, xp: Any) -> Any:
        """n, the ticks beyond `periods`, of the period nearest to that of `offset`."""
        x = (offset - self.first) * (1.0 / self.centre)
        return xp.floor(self.periods * (x * (x * (1.0 - x) - 1.0)) + 0.5)

    def made(self, offset: Any, xp: Any) -> Any:
        """The frequency of so many ticks."""
        y = self.ticks(offset, xp) * (1.0 / self.periods)
        return self.first + self.centre * (y * (y * (1.0 - y) - 1.0))


Source = Multiples | Timer
