"""Commissioning a new controller: the steps at the bench, in order, and what each must show.

All numbers follow from controller.json. One axis of the plate settles as e^{-t/tau}; half a bandwidth 1/(2 pi
tau) from the resonance its amplitude is 1/sqrt(2) and |Wq| = |Wd|; the PI alone leaves one pole, 1 - K per
sample.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

SHARE = 0.1  # of the voltage limit, at which one begins
SLOWER = 10.0  # by which the gains of the first closed loop are divided
SETTLED = math.log(20.0)  # time constants to 95 %


class Stage(NamedTuple):
    """What to do, and what must be seen."""

    name: str
    do: str
    expect: str
    inputs: str = ""  # of dq_step, with enable = 1, after it was 0


def sheet(controller: Mapping[str, Any]) -> list[Stage]:
    """The stages for the content of a controller.json, each safe once the one before is as expected."""
    at = _Point.of(controller)
    return [*_open(at), *_closed(at, controller), *_disturbed(at, controller)]


def _set(task: str, **inputs: float) -> str:
    """What the exported step is told."""
    said = {"share": 1.0, "offset": 0.0} | inputs
    return ", ".join([f"task = DQ_TASK_{task}", *(f"{name} = {value:.5g}" for name, value in said.items())])


class _Point(NamedTuple):
    """What the stages drive at: the resonance (Hz; None: not known) and half its bandwidth (Hz), the whole
    `amplitude` and its `steady` voltage, the voltage `low` that one begins with and what it makes the plate
    do; the units of both."""

    tau: float
    f0: float | None
    half_bandwidth: float
    amplitude: float
    steady: float
    low: float
    small: float
    drive: str
    response: str

    @classmethod
    def of(cls, controller: Mapping[str, Any]) -> "_Point":
        """Of a controller.json."""
        plant, units, amplitude = controller["plant"], controller["units"], controller["range"]["amplitude"]
        steady = amplitude / abs(plant["G"])
        low = SHARE * (controller["voltage_limit"] or steady)
        half, words = 1 / (2 * math.pi * plant["tau"]), (units["drive"] or "", units["response"] or "")
        return cls(plant["tau"], plant["f0"], half, amplitude, steady, low, plant["G"] * low, *words)


def _open(at: _Point) -> Iterator[Stage]:
    """Demodulator and sign of q, in open loop."""
    where = "at the resonance" if at.f0 is None else f"at {at.f0:.8g} Hz"
    expect = f"Wd settles at {at.small:.4g} {at.response}, to 95 % in {1e3 * SETTLED * at.tau:.3g} ms;"
    expect += " Wq is small beside it"
    do = f"open loop: {at.low:.4g} {at.drive} "
    yield Stage("demodulator", do + where, expect, _set("OPEN_LOOP", voltage=at.low))
    if at.f0 is None:
        return
    do += f"at {at.f0 - at.half_bandwidth:.8g} Hz, half a bandwidth below"
    expect = (
        f"Wd and Wq both at {at.small / 2:.4g} {at.response}; a negative Wq has the other sign. Each degree"
        f" of rotation makes the tracker settle {at.half_bandwidth * math.tan(math.radians(1)):.3g} Hz"
        " beside the resonance"
    )
    yield Stage("sign of q", do, expect, _set("OPEN_LOOP", voltage=at.low, offset=-at.half_bandwidth))


def _closed(at: _Point, controller: Mapping[str, Any]) -> Iterator[Stage]:
    """The slow loop alone, with its tracker, and the whole."""
    do = f"gains divided by {SLOWER:g}, tracker off, ask for {at.small:.4g} {at.response}"
    T = controller["sample_time_s"]
    K = -math.expm1(-2 * math.pi * controller["bandwidth_Hz"] * T) / SLOWER
    expect = f"without overshoot to 95 % in {1e3 * SETTLED / -math.log1p(-K) * T:.3g} ms,"
    expect += f" with {at.low:.4g} {at.drive} at the end"
    yield Stage("slow loop", do, expect, _set("AMPLITUDE", reference=at.small, share=1 / SLOWER))
    tracker, promise = controller["tracker"], controller["promise"]
    if tracker and at.f0 is not None:
        taken = _updates(tracker, at.half_bandwidth) * tracker["period_s"] + SETTLED * at.tau
        expect = f"f within {0.1 * at.half_bandwidth:.2g} Hz of the resonance in {1e3 * taken:.3g} ms"
        do = f"tracker on, begun at {at.f0 + at.half_bandwidth:.8g} Hz, at the same amplitude"
        yield Stage("tracker", do, expect, _set("REGULATE", reference=at.small, offset=at.half_bandwidth))
    if promise["settling_s"] is not None:
        expect = (
            f"within 5 % after {1e3 * promise['settling_s']:.3g} ms, {at.steady:.4g} {at.drive} at the end;"
        )
        expect += f" an overshoot of {100 * promise['overshoot']:.2g} % at most, beside the noise"
        do = f"the gains as they are, in run ask for {at.amplitude:.4g} {at.response}"
        yield Stage("full", do, expect, _set("REGULATE", reference=at.amplitude))


def _disturbed(at: _Point, controller: Mapping[str, Any]) -> Iterator[Stage]:
    """A touch, and a fault."""
    limit, guard = controller["voltage_limit"], controller["guard"]
    expect = "the amplitude comes back, the voltage rises as the damping does"
    if limit is not None:
        expect += f"; {limit:.4g} {at.drive} hold it up to {limit / at.steady:.3g} times the damping"
    yield Stage("touch", "a finger on the plate", expect)
    if guard is not None:
        expect = f"no voltage after {1e3 * guard['patience_s']:.3g} ms, and none until the fault is reset"
        yield Stage("fault", "pull the sensor's plug", expect)


def _updates(tracker: Mapping[str, float], half_bandwidth: float) -> float:
    """Updates from one half bandwidth beside the resonance to a tenth of it."""
    if "step_Hz" in tracker:
        return math.ceil(0.9 * half_bandwidth / tracker["step_Hz"])
    if "gain_Hz" in tracker:
        return math.ceil(math.log(0.1) / math.log1p(-tracker["gain_Hz"] / half_bandwidth))
    return 1.0  # an observer moves there as soon as it knows
