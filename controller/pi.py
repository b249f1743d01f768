"""The amplitude loop, a PI on Wd with voltage clip, back-calculation and feed-forward: what a DSP runs."""

import math
from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT, clip, either, seen


class PIState(NamedTuple):
    """`integral`, last `output` (drive unit); the `model`'s amplitude, the latest first (response unit)."""

    integral: Any
    output: Any
    model: tuple = ()


class PIInfo(NamedTuple):
    """For people: the measurement was `missing`; the limit of voltage or slew `saturated` the output."""

    missing: Any
    saturated: Any


class Model(NamedTuple):
    """The plate as it was identified, brought to the reference in the time that the voltage allows:

        U = clip((reference - keep M) / push),   M <- keep M + push U,   keep = e^{-T/tau},  push = G (1 -
        keep),

    the clip being that of the voltage. U at its limit until it is there is the time-optimal course of a
    first-order plant. `latest`: share of the younger of the last two amplitudes in `line` (zeros, as many as
    are remembered) that together are the amplitude a delay ago. Source: two degrees of freedom, Astrom and
    Hagglund, Advanced PID Control, 2006, section 5.3.
    """

    keep: float
    push: float
    latest: float
    line: tuple[float, ...]

    @classmethod
    def of(cls, G: float, tau: float, T: float, delay: float) -> "Model":
        """Of a plate sampled every T s, whose answer is seen `delay` s after a command."""
        keep, late = math.exp(-T / tau), math.floor(delay / T + 1e-9)
        rest = max(delay / T - late, 0.0)
        latest = math.expm1((rest - 1.0) * T / tau) / math.expm1(-T / tau)
        return cls(keep, G * (1.0 - keep), latest if rest >= 1e-9 else 1.0, (0.0,) * (late + 2))

    def expected(self, line: tuple) -> Any:
        """What the sensor shows of it now."""
        return self.latest * line[-2] + (1.0 - self.latest) * line[-1]


class PI(NamedTuple):
    """V = clip(U + Kp e + I),  I <- I + Ki_Ts e + (V - U - Kp e - I) Ki_Ts / Kp,  with e = M - Wd.

    U and M are the voltage and the amplitude, a delay ago, of the `model`; without one U = 0 and M =
    reference. The loop, and so its margins, are the same with and without. `Kp` and `Ki_Ts` are in drive unit
    per response unit. The output stays within `lowest` to `highest` and changes by `slew` at most from one
    sample to the next, all in the drive unit. A negative V is the voltage vector turned by half a carrier
    period, which brakes; an amplifier that cannot has `lowest` = 0. This step closes d only, the tracker
    brings Wq to zero.
    """

    Kp: float
    Ki_Ts: float
    lowest: float = -NO_LIMIT
    highest: float = NO_LIMIT
    slew: float = NO_LIMIT
    model: Model | None = None

    @property
    def anti_windup(self) -> float:
        """Share of a clipped voltage that the integral takes back in one sample: Ki_Ts / Kp, no unit."""
        return self.Ki_Ts / self.Kp

    def init(self) -> PIState:
        """At rest: no voltage."""
        return PIState(0.0, 0.0, () if self.model is None else self.model.line)

    def step(
        self, state: PIState, reference: Any, W: Any, xp: Any = scalar, share: Any = 1.0, most: Any = NO_LIMIT
    ) -> tuple[PIState, Any, PIInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the voltage V (peak, drive
        unit) out.

        `share` multiplies both gains: the closed loop is slower by as much, and so is the model, by the
        loop's own K. `most` is a limit of the voltage for this sample, beside its own. A missing measurement
        (not finite) is not zero: output, integral and model are held, and `info.missing` says so.
        """
        there = seen(reference, W, xp)
        lowest, highest = within(self.lowest, self.highest, most, xp)
        aim, held, model = self._aimed(state, reference, share, lowest, highest, xp)
        error = share * (aim - W.real)
        wanted = self.Kp * error + held
        output = slewed(wanted, state.output, self.slew, lowest, highest, xp)
        integral = state.integral + self.Ki_Ts * error + (output - wanted) * self.anti_windup
        after = either(there, PIState(integral, output, model), state, xp)
        return after, after.output, PIInfo(xp.logical_not(there), there & (output != wanted))

    def _aimed(
        self, state: PIState, reference: Any, share: Any, lowest: Any, highest: Any, xp: Any
    ) -> tuple[Any, Any, tuple]:
        """The amplitude that Wd should have now, the voltage without an error, U + I, and the next model."""
        if self.model is None:
            return reference, state.integral, ()
        keep, push, now = self.model.keep, self.model.push, state.model[0]
        part = xp.where(share < 1.0, share * (self.Kp * push), 1.0)
        driven = clip((part * (reference - now) + (1.0 - keep) * now) * (1.0 / push), lowest, highest, xp)
        moved = (keep * now + push * driven, *state.model[:-1])
        return self.model.expected(state.model), state.integral + driven, moved


def within(lowest: Any, highest: Any, most: Any, xp: Any) -> tuple[Any, Any]:
    """A range of voltages that includes zero, cut to +-most."""
    highest = xp.where(most < highest, most, highest)
    return xp.where(lowest < -highest, -highest, lowest), highest


def slewed(wanted: Any, last: Any, slew: Any, lowest: Any, highest: Any, xp: Any) -> Any:
    """The voltage nearest to `wanted` that is no further than `slew` from the last one and within a range."""
    return clip(clip(wanted, last - slew, last + slew, xp), lowest, highest, xp)
