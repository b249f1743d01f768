"""An observer of the plate's pole, and the controller built on it: amplitude and frequency from one model.

The response obeys  Z' = lambda Z + b V,  lambda = -1/tau + j 2 pi (f0 - f),  b = G/tau. Neither finger nor
temperature changes b: a touch or a warmer plate changes lambda alone. So lambda is estimated on line, from
the difference of each sample and its prediction, and everything else follows. The frequency is the estimated
resonance; the voltage is the one that the model needs,  b V = (K/T)(reference - Wd) - Re(lambda Z), which is
feed-forward, decoupling and the finger's share in one term. A clipped or negative voltage enters the model as
it is, so nothing winds up, and braking needs no rule.
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.pi import slewed, within
from controller.scalar import NO_LIMIT, clip, seen
from controller.source import Source
from controller.source import begun as first
from controller.tracker import cooled, gated, warmed


class AdaptiveState(NamedTuple):
    """Prediction (d, q) of this sample; `damping` = T/tau; the `resonance`, and the commands on their way
    (the latest first): `voltages`, and `frequencies` in Hz above the start; the estimates of Z at `past`
    samples (the latest first)."""

    d: Any
    q: Any
    damping: Any
    resonance: Any
    temperature: Any
    voltages: tuple
    frequencies: tuple
    past: tuple


class Adaptive(NamedTuple):
    """The controller of a plate with  b T = `push` (response per drive),  T/tau = `damping`, from the
    frequency `start` (Hz).

    `K`: share of the amplitude's error that one sample removes. `keep`: the observer's double poles exp(-T /
    time constant) along d, which shows the damping, and along q, which shows the resonance. `turn` = 2 pi T
    (rad per Hz). Commands take effect `len(delay)` whole samples after they were asked for; readings are late
    by `len(late)` samples and `between` of one, on a straight line between two. Voltage, slew limits and
    window, source and temperature as in `PI` and `Tracker`; `sweep` is the most that the frequency moves in a
    sample. The pole is held unless reference > 0 and |Z| > gate * reference, a reference below `least`
    counting as that.
    """

    push: float
    damping: float
    turn: float
    start: float
    K: float
    keep: tuple[float, float]
    # one zero for each sample of latency: what is on its way at the beginning
    delay: tuple[float, ...] = (0.0,)
    late: tuple[float, ...] = ()
    between: float = 0.0
    lowest_voltage: float = -NO_LIMIT
    highest_voltage: float = NO_LIMIT
    slew: float = NO_LIMIT
    lowest: float = 0.0
    highest: float = NO_LIMIT
    sweep: float = NO_LIMIT
    gate: float = 0.2
    least: float = 0.0
    source: Source | None = None
    dead_band: float = 0.0
    k_T: float | None = None
    temperature: float = 24.0

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> AdaptiveState:
        """At rest, `begun` Hz above the start frequency, with the plate as it was identified."""
        still, offset = (0.0, *self.delay), first(self.source, begun, xp)
        return AdaptiveState(
            0.0, 0.0, self.damping, begun, self.temperature, still, tuple(zero + offset for zero in still),
            ((0.0, 0.0), *((zero, zero) for zero in self.late)),
        )  # fmt: skip

    def rest(self, begun: Any = 0.0, xp: Any = scalar) -> Command:
        """What is driven before the first sample has taken effect."""
        return Command(0.0, self.start + first(self.source, begun, xp))

    def learned(self, state: AdaptiveState) -> Any:
        """The resonance, Hz above the start, at the temperature of the start."""
        return cooled(self, state.resonance, state.temperature)

    def step(
        self, state: AdaptiveState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar,
        share: Any = 1.0, most: Any = NO_LIMIT, frozen: Any = None, least: Any = None,
    ) -> tuple[AdaptiveState, Command, None]:  # fmt: skip
        """One sample: `reference` and W = Wd + j Wq (peak, response unit), a temperature (degC), a share of
        K, the most voltage, whether the frequency is `frozen` and another `least` in, what to drive with out;
        the state tells the rest.

        A missing measurement (not finite) is not zero: the prediction stands in for it.
        """
        there = seen(reference, W, xp)
        d, q, damping, resonance = self._observed(state, there, reference, W, least, xp)
        resonance, temperature = warmed(self, resonance, state.temperature, temperature, xp)
        resonance = clip(resonance, self.lowest - self.start, self.highest - self.start, xp)
        frequency = self._frequency(state, resonance, xp)
        frequency = frequency if frozen is None else xp.where(frozen, state.frequencies[0], frequency)
        ahead, after = (d, q), (d, q)
        for k in range(len(state.voltages) - 1, 0, -1):  # what is on its way, the oldest first
            ahead = self._moved(ahead, damping, resonance - state.frequencies[k - 1], state.voltages[k - 1])
            after = ahead if k == len(state.voltages) - 1 else after
        detuned = self.turn * (resonance - frequency)
        held = damping * ahead[0] + detuned * ahead[1]  # -Re(lambda T Z)
        removed = share * (self.K / (1.0 - 0.5 * self.damping)) * (reference - ahead[0])
        wanted = (removed + held) * (1.0 / self.push)
        last = state.voltages[0]
        lowest, highest = within(self.lowest_voltage, self.highest_voltage, most, xp)
        voltage = slewed(wanted, last, self.slew, lowest, highest, xp)
        voltage = xp.where(xp.isfinite(reference), voltage, last)
        if len(state.voltages) == 1:  # no latency: this command acts at once
            after = self._moved((d, q), damping, resonance - frequency, voltage)
        state = AdaptiveState(
            *after, damping, resonance, temperature,
            (voltage, *state.voltages[:-1]), (frequency, *state.frequencies[:-1]), ((d, q), *state.past[:-1]),
        )  # fmt: skip
        return state, Command(voltage, self.start + frequency), None

    def _observed(
        self, state: AdaptiveState, there: Any, reference: Any, W: Any, least: Any, xp: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Z, T/tau and resonance with this sample's e: Z + (1 - keep^2) e, lambda T + (1 - keep)^2 e / Z."""
        keep_d, keep_q = self.keep
        seen, before = ((state.d, state.q), *state.past)[-2:]
        e_d = xp.where(there, W.real - (seen[0] + self.between * (before[0] - seen[0])), 0.0)
        e_q = xp.where(there, W.imag - (seen[1] + self.between * (before[1] - seen[1])), 0.0)
        d, q = state.d + (1.0 - keep_d * keep_d) * e_d, state.q + (1.0 - keep_q * keep_q) * e_q
        size, threshold = d * d + q * q, gated(self, reference, least, xp)
        learns = there & (reference > 0.0) & (size > threshold * threshold)
        rate = xp.where(learns, 1.0, 0.0) / xp.where(learns, size, 1.0)
        damping = state.damping - (1.0 - keep_d) * (1.0 - keep_d) * rate * (e_d * d + e_q * q)
        damping = clip(damping, 0.2 * self.damping, 20.0 * self.damping, xp)
        turned = (1.0 - keep_q) * (1.0 - keep_q) * (1.0 / self.turn) * rate * (e_q * d - e_d * q)
        resonance = state.resonance + turned
        return d, q, damping, resonance

    def _moved(self, Z: tuple[Any, Any], damping: Any, offset: Any, voltage: Any) -> tuple[Any, Any]:
        """Z one sample later: Z + (a Z + b T V)(1 + a/2 + a^2/6), a = lambda T: exact to a^4/24."""
        (d, q), x, y = Z, -damping, self.turn * offset
        go_d, go_q = x * d - y * q + self.push * voltage, x * q + y * d
        m_d, m_q = 1.0 + 0.5 * x + (x * x - y * y) * (1.0 / 6.0), 0.5 * y + x * y * (1.0 / 3.0)
        return d + m_d * go_d - m_q * go_q, q + m_d * go_q + m_q * go_d

    def _frequency(self, state: AdaptiveState, resonance: Any, xp: Any) -> Any:
        """The frequency to drive with, Hz above the start: the resonance, by steps of the source."""
        last = state.frequencies[0]
        wanted = clip(resonance, last - self.sweep, last + self.sweep, xp)
        if self.source is None:
            return wanted
        off, enough = resonance - last, 0.5 * self.source.step + self.dead_band
        return xp.where(off * off > enough * enough, self.source.made(wanted, xp), last)
