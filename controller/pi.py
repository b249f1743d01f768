"""The amplitude loop, a PI on Wd with voltage clip and back-calculation: the paper's, and what a DSP runs."""

from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT, Full, Span, clip, seen


class PIState(NamedTuple):
    """`integral` and the last `output`, both in the drive unit."""

    integral: Any
    output: Any


class PIInfo(NamedTuple):
    """For people: the measurement was `missing`; the output was `saturated` by the voltage limit or the slew limit."""

    missing: Any
    saturated: Any


class PI(NamedTuple):
    """V = clip(Kp e + I),  I <- I + Ki_Ts e + (V - Kp e - I) Ki_Ts / Kp,  with e = reference - Wd.

    `Kp` and `Ki_Ts` are in drive unit per response unit. The output stays within `lowest` to `highest` and changes by `slew` at
    most from one sample to the next, all in the drive unit. A negative V is the voltage vector turned by half a carrier period,
    which brakes; an amplifier that cannot has `lowest` = 0. This step closes d only, the tracker brings Wq to zero.
    """

    Kp: float
    Ki_Ts: float
    lowest: float = -NO_LIMIT
    highest: float = NO_LIMIT
    slew: float = NO_LIMIT

    @property
    def anti_windup(self) -> float:
        """What share of a clipped voltage is taken back from the integral in one sample: Ki_Ts / Kp, no unit."""
        return self.Ki_Ts / self.Kp

    def init(self) -> PIState:
        """At rest: no voltage."""
        return PIState(0.0, 0.0)

    def span(self, full: Full) -> PIState:
        """The integral is a mean of outputs: I <- (1 - anti_windup) I + anti_windup V."""
        volts = Span(max(self.lowest, -full.voltage), min(self.highest, full.voltage))
        return PIState(volts, volts)

    def step(self, state: PIState, reference: Any, W: Any, xp: Any = scalar, share: Any = 1.0) -> tuple[PIState, Any, PIInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the voltage V (peak, drive unit) out.

        `share` multiplies both gains: the closed loop is slower by as much. A missing measurement (not finite) is not zero:
        output and integral are held, and `info.missing` says so.
        """
        there = seen(reference, W, xp)
        error = share * (reference - W.real)
        wanted = self.Kp * error + state.integral
        output = clip(clip(wanted, state.output - self.slew, state.output + self.slew, xp), self.lowest, self.highest, xp)
        integral = state.integral + self.Ki_Ts * error + (output - wanted) * self.anti_windup
        after = PIState(xp.where(there, integral, state.integral), xp.where(there, output, state.output))
        return after, after.output, PIInfo(xp.logical_not(there), there & (output != wanted))
