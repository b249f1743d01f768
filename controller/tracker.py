"""Resonance trackers, which set the frequency from Wq/Wd: the paper's rule, one that knows tau, and a PLL."""

from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT, beyond, clip, seen
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
    """For people: the measurement was `missing`; an update was due but `held` back; the `step` in Hz."""

    missing: Any
    held: Any
    step: Any


def warmed(follower: Any, estimate: Any, was: Any, temperature: Any, xp: Any) -> tuple[Any, Any]:
    """The estimate of a resonance moved as the plate's temperature has from what it `was`, and that
    temperature: one that is not finite is the last."""
    if follower.k_T is None or temperature is None:
        return estimate, was
    known = xp.where(xp.isfinite(temperature), temperature, was)
    return estimate + follower.k_T * (known - was), known


def cooled(follower: Any, estimate: Any, temperature: Any) -> Any:
    """The resonance, Hz above the start, at the temperature of the start."""
    if follower.k_T is None:
        return estimate
    return estimate - follower.k_T * (temperature - follower.temperature)


def gated(follower: Any, reference: Any, least: Any, xp: Any) -> Any:
    """|W| from which it tells the plate from noise: below `least` it falls no further; None: its own."""
    least = follower.least if least is None else least
    return follower.gate * xp.where(reference > least, reference, least)


class Follower:
    """What all trackers do: each says what is `wanted` of the ratio Wq / Wd, given the numbers of its own."""

    begins: float | None = None  # the ratio that is remembered before the first; None: none is

    def init(self: Any, begun: Any = 0.0, xp: Any = scalar) -> TrackerState:
        """At `begun` Hz above the start frequency, or what the source makes of it; the first update comes
        after one full period."""
        temperature = None if self.k_T is None else self.temperature
        return TrackerState(first(self.source, begun, xp), begun, 0.0, temperature, self.begins)

    def learned(self, state: TrackerState) -> Any:
        """The resonance, Hz above the start, at the temperature of the start."""
        return cooled(self, state.estimate, state.temperature)

    def step(
        self: Any, state: TrackerState, reference: Any, W: Any, temperature: Any = None, braked: Any = False,
        xp: Any = scalar, least: Any = None,
    ) -> tuple[TrackerState, Any, TrackerInfo]:  # fmt: skip
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the drive frequency in Hz out.

        An update is made where it is due, the measurement is there, the plate vibrates and the voltage does
        not brake. A measurement that is missing (not finite) when an update is due holds the frequency for
        that period.
        """
        there, count = seen(reference, W, xp), state.count + 1.0
        due = count >= self.every
        # Squares instead of a root or hypot: the same bits in C on every machine.
        size, threshold = W.real * W.real + W.imag * W.imag, gated(self, reference, least, xp)
        vibrates = (reference > 0.0) & (W.real > 0.0) & (size > threshold * threshold)
        moves = due & there & vibrates & xp.logical_not(braked)
        # Without vibration no division by what may be zero.
        ratio = clip(W.imag / xp.where(moves, W.real, 1.0), -self.most, self.most, xp)
        wanted, ratio = self.wanted(state, ratio, moves, xp)
        step = xp.where(moves, clip(wanted, -self.max_step, self.max_step, xp), 0.0)
        offset, estimate, known = self._moved(state, step, temperature, xp)
        after = TrackerState(offset, estimate, xp.where(due, 0.0, count), known, ratio)
        said = TrackerInfo(xp.logical_not(there), due & xp.logical_not(moves), step)
        return after, self.start + offset, said

    def _moved(self: Any, state: TrackerState, step: Any, temperature: Any, xp: Any) -> tuple[Any, Any, Any]:
        """Offset, estimate and temperature: the estimate moves by `step` and with the temperature, within the
        window; the offset is what the source makes of it, left only where that is further off than half a
        step and the dead band."""
        estimate, known = warmed(self, state.estimate, state.temperature, temperature, xp)
        estimate = clip(estimate + step, self.lowest - self.start, self.highest - self.start, xp)
        if self.source is None:
            return estimate, estimate, known
        far = beyond(estimate - state.offset, 0.5 * self.source.step + self.dead_band)
        return xp.where(far, self.source.made(estimate, xp), state.offset), estimate, known


class _Tracker(NamedTuple):
    gain: float
    max_step: float
    start: float
    every: float
    share: float = 0.3
    gate: float = 0.2
    least: float = 0.0
    lowest: float = 0.0
    highest: float = NO_LIMIT
    source: Source | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0  # degC, at which `start` is the resonance


class Tracker(_Tracker, Follower):
    """Where the resonance is, f + (Wq / Wd) / (2 pi tau), followed by the share `share` on every `every`-th
    sample.

    Settled, Wq / Wd = 2 pi (f0 - f) tau, so that an update of the estimate e,

        e <- e + clip(gain Wq / Wd + share (f - e), +-max_step),    gain = share / (2 pi tau) in Hz,

    removes that share of the detuning: Wq > 0 means below resonance, and f rises. The drive frequency f is
    the estimate; where the `source` has only steps it is the one nearest to it, and is left only when the
    estimate is further off than half a step and `dead_band` Hz: noise does not make it chatter. Without
    vibration Wq / Wd is noise: the estimate is held unless reference > 0, Wd > 0 and |W| > gate * reference,
    a reference below `least` counting as that, and while the voltage brakes. `lowest` to `highest` is the
    window of the frequency. With `k_T` (Hz/degC) the estimate moves on every sample as the plate's
    temperature does.

    Called on every sample, as the PI is: one clock for both. `start` is the first frequency in Hz.
    """

    @property
    def most(self) -> float:
        """Wq / Wd beyond which the step is the largest anyway."""
        beside = 0.0 if self.source is None else 0.5 * self.source.step + self.dead_band
        return (self.max_step + self.share * beside) / self.gain

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, None]:
        """The step in Hz that `ratio` = Wq / Wd asks for, and nothing to remember."""
        return self.gain * ratio + self.share * (state.offset - state.estimate), None


class _SignTracker(NamedTuple):
    start: float
    every: float
    size: float = 10.0
    gate: float = 0.2
    least: float = 0.0
    lowest: float = 0.0
    highest: float = NO_LIMIT
    source: Source | None = None
    k_T: float | None = None
    most: float = NO_LIMIT


class SignTracker(_SignTracker, Follower):
    """The paper's rule: f <- f + step where Wq > 0, f - step where Wq < 0, on every `every`-th sample; f
    holds at Wq = 0, and where `Tracker` is held. All in Hz. Source: Ben Messaoud et al., ACTUATOR 2014: steps
    of 10 Hz, one each millisecond.
    """

    @property
    def max_step(self) -> float:
        """Each step is as large."""
        return self.size

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, None]:
        """The step in Hz that `ratio` = Wq / Wd asks for, and nothing to remember."""
        return xp.where(ratio > 0.0, self.size, xp.where(ratio < 0.0, -self.size, 0.0)), None


class _PLL(NamedTuple):
    lead: float
    gain: float
    half_bandwidth: float
    max_step: float
    start: float
    gate: float = 0.2
    least: float = 0.0
    lowest: float = 0.0
    highest: float = NO_LIMIT
    source: Source | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0
    most: float = 3.0  # Wq / Wd beyond which it counts as that
    every: float = 1.0


class PLL(_PLL, Follower):
    """A phase-locked loop: a PI on the phase of W, whose zero cancels the plate's pole.

    With r = Wq / Wd the plate obeys r' = -r / tau + delta, delta = 2 pi (f0 - f), and the detuning obeys
    delta' = -kp r' - ki r. With ki = kp / tau it settles as e^{-kp t} and passes by nothing. On every sample

        e <- e + clip(lead (r - r_before) + gain (r + (f - e) / half_bandwidth), +-max_step),
        lead = kp / (2 pi),  gain = lead T / tau, in Hz,

    where (f - e) / half_bandwidth takes away what a source with steps leaves of r. Gate, window, source and
    temperature as in `Tracker`; while it is held, r_before follows.
    """

    begins = 0.0

    def wanted(self, state: TrackerState, ratio: Any, moves: Any, xp: Any) -> tuple[Any, Any]:
        """As `Tracker`; the ratio is remembered."""
        ratio = xp.where(moves, ratio, state.ratio)
        left = ratio + (state.offset - state.estimate) * (1.0 / self.half_bandwidth)
        return self.lead * (ratio - state.ratio) + self.gain * left, ratio
