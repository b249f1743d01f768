"""Resonance trackers, a drive frequency that follows Wq / Wd: the paper's sign rule, and one that knows the fitted tau."""

from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT, clip, seen


class TrackerState(NamedTuple):
    """Drive `frequency` and `estimate` of the resonance in Hz, `count` of samples since the last update, last `temperature`."""

    frequency: Any
    estimate: Any
    count: Any
    temperature: Any


class TrackerInfo(NamedTuple):
    """For people: the measurement was `missing`; an update was due and the frequency was `held`; the `step` in Hz."""

    missing: Any
    held: Any
    step: Any


def _due(tracker: Any, state: TrackerState, reference: Any, W: Any, braked: Any, xp: Any) -> tuple[Any, Any, Any, Any]:
    """Whether the measurement is there, whether an update is due, whether it may be made, and the count after it."""
    there = seen(reference, W, xp)
    count = state.count + 1.0
    due = count >= tracker.every
    # Squares instead of a root or hypot: the same bits in C on every machine.
    threshold = tracker.gate * reference
    vibrates = (reference > 0.0) & (W.real > 0.0) & (W.real * W.real + W.imag * W.imag > threshold * threshold)
    return there, due, due & there & vibrates & xp.logical_not(braked), xp.where(due, 0.0, count)


class SignTracker(NamedTuple):
    """The paper's rule: f <- f + step where Wq > 0, f - step where Wq < 0, on every `every`-th sample; f holds at Wq = 0.

    Held unless reference > 0, Wd > 0 and |W| > gate * reference, and while the voltage brakes: without vibration the sign of Wq
    is noise, and under a negative voltage it is the other one. `start` is the first frequency. All in Hz.
    Source: Ben Messaoud et al., ACTUATOR 2014: steps of 10 Hz, one each millisecond.
    """

    start: float
    every: float
    size: float = 10.0
    gate: float = 0.2

    def init(self) -> TrackerState:
        """At the start frequency; the first update comes after one full period."""
        return TrackerState(self.start, self.start, 0.0, 0.0)

    def step(
        self, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False, xp: Any = scalar
    ) -> tuple[TrackerState, Any, TrackerInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the drive frequency in Hz out."""
        there, due, moves, count = _due(self, state, reference, W, braked, xp)
        step = xp.where(W.imag > 0.0, self.size, xp.where(W.imag < 0.0, -self.size, 0.0))
        step = xp.where(moves, step, 0.0)
        frequency = state.frequency + step
        after = TrackerState(frequency, frequency, count, state.temperature)
        return after, frequency, TrackerInfo(xp.logical_not(there), due & xp.logical_not(moves), step)


class Tracker(NamedTuple):
    """Where the resonance is, f + (Wq / Wd) / (2 pi tau), followed by the share `share` on every `every`-th sample.

    Settled, Wq / Wd = 2 pi (f0 - f) tau, so that an update of the estimate e,

        e <- e + clip(gain Wq / Wd + share (f - e), +-max_step),    gain = share / (2 pi tau) in Hz,

    removes that share of the detuning: Wq > 0 means below resonance, and f rises. The drive frequency f is the estimate; where
    the source has only steps of `quantum` Hz it is the multiple nearest to it, and is left only when the estimate is further
    off than half a step and `dead_band` Hz: noise does not make it chatter. Without vibration Wq / Wd is noise: the estimate is
    held unless reference > 0, Wd > 0 and |W| > gate * reference, and while the voltage brakes. `lowest` to `highest` is the
    window of the frequency. With `k_T` (Hz/degC) the estimate moves on every sample as the plate's temperature does.

    Called on every sample, as the PI is: one clock for both. `start` is the first frequency in Hz.
    """

    gain: float
    max_step: float
    start: float
    every: float
    share: float = 0.3
    gate: float = 0.2
    lowest: float = 0.0
    highest: float = NO_LIMIT
    quantum: float | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0  # degC, at which `start` is the resonance

    def init(self) -> TrackerState:
        """At the start frequency; the first update comes after one full period."""
        return TrackerState(self._made(self.start, scalar), self.start, 0.0, self.temperature)

    def step(
        self, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False, xp: Any = scalar
    ) -> tuple[TrackerState, Any, TrackerInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the drive frequency in Hz out.

        A measurement that is missing (not finite) when an update is due holds the frequency for that period.
        """
        there, due, moves, count = _due(self, state, reference, W, braked, xp)
        ratio = W.imag / xp.where(moves, W.real, 1.0)
        wanted = self.gain * ratio + self.share * (state.frequency - state.estimate)
        step = xp.where(moves, clip(wanted, -self.max_step, self.max_step, xp), 0.0)
        estimate, known = self._warmed(state, temperature, xp)
        estimate = clip(estimate + step, self.lowest, self.highest, xp)
        frequency = self._drive(state.frequency, estimate, xp)
        after = TrackerState(frequency, estimate, count, known)
        return after, frequency, TrackerInfo(xp.logical_not(there), due & xp.logical_not(moves), step)

    def _warmed(self, state: TrackerState, temperature: Any, xp: Any) -> tuple[Any, Any]:
        """The estimate moved by the temperature's change, and the temperature; unchanged where none is measured."""
        if self.k_T is None or temperature is None:
            return state.estimate, state.temperature
        known = xp.where(xp.isfinite(temperature), temperature, state.temperature)
        return state.estimate + self.k_T * (known - state.temperature), known

    def _drive(self, frequency: Any, estimate: Any, xp: Any) -> Any:
        if self.quantum is None:
            return estimate
        off = estimate - frequency
        far = off * off > (0.5 * self.quantum + self.dead_band) * (0.5 * self.quantum + self.dead_band)
        return xp.where(far, self._made(estimate, xp), frequency)

    def _made(self, frequency: Any, xp: Any) -> Any:
        return frequency if self.quantum is None else self.quantum * xp.floor(frequency * (1.0 / self.quantum) + 0.5)
