"""The amplitude loop, a PI on Wd with voltage clip and back-calculation, in plain floats: what the DSP runs."""

import math
import sys
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class PIState:
    """`integral` and the last `output`, both in the drive unit."""

    integral: float
    output: float


@final
@dataclass(frozen=True)
class PIInfo:
    """For people: the measurement was `missing`, the output was `saturated` by the voltage limit."""

    missing: bool
    saturated: bool


@final
@dataclass(frozen=True)
class PI:
    """V = clip(Kp e + I),  I <- I + Ki_Ts e + (V - Kp e - I) Ki_Ts / Kp,  with e = reference - Wd.

    `Kp` and `Ki_Ts` are in drive unit per response unit, `voltage_limit` in the drive unit: the largest |V|. A negative
    V is the voltage vector turned by half a carrier period, which brakes. Both axes of the envelope have the same real
    pole, so the gains serve q as well; this step closes d only, the tracker brings Wq to zero.
    """

    Kp: float
    Ki_Ts: float
    voltage_limit: float = sys.float_info.max

    @property
    def anti_windup(self) -> float:
        """What share of a clipped voltage is taken back from the integral in one sample: Ki_Ts / Kp, no unit."""
        return self.Ki_Ts / self.Kp

    def init(self) -> PIState:
        """At rest: no voltage."""
        return PIState(0.0, 0.0)

    def step(self, state: PIState, reference: float, W: complex) -> tuple[PIState, float, PIInfo]:
        """One sample: `reference` and W = Wd + j Wq (peak, response unit) in, the voltage V (peak, drive unit) out.

        A missing measurement (not finite) is not zero: output and integral are held, and `info.missing` says so.
        """
        if not (math.isfinite(reference) and math.isfinite(W.real) and math.isfinite(W.imag)):
            return state, state.output, PIInfo(missing=True, saturated=abs(state.output) >= self.voltage_limit)
        error = reference - W.real
        wanted = self.Kp * error + state.integral
        output = min(max(wanted, -self.voltage_limit), self.voltage_limit)
        integral = state.integral + self.Ki_Ts * error + (output - wanted) * self.anti_windup
        return PIState(integral, output), output, PIInfo(missing=False, saturated=output != wanted)
