"""A `Record`: one log as it is read, before anything is fitted to it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sysid.logs.log import Log
from sysid.rows.hold import Hold
from sysid.rows.prepare import from_rest, one_level

FLUX = "V*s"  # the unit of what the voltage of a coil is read as
SLOW = 0.05  # of a drive's range from row to row: it takes twenty rows or more from end to end


@dataclass(frozen=True, eq=False)
class Record:
    """The rows of one log, its inputs, and what the recorder did to them."""

    log: Log  # condensed where it is long
    kind: str  # "transient" | "steady"
    inputs: Hold = field(repr=False)  # with offsets from 0 Hz and 0 degC
    there: np.ndarray = field(repr=False)  # rows that hold a signal
    spacing: float = 0.0  # s, from row to row of the file
    gap: float = 0.0  # s, the longest without a row in which an input changed, who knows when
    dark: int = 0  # rows of the file that hold no signal
    spoilt: tuple[int, ...] = ()  # and those that a recorder spoilt
    most: int = 0  # rows, if condensed no more than a filter asks for
    rectified: bool = False  # an amplitude by its noise at rest, though no frequency is recorded
    steps: tuple[float, ...] = ()  # of the recorder, of d and q or of the one channel; 0: none show
    recorded: Log | None = field(default=None, repr=False)  # as it was read, whatever an effect makes of it
    whole: Log | None = field(default=None, repr=False)  # every row, where `log` holds means

    @property
    def steady(self) -> bool:
        return self.kind == "steady"

    @cached_property
    def scale(self) -> float:
        """Largest magnitude of the response."""
        return scale_of(self.log.response)

    @cached_property
    def tuned(self) -> int:
        """Different frequencies that were recorded, whatever an effect makes of them."""
        frequency = None if self.recorded is None else self.recorded.frequency
        return 0 if frequency is None else len(np.unique(frequency))

    @property
    def undriven_sweep(self) -> bool:
        """Amplitudes over frequency without a drive, like the spectrum of a plate moved by its own noise:
        they scatter in proportion to their size, by half if none are averaged."""
        return self.steady and self.resonant and not self.signed and self.log.drive is None

    @cached_property
    def silent(self) -> bool:
        """The response is the same in every row."""
        return bool(np.all(self.log.response == self.log.response[0]))

    @cached_property
    def driven(self) -> bool:
        """A drive is recorded and not zero throughout."""
        return self.log.drive is not None and bool(np.any(self.log.drive != 0))

    @property
    def resonant(self) -> bool:
        """An excitation frequency is recorded."""
        return self.log.frequency is not None

    @property
    def creeps(self) -> bool:
        """Whether it is a transient at one frequency whose drive changes from row to row, and nowhere by
        much."""
        if self.steady or not self.driven or (self.resonant and np.ptp(self.log.frequency) > 0):
            return False
        change, wide = np.abs(np.diff(self.log.drive)), float(np.ptp(self.log.drive))
        often = 2 * np.count_nonzero(change) > len(change)
        return bool(often and np.max(change) < SLOW * wide)

    @property
    def swept(self) -> bool:
        """Settled points of a sweep, whose neighbours are those of the next frequency."""
        return self.steady and self.resonant and bool(np.ptp(self.log.frequency) > 0)

    @cached_property
    def touched(self) -> bool:
        """A finger's force is recorded."""
        return bool(np.any(self.inputs.contact))

    @cached_property
    def slowed(self) -> bool:
        """What damps the plate changes within the log, besides a finger."""
        return bool(np.any(self.inputs.damped != 1))

    @cached_property
    def off_middle(self) -> np.ndarray:
        """(n,) Hz by which the rows of a sweep are off its middle; of the flux of a coil, to which its
        resistance R adds R/(j omega), by what is the same there, to first order."""
        frequency, middle = self.log.frequency, float(np.mean(self.log.frequency))
        return middle * (1 - middle / frequency) if self.log.response_unit == FLUX else frequency - middle

    @cached_property
    def signed(self) -> bool:
        """d/q rows, or the signed output of a first-order plant: linear in all that the bench adds."""
        return not self.log.amplitude_only or not (self.resonant or self.log.relative_noise or self.rectified)

    @property
    def channels(self) -> int:
        """2 for d/q rows, 1 for real ones."""
        return 2 if np.iscomplexobj(self.log.response) else 1

    @cached_property
    def one_level(self) -> bool:
        """A transient whose inputs never change."""
        return not self.steady and one_level(self.log)

    @cached_property
    def from_rest(self) -> bool:
        """A transient of one level that is read as a step at the first row."""
        return not self.steady and from_rest(self.log)

    @property
    def since_change(self) -> np.ndarray:
        """Seconds since the inputs of each row of a transient last changed."""
        hold = self.inputs
        return np.where(
            hold.interval > 0, hold.elapsed, hold.elapsed if self.from_rest or not self.driven else np.inf
        )

    @property
    def changes(self) -> int:
        """How often the inputs of a transient change."""
        return len(self.inputs.drive) - 1

    @property
    def lost(self) -> int:
        """Number of rows that hold no signal, or were spoilt; other rows that are left out are outliers."""
        return int(np.sum(~self.there))

    def as_recorded(self, model: np.ndarray) -> np.ndarray:
        """Modelled rows (n,), real where the log's are."""
        return model.real if self.log.amplitude_only else model

    def residual(self, model: np.ndarray) -> np.ndarray:
        """(n,) recorded - modelled; zero where there is no signal."""
        return np.where(self.there, self.log.response - self.as_recorded(model), 0.0)

    @property
    def radian(self) -> float:
        """Time (s) in which the carrier turns by a radian; 0 where no frequency is recorded."""
        highest = float(np.max(self.log.frequency)) if self.resonant else 0.0
        return 1 / (2 * np.pi * highest) if highest else 0.0


def scale_of(response: np.ndarray) -> float:
    """Largest magnitude of a response; 1 of none."""
    return float(np.max(np.abs(response))) or 1.0
