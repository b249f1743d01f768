"""Commissioning: what to do at the bench one after the other with a new controller, and what must then be seen.

All numbers follow from controller.json. One axis of the plate settles as e^{-t/tau}; half a bandwidth 1/(2 pi tau) beside the
resonance its amplitude is 1/sqrt(2) and |Wq| = |Wd|; the PI alone leaves one pole, 1 - K a sample.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

SHARE = 0.1  # of the voltage limit, at which one begins
SLOWER = 10.0  # by which the gains of the first closed loop are divided
SETTLED = math.log(20.0)  # time constants to 95 %


class Stage(NamedTuple):
    """What to do, and what is to be seen."""

    name: str
    do: str
    expect: str


def sheet(controller: Mapping[str, Any]) -> list[Stage]:
    """The stages for the content of a controller.json, each safe once the one before is as expected."""
    plant, units = controller["plant"], controller["units"]
    drive, response = units["drive"] or "", units["response"] or ""
    G, tau, f0 = plant["G"], plant["tau"], plant["f0"]
    amplitude = controller["range"]["amplitude"]
    steady = amplitude / abs(G)
    low = SHARE * (controller["voltage_limit"] or steady)
    at = "at the resonance" if f0 is None else f"at {f0:.8g} Hz"
    stages = [
        Stage(
            "demodulator",
            f"open loop: {low:.4g} {drive} {at}",
            f"Wd settles at {G * low:.4g} {response}, to 95 % in {1e3 * SETTLED * tau:.3g} ms; Wq is small beside it",
        )
    ]
    if f0 is not None:
        hb = 1 / (2 * math.pi * tau)
        stages.append(
            Stage(
                "sign of q",
                f"open loop: {low:.4g} {drive} at {f0 - hb:.8g} Hz, half a bandwidth below",
                f"Wd and Wq both at {G * low / 2:.4g} {response}; a negative Wq has the other sign. Each degree of rotation"
                f" makes the tracker settle {hb * math.tan(math.radians(1)):.3g} Hz beside the resonance",
            )
        )
    stages.append(
        Stage(
            "slow loop",
            f"gains divided by {SLOWER:g}, tracker off, ask for {G * low:.4g} {response}",
            f"without overshoot to 95 % in {1e3 * _slow(controller):.3g} ms, with {low:.4g} {drive} at the end",
        )
    )
    if controller["tracker"] and f0 is not None:
        updates = _updates(controller["tracker"], hb)
        taken = updates * controller["tracker"]["period_s"] + SETTLED * tau
        stages.append(
            Stage(
                "tracker",
                f"tracker on, begun at {f0 + hb:.8g} Hz, at the same amplitude",
                f"f within {0.1 * hb:.2g} Hz of the resonance in {1e3 * taken:.3g} ms",
            )
        )
    promise = controller["promise"]
    if promise["settling_s"] is not None:
        stages.append(
            Stage(
                "full",
                f"the gains as they are, ask for {amplitude:.4g} {response}",
                f"within 5 % after {1e3 * promise['settling_s']:.3g} ms, {steady:.4g} {drive} at the end; an overshoot of"
                f" {100 * promise['overshoot']:.2g} % at most, beside the noise",
            )
        )
    limit = controller["voltage_limit"]
    spare = "" if limit is None else f"; {limit:.4g} {drive} hold it up to {limit / steady:.3g} times the damping"
    stages.append(
        Stage("touch", "a finger on the plate", f"the amplitude comes back, the voltage rises as the damping does{spare}")
    )
    if controller["guard"] is None:
        return stages
    pulled = f"no voltage after {1e3 * controller['guard']['patience_s']:.3g} ms, and none until the fault is reset"
    return [*stages, Stage("fault", "pull the sensor's plug", pulled)]


def _slow(controller: Mapping[str, Any]) -> float:
    """Seconds to 95 % of the loop whose K is divided by SLOWER."""
    K = -math.expm1(-2 * math.pi * controller["bandwidth_Hz"] * controller["sample_time_s"])
    return SETTLED / -math.log1p(-K / SLOWER) * controller["sample_time_s"]


def _updates(tracker: Mapping[str, float], half_bandwidth: float) -> float:
    """Updates from one half bandwidth beside the resonance to a tenth of it."""
    if "step_Hz" in tracker:
        return math.ceil(0.9 * half_bandwidth / tracker["step_Hz"])
    if "gain_Hz" in tracker:
        return math.ceil(math.log(0.1) / math.log1p(-tracker["gain_Hz"] / half_bandwidth))
    return 1.0  # an observer moves there as soon as it knows
