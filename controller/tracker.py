"""Resonance trackers, which set the drive frequency from Wq/Wd: the paper's sign rule, one that knows the
fitted tau, and a PLL."""

from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT, clip, seen
from controller.source import Source
from controller.source import begun as first


class TrackerState(NamedTuple):
    """Drive frequency, `offset`, and `estimate` of the resonance in Hz above the start (absolute ones would
    lose digits in single precision), `count` of samples since the last update; last `temperature` and `ratio`
    Wq / Wd, None where nobody asks."""

    offset: Any
    estimate: Any
    count: Any
    temperature: Any = None
    ratio: Any = None


class TrackerInfo(NamedTuple):
    """For people: the measurement was `missing`; an update was due and the frequency was `held`; the `step`
    in Hz."""

    missing: Any
    held: Any
    step: Any


def _begun(tracker: Any, begun: Any, ratio: float | None, xp: Any) -> TrackerState:
    """At `begun` Hz above the start, or what the source makes of it."""
    offset = first(tracker.source, begun, xp)
    return TrackerState(offset, begun, 0.0, None if tracker.k_T is None else tracker.temperature, ratio)


def _learned(tracker: Any, state: TrackerState) -> Any:
    """The resonance, Hz above the start, at the temperature of the start."""
    return (
        state.estimate
        if tracker.k_T is None
        else state.estimate - tracker.k_T * (state.temperature - tracker.temperature)
    )


def _moved(tracker: Any, state: TrackerState, step: Any, temperature: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Offset, estimate and temperature: the estimate moves by `step` and with the temperature, within the
    window; the offset is what the source makes of it, left only where that is further off than half a step
    and the dead band."""
    estimate, known = state.estimate, state.temperature
    if tracker.k_T is not None and temperature is not None:
        known = xp.where(xp.isfinite(temperature), temperature, known)
        estimate = estimate + tracker.k_T * (known - state.temperature)
    estimate = clip(estimate + step, tracker.lowest - tracker.start, tracker.highest - tracker.start, xp)
    if tracker.source is None:
        return estimate, estimate, known
    off, enough = estimate - state.offset, 0.5 * tracker.source.step + tracker.dead_band
    far = (off > enough) | (off < -enough)
    return xp.where(far, tracker.source.made(estimate, xp), state.offset), estimate, known


def _followed(
    tracker: Any, state: TrackerState, reference: Any, W: Any, temperature: Any, braked: Any, xp: Any
) -> tuple[TrackerState, Any, TrackerInfo]:
    """One sample of a tracker that says what is `wanted` of the ratio Wq / Wd: an update is made where it is
    due, the measurement is there, the plate vibrates and the voltage does not brake."""
    there, count = seen(reference, W, xp), state.count + 1.0
    due = count >= tracker.every
    # Squares instead of a root or hypot: the same bits in C on every machine.
    size, threshold = W.real * W.real + W.imag * W.imag, tracker.gate * reference
    vibrates = (reference > 0.0) & (W.real > 0.0) & (size > threshold * threshold)
    moves = due & there & vibrates & xp.logical_not(braked)
    # Without vibration no division by what may be zero.
    ratio = clip(W.imag / xp.where(moves, W.real, 1.0), -tracker.most, tracker.most, xp)
    wanted, ratio = tracker.wanted(state, ratio, moves, xp)
    step = xp.where(moves, clip(wanted, -tracker.max_step, tracker.max_step, xp), 0.0)
    offset, estimate, known = _moved(tracker, state, step, temperature, xp)
    after = TrackerState(offset, estimate, xp.where(due, 0.0, count), known, ratio)
    said = TrackerInfo(xp.logical_not(there), due & xp.logical_not(moves), step)
    return after, tracker.start + offset, said


class Tracker(NamedTuple):
    """Where the resonance is, f + (Wq / Wd) / (2 pi tau), followed by the share `share` on every `every`-th
    sample.

    Settled, Wq / Wd = 2 pi (f0 - f) tau, so that an update of the estimate e,

        e <- e + clip(gain Wq / Wd + share (f - e), +-max_step),    gain = share / (2 pi tau) in Hz,

    removes that share of the detuning: Wq > 0 means below resonance, and f rises. The drive frequency f is
    the estimate; where the `source` has only steps it is the one nearest to it, and is left only when the
    estimate is further off than half a step and `dead_band` Hz: noise does not make it chatter. Without
    vibration Wq / Wd is noise: the estimate is held unless reference > 0, Wd > 0 and |W| > gate * reference,
    and while the voltage brakes. `lowest` to `highest` is the window of the frequency. With `k_T` (Hz/degC)
    the estimate moves on every sample as the plate's temperature does.

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
    source: Source | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0  # degC, at which `start` is the resonance

    @property
    def most(self) -> float:
        """Wq / Wd beyond which the step is the largest anyway."""
        beside = 0.0 if self.source is None else 0.5 * self.source.step + self.dead_band
        return (self.max_step + self.share * beside) / self.gain

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> TrackerState:
        """At `begun` Hz above the start frequency; the first update comes after one full period."""
        return _begun(self, begun, None, xp)

    def learned(self, state: TrackerState) -> Any:
        """The resonance, Hz above the start, at the temperature of the start."""
        return _learned(self, state)

    def step(
        self, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False,
        xp: Any = scalar,
    ) -> tuple[TrackerState, Any, TrackerInfo]:  # fmt: skip
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the drive frequency in Hz out.

        A measurement that is missing (not finite) when an update is due holds the frequency for that period.
        """
        return _followed(self, state, reference, W, temperature, braked, xp)

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, None]:
        """The step in Hz that `ratio` = Wq / Wd asks for, and nothing to remember."""
        return self.gain * ratio + self.share * (state.offset - state.estimate), None


class SignTracker(NamedTuple):
    """The paper's rule: f <- f + step where Wq > 0, f - step where Wq < 0, on every `every`-th sample; f
    holds at Wq = 0, and where `Tracker` is held. All in Hz. Source: Ben Messaoud et al., ACTUATOR 2014: steps
    of 10 Hz, one each millisecond.
    """

    start: float
    every: float
    size: float = 10.0
    gate: float = 0.2
    lowest: float = 0.0
    highest: float = NO_LIMIT
    source: Source | None = None
    k_T: float | None = None
    most: float = NO_LIMIT

    @property
    def max_step(self) -> float:
        """Each step is as large."""
        return self.size

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> TrackerState:
        """As `Tracker`."""
        return _begun(self, begun, None, xp)

    def learned(self, state: TrackerState) -> Any:
        """As `Tracker`."""
        return _learned(self, state)

    def step(
        self, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False,
        xp: Any = scalar,
    ) -> tuple[TrackerState, Any, TrackerInfo]:  # fmt: skip
        """As `Tracker`."""
        return _followed(self, state, reference, W, temperature, braked, xp)

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, None]:
        """The step in Hz that `ratio` = Wq / Wd asks for, and nothing to remember."""
        return xp.where(ratio > 0.0, self.size, xp.where(ratio < 0.0, -self.size, 0.0)), None


class PLL(NamedTuple):
    """A phase-locked loop: a PI on the phase of W, whose zero cancels the plate's pole.

    With r = Wq / Wd the plate obeys r' = -r / tau + delta, delta = 2 pi (f0 - f), and the detuning obeys
    delta' = -kp r' - ki r. With ki = kp / tau it settles as e^{-kp t} and passes by nothing. On every sample

        e <- e + clip(lead (r - r_before) + gain (r + (f - e) / half_bandwidth), +-max_step),
        lead = kp / (2 pi),  gain = lead T / tau, in Hz,

    where (f - e) / half_bandwidth takes away what a source with steps leaves of r. Gate, window, source and
    temperature as in `Tracker`; while it is held, r_before follows.
    """

    lead: float
    gain: float
    half_bandwidth: float
    max_step: float
    start: float
    gate: float = 0.2
    lowest: float = 0.0
    highest: float = NO_LIMIT
    source: Source | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0
    most: float = 3.0  # Wq / Wd beyond which it counts as that
    every: float = 1.0

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> TrackerState:
        """As `Tracker`."""
        return _begun(self, begun, 0.0, xp)

    def learned(self, state: TrackerState) -> Any:
        """As `Tracker`."""
        return _learned(self, state)

    def step(
        self, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False,
        xp: Any = scalar,
    ) -> tuple[TrackerState, Any, TrackerInfo]:  # fmt: skip
        """As `Tracker`."""
        return _followed(self, state, reference, W, temperature, braked, xp)

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, Any]:
        """As `Tracker`; the ratio is remembered."""
        ratio = xp.where(moves, ratio, state.ratio)
        left = ratio + (state.offset - state.estimate) * (1.0 / self.half_bandwidth)
        return self.lead * (ratio - state.ratio) + self.gain * left, ratio
