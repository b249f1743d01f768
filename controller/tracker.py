"""The resonance tracker, a drive frequency that follows Wq / Wd, in plain floats: what the DSP runs."""

import math
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class TrackerState:
    """Drive `frequency` in Hz and `count`, the samples since the last update."""

    frequency: float
    count: int


@final
@dataclass(frozen=True)
class TrackerInfo:
    """For people: the measurement was `missing`; an update was due and the frequency was `held`; the `step` in Hz."""

    missing: bool
    held: bool
    step: float


@final
@dataclass(frozen=True)
class Tracker:
    """f <- f + clip(gain Wq / Wd) on every `every`-th sample, gain = beta / (2 pi tau) in Hz.

    Settled, Wq / Wd = 2 pi (f0 - f) tau, so that an update removes the fraction beta of the detuning: Wq > 0 means
    below resonance, and f rises. The step is clipped at `max_step` Hz. Without vibration Wq / Wd is noise: the
    frequency is held unless reference > 0, Wd > 0 and |W| > gate * reference.

    Called on every sample, as the PI is: one clock for both. `start` is the first frequency in Hz.
    """

    gain: float
    max_step: float
    start: float
    every: int
    gate: float = 0.2

    def init(self) -> TrackerState:
        """At the start frequency; the first update comes after one full period."""
        return TrackerState(self.start, 0)

    def step(self, state: TrackerState, reference: float, W: complex) -> tuple[TrackerState, float, TrackerInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the drive frequency in Hz out.

        A measurement that is missing (not finite) when an update is due holds the frequency for that period.
        """
        missing = not (math.isfinite(reference) and math.isfinite(W.real) and math.isfinite(W.imag))
        count = state.count + 1
        if count < self.every:
            return TrackerState(state.frequency, count), state.frequency, TrackerInfo(missing, False, 0.0)
        if missing or not self._vibrates(reference, W.real, W.imag):
            return TrackerState(state.frequency, 0), state.frequency, TrackerInfo(missing, True, 0.0)
        step = min(max(self.gain * (W.imag / W.real), -self.max_step), self.max_step)
        frequency = state.frequency + step
        return TrackerState(frequency, 0), frequency, TrackerInfo(False, False, step)

    def _vibrates(self, reference: float, Wd: float, Wq: float) -> bool:
        threshold = self.gate * reference
        # Squares instead of a root or hypot: the same bits in C on every machine.
        return reference > 0.0 and Wd > 0.0 and Wd * Wd + Wq * Wq > threshold * threshold
